// The transmittance maps of all lights of a batch through all volumes, as tiles of one atlas.

#include "include/light_map.glsl"
#include "include/map_curve.glsl"

struct LightMap {
    mat4 to_map;       // point relative to the volume's centre -> (U, V, -, W); of orthographic slices (U, V, slice, 1)
    vec4 centre;       // relative to the render origin; w: MAP_*
    vec4 from_light;   // light -> centre, or the direction of travel; w: its length
    vec4 tile;         // first texel x, y; z: exponent per unit of extinction; w: 1 where levels are stretched
    vec4 slices;       // distance of the first from the light, from the centre's; slices per unit of distance; texels across and up
};

layout(std140) uniform LightMaps { LightMap light_maps[LIGHT_CAPACITY * VOLUME_COUNT]; };

uniform float map_size;
#if MAP_CURVE != CURVE_SLICES
uniform sampler2D map_values0;
#if MAP_LAYERS > 1
uniform sampler2D map_values1;
#endif
#if MAP_LAYERS > 2
uniform sampler2D map_values2;
#endif
#if MAP_LAYERS > 3
uniform sampler2D map_values3;
#endif
#if MAP_LAYERS > 4
uniform sampler2D map_values4;
#endif
#endif

// Map coordinate of a point relative to the volume's centre; false outside the map, where there is nothing on the way.
bool map_coordinate(int m, vec3 y, out vec2 uv) {
    vec4 h = light_maps[m].to_map * vec4(y, 1.0);
    if (int(light_maps[m].centre.w) == MAP_OCTAHEDRAL) {
        uv = octahedral_encode(h.xyz);
        return true;
    }
    if (h.w <= 0.0) return false;
    uv = h.xy / h.w;
    return all(greaterThan(uv, vec2(0.0))) && all(lessThan(uv, vec2(1.0)));
}

vec3 raised(float value, vec3 exponent) {
#if MAP_EXPONENT == 1
    return vec3(value);
#elif MAP_EXPONENT == 2
    return vec3(value * value);
#elif CHROMATIC
    return pow(vec3(max(value, 1e-12)), exponent);
#else
    return vec3(pow(max(value, 1e-12), exponent.r));
#endif
}
