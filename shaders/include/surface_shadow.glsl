// Shadows of meshes on surfaces: the light's shadow map against the plane of the surface. SHADOW_KIND and SHADOW_FACES are those of the
// light.

#if HAS_SHADOW_MAPS
uniform sampler2D shadow_depths;  // the shadow atlas, read texel by texel

// Steepest plane towards the light that a shadow is looked up on, the tangent of its angle. Of a steeper one a texel of the map spans so
// much that beyond it there may be something else.
const float STEEPEST_PLANE = 4.0;

// The face of a light's shadow map that a position lies in; -1 where it lies in none.
int shadow_face(int i, vec3 position) {
    if (SHADOW_KIND == SHADOW_CUBE) {
        vec3 d = position - lights[i].position.xyz;
        vec3 a = abs(d);
        if (a.x >= a.y && a.x >= a.z) return d.x > 0.0 ? 0 : 1;
        if (a.y >= a.z) return d.y > 0.0 ? 2 : 3;
        return d.z > 0.0 ? 4 : 5;
    }
    for (int face = 0; face < min(SHADOW_FACES, 2); ++face) {
        vec4 p = lights[i].shadow_matrix[face] * vec4(position, 1.0);
        if (p.w > 0.0 && max(abs(p.x), abs(p.y)) < p.w) return face;
    }
    return -1;
}

// Place in a face, 0 to 1, and the depth that the map would hold there. `matrix` is that of the face.
vec3 shadow_place(int i, int face, mat4 matrix, vec3 position) {
    vec3 d = position - lights[i].position.xyz;
    if (SHADOW_KIND == SHADOW_CUBE) {
        float major = max(abs(face < 2 ? d.x : face < 4 ? d.y : d.z), 1e-30);
        vec2 across = face < 2 ? d.yz : face < 4 ? d.zx : d.xy;
        return vec3(across / major * 0.5 + 0.5, length(d) / lights[i].shadow.w);
    }
    vec4 p = matrix * vec4(position, 1.0);
    if (SHADOW_KIND == SHADOW_ORTHOGRAPHIC) return p.xyz * 0.5 + 0.5;
    return vec3(p.xy / p.w * 0.5 + 0.5, length(d) / lights[i].shadow.w);
}

// How much of light i reaches a position on a surface past the meshes, 0 to 1. The map's texels around it are compared each with the
// depth of the surface's own plane there, so that a surface does not shade itself and shadows begin where they are cast.
float surface_visibility(int i, vec3 position, vec3 plane) {
    vec4 shadow = lights[i].shadow;
    int face = shadow_face(i, position);
    if (face < 0) return 1.0;
    // Picked, not indexed: an index that differs between pixels costs a processor more than the arithmetic.
    mat4 matrix = lights[i].shadow_matrix[0];
    if (SHADOW_FACES == 2 && face == 1) matrix = lights[i].shadow_matrix[1];
    vec3 here = shadow_place(i, face, matrix, position);
    vec3 tangent = normalize(abs(plane.x) < 0.7 ? cross(plane, vec3(1.0, 0.0, 0.0)) : cross(plane, vec3(0.0, 1.0, 0.0)));
    vec3 bitangent = cross(plane, tangent);
    vec3 along;
    vec3 beside;
    // Depth that the whole map spans, or that lies before the surface.
    float worth;
    if (SHADOW_KIND == SHADOW_ORTHOGRAPHIC) {
        float size = 2.0 / length(vec3(matrix[0][0], matrix[1][0], matrix[2][0]));
        along = 0.5 * size * (mat3(matrix) * tangent);
        beside = 0.5 * size * (mat3(matrix) * bitangent);
        worth = 0.5 * size * length(vec3(matrix[0][2], matrix[1][2], matrix[2][2]));
    } else {
        // Far enough for the difference to keep its digits: a hundredth of the distance.
        float size = 1e-2 * length(position - lights[i].position.xyz);
        along = shadow_place(i, face, matrix, position + size * tangent) - here;
        beside = shadow_place(i, face, matrix, position + size * bitangent) - here;
        worth = here.z;
    }
    float area = along.x * beside.y - along.y * beside.x;
    float texel = 2.0 * shadow_tiling.w;
    vec2 slope = vec2(0.0);
    if (abs(area) > 1e-12)
        slope = vec2(along.z * beside.y - beside.z * along.y, beside.z * along.x - along.z * beside.x) / area;
    // Depth across one texel: more than a few texels' worth is a surface that the light grazes, of which a texel cannot tell.
    float steep = length(slope) / max(worth, 1e-30);
    float kept = min(steep, STEEPEST_PLANE);
    slope *= kept / max(steep, 1e-30);
    // What of the slope is not followed, what rounding of the plane to half floats makes of it, and a little.
    float slack = texel * worth * (min(steep - kept, 1e3) + 1e-3 * kept * kept + 0.02 * (1.0 + kept)) + 1e-6;
    vec2 p = here.xy / texel - 0.5;
    vec2 corner = floor(p);
    vec2 f = p - corner;
    // Depths of the plane at the four texels, which are 1 where a map is clear: what lies beyond its depths is not shadowed there.
    vec2 step_of_depth = slope * texel;
    vec4 depth = vec4(here.z - dot(step_of_depth, f) - slack);
    depth.yw += step_of_depth.x;
    depth.zw += step_of_depth.y;
    depth = min(depth, vec4(1.0));
    // Texels of the face's tile in the atlas.
    float tile = shadow.y + float(face);
    float row = floor((tile + 0.5) / shadow_tiling.z);
    int last = int(1.0 / texel + 0.5) - 1;
    ivec2 first = ivec2(int(tile - row * shadow_tiling.z), int(row)) * (last + 1);
    ivec2 a = clamp(ivec2(corner), ivec2(0), ivec2(last));
    ivec2 b = clamp(ivec2(corner) + 1, ivec2(0), ivec2(last)) + first;
    a += first;
    vec4 held = vec4(texelFetch(shadow_depths, a, 0).r, texelFetch(shadow_depths, ivec2(b.x, a.y), 0).r,
                     texelFetch(shadow_depths, ivec2(a.x, b.y), 0).r, texelFetch(shadow_depths, b, 0).r);
    vec4 seen = vec4(lessThanEqual(depth, held));
    return mix(mix(seen.x, seen.y, f.x), mix(seen.z, seen.w, f.x), f.y);
}
#else
float surface_visibility(int i, vec3 position, vec3 plane) {
    return 1.0;
}
#endif
