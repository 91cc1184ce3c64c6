// The lights, reduced to directions and centres, and the shadows that meshes cast.

struct Light {
    vec4 position;     // point: position; distant: direction of travel. w: 0 distant, 1 point
    vec4 strength;     // irradiance (distant) or radiant intensity (point); w: radius below which 1/d^2 stops growing
    vec4 axis;         // direction of the light's axis; w: 1 when it emits with the cosine to its axis (disk, rect)
    vec4 cone;         // inner and outer angle in radians, focus, cosine of the outer angle
    vec4 focus_tint;   // rgb; w: 0, or 1 + the sine of the outer angle when the light is shaped
    vec4 shadow;       // SHADOW_*, first tile, number of faces, far distance
    mat4 shadow_matrix[2];
};

const int SHADOW_NONE = 0;
const int SHADOW_ORTHOGRAPHIC = 1;
const int SHADOW_PERSPECTIVE = 2;
const int SHADOW_CUBE = 3;

layout(std140) uniform Lights { Light lights[LIGHT_CAPACITY]; };

#if LIGHT_CAPACITY > 1
uniform int light_count;
#else
const int light_count = 1;
#endif

// UsdLux ShapingAPI: 1 - smoothstep(theta, (1 - softness) cone, cone), times lerp(focusTint, 1, cos^focus). Not `cut`, the light goes on
// outside its cone, for who finds the cone's edge himself.
vec3 shaping(int i, vec3 travel, bool cut) {
    vec3 factor = vec3(1.0);
#if HAS_SHAPING || HAS_COSINE
    float cosine = dot(travel, lights[i].axis.xyz);
#endif
#if HAS_SHAPING
    if (lights[i].focus_tint.w > 0.5) {
        vec4 cone = lights[i].cone;
        if (cut && cosine < cone.w) return vec3(0.0);
#if HAS_SOFT_CONES
        if (cone.x < cone.y && cone.w > -1.5) {
            // Angle to the cone's edge, from its own sine and cosine: as the difference of two angles it would have no digits there. The
            // polynomial is 1 - s s (3 - 2 s) with s = 1 - t, for the same reason.
            vec2 edge = vec2(cone.w, lights[i].focus_tint.w - 1.0);
            float sine = length(cross(travel, lights[i].axis.xyz));
            float inside = 2.0 * atan((edge.y * cosine - edge.x * sine) / max(1.0 + edge.x * cosine + edge.y * sine, 1e-6));
            float t = clamp(inside / (cone.y - cone.x), 0.0, 1.0);
            factor *= t * t * (3.0 - 2.0 * t);
        }
#endif
#if HAS_FOCUS
        if (cone.z > 0.0) factor *= mix(lights[i].focus_tint.rgb, vec3(1.0), pow(max(cosine, 1e-6), cone.z));
#endif
    }
#endif
#if HAS_COSINE
    if (lights[i].axis.w > 0.5) factor *= max(cosine, 0.0);
#endif
    return factor;
}

// Direction in which the light travels at a position; `inverse_square` is 1/d^2, or 1 for a distant light.
vec3 light_travel(int i, vec3 position, out float inverse_square) {
    inverse_square = 1.0;
#if HAS_POINT
    if (lights[i].position.w > 0.5) {
        vec3 offset = position - lights[i].position.xyz;
        float square = dot(offset, offset);
        float radius = lights[i].strength.w;
        inverse_square = 1.0 / max(max(square, radius * radius), 1e-30);
        return offset * inversesqrt(max(square, 1e-30));
    }
#endif
    return lights[i].position.xyz;
}

#if HAS_SHADOW_MAPS
uniform sampler2DShadow shadow_atlas;
uniform vec4 shadow_tiling;  // size of a tile in the atlas (u, v), tiles per row, half a texel of a tile

float shadow_fetch(float tile, vec2 uv, float depth) {
    float row = floor((tile + 0.5) / shadow_tiling.z);
    vec2 cell = vec2(tile - row * shadow_tiling.z, row);
    uv = clamp(uv, vec2(shadow_tiling.w), vec2(1.0 - shadow_tiling.w));
    return texture(shadow_atlas, vec3((cell + uv) * shadow_tiling.xy, depth));
}
#endif

#if HAS_SHADOW_MAPS
// Whether a place in a face lies where the lookup reads no other.
bool in_tile(vec2 uv) {
    return all(greaterThan(uv, vec2(shadow_tiling.w))) && all(lessThan(uv, vec2(1.0 - shadow_tiling.w)));
}
#endif

// How much of light i reaches a position past the meshes, 0 to 1.
float visibility(int i, vec3 position) {
#if HAS_SHADOW_MAPS
    vec4 shadow = lights[i].shadow;
    int kind = int(shadow.x);
    float tile = shadow.y;
    vec2 uv;
    float depth;
    bool covered;
    // One lookup for all kinds of maps: software skips none of them by a branch.
#if HAS_POINT
    vec3 d = position - lights[i].position.xyz;
    depth = length(d) / shadow.w;
    vec4 p = lights[i].shadow_matrix[0] * vec4(position, 1.0);
    covered = p.w > 0.0;
    uv = p.xy / p.w * 0.5 + 0.5;
    if (kind == SHADOW_ORTHOGRAPHIC) depth = p.z * 0.5 + 0.5;
#if HAS_CUBES
    if (kind == SHADOW_CUBE) {
        vec3 a = abs(d);
        float face;
        if (a.x >= a.y && a.x >= a.z) { face = d.x > 0.0 ? 0.0 : 1.0; uv = d.yz / a.x; }
        else if (a.y >= a.z) { face = d.y > 0.0 ? 2.0 : 3.0; uv = d.zx / a.y; }
        else { face = d.z > 0.0 ? 4.0 : 5.0; uv = d.xy / max(a.z, 1e-30); }
        tile += face;
        uv = uv * 0.5 + 0.5;
        covered = true;
    }
#endif
#else
    vec3 p = (lights[i].shadow_matrix[0] * vec4(position, 1.0)).xyz * 0.5 + 0.5;
    uv = p.xy;
    depth = p.z;
    covered = true;
#endif
    // A closer map of the media comes before the one of everything.
    if (kind == SHADOW_ORTHOGRAPHIC && shadow.z > 1.5 && !in_tile(uv)) {
        vec3 wide = (lights[i].shadow_matrix[1] * vec4(position, 1.0)).xyz * 0.5 + 0.5;
        uv = wide.xy;
        depth = wide.z;
        tile += 1.0;
    }
    if (kind == SHADOW_NONE || kind < 0 || !covered) return 1.0;
    if (kind == SHADOW_ORTHOGRAPHIC && !in_tile(uv)) return 1.0;
    if (kind == SHADOW_PERSPECTIVE && (any(lessThan(uv, vec2(0.0))) || any(greaterThan(uv, vec2(1.0))))) return 1.0;
    return shadow_fetch(tile, uv, depth);
#else
    return 1.0;
#endif
}
