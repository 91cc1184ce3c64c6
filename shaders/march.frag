// Single scattering along a view ray, front to back [TFM11 eq. 4]:
//   L = int T(0, t) [ sum_v sigma_s,v (sum_lights p_v L_i V T_light + ambient) + sigma_a,v L_e,v ] dt
// Steps end on the bounds of the volumes and on the surface; what is empty is leapt over. Density is read at the ends and the middle of a
// step and integrated by Simpson's rule; the exponential is taken analytically, and the light evaluated where the step's extinction has its
// centroid. An optically deep step is cut into several, so that the front of a dense medium is resolved however few steps a ray takes.

#include "include/phase.glsl"
#include "include/integrate.glsl"
#include "include/camera.glsl"
#include "include/transmittance.glsl"
#include "include/light_list.glsl"
#if HAS_EMISSION
#include "include/emission.glsl"
#endif

#include "include/pixel.glsl"

layout(location = 0) out vec4 out_scattered;
layout(location = 1) out vec4 out_transmittance;
#if HAS_EMISSION
layout(location = 2) out vec4 out_emission;
#endif

#if HAS_MESHES && !RESUMES
uniform sampler2D gbuffer_normal_distance;
#endif
uniform vec3 ambient;
uniform float opacity_cutoff;
#if PROJECTIVE_STEPS
uniform int projective_minimum;  // steps that a ray takes through the cone at the least
#endif
uniform bool first_batch;

// Optical depth from which a step is cut. At the front of a dense medium the parts are finer, in proportion to the depth behind the
// front, because light that grazes it fades within a small part of the depth that the view does.
const float DEEP_STEP = 0.12;
const float FINEST_PART = 0.06;
const float DEEPEST_PART = 0.5;
const float PART_OF_DEPTH = 0.4;
// How much of a light more or less is an edge, and to which part of a step its place is searched for.
const float EDGE = 0.1;
const float EDGE_PART = 0.04;
// A ray may go back as long as enough iterations are left for whole steps.
uniform float iterations_left;  // in this draw and those after it
uniform float iterations_kept;  // for the beginnings of segments and for leaps

// A long march is drawn in slices of so many iterations: each takes up the state that the one before it left.
uniform int slice_length;
#if RESUMES
uniform bool first_slice;
uniform sampler2D previous_scattered;  // a: how far the ray sees; in the first draw the G-buffer's normal and distance
uniform sampler2D previous_transmittance;
#if HAS_EMISSION
uniform sampler2D previous_emission;
#endif
#endif

// What is grey is computed in one channel.
#if CHROMATIC
#define Colour vec3
#define colour_of(c) (c)
#else
#define Colour float
#define colour_of(c) (c).r
#endif

Ray ray;
Colour optical_depth = Colour(0.0);  // summed, and not the transmittance multiplied, so that a thin medium keeps its digits
vec3 transmittance = vec3(1.0);
vec3 scattered = vec3(0.0);
vec3 emitted = vec3(0.0);
vec3 gathered;  // of the step under way, before the view's transmittance

#if PROJECTIVE_STEPS
#include "include/cone.glsl"

// Uniform steps in the projection of the only spot [TFM11 section 4.2], inside its cone; what lies before and behind the cone is not lit
// and takes one step each.
vec2 cone;         // of the segment
float cone_w[2];   // depth from the light where the ray enters the cone, and where it leaves it
float cone_steps;

void project_segment(float begin, float end, float longest) {
    cone = cone_interval(begin, end);
    if (cone.x >= cone.y) {
        cone = vec2(end);
        return;
    }
    vec4 row = vec4(lights[0].shadow_matrix[0][0].w, lights[0].shadow_matrix[0][1].w,
                    lights[0].shadow_matrix[0][2].w, lights[0].shadow_matrix[0][3].w);
    cone_w[0] = dot(row, vec4(ray.anchor + cone.x * ray.direction, 1.0));
    cone_w[1] = dot(row, vec4(ray.anchor + cone.y * ray.direction, 1.0));
    cone_steps = max(ceil((cone.y - cone.x) / longest), float(projective_minimum));
}

// End of a step that begins at s, and whether the light can reach it.
float projected_end(float s, float end, out bool lit) {
    lit = s >= cone.x && s < cone.y;
    if (!lit) return s < cone.x ? cone.x : end;
    float span = cone.y - cone.x;
    float part = (s - cone.x) / span;
    float place = part * cone_w[1] / (part * cone_w[1] + (1.0 - part) * cone_w[0]);
    place = (floor(place * cone_steps + 0.5) + 1.0) / cone_steps;
    if (place >= 1.0) return cone.y;
    return cone.x + span * place * cone_w[0] / (place * cone_w[0] + (1.0 - place) * cone_w[1]);
}
#endif

#if HAS_POINT
// Mean of 1/d^2 to a light over [s0, s1] of the ray: exact where the step is long against the distance, because a midpoint would
// miss or double the peak next to the light.
float mean_inverse_square(vec3 light, float radius, float s0, float s1) {
    vec3 to_light = light - ray.anchor;
    float along = dot(to_light, ray.direction);
    vec3 across = to_light - along * ray.direction;
    float square = max(dot(across, across), 1e-30);
    float a = s0 - along;
    float b = s1 - along;
    float h = b - a;
    float middle = 0.5 * (a + b);
    float at_middle = square + middle * middle;
    float mean;
    if (h * h < 0.04 * at_middle) {
        mean = (1.0 / (square + a * a) + 4.0 / at_middle + 1.0 / (square + b * b)) / 6.0;
    } else {
        float across_distance = sqrt(square);
        mean = atan(h * across_distance, square + a * b) / (across_distance * h);
    }
    return radius > 0.0 ? min(mean, 1.0 / (radius * radius)) : mean;
}
#endif

// Whether the edge of a light's cone is a jump, and how much of the light is inside it at a position.
bool has_hard_cone(int i) {
#if HAS_HARD_CONES
    return lights[i].focus_tint.w > 0.5 && lights[i].cone.x >= lights[i].cone.y;
#else
    return false;
#endif
}

#if HAS_SHADOW_MAPS || HAS_HARD_CONES
// How much of light i passes the meshes and is inside its cone, where that has a hard edge, at a place on the ray.
float seen_at(int i, float s, bool hard_cone) {
    vec3 position = ray.anchor + s * ray.direction;
    // In its projection steps end on the cone.
#if HAS_HARD_CONES && !PROJECTIVE_STEPS
    if (hard_cone) {
        vec3 offset = position - lights[i].position.xyz;
        if (dot(offset, lights[i].axis.xyz) < lights[i].cone.w * length(offset)) return 0.0;
    }
#endif
    return visibility(i, position);
}
#endif

float strongest(vec3 c) {
    return max(max(c.r, c.g), c.b);
}

bool is_opaque() {
    return strongest(transmittance) < opacity_cutoff;
}

// Where the ray runs in the unit boxes of the volumes.
#if VOLUME_COUNT <= 4
vec3 box_from[VOLUME_COUNT];
vec3 box_along[VOLUME_COUNT];

vec3 box_at(int v, float s) {
    return box_from[v] + s * box_along[v];
}
#else
vec3 box_at(int v, float s) {
    return (volumes[v].world_to_box * vec4(ray.anchor + s * ray.direction, 1.0)).xyz;
}
#endif

#if SKIP_EMPTY && HAS_GRIDS
// Cells that the ray crosses per unit of its length, and its inverse.
vec3 cells_along(int v) {
#if VOLUME_COUNT <= 4
    vec3 along = box_along[v] * volumes[v].cells_scale.xyz;
#else
    vec3 along = mat3(volumes[v].world_to_box) * ray.direction * volumes[v].cells_scale.xyz;
#endif
    return mix(along, vec3(1e-20), lessThan(abs(along), vec3(1e-20)));
}

#if VOLUME_COUNT <= 4
vec3 cell_length[VOLUME_COUNT];  // of the ray from face to face, negative against an axis
#define CELL_LENGTH(v) cell_length[v]
#else
#define CELL_LENGTH(v) (1.0 / cells_along(v))
#endif

// How far a ray at s can go on before any of the volumes that it is in may have density.
float empty_length(float s, bool inside[VOLUME_COUNT]) {
    float clear = 1e30;
    for (int v = 0; v < VOLUME_COUNT; ++v) {
        vec3 cell = box_at(v, s) * volumes[v].cells_scale.xyz;
        float found = density_cell(v, cell);
        // To the first face of the cube of cells that are empty too.
        vec3 way = CELL_LENGTH(v) * (floor(cell) + 0.5 - cell) - abs(CELL_LENGTH(v)) * (found + 0.5);
        // A little over the border, so that rounding does not leave the ray before it.
        vec3 size = abs(CELL_LENGTH(v));
        float length_ = min(min(way.x, way.y), way.z) + 1e-3 * min(min(size.x, size.y), size.z);
        if (inside[v]) clear = min(clear, found < 0.0 && is_grid(v) ? length_ : 0.0);
    }
    return clear;
}
#endif

// The strongest of the channels that still transmit.
float strongest_visible(Colour c) {
#if CHROMATIC
    return strongest(c * vec3(greaterThan(transmittance, vec3(max(opacity_cutoff, 1e-7)))));
#else
    return c;
#endif
}

// Optical depth that a part of a deep step may have.
float part_depth() {
    return clamp(PART_OF_DEPTH * strongest(vec3(optical_depth)), FINEST_PART, DEEPEST_PART);
}

// How much of each light is seen where the next step begins, and where it ends: the end of one is the beginning of the next. With lists a
// light may be left out by one step and not by the next.
#define SEES_EDGES (HAS_LIGHTS && (HAS_SHADOW_MAPS || HAS_HARD_CONES))
#define KEEPS_ENDS (SEES_EDGES && !HAS_LIGHT_LISTS)
#if KEEPS_ENDS
float light_seen[LIGHT_CAPACITY];
float light_seen_end[LIGHT_CAPACITY];
#endif

// The step under way.
bool lit = true;       // whether the light can reach it, of projective steps
bool may_cut;          // whether it may be tried again shorter
bool again;            // whether it has to be,
float wanted;          // and how long it then is at the most
vec3 scattering[VOLUME_COUNT];
#if HAS_LIGHTS
float step_begin, step_end;
float step_longest;    // step of the segment
vec3 event;            // where the light is evaluated

#if !HAS_POINT && LIGHT_CAPACITY * VOLUME_COUNT <= 8
// Distant light meets the ray at one angle everywhere.
#define KEEPS_PHASES 1
float light_phase[LIGHT_CAPACITY * VOLUME_COUNT];

void find_phases() {
    for (int i = 0; i < LIGHT_CAPACITY; ++i)
        for (int v = 0; v < VOLUME_COUNT; ++v)
            light_phase[i * VOLUME_COUNT + v] = phase(volumes[v].phase, dot(lights[i].position.xyz, -ray.direction));
}
#else
#define KEEPS_PHASES 0
#endif

// Add what light i scatters in the step. Few lights are called for one by one: software is slow with what a loop counts.
void add_light(int i) {
    float inverse_square;
    vec3 travel = light_travel(i, event, inverse_square);
#if HAS_POINT
    if (lights[i].position.w > 0.5)
        inverse_square = mean_inverse_square(lights[i].position.xyz, lights[i].strength.w, step_begin, step_end);
#endif
    bool hard_cone = has_hard_cone(i);
    vec3 arriving = lights[i].strength.rgb * shaping(i, travel, !hard_cone) * inverse_square;
    float seen = lit ? 1.0 : 0.0;
#if SEES_EDGES
    float seen_end = seen_at(i, step_end, hard_cone);
#if KEEPS_ENDS
    float seen_begin = light_seen[i];
    light_seen_end[i] = seen_end;
#else
    float seen_begin = seen_at(i, step_begin, hard_cone);
#endif
    seen *= 0.5 * (seen_begin + seen_end);
    // Edges of shadows and of hard cones are the only discontinuities along a ray: they are searched for, so that their place is
    // not rounded to whole steps, which would show as bands.
    float h = step_end - step_begin;
    if (abs(seen_begin - seen_end) > EDGE && h > EDGE_PART * step_longest && may_cut) {
        again = true;
        wanted = min(wanted, 0.5 * h);
    }
#endif
    vec3 turned = vec3(0.0);
    for (int v = 0; v < VOLUME_COUNT; ++v) {
#if KEEPS_PHASES
        turned += scattering[v] * light_phase[i * VOLUME_COUNT + v];
#else
        turned += scattering[v] * phase(volumes[v].phase, dot(travel, -ray.direction));
#endif
    }
    gathered += turned * arriving * (seen * light_transmittance(i, event, travel));
}
#endif

void main() {
    vec2 position = picture_position();
#if SCATTERED_PIXELS
    if (position.x < 0.0) return;
#endif
    ray = camera_ray(position);
    vec2 visible = camera_range(ray);
#if RESUMES
    bool resumed = !(first_batch && first_slice);
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 previous = texelFetch(previous_scattered, resumed ? pixel : geometry_texel(), 0);
    if (resumed) scattered = previous.rgb;
#if HAS_MESHES
    visible.y = min(visible.y, previous.a);
#endif
#elif HAS_MESHES
    visible.y = min(visible.y, texelFetch(gbuffer_normal_distance, geometry_texel(), 0).w);
#endif
    vec2 spans[VOLUME_COUNT];
    float s = visible.y;
    float end = visible.x;
    for (int v = 0; v < VOLUME_COUNT; ++v) {
        vec2 span = volume_interval(v, ray.anchor, ray.direction);
        span = vec2(max(span.x, visible.x), min(span.y, visible.y));
        spans[v] = span;
        if (span.x < span.y) {
            s = min(s, span.x);
            end = max(end, span.y);
        }
#if VOLUME_COUNT <= 4
        box_from[v] = (volumes[v].world_to_box * vec4(ray.anchor, 1.0)).xyz;
        box_along[v] = mat3(volumes[v].world_to_box) * ray.direction;
#if SKIP_EMPTY && HAS_GRIDS
        cell_length[v] = 1.0 / cells_along(v);
#endif
#endif
    }
#if RESUMES
#if HAS_EMISSION
    if (resumed) emitted = texelFetch(previous_emission, pixel, 0).rgb;
#endif
    // Every batch of lights marches from the front again.
    if (!first_slice) {
        vec4 reached = texelFetch(previous_transmittance, pixel, 0);
        transmittance = reached.rgb;
        s = reached.a;
        optical_depth = -log(max(colour_of(transmittance), 1e-38));
    }
#endif
#if HAS_LIGHTS && KEEPS_PHASES
    find_phases();
#endif
    bool inside[VOLUME_COUNT];
    float density[VOLUME_COUNT];  // where the next step begins
    for (int v = 0; v < VOLUME_COUNT; ++v) density[v] = 0.0;
    bool known = false;   // whether that, and how much of the lights is seen there, has been found
    float next = s;       // end of the segment: between two neighbouring bounds the same volumes are marched through
    float longest = 1e30; // step of the segment
    float tried = 1e30;   // length of the next step at the most
    float begun = s;      // the segment
    float whole = 0.0;    // steps of full length from there to the end
    // One iteration after the other, whatever it is for: a step, one that is tried again shorter, a leap, the beginning of a segment. A
    // processor runs many pixels side by side and skips nothing by a branch: what stands in the loop once is paid for once.
    for (int n = 0; n < slice_length; ++n) {
        if (is_opaque() || s >= end) break;
        if (s >= next) {
            next = end;
            longest = 1e30;
            begun = s;
            whole = 0.0;
            bool any_inside = false;
            for (int v = 0; v < VOLUME_COUNT; ++v) {
                inside[v] = spans[v].x < spans[v].y && spans[v].x <= s && spans[v].y > s;
                if (spans[v].x < spans[v].y && spans[v].x > s) next = min(next, spans[v].x);
                if (spans[v].x < spans[v].y) whole += max(spans[v].y - max(spans[v].x, s), 0.0) / volumes[v].atlas_offset.w;
                if (inside[v]) {
                    next = min(next, spans[v].y);
                    any_inside = true;
                    longest = min(longest, volumes[v].atlas_offset.w);
                }
            }
            known = false;
            tried = 1e30;
#if PROJECTIVE_STEPS
            project_segment(s, next, longest);
#endif
            if (!any_inside) {
                s = next;
                continue;
            }
        }
        float rest = next - s;
#if SKIP_EMPTY && HAS_GRIDS
        float clear = empty_length(s, inside);
        if (clear > 0.0) {
            s = clear < rest ? s + clear : next;
            known = false;
            tried = 1e30;
            rest = next - s;
        }
#endif
        // What is not known where a step begins is found by one of no length.
        lit = true;
#if PROJECTIVE_STEPS
        float s1 = projected_end(s, next, lit);
#else
        float parts = ceil(rest / longest - 1e-3);
        float s1 = parts > 1.0 ? s + rest / parts : next;
#endif
        may_cut = iterations_left - float(n) > iterations_kept + whole - (s - begun) / longest;
        if (may_cut) s1 = min(s1, s + tried);
        if (!known) s1 = s;
        float h = s1 - s;
        may_cut = may_cut && known;

        float to[VOLUME_COUNT];
        Colour extinction = Colour(0.0);
        Colour rise = Colour(0.0);
        float extinction0 = 0.0;
        float extinction1 = 0.0;
        Colour extinction_end = Colour(0.0);
        vec3 source = vec3(0.0);
        vec3 glow = vec3(0.0);
        for (int v = 0; v < VOLUME_COUNT; ++v) {
            float between = inside[v] ? max(density_in_box(v, box_at(v, 0.5 * (s + s1))), 0.0) : 0.0;
            to[v] = inside[v] ? max(density_in_box(v, box_at(v, s1)), 0.0) : 0.0;
            float mean_density = (density[v] + 4.0 * between + to[v]) * (1.0 / 6.0);
            Colour strength = colour_of(volumes[v].strength.rgb);
            Colour sigma_t = mean_density * strength;
            extinction += sigma_t;
            rise += (to[v] - density[v]) * strength;
            extinction_end += to[v] * strength;
            extinction0 += density[v] * strongest_visible(strength);
            extinction1 += between * strongest_visible(strength);
            scattering[v] = sigma_t * volumes[v].albedo.rgb;
#if HAS_AMBIENT
            source += scattering[v] * ambient;
#endif
#if HAS_EMISSION
            glow += (sigma_t - scattering[v]) * emitted_radiance(v, ray.anchor + (0.5 * (s + s1)) * ray.direction);
#endif
        }
        again = false;
        float seen_depth = strongest_visible(extinction) * h;
        wanted = 1e30;
        if (seen_depth > DEEP_STEP && may_cut) {
            // Where an extinction that is linear to the middle has summed to as much as a part may have.
            float depth = part_depth();
            float square = extinction0 * extinction0 + 4.0 * depth * (extinction1 - extinction0) / h;
            float root = extinction0 + sqrt(max(square, 0.0));
            float part = root > 0.0 ? 2.0 * depth / root : 0.5 * h;
            wanted = square < 0.0 ? 0.5 * h : min(part, 0.5 * h);
            again = seen_depth > 1.5 * depth;
        }
        if (!first_batch) {
            source = vec3(0.0);
            glow = vec3(0.0);
        }
        Colour depth = extinction * h;
        // Loss of the view over the step, of which both its transmittance and the mean inside it follow.
        Colour mean = mean_transmittance(depth);
        gathered = source;
#if HAS_LIGHTS
        // Of a linear density the centroid is off the middle by a twelfth of its relative rise.
        float shift = clamp(dot(vec3(rise), vec3(1.0)) / max(12.0 * dot(vec3(extinction), vec3(1.0)), 1e-30), -0.5, 0.5);
        float place = clamp(extinction_centroid(dot(vec3(depth), vec3(1.0 / 3.0))) + shift, 0.0, 1.0);
        step_begin = s;
        step_end = s1;
        step_longest = longest;
        event = ray.anchor + (s + h * place) * ray.direction;
#if HAS_LIGHT_LISTS || LIGHT_CAPACITY > 4
        int listed;
        int first_listed = light_first(event, listed);
        for (int n = first_listed; n < first_listed + listed; ++n) add_light(listed_light(n));
#else
        add_light(0);
#if LIGHT_CAPACITY > 1
        if (light_count > 1) add_light(1);
#endif
#if LIGHT_CAPACITY > 2
        if (light_count > 2) add_light(2);
#endif
#if LIGHT_CAPACITY > 3
        if (light_count > 3) add_light(3);
#endif
#endif
#endif
        gathered *= mean;
        if (again) {
            tried = wanted;
            continue;
        }
        if (known) {
            scattered += gathered * transmittance * h;
#if HAS_EMISSION
            emitted += glow * transmittance * (mean * h);
#endif
            optical_depth += depth;
            transmittance = vec3(exp(-optical_depth));
            // Where whole steps are deep the next part is as deep as a part may be, by the extinction here.
            float ahead = strongest_visible(extinction_end);
            tried = ahead * longest > DEEP_STEP ? min(2.0 * h, part_depth() / ahead) : 2.0 * h;
        }
        s = s1;
        density = to;
        known = true;
#if KEEPS_ENDS
        for (int i = 0; i < LIGHT_CAPACITY; ++i) light_seen[i] = light_seen_end[i];
#endif
    }
    if (is_opaque()) transmittance = vec3(0.0);
    out_scattered = vec4(scattered, visible.y);  // and how far the ray sees, for upsample.frag
    out_transmittance = vec4(transmittance, s);
#if HAS_EMISSION
    out_emission = vec4(emitted, 1.0);
#endif
}
