// Where the view ray runs through the cone of the only spot, for placing steps in its projection.
// Uses `ray`, so it is included after it is declared.

vec2 cone_interval(float begin, float end) {
    vec3 axis = lights[0].axis.xyz;
    float k = lights[0].cone.w * lights[0].cone.w;
    vec3 o = ray.anchor - lights[0].position.xyz;
    float od = dot(o, axis);
    float dd = dot(ray.direction, axis);
    // (p . axis)^2 = cos^2 |p|^2 on the double cone.
    float a = dd * dd - k;
    float b = od * dd - k * dot(o, ray.direction);
    float c = od * od - k * dot(o, o);
    float discriminant = b * b - a * c;
    vec2 span;
    if (abs(a) < 1e-12) {
        if (abs(b) < 1e-30) return vec2(1.0, 0.0);
        float t = -0.5 * c / b;
        span = b > 0.0 ? vec2(t, end) : vec2(begin, t);
    } else if (discriminant <= 0.0) {
        // No crossing: all of the line is inside one nappe, or none is.
        if (a > 0.0) span = vec2(begin, end); else return vec2(1.0, 0.0);
    } else {
        float root = sqrt(discriminant);
        float q = b >= 0.0 ? -b - root : -b + root;
        float t0 = q / a;
        float t1 = c / q;
        if (t0 > t1) { float swap = t0; t0 = t1; t1 = swap; }
        bool front0 = od + t0 * dd > 0.0;
        bool front1 = od + t1 * dd > 0.0;
        if (a < 0.0) {
            if (!front0) return vec2(1.0, 0.0);
            span = vec2(t0, t1);
        } else if (front0 && front1) {
            span = vec2(begin, end);  // cannot happen for a single nappe; keep everything
        } else {
            span = dd > 0.0 ? vec2(front1 ? t1 : t0, end) : vec2(begin, front0 ? t0 : t1);
        }
    }
    return vec2(max(span.x, begin), min(span.y, end));
}
