// The plainest march: between where a view ray enters the bounds of the volumes and where it leaves them, so many steps of equal length,
// one density fetch in each, the optical depth summed and one exponential at the end. No light, and nothing is skipped.

#include "include/camera.glsl"
#include "include/medium.glsl"

in vec2 uv;

layout(location = 0) out vec4 out_transmittance;

uniform int floor_steps;

void main() {
    Ray ray = camera_ray(uv);
    vec2 visible = camera_range(ray);
    vec2 spans[VOLUME_COUNT];
    float first = visible.y;
    float last = visible.x;
    for (int v = 0; v < VOLUME_COUNT; ++v) {
        spans[v] = volume_interval(v, ray.anchor, ray.direction);
        spans[v] = vec2(max(spans[v].x, visible.x), min(spans[v].y, visible.y));
        if (spans[v].x >= spans[v].y) continue;
        first = min(first, spans[v].x);
        last = max(last, spans[v].y);
    }
    vec3 optical_depth = vec3(0.0);
    if (first < last) {
        float h = (last - first) / float(floor_steps);
        float density[VOLUME_COUNT];
#if HAS_GRIDS
        // Where the ray runs in the atlas: affine in its parameter, so that a step is a multiplication and a fetch.
        vec3 start[VOLUME_COUNT];
        vec3 slope[VOLUME_COUNT];
#endif
        for (int v = 0; v < VOLUME_COUNT; ++v) {
            density[v] = 0.0;
#if HAS_GRIDS
            start[v] = (volumes[v].world_to_box * vec4(ray.anchor, 1.0)).xyz * volumes[v].atlas_scale.xyz + volumes[v].atlas_offset.xyz;
            slope[v] = mat3(volumes[v].world_to_box) * ray.direction * volumes[v].atlas_scale.xyz;
#endif
        }
        for (int n = 0; n < floor_steps; ++n) {
            float s = first + (float(n) + 0.5) * h;
            for (int v = 0; v < VOLUME_COUNT; ++v) {
#if VOLUME_COUNT > 1
                if (s < spans[v].x || s > spans[v].y) continue;
#endif
#if HAS_GRIDS
#if HAS_SPARSE
                density[v] += is_grid(v) ? density_at(v, ray.anchor + s * ray.direction) / volumes[v].atlas_scale.w : 1.0;
#else
                density[v] += is_grid(v) ? texture(density_atlas, start[v] + s * slope[v]).r : 1.0;
#endif
#else
                density[v] += 1.0;
#endif
            }
        }
        for (int v = 0; v < VOLUME_COUNT; ++v)
            optical_depth += density[v] * h * (is_grid(v) ? volumes[v].atlas_scale.w : 1.0) * volumes[v].strength.rgb;
    }
    out_transmittance = vec4(exp(-optical_depth), 1.0);
}
