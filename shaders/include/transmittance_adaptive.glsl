// Maps whose texels have each a range of their own [ATFM12], which ends where the curve has fallen below a threshold. What
// neighbouring texels hold cannot be interpolated: the curves are evaluated and their transmittance is blended, or one is picked.

uniform sampler2D map_range;

// First and last distance of a texel's range along its ray; then where in it a gap without density begins, from the first, and how long
// the gap is.
vec4 stored_range(ivec2 texel) {
    return texelFetch(map_range, texel, 0);
}

// Place in the range, 0 at its first distance and 1 at its last. The gap is left out: nothing falls in it that values could tell of.
float range_place(vec4 range, float k) {
    float s = k - range.x;
    if (s > range.z) s = max(s - range.w, range.z);
    return s / (range.y - range.x - range.w);
}

// What is stored at a texel; the vector that holds the tail and the end is read first, as the others often are not needed.
vec4 last_vector(ivec2 texel) {
#if MAP_LAYERS == 1
    return texelFetch(map_values0, texel, 0);
#elif MAP_LAYERS == 2
    return texelFetch(map_values1, texel, 0);
#elif MAP_LAYERS == 3
    return texelFetch(map_values2, texel, 0);
#elif MAP_LAYERS == 4
    return texelFetch(map_values3, texel, 0);
#else
    return texelFetch(map_values4, texel, 0);
#endif
}

void other_vectors(ivec2 texel, inout vec4 c[MAP_LAYERS]) {
#if MAP_LAYERS > 1
    c[0] = texelFetch(map_values0, texel, 0);
#endif
#if MAP_LAYERS > 2
    c[1] = texelFetch(map_values1, texel, 0);
#endif
#if MAP_LAYERS > 3
    c[2] = texelFetch(map_values2, texel, 0);
#endif
#if MAP_LAYERS > 4
    c[3] = texelFetch(map_values3, texel, 0);
#endif
}

#if MAP_CURVE == CURVE_QUANTILE

// Stored optical depth at a distance k along the light's ray.
float depth_at(ivec2 texel, float k, bool stretched) {
    float x = range_place(stored_range(texel), k);
    if (x <= 0.0) return 0.0;
    vec4 c[MAP_LAYERS];
    c[MAP_LAYERS - 1] = last_vector(texel);
    float tail = c[COEFFICIENTS >> 2][COEFFICIENTS & 3];
    float total = c[(COEFFICIENTS + 1) >> 2][(COEFFICIENTS + 1) & 3];
    if (x >= 1.0) return total + tail * (x - 1.0);
    other_vectors(texel, c);
    return map_depth(c, x, total, stretched);
}

vec3 texel_transmittance(ivec2 texel, float k, vec3 exponent, bool stretched) {
#if CHROMATIC
    return exp(-exponent * depth_at(texel, k, stretched));
#else
    return vec3(exp(-exponent.r * depth_at(texel, k, stretched)));
#endif
}

#else

// Stored transmittance at a distance k along the light's ray.
float curve(ivec2 texel, float k) {
    float x = range_place(stored_range(texel), k);
    if (x <= 0.0) return 1.0;
    vec4 c[MAP_LAYERS];
    c[MAP_LAYERS - 1] = last_vector(texel);
    float tail = c[COEFFICIENTS >> 2][COEFFICIENTS & 3];
    float end = c[(COEFFICIENTS + 1) >> 2][(COEFFICIENTS + 1) & 3];
    if (x >= 1.0) return end * exp(-tail * (x - 1.0));
    other_vectors(texel, c);
    // A transmittance never rises: inside the range it lies between 1 and its value at the end.
    return clamp(map_curve(c, x), end, 1.0);
}

vec3 texel_transmittance(ivec2 texel, float k, vec3 exponent, bool stretched) {
    return raised(curve(texel, k), exponent);
}

#endif

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

#define FILTER_NEAREST 0
#define FILTER_BLEND 1
#define FILTER_STOCHASTIC 2

#if MAP_FILTER == FILTER_STOCHASTIC
// Two random numbers in [0, 1) from a position: the hash of Jarzynski and Olano (2020), pcg3d, on its bits.
vec2 random_pair(vec3 position) {
    uvec3 v = floatBitsToUint(position) * 1664525u + 1013904223u;
    v.x += v.y * v.z;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v ^= v >> 16u;
    v.x += v.y * v.z;
    v.y += v.z * v.x;
    return vec2(v.xy >> 8u) * (1.0 / 16777216.0);
}
#endif

vec3 grid_transmittance(int i, int v, vec3 position, vec3 travel) {
    int m = i * VOLUME_COUNT + v;
    vec3 y = position - light_maps[m].centre.xyz;
    vec2 uv;
    if (!map_coordinate(m, y, uv)) return vec3(1.0);
    float k = distance_along_light(int(light_maps[m].centre.w), y, light_maps[m].from_light);
    vec3 exponent = volumes[v].strength.rgb * light_maps[m].tile.z;
    bool stretched = light_maps[m].tile.w > 0.5;
    vec2 p = uv * map_size;
#if MAP_FILTER == FILTER_BLEND
    p -= 0.5;
    ivec2 corner = ivec2(floor(p));
    vec2 f = p - vec2(corner);
    // A loop and not four calls: it is left after one turn where no pixel of a group has anything to look up, and compiles faster.
    vec3 sum = vec3(0.0);
    for (int n = 0; n < 4; ++n) {
        ivec2 beside = ivec2(n & 1, n >> 1);
        vec2 weight = mix(1.0 - f, f, vec2(beside));
        sum += weight.x * weight.y * texel_transmittance(map_texel(m, corner + beside), k, exponent, stretched);
    }
    return sum;
#else
#if MAP_FILTER == FILTER_STOCHASTIC
    // The texel in which a point falls that is moved by up to half a texel at random is one of the four neighbours, by its weight.
    p += random_pair(position) - 0.5;
#endif
    return texel_transmittance(map_texel(m, ivec2(floor(p))), k, exponent, stretched);
#endif
}
