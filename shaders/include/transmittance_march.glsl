// Brute force: march towards the light from every sample. The reference that the maps are measured against.

vec2 interval_towards_light(int i, int v, vec3 position, vec3 travel);

vec3 grid_transmittance(int i, int v, vec3 position, vec3 travel) {
    vec2 span = interval_towards_light(i, v, position, travel);
    if (span.y <= span.x) return vec3(1.0);
    int count = int(ceil((span.y - span.x) / volumes[v].strength.w));
    float h = (span.y - span.x) / float(count);
    float sum = 0.0;
    for (int n = 0; n < count; ++n) sum += density_at(v, position - (span.x + (float(n) + 0.5) * h) * travel);
    return exp(-volumes[v].strength.rgb * (sum * h));
}
