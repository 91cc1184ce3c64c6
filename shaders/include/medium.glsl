// The media: parameters of every volume, where a ray crosses them, and their density.
// Positions are relative to the render origin. Extinction is density times `strength` ([TFM11] eq. 11).

struct Volume {
    mat4 world_to_box;   // a grid or box fills the unit cube, a sphere the unit ball, a capsule has radius 1 about z
    vec4 atlas_scale;    // box -> density atlas; w: density of a texel of value 1
    vec4 atlas_offset;   // xyz; w: length of a view step
    vec4 strength;       // extinction at density 1; w: length of a light step
    vec4 albedo;         // rgb; w: SHAPE_*
    vec4 phase;          // anisotropy, second anisotropy, lobe mix, PHASE_*
    vec4 emission;       // emitted radiance rgb; w: half height of a capsule in radii
    vec4 cells_scale;    // box -> cells of the density field; w: voxels along a cell
    vec4 cells_offset;   // first texel of the field's cells
    vec4 bricks_scale;   // see field.glsl
    vec4 bricks_shift;
    vec4 bricks_offset;
};

const int SHAPE_GRID = 0;
const int SHAPE_BOX = 1;
const int SHAPE_SPHERE = 2;
const int SHAPE_CAPSULE = 3;

#if VOLUME_COUNT > 0
layout(std140) uniform Volumes { Volume volumes[VOLUME_COUNT]; };

#if HAS_GRIDS
#include "include/field.glsl"

uniform sampler3D density_cells;  // positive: largest density in a cell / atlas_scale.w; negative: minus the distance to the next such
#endif

// Parameters where a ray enters and leaves the unit cube; empty when x >= y.
vec2 unit_cube_interval(vec3 origin, vec3 direction) {
    vec3 safe = mix(direction, vec3(1e-20), lessThan(abs(direction), vec3(1e-20)));
    vec3 a = -origin / safe;
    vec3 b = (1.0 - origin) / safe;
    vec3 first = min(a, b);
    vec3 last = max(a, b);
    return vec2(max(max(first.x, first.y), first.z), min(min(last.x, last.y), last.z));
}

vec2 unit_ball_interval(vec3 origin, vec3 direction) {
    float a = dot(direction, direction);
    float closest = -dot(origin, direction) / a;
    vec3 nearest = origin + closest * direction;  // keeps its digits where the quadratic formula cancels
    float rest = 1.0 - dot(nearest, nearest);
    if (rest <= 0.0) return vec2(1.0, 0.0);
    float half_width = sqrt(rest / a);
    return vec2(closest - half_width, closest + half_width);
}

vec2 capsule_interval(vec3 origin, vec3 direction, float half_height) {
    vec2 span = vec2(1.0, 0.0);
    float a = dot(direction.xy, direction.xy);
    if (a > 1e-20) {
        float closest = -dot(origin.xy, direction.xy) / a;
        vec2 nearest = origin.xy + closest * direction.xy;
        float rest = 1.0 - dot(nearest, nearest);
        if (rest > 0.0) {
            float half_width = sqrt(rest / a);
            float safe = abs(direction.z) < 1e-20 ? 1e-20 : direction.z;
            float c0 = (-half_height - origin.z) / safe;
            float c1 = (half_height - origin.z) / safe;
            span = vec2(max(closest - half_width, min(c0, c1)), min(closest + half_width, max(c0, c1)));
        }
    } else if (dot(origin.xy, origin.xy) < 1.0) {
        float c0 = (-half_height - origin.z) / direction.z;
        float c1 = (half_height - origin.z) / direction.z;
        span = vec2(min(c0, c1), max(c0, c1));
    }
    // A capsule is convex: its interval is the hull of the intervals of its parts.
    for (int cap = -1; cap <= 1; cap += 2) {
        vec2 ball = unit_ball_interval(origin - vec3(0.0, 0.0, float(cap) * half_height), direction);
        if (ball.x < ball.y) span = span.x < span.y ? vec2(min(span.x, ball.x), max(span.y, ball.y)) : ball;
    }
    return span;
}

// Interval of a ray inside volume v, in the ray's own parameter.
vec2 volume_interval(int v, vec3 origin, vec3 direction) {
    vec3 o = (volumes[v].world_to_box * vec4(origin, 1.0)).xyz;
    vec3 d = mat3(volumes[v].world_to_box) * direction;
#if HAS_SHAPES
    int shape = int(volumes[v].albedo.w);
    if (shape == SHAPE_SPHERE) return unit_ball_interval(o, d);
    if (shape == SHAPE_CAPSULE) return capsule_interval(o, d, volumes[v].emission.w);
#endif
    return unit_cube_interval(o, d);
}

bool is_grid(int v) {
#if HAS_GRIDS && HAS_SHAPES
    return int(volumes[v].albedo.w) == SHAPE_GRID;
#elif HAS_GRIDS
    return true;
#else
    return false;
#endif
}

// Density at a place in the unit box of the volume.
float density_in_box(int v, vec3 box) {
#if HAS_GRIDS
    if (is_grid(v)) {
        return field_density(clamp(box, 0.0, 1.0), volumes[v].atlas_scale, volumes[v].atlas_offset.xyz, volumes[v].bricks_scale,
                             volumes[v].bricks_shift.xyz, volumes[v].bricks_offset.xyz);
    }
#endif
    return 1.0;
}

// Density at a point inside the volume's interval.
float density_at(int v, vec3 position) {
    return density_in_box(v, (volumes[v].world_to_box * vec4(position, 1.0)).xyz);
}

#if HAS_GRIDS
// Intervals between voxels that the box of grid v spans.
vec3 voxel_intervals(int v) {
    return volumes[v].cells_scale.xyz * volumes[v].cells_scale.w;
}

// What is known of the density of grid v in one of its cells, given in cells from the corner of the box. Positive: no density in it has
// a larger magnitude. Negative: it is empty, and so are all cells that are fewer than so many cells away along every axis.
float density_cell(int v, vec3 cell) {
    vec3 inside = clamp(cell, vec3(0.0), volumes[v].cells_scale.xyz - 1e-4);
    float found = texelFetch(density_cells, ivec3(inside + volumes[v].cells_offset.xyz), 0).r;
    return found > 0.0 ? found * volumes[v].atlas_scale.w : found;
}
#endif
#endif
