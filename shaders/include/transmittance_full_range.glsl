// Transmittance function maps [TFM11] section 5: cosine coefficients over the whole way of the light ray through the volume's
// bounds. All texels share that range, so the texture unit may interpolate the coefficients.

vec3 grid_transmittance(int i, int v, vec3 position, vec3 travel) {
    int m = i * VOLUME_COUNT + v;
    vec3 y = position - light_maps[m].centre.xyz;
    vec2 uv;
    if (!map_coordinate(m, y, uv)) return vec3(1.0);
    vec2 span = volume_interval(v, position, travel);
    if (span.x >= span.y) return vec3(1.0);
#if HAS_POINT
    if (lights[i].position.w > 0.5) span.x = max(span.x, -length(position - lights[i].position.xyz));
#endif
    if (span.x >= 0.0) return vec3(1.0);
    float x = clamp(-span.x / (span.y - span.x), 0.0, 1.0);
    vec2 atlas = vec2(textureSize(map_values0, 0));
    vec2 texel = (light_maps[m].tile.xy + clamp(uv * map_size, vec2(0.5), vec2(map_size - 0.5))) / atlas;
    vec4 c[MAP_LAYERS];
    c[0] = texture(map_values0, texel);
#if MAP_LAYERS > 1
    c[1] = texture(map_values1, texel);
#endif
#if MAP_LAYERS > 2
    c[2] = texture(map_values2, texel);
#endif
#if MAP_LAYERS > 3
    c[3] = texture(map_values3, texel);
#endif
#if MAP_LAYERS > 4
    c[4] = texture(map_values4, texel);
#endif
    return raised(clamp(map_curve(c, x), 0.0, 1.0), volumes[v].strength.rgb * light_maps[m].tile.z);
}
