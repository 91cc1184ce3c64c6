// A ray per pixel, anchored on a plane through the scene so that a far camera costs no digits.

uniform mat3 camera_anchor;     // columns: at (0, 0), change along u, change along v
uniform mat3 camera_direction;  // likewise; advances one unit along the camera's axis
uniform vec3 camera_depths;     // depth of the anchor plane, near, far

struct Ray {
    vec3 anchor;
    vec3 direction;  // unit length
    float per_depth; // distance along the ray per unit of depth along the axis
};

Ray camera_ray(vec2 uv) {
    vec3 d = camera_direction[0] + uv.x * camera_direction[1] + uv.y * camera_direction[2];
    float l = length(d);
    return Ray(camera_anchor[0] + uv.x * camera_anchor[1] + uv.y * camera_anchor[2], d / l, l);
}

// Distances from the anchor to the near and far plane.
vec2 camera_range(Ray ray) {
    return (camera_depths.yz - camera_depths.x) * ray.per_depth;
}

float camera_depth(Ray ray, float s) {
    return camera_depths.x + s / ray.per_depth;
}
