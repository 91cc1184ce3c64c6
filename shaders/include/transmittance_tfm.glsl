// Adaptive transmittance function maps [ATFM12]: cosine coefficients over a range of its own in every texel, which ends where
// the curve has fallen below a threshold. Neighbouring texels have different ranges, so their coefficients cannot be
// interpolated: the four curves are evaluated and their transmittance is blended.

uniform sampler2D map_range;

float curve(ivec2 texel, float k) {
    vec2 range = texelFetch(map_range, texel, 0).xy;
    float x = (k - range.x) / (range.y - range.x);
    if (x <= 0.0) return 1.0;
    vec4 c[MAP_LAYERS];
    c[MAP_LAYERS - 1] =
#if MAP_LAYERS == 1
        texelFetch(map_coefficients0, texel, 0);
#elif MAP_LAYERS == 2
        texelFetch(map_coefficients1, texel, 0);
#elif MAP_LAYERS == 3
        texelFetch(map_coefficients2, texel, 0);
#elif MAP_LAYERS == 4
        texelFetch(map_coefficients3, texel, 0);
#else
        texelFetch(map_coefficients4, texel, 0);
#endif
    float tail = c[COEFFICIENTS >> 2][COEFFICIENTS & 3];
    float end = c[(COEFFICIENTS + 1) >> 2][(COEFFICIENTS + 1) & 3];
    if (x >= 1.0) return end * exp(-tail * (x - 1.0));
#if MAP_LAYERS > 1
    c[0] = texelFetch(map_coefficients0, texel, 0);
#endif
#if MAP_LAYERS > 2
    c[1] = texelFetch(map_coefficients1, texel, 0);
#endif
#if MAP_LAYERS > 3
    c[2] = texelFetch(map_coefficients2, texel, 0);
#endif
#if MAP_LAYERS > 4
    c[3] = texelFetch(map_coefficients3, texel, 0);
#endif
    // A transmittance never rises: inside the range it lies between 1 and its value at the end.
    return clamp(cosine_series(c, x), end, 1.0);
}

ivec2 map_texel(int m, ivec2 p) {
    int last = int(map_size) - 1;
    if (int(light_maps[m].centre.w) == MAP_OCTAHEDRAL) {
        // The square's edges are folded onto themselves.
        if (p.x < 0) p = ivec2(-1 - p.x, last - p.y);
        if (p.x > last) p = ivec2(2 * last + 1 - p.x, last - p.y);
        if (p.y < 0) p = ivec2(last - p.x, -1 - p.y);
        if (p.y > last) p = ivec2(last - p.x, 2 * last + 1 - p.y);
    }
    return ivec2(light_maps[m].tile.xy) + clamp(p, ivec2(0), ivec2(last));
}

vec3 grid_transmittance(int i, int v, vec3 position, vec3 travel) {
    int m = i * VOLUME_COUNT + v;
    vec3 y = position - light_maps[m].centre.xyz;
    vec2 uv;
    if (!map_coordinate(m, y, uv)) return vec3(1.0);
    float k = distance_along_light(int(light_maps[m].centre.w), y, light_maps[m].from_light);
    vec3 exponent = volumes[v].strength.rgb * light_maps[m].tile.z;
    vec2 p = uv * map_size;
#if MAP_BLEND
    p -= 0.5;
    ivec2 corner = ivec2(floor(p));
    vec2 f = p - vec2(corner);
    vec3 row0 = mix(raised(curve(map_texel(m, corner), k), exponent),
                    raised(curve(map_texel(m, corner + ivec2(1, 0)), k), exponent), f.x);
    vec3 row1 = mix(raised(curve(map_texel(m, corner + ivec2(0, 1)), k), exponent),
                    raised(curve(map_texel(m, corner + ivec2(1, 1)), k), exponent), f.x);
    return mix(row0, row1, f.y);
#else
    return raised(curve(map_texel(m, ivec2(p)), k), exponent);
#endif
}
