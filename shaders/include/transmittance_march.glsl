// Brute force: march towards the light from every sample. The reference that the maps are measured against.

vec2 interval_towards_light(int i, int v, vec3 position, vec3 travel);

#if LIGHT_CELLS

// Integral of the density over a ray's interval, cell by cell: trilinear voxels are a cubic along a ray inside a cell, for which
// Simpson's rule is exact.
float density_integral(int v, vec3 origin, vec3 direction, vec2 span) {
    vec3 intervals = voxel_intervals(v);
    vec3 o = (volumes[v].world_to_box * vec4(origin, 1.0)).xyz * intervals;
    vec3 d = (mat3(volumes[v].world_to_box) * direction) * intervals;
    d = mix(d, vec3(1e-20), lessThan(abs(d), vec3(1e-20)));
    vec3 forward = sign(d);
    vec3 start = o + span.x * d;
    vec3 face = mix(ceil(start) - 1.0, floor(start) + 1.0, greaterThan(d, vec3(0.0)));
    float opaque = 80.0 / max(min(min(volumes[v].strength.r, volumes[v].strength.g), volumes[v].strength.b), 1e-30);
    float sum = 0.0;
    float t = span.x;
    float before = density_at(v, origin + t * direction);
    while (t < span.y && sum < opaque) {
        vec3 crossing = (face - o) / d;
        float next = min(min(min(crossing.x, crossing.y), crossing.z), span.y);
        face += forward * vec3(lessThanEqual(crossing, vec3(next)));
        if (next <= t) continue;
        float middle = density_at(v, origin + (0.5 * (t + next)) * direction);
        float after = density_at(v, origin + next * direction);
        sum += (before + 4.0 * middle + after) * (next - t);
        before = after;
        t = next;
    }
    return sum * (1.0 / 6.0);
}

vec3 grid_transmittance(int i, int v, vec3 position, vec3 travel) {
    vec2 span = interval_towards_light(i, v, position, travel);
    if (span.y <= span.x) return vec3(1.0);
    return exp(-volumes[v].strength.rgb * density_integral(v, position, -travel, span));
}

#else

vec3 grid_transmittance(int i, int v, vec3 position, vec3 travel) {
    vec2 span = interval_towards_light(i, v, position, travel);
    if (span.y <= span.x) return vec3(1.0);
    int count = int(ceil((span.y - span.x) / volumes[v].strength.w));
    float h = (span.y - span.x) / float(count);
    float sum = 0.0;
    for (int n = 0; n < count; ++n) sum += density_at(v, position - (span.x + (float(n) + 0.5) * h) * travel);
    return exp(-volumes[v].strength.rgb * (sum * h));
}

#endif
