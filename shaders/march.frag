// Single scattering along a view ray, front to back [TFM11 eq. 4]:
//   L = int T(0, t) [ sum_v sigma_s,v (sum_lights p_v L_i V T_light + ambient) + sigma_a,v L_e,v ] dt
// Steps end on the bounds of the volumes and on the surface. Density is read at their ends and middle and integrated by Simpson's rule;
// the exponential is taken analytically, and the light evaluated where the step's extinction has its centroid. An optically deep step
// is cut into several, so that the front of a dense medium is resolved however few steps a ray takes.

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

#if HAS_MESHES
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
const float DEEP_STEP = 0.25;
const float FINEST_PART = 0.04;
const float DEEPEST_PART = 0.5;
const float PART_OF_DEPTH = 0.3;
uniform int most_cuts;  // in one draw
int cuts = 0;

// A long march is drawn in slices of its steps: each takes up the state that the one before it left.
uniform int slice_begin;  // steps of the ray, counted from its first
uniform int slice_end;
#if RESUMES
uniform bool first_slice;
uniform sampler2D previous_scattered;
uniform sampler2D previous_transmittance;
#if HAS_EMISSION
uniform sampler2D previous_emission;
#endif
#endif

Ray ray;
vec3 optical_depth = vec3(0.0);  // summed, and not the transmittance multiplied, so that a thin medium keeps its digits
vec3 transmittance = vec3(1.0);
vec3 scattered = vec3(0.0);
vec3 emitted = vec3(0.0);

#if PROJECTIVE_STEPS
#include "include/cone.glsl"
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
        mean = (atan(b / across_distance) - atan(a / across_distance)) / (across_distance * h);
    }
    return radius > 0.0 ? min(mean, 1.0 / (radius * radius)) : mean;
}
#endif

// Whether the edge of a light's cone is a jump, and how much of the light is inside it at a position.
bool has_hard_cone(int i) {
#if HAS_SHAPING
    return lights[i].focus_tint.w > 0.5 && lights[i].cone.x >= lights[i].cone.y;
#else
    return false;
#endif
}

float reach(int i, vec3 position, bool hard_cone) {
#if HAS_SHAPING
    if (hard_cone) {
        vec3 offset = position - lights[i].position.xyz;
        if (dot(offset, lights[i].axis.xyz) < lights[i].cone.w * length(offset)) return 0.0;
    }
#endif
    return visibility(i, position);
}

// Share of a step that light i reaches, past the meshes and inside a hard cone. These edges are the only discontinuities along a ray:
// where the ends of the step differ they are searched for, so that their place is not rounded to whole steps, which would show as bands.
float lit_share(int i, float s0, float s1, bool hard_cone) {
#if HAS_SHADOW_MAPS || HAS_SHAPING
    float a = reach(i, ray.anchor + s0 * ray.direction, hard_cone);
    float b = reach(i, ray.anchor + s1 * ray.direction, hard_cone);
    if (a == b) return a;
    float level = 0.5 * (a + b);
    float lo = 0.0;
    float hi = 1.0;
    for (int n = 0; n < 5; ++n) {
        float middle = 0.5 * (lo + hi);
        float seen = reach(i, ray.anchor + mix(s0, s1, middle) * ray.direction, hard_cone);
        if ((seen > level) == (a > level)) lo = middle; else hi = middle;
    }
    return mix(b, a, 0.5 * (lo + hi));
#else
    return 1.0;
#endif
}

float strongest(vec3 c) {
    return max(max(c.r, c.g), c.b);
}

bool is_opaque() {
    return strongest(transmittance) < opacity_cutoff;
}

// Densities of the volumes that a place on the ray lies in, 0 for the others.
void densities_at(float s, bool inside[VOLUME_COUNT], out float density[VOLUME_COUNT]) {
    vec3 position = ray.anchor + s * ray.direction;
    for (int v = 0; v < VOLUME_COUNT; ++v) density[v] = inside[v] ? max(density_at(v, position), 0.0) : 0.0;
}

// Extinction of all volumes together, in the strongest of the channels that still transmit.
float visible_extinction(float density[VOLUME_COUNT]) {
    vec3 extinction = vec3(0.0);
    for (int v = 0; v < VOLUME_COUNT; ++v) extinction += density[v] * volumes[v].strength.rgb;
    return strongest(extinction * vec3(greaterThan(transmittance, vec3(max(opacity_cutoff, 1e-7)))));
}

// What lies between s0 and s1, where the volumes have the densities `from`, half way `between`, and `to`.
void march_step(float s0, float s1, float from[VOLUME_COUNT], float between[VOLUME_COUNT], float to[VOLUME_COUNT], bool lit) {
    float h = s1 - s0;
    vec3 middle = ray.anchor + (0.5 * (s0 + s1)) * ray.direction;
    vec3 extinction = vec3(0.0);
    vec3 rise = vec3(0.0);
    vec3 scattering[VOLUME_COUNT];
    vec3 source = vec3(0.0);
    vec3 glow = vec3(0.0);
    for (int v = 0; v < VOLUME_COUNT; ++v) {
        scattering[v] = vec3(0.0);
        float density = (from[v] + 4.0 * between[v] + to[v]) * (1.0 / 6.0);
        if (density <= 0.0) continue;
        vec3 sigma_t = density * volumes[v].strength.rgb;
        extinction += sigma_t;
        rise += (to[v] - from[v]) * volumes[v].strength.rgb;
        scattering[v] = sigma_t * volumes[v].albedo.rgb;
#if HAS_AMBIENT
        source += scattering[v] * ambient;
#endif
#if HAS_EMISSION
        glow += (sigma_t - scattering[v]) * emitted_radiance(v, middle);
#endif
    }
    if (strongest(extinction) <= 0.0) return;
    if (!first_batch) {
        source = vec3(0.0);
        glow = vec3(0.0);
    }
    vec3 depth = extinction * h;
#if HAS_LIGHTS
    if (lit) {
        float mean_depth = dot(depth, vec3(1.0 / 3.0));
        // Of a linear density the centroid is off the middle by a twelfth of its relative rise.
        float middle_of_loss = extinction_centroid(mean_depth) + dot(rise, vec3(1.0)) / (12.0 * dot(extinction, vec3(1.0)));
        float event = s0 + h * clamp(middle_of_loss, 0.0, 1.0);
        vec3 position = ray.anchor + event * ray.direction;
        int listed;
        int first_listed = light_first(position, listed);
        for (int n = first_listed; n < first_listed + listed; ++n) {
            int i = listed_light(n);
            float inverse_square;
            vec3 travel = light_travel(i, position, inverse_square);
#if HAS_POINT
            if (lights[i].position.w > 0.5)
                inverse_square = mean_inverse_square(lights[i].position.xyz, lights[i].strength.w, s0, s1);
#endif
            bool hard_cone = has_hard_cone(i);
            vec3 arriving = lights[i].strength.rgb * shaping(i, travel, !hard_cone) * inverse_square;
            if (strongest(arriving) <= 0.0) continue;
            float seen = lit_share(i, s0, s1, hard_cone);
            if (seen <= 0.0) continue;
            float cosine = dot(travel, -ray.direction);
            vec3 turned = vec3(0.0);
            for (int v = 0; v < VOLUME_COUNT; ++v)
                if (scattering[v] != vec3(0.0)) turned += scattering[v] * phase(volumes[v].phase, cosine);
            source += turned * arriving * (seen * light_transmittance(i, position, travel));
        }
    }
#endif
#if CHROMATIC
    vec3 mean = mean_transmittance(depth);
#else
    vec3 mean = vec3(mean_transmittance(depth.r));
#endif
    vec3 weight = transmittance * mean * h;
    scattered += source * weight;
#if HAS_EMISSION
    emitted += glow * weight;
#endif
    optical_depth += depth;
#if CHROMATIC
    transmittance = exp(-optical_depth);
#else
    transmittance = vec3(exp(-optical_depth.r));
#endif
}

// A step that is cut where it is deep. `density` is that at s0, and becomes that at s1.
void march_between(float s0, float s1, bool inside[VOLUME_COUNT], inout float density[VOLUME_COUNT], bool lit) {
    float last[VOLUME_COUNT];
    densities_at(s1, inside, last);
    for (;;) {
        float rest = s1 - s0;
        float next = s1;
        float between[VOLUME_COUNT];
        densities_at(0.5 * (s0 + s1), inside, between);
        float extinction0 = visible_extinction(density);
        float extinction1 = visible_extinction(between);
        if ((extinction0 + 4.0 * extinction1 + visible_extinction(last)) * rest > 6.0 * DEEP_STEP && cuts < most_cuts) {
            // Where an extinction that is linear to the middle has summed to as much as a part may have.
            float depth = clamp(PART_OF_DEPTH * -log(strongest(transmittance)), FINEST_PART, DEEPEST_PART);
            float square = extinction0 * extinction0 + 4.0 * depth * (extinction1 - extinction0) / rest;
            float root = extinction0 + sqrt(max(square, 0.0));
            float part = root > 0.0 ? 2.0 * depth / root : 0.5 * rest;
            part = square < 0.0 ? 0.5 * rest : min(part, 0.5 * rest);
            next = s0 + part;
            ++cuts;
        }
        float there[VOLUME_COUNT];
        if (next < s1) {
            densities_at(0.5 * (s0 + next), inside, between);
            densities_at(next, inside, there);
        } else {
            there = last;
        }
        march_step(s0, next, density, between, there, lit);
        density = there;
        s0 = next;
        if (s0 >= s1 || is_opaque()) break;
    }
}

void main() {
    vec2 position = picture_position();
#if SCATTERED_PIXELS
    if (position.x < 0.0) return;
#endif
    ray = camera_ray(position);
    vec2 visible = camera_range(ray);
#if HAS_MESHES
    visible.y = min(visible.y, texelFetch(gbuffer_normal_distance, geometry_texel(), 0).w);
#endif
    vec2 spans[VOLUME_COUNT];
    float cursor = visible.y;
    float end = visible.x;
    for (int v = 0; v < VOLUME_COUNT; ++v) {
        vec2 span = volume_interval(v, ray.anchor, ray.direction);
        span = vec2(max(span.x, visible.x), min(span.y, visible.y));
        spans[v] = span;
        if (span.x < span.y) {
            cursor = min(cursor, span.x);
            end = max(end, span.y);
        }
    }
#if RESUMES
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    if (!(first_batch && first_slice)) {
        scattered = texelFetch(previous_scattered, pixel, 0).rgb;
#if HAS_EMISSION
        emitted = texelFetch(previous_emission, pixel, 0).rgb;
#endif
    }
    // Every batch of lights marches from the front again.
    if (!first_slice) {
        transmittance = texelFetch(previous_transmittance, pixel, 0).rgb;
        optical_depth = -log(max(transmittance, 1e-38));
    }
#endif
    bool inside[VOLUME_COUNT];
    float density[VOLUME_COUNT];  // where the next step begins
    bool known = false;           // whether it has been read
    float next = cursor;  // end of the segment: between two neighbouring bounds the same volumes are marched through
    int count = 0;        // steps of the segment
    int n = 0;            // the segment's next step
#if PROJECTIVE_STEPS
    vec2 cone;
    int inner;
    float w0, w1;
#else
    float h;
#endif
    // One loop over the steps of all segments. Steps nested in segments would let the pixels that a processor runs side by side,
    // each in another segment, take many more iterations together than any takes alone.
    for (int number = 0; number < slice_end; ++number, ++n) {
        if (is_opaque()) break;
        while (n == count && next < end) {
            cursor = next;
            next = end;
            float length_of_step = 1e30;
            bool any_inside = false;
            for (int v = 0; v < VOLUME_COUNT; ++v) {
                inside[v] = false;
                if (spans[v].x >= spans[v].y) continue;
                if (spans[v].x > cursor) next = min(next, spans[v].x);
                if (spans[v].y > cursor) next = min(next, spans[v].y);
                if (spans[v].x <= cursor && spans[v].y > cursor) {
                    inside[v] = any_inside = true;
                    length_of_step = min(length_of_step, volumes[v].atlas_offset.w);
                }
            }
            count = 0;
            known = false;
            if (any_inside) {
#if PROJECTIVE_STEPS
                // Uniform steps in the projection of the only spot [TFM11 section 4.2], inside its cone; what lies before and
                // behind the cone is not lit and takes one step each.
                cone = cone_interval(cursor, next);
                bool lit = cone.x < cone.y;
                if (!lit) cone = vec2(cursor);
                vec4 row = vec4(lights[0].shadow_matrix[0][0].w, lights[0].shadow_matrix[0][1].w,
                                lights[0].shadow_matrix[0][2].w, lights[0].shadow_matrix[0][3].w);
                w0 = dot(row, vec4(ray.anchor + cone.x * ray.direction, 1.0));
                w1 = dot(row, vec4(ray.anchor + cone.y * ray.direction, 1.0));
                inner = lit ? max(int(ceil((cone.y - cone.x) / length_of_step)), projective_minimum) : 0;
                count = inner + 2;
#else
                count = int(ceil((next - cursor) / length_of_step));
                h = (next - cursor) / float(count);
#endif
            }
            n = clamp(slice_begin - number, 0, count);
            number += n;
        }
        if (n == count) break;
        float s0, s1;
        bool lit = true;
#if PROJECTIVE_STEPS
        if (n == 0 || n == count - 1) {
            s0 = n == 0 ? cursor : cone.y;
            s1 = n == 0 ? cone.x : next;
            if (s1 <= s0) continue;
            lit = false;
        } else {
            float f0 = float(n - 1) / float(inner);
            float f1 = float(n) / float(inner);
            float span = cone.y - cone.x;
            s0 = cone.x + span * f0 * w0 / (f0 * w0 + (1.0 - f0) * w1);
            s1 = cone.x + span * f1 * w0 / (f1 * w0 + (1.0 - f1) * w1);
        }
#else
        s0 = cursor + float(n) * h;
        s1 = cursor + float(n + 1) * h;
#endif
        if (!known) densities_at(s0, inside, density);
        known = true;
        march_between(s0, s1, inside, density, lit);
    }
    if (is_opaque()) transmittance = vec3(0.0);
    out_scattered = vec4(scattered, visible.y);  // and how far the ray sees, for upsample.frag
    out_transmittance = vec4(transmittance, 1.0);
#if HAS_EMISSION
    out_emission = vec4(emitted, 1.0);
#endif
}
