// The optical depth on the light's way to every place, from a light-space grid: slices of a map at even distances from the light.

uniform sampler3D light_slices;  // distance, u, v
uniform vec3 slices_texel;       // 1 / its size
uniform float slice_count;

vec3 grid_transmittance(int i, int v, vec3 position, vec3 travel) {
    int m = i * VOLUME_COUNT + v;
    vec3 y = position - light_maps[m].centre.xyz;
    vec4 h = light_maps[m].to_map * vec4(y, 1.0);
    vec2 uv = h.xy;
    float slice = h.z;
    bool covered = h.w > 0.0;
#if HAS_POINT
    int kind = int(light_maps[m].centre.w);
    if (kind != MAP_ORTHOGRAPHIC) {
        float k = distance_along_light(kind, y, light_maps[m].from_light);
        slice = (k - light_maps[m].slices.x) * light_maps[m].slices.y;
        uv = kind == MAP_OCTAHEDRAL ? octahedral_encode(h.xyz) : h.xy / h.w;
        covered = covered || kind == MAP_OCTAHEDRAL;
    }
#endif
    // Beside the map there is nothing on the way, as its border texels say.
    vec2 texel = light_maps[m].tile.xy + clamp(uv * light_maps[m].slices.zw, vec2(0.5), light_maps[m].slices.zw - 0.5);
    vec3 place = vec3(clamp(slice, 0.0, slice_count - 1.0) + 0.5, texel) * slices_texel;
    float depth = covered ? texture(light_slices, place).r : 0.0;
#if CHROMATIC
    return exp(-volumes[v].strength.rgb * (light_maps[m].tile.z * depth));
#else
    return vec3(exp(-volumes[v].strength.r * light_maps[m].tile.z * depth));
#endif
}
