// Transmittance along one ray of the only light, by the very functions with which the passes light media and surfaces.

#include "include/transmittance.glsl"

in vec2 uv;

uniform vec3 ray_anchor;     // relative to the render origin
uniform vec3 ray_direction;  // the way the light travels
uniform vec2 ray_range;      // distances of the ray's ends from the anchor
uniform int map_volume;      // the volume whose map is asked for its range; -1 for none

layout(location = 0) out vec4 out_transmittance;  // w: how much of the light gets past the meshes
layout(location = 1) out vec4 out_range;          // where the map's range begins and ends, as distances from the anchor; z: 1 where it does

void main() {
    float s = mix(ray_range.x, ray_range.y, uv.x);
    vec3 position = ray_anchor + s * ray_direction;
    float inverse_square;
    vec3 travel = light_travel(0, position, inverse_square);
    out_transmittance = vec4(light_transmittance(0, position, travel), visibility(0, position));
    out_range = vec4(0.0);
#if HAS_GRIDS && HAS_MAPS && MAP_ADAPTIVE
    if (map_volume >= 0) {
        vec3 y = position - light_maps[map_volume].centre.xyz;
        vec2 coordinate;
        if (map_coordinate(map_volume, y, coordinate)) {
            vec2 range = stored_range(map_texel(map_volume, ivec2(coordinate * map_size))).xy;
            float k = distance_along_light(int(light_maps[map_volume].centre.w), y, light_maps[map_volume].from_light);
            if (range.x < 1e29) out_range = vec4(range + s - k, 1.0, 0.0);
        }
    }
#elif HAS_GRIDS && HAS_MAPS
    if (map_volume >= 0) {
        // Maps of the full range need none stored: it runs from the light or the bounds to the bounds.
        vec2 span = volume_interval(map_volume, position, travel) + s;
#if HAS_POINT
        if (lights[0].position.w > 0.5) span.x = max(span.x, s - length(position - lights[0].position.xyz));
#endif
        if (span.x < span.y) out_range = vec4(span, 1.0, 0.0);
    }
#endif
}
