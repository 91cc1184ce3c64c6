// How much light gets to a point through all media: `vec3 light_transmittance(int light, vec3 position)`.
// HAS_MAPS and MAP_ADAPTIVE pick one of the interchangeable implementations; homogeneous shapes are always taken in closed form
// ([TFM11] eq. 5).

#include "include/medium.glsl"
#include "include/lights.glsl"

#if VOLUME_COUNT > 0
#if HAS_GRIDS
#if !HAS_MAPS
#include "include/transmittance_march.glsl"
#else
#include "include/light_map_lookup.glsl"
#if MAP_CURVE == CURVE_SLICES
#include "include/transmittance_slices.glsl"
#elif MAP_ADAPTIVE
#include "include/transmittance_adaptive.glsl"
#else
#include "include/transmittance_full_range.glsl"
#endif
#endif
#endif

// Part of the ray from a position back to light i that lies in volume v, as distances from the position.
vec2 interval_towards_light(int i, int v, vec3 position, vec3 travel) {
    vec2 span = volume_interval(v, position, -travel);
    span.x = max(span.x, 0.0);
#if HAS_POINT
    if (lights[i].position.w > 0.5) span.y = min(span.y, length(position - lights[i].position.xyz));
#endif
    return span;
}
#endif

vec3 light_transmittance(int i, vec3 position, vec3 travel) {
    vec3 transmittance = vec3(1.0);
#if VOLUME_COUNT > 0
    if (lights[i].shadow.x < -0.5) return transmittance;  // shadows are off for this light
    for (int v = 0; v < VOLUME_COUNT; ++v) {
#if HAS_GRIDS
        if (is_grid(v)) {
            transmittance *= grid_transmittance(i, v, position, travel);
            continue;
        }
#endif
#if HAS_SHAPES
        vec2 span = interval_towards_light(i, v, position, travel);
        if (span.y > span.x) transmittance *= exp(-volumes[v].strength.rgb * (span.y - span.x));
#endif
    }
#endif
    return transmittance;
}
