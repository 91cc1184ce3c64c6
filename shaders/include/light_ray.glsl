// The light ray of a map's texel, and the density of the volume along it.

#include "include/light_map.glsl"
#include "include/field.glsl"

in vec2 uv;

uniform mat4 centre_to_box;  // point relative to the volume's centre -> unit cube
uniform vec4 atlas_scale;    // w: density of a texel of value 1
uniform vec3 atlas_offset;
uniform vec4 bricks_scale;
uniform vec4 bricks_shift;
uniform vec4 bricks_offset;
uniform int map_kind;
uniform mat3 ray_origin;     // columns: at (0, 0), change along u, change along v
uniform mat3 ray_direction;
uniform vec4 from_light;     // light -> centre, or direction of travel; w: length

vec3 origin, direction;
vec3 box_origin, box_direction;  // in the volume's unit cube

// Find where the ray begins, and its direction.
void light_ray() {
    if (map_kind == MAP_OCTAHEDRAL) {
        origin = -from_light.xyz;
        direction = octahedral_decode(uv);
    } else {
        origin = ray_origin[0] + uv.x * ray_origin[1] + uv.y * ray_origin[2];
        direction = normalize(ray_direction[0] + uv.x * ray_direction[1] + uv.y * ray_direction[2]);
    }
    box_origin = (centre_to_box * vec4(origin, 1.0)).xyz;
    box_direction = mat3(centre_to_box) * direction;
}

float density_along(float s) {
    vec3 box = clamp(box_origin + s * box_direction, 0.0, 1.0);
    return field_density(box, atlas_scale, atlas_offset, bricks_scale, bricks_shift.xyz, bricks_offset.xyz);
}

// Where the ray enters the volume's bounds, and where it leaves them; empty when x >= y.
vec2 bounds_interval() {
    vec3 d = mix(box_direction, vec3(1e-20), lessThan(abs(box_direction), vec3(1e-20)));
    vec3 a = -box_origin / d;
    vec3 b = (1.0 - box_origin) / d;
    vec3 first = min(a, b);
    vec3 last = max(a, b);
    return vec2(max(max(first.x, first.y), first.z), min(min(last.x, last.y), last.z));
}
