// The optical depth on the light's way to every place, from a light-space grid: slices of a map at even distances from the light.

uniform sampler3D light_slices;  // distance, u, v
uniform float slice_count;

vec3 grid_transmittance(int i, int v, vec3 position, vec3 travel) {
    int m = i * VOLUME_COUNT + v;
    vec3 y = position - light_maps[m].centre.xyz;
    vec2 uv;
    if (!map_coordinate(m, y, uv)) return vec3(1.0);
    float k = distance_along_light(int(light_maps[m].centre.w), y, light_maps[m].from_light);
    float slice = clamp((k - light_maps[m].slices.x) * light_maps[m].slices.y, 0.0, slice_count - 1.0);
    vec2 texel = light_maps[m].tile.xy + clamp(uv * map_size, vec2(0.5), vec2(map_size - 0.5));
    float depth = texture(light_slices, vec3(slice + 0.5, texel) / vec3(textureSize(light_slices, 0))).r;
#if CHROMATIC
    return exp(-volumes[v].strength.rgb * (light_maps[m].tile.z * depth));
#else
    return vec3(exp(-volumes[v].strength.r * light_maps[m].tile.z * depth));
#endif
}
