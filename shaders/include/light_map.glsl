// Where a point lies in the transmittance map of one light through one volume. A point is given relative to the volume's centre, and
// distances along a light ray count from the centre's: |x - L| - |c - L|, written so that a far light costs no digits.

const int MAP_ORTHOGRAPHIC = 0;
const int MAP_PERSPECTIVE = 1;
const int MAP_OCTAHEDRAL = 2;

vec2 octahedral_encode(vec3 d) {
    d /= abs(d.x) + abs(d.y) + abs(d.z);
    vec2 p = d.z >= 0.0 ? d.xy : (1.0 - abs(d.yx)) * vec2(d.x >= 0.0 ? 1.0 : -1.0, d.y >= 0.0 ? 1.0 : -1.0);
    return p * 0.5 + 0.5;
}

vec3 octahedral_decode(vec2 uv) {
    vec2 p = uv * 2.0 - 1.0;
    vec3 d = vec3(p, 1.0 - abs(p.x) - abs(p.y));
    if (d.z < 0.0) d.xy = (1.0 - abs(d.yx)) * vec2(p.x >= 0.0 ? 1.0 : -1.0, p.y >= 0.0 ? 1.0 : -1.0);
    return normalize(d);
}

float distance_along_light(int kind, vec3 y, vec4 from_light) {
    if (kind == MAP_ORTHOGRAPHIC) return dot(y, from_light.xyz);
    vec3 e = from_light.xyz;
    return dot(y, y + 2.0 * e) / max(length(y + e) + from_light.w, 1e-30);
}
