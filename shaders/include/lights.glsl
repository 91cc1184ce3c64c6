// The lights, reduced to directions and centres, and the shadows that meshes cast.

struct Light {
    vec4 position;     // point: position; distant: direction of travel. w: 0 distant, 1 point
    vec4 strength;     // irradiance (distant) or radiant intensity (point); w: radius below which 1/d^2 stops growing
    vec4 axis;         // direction of the light's axis; w: 1 when it emits with the cosine to its axis (disk, rect)
    vec4 cone;         // inner and outer angle in radians, focus, cosine of the outer angle
    vec4 focus_tint;   // rgb; w: 1 when the light is shaped
    vec4 shadow;       // SHADOW_*, first tile, number of faces, far distance
    mat4 shadow_matrix[2];
};

const int SHADOW_NONE = 0;
const int SHADOW_ORTHOGRAPHIC = 1;
const int SHADOW_PERSPECTIVE = 2;
const int SHADOW_CUBE = 3;

// Steepest plane towards the light that a shadow is looked up on, the tangent of its angle. Of a steeper one a texel of the map spans so
// much that beyond it there may be something else.
const float STEEPEST_PLANE = 4.0;

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
        if (cone.x < cone.y) {
            // Angle to the cone's edge, from its own sine and cosine: as the difference of two angles it would have no digits there. The
            // polynomial is 1 - s s (3 - 2 s) with s = 1 - t, for the same reason.
            vec2 edge = vec2(cos(cone.y), sin(cone.y));
            float sine = length(cross(travel, lights[i].axis.xyz));
            float inside = atan(edge.y * cosine - edge.x * sine, edge.x * cosine + edge.y * sine);
            float t = clamp(inside / (cone.y - cone.x), 0.0, 1.0);
            factor *= t * t * (3.0 - 2.0 * t);
        }
        if (cone.z > 0.0) factor *= mix(lights[i].focus_tint.rgb, vec3(1.0), pow(max(cosine, 1e-6), cone.z));
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

// How much of light i reaches a position past the meshes, 0 to 1.
float visibility(int i, vec3 position) {
#if HAS_SHADOW_MAPS
    vec4 shadow = lights[i].shadow;
    int kind = int(shadow.x);
    if (kind == SHADOW_ORTHOGRAPHIC) {
        for (int face = 0; face < int(shadow.z); ++face) {
            vec3 p = (lights[i].shadow_matrix[face] * vec4(position, 1.0)).xyz * 0.5 + 0.5;
            if (all(greaterThan(p.xy, vec2(shadow_tiling.w))) && all(lessThan(p.xy, vec2(1.0 - shadow_tiling.w))))
                return shadow_fetch(shadow.y + float(face), p.xy, p.z);
        }
        return 1.0;
    }
    if (kind == SHADOW_PERSPECTIVE) {
        vec4 p = lights[i].shadow_matrix[0] * vec4(position, 1.0);
        if (p.w <= 0.0) return 1.0;
        vec2 uv = p.xy / p.w * 0.5 + 0.5;
        if (any(lessThan(uv, vec2(0.0))) || any(greaterThan(uv, vec2(1.0)))) return 1.0;
        return shadow_fetch(shadow.y, uv, length(position - lights[i].position.xyz) / shadow.w);
    }
    if (kind == SHADOW_CUBE) {
        vec3 d = position - lights[i].position.xyz;
        vec3 a = abs(d);
        float face;
        vec2 uv;
        if (a.x >= a.y && a.x >= a.z) { face = d.x > 0.0 ? 0.0 : 1.0; uv = d.yz / a.x; }
        else if (a.y >= a.z) { face = d.y > 0.0 ? 2.0 : 3.0; uv = d.zx / a.y; }
        else { face = d.z > 0.0 ? 4.0 : 5.0; uv = d.xy / max(a.z, 1e-30); }
        return shadow_fetch(shadow.y + face, uv * 0.5 + 0.5, length(d) / shadow.w);
    }
#endif
    return 1.0;
}

#if HAS_SHADOW_MAPS
// The face of a light's shadow map that a position lies in; -1 where it lies in none.
int shadow_face(int i, vec3 position) {
    int kind = int(lights[i].shadow.x);
    if (kind == SHADOW_CUBE) {
        vec3 d = position - lights[i].position.xyz;
        vec3 a = abs(d);
        if (a.x >= a.y && a.x >= a.z) return d.x > 0.0 ? 0 : 1;
        if (a.y >= a.z) return d.y > 0.0 ? 2 : 3;
        return d.z > 0.0 ? 4 : 5;
    }
    for (int face = 0; face < int(lights[i].shadow.z); ++face) {
        vec4 p = lights[i].shadow_matrix[face] * vec4(position, 1.0);
        if (p.w > 0.0 && max(abs(p.x), abs(p.y)) < p.w) return face;
    }
    return -1;
}

// Place in a face, 0 to 1, and the depth that the map would hold there.
vec3 shadow_place(int i, int face, vec3 position) {
    int kind = int(lights[i].shadow.x);
    vec3 d = position - lights[i].position.xyz;
    if (kind == SHADOW_CUBE) {
        float major = max(abs(face < 2 ? d.x : face < 4 ? d.y : d.z), 1e-30);
        vec2 across = face < 2 ? d.yz : face < 4 ? d.zx : d.xy;
        return vec3(across / major * 0.5 + 0.5, length(d) / lights[i].shadow.w);
    }
    vec4 p = lights[i].shadow_matrix[face] * vec4(position, 1.0);
    if (kind == SHADOW_ORTHOGRAPHIC) return p.xyz * 0.5 + 0.5;
    return vec3(p.xy / p.w * 0.5 + 0.5, length(d) / lights[i].shadow.w);
}
#endif

// How much of light i reaches a position on a surface past the meshes, 0 to 1. The map's texels around it are compared each with the
// depth of the surface's own plane there, so that a surface does not shade itself and shadows begin where they are cast.
float surface_visibility(int i, vec3 position, vec3 plane) {
#if HAS_SHADOW_MAPS
    vec4 shadow = lights[i].shadow;
    if (int(shadow.x) <= SHADOW_NONE) return 1.0;
    int face = shadow_face(i, position);
    if (face < 0) return 1.0;
    vec3 here = shadow_place(i, face, position);
    // Far enough for the difference to keep its digits: a hundredth of what the map spans.
    float size = 1e-2 * (int(shadow.x) == SHADOW_ORTHOGRAPHIC
        ? 2.0 / length(vec3(lights[i].shadow_matrix[face][0][0], lights[i].shadow_matrix[face][1][0], lights[i].shadow_matrix[face][2][0]))
        : length(position - lights[i].position.xyz));
    vec3 tangent = normalize(abs(plane.x) < 0.7 ? cross(plane, vec3(1.0, 0.0, 0.0)) : cross(plane, vec3(0.0, 1.0, 0.0)));
    vec3 along = shadow_place(i, face, position + size * tangent) - here;
    vec3 beside = shadow_place(i, face, position + size * cross(plane, tangent)) - here;
    float area = along.x * beside.y - along.y * beside.x;
    float texel = 2.0 * shadow_tiling.w;
    vec2 slope = vec2(0.0);
    if (abs(area) > 1e-12)
        slope = vec2(along.z * beside.y - beside.z * along.y, beside.z * along.x - along.z * beside.x) / area;
    // Depth across one texel: more than a few texels' worth is a surface that the light grazes, of which a texel cannot tell.
    float worth = int(shadow.x) == SHADOW_ORTHOGRAPHIC
        ? 50.0 * size * length(vec3(lights[i].shadow_matrix[face][0][2], lights[i].shadow_matrix[face][1][2], lights[i].shadow_matrix[face][2][2]))
        : here.z;
    float steep = length(slope) / max(worth, 1e-30);
    float kept = min(steep, STEEPEST_PLANE);
    slope *= kept / max(steep, 1e-30);
    // What of the slope is not followed, what rounding of the plane to half floats makes of it, and a little.
    float slack = texel * worth * (min(steep - kept, 1e3) + 1e-3 * kept * kept + 0.02 * (1.0 + kept)) + 1e-6;
    vec2 p = here.xy / texel - 0.5;
    vec2 corner = floor(p);
    vec2 f = p - corner;
    float seen[4];
    for (int n = 0; n < 4; ++n) {
        vec2 centre = (corner + vec2(n & 1, n >> 1) + 0.5) * texel;
        seen[n] = shadow_fetch(shadow.y + float(face), centre, here.z + dot(slope, centre - here.xy) - slack);
    }
    return mix(mix(seen[0], seen[1], f.x), mix(seen[2], seen[3], f.x), f.y);
#else
    return 1.0;
#endif
}
