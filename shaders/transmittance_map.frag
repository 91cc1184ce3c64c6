// One texel: the transmittance f = exp(-stored strength * optical density) along one light ray through one volume, as MAP_CURVE says:
//   cosine    c_j = (2/D) int_0^D f(x) cos(j pi x / D) dx [TFM11 alg. 2]
//   quantile  the depths at which f crosses evenly spaced levels between 1 and its end
// The curve is exponential inside a step; its mean over the step times the mean of the basis over the step is summed.
// Without MAP_ADAPTIVE the range is the whole way through the bounds [TFM11]. With it the ray is marched twice [ATFM12 alg. 2]: once to
// find the range in which the curve falls from 1 to a threshold, once inside it.

#include "include/light_ray.glsl"
#include "include/map_curve.glsl"
#include "include/integrate.glsl"

const float PI = 3.14159265358979;
const float EMPTY = 1e30;

layout(location = 0) out vec4 values0;
#if MAP_LAYERS > 1
layout(location = 1) out vec4 values1;
#endif
#if MAP_LAYERS > 2
layout(location = 2) out vec4 values2;
#endif
#if MAP_LAYERS > 3
layout(location = 3) out vec4 values3;
#endif
#if MAP_LAYERS > 4
layout(location = 4) out vec4 values4;
#endif
layout(location = MAP_LAYERS) out vec4 range;

uniform float stored;        // extinction per unit of density at which the curve is stored
uniform float end_depth;     // stored optical depth at which the adaptive range ends
uniform float begin_depth;   // stored optical depth that the start of the range may leave out
uniform float step_length;
uniform bool stretched;      // whether levels are of exp(-sqrt(depth))

// The longest part without density between the first and the last: where it begins, and how long it is. Marches in the range leave it out.
float gap_begin = EMPTY;
float gap_length = 0.0;

float past_gap(float s) {
    return s > gap_begin ? s + gap_length : s;
}

#if MAP_CURVE == CURVE_QUANTILE
// Depths, as parts of the range, at which the curve crosses the levels; `total` is the stored optical depth at its end.
void project(inout vec4 c[MAP_LAYERS], float begin, float h, float count, float depth, float total) {
    for (int i = 0; i < MAP_LAYERS; ++i) c[i] = vec4(1.0);
    float drop = (1.0 - curve_level(total, stretched)) / float(COEFFICIENTS);
    float level = 1.0 - drop;
    float wanted = level_depth(level, stretched);
    int next = 0;
    for (float n = 0.0; n < count && next < COEFFICIENTS - 1; n += 1.0) {
        float step_depth = stored * density_along(past_gap(begin + (n + 0.5) * h)) * h;
        while (next < COEFFICIENTS - 1 && depth + step_depth >= wanted) {
            c[next >> 2][next & 3] = (n + clamp((wanted - depth) / step_depth, 0.0, 1.0)) / count;
            ++next;
            level -= drop;
            wanted = level_depth(level, stretched);
        }
        depth += step_depth;
    }
}
#else
// Coefficients of the curve; `depth` becomes the stored optical depth at its end.
void project(inout vec4 c[MAP_LAYERS], float begin, float h, float count, inout float depth) {
    for (int i = 0; i < MAP_LAYERS; ++i) c[i] = vec4(0.0);
    float from = exp(-depth);
    for (float n = 0.0; n < count; n += 1.0) {
        float step_depth = stored * density_along(past_gap(begin + (n + 0.5) * h)) * h;
        float mean = from * mean_transmittance(step_depth);
        float twice = 2.0 * cos(PI * (n + 0.5) / count);
        float previous = 0.5 * twice;  // cos of -theta, then Chebyshev: cos((j+1)t) = 2 cos t cos(jt) - cos((j-1)t)
        float current = 1.0;
        for (int j = 0; j < COEFFICIENTS; ++j) {
            c[j >> 2][j & 3] += mean * current;
            float next = twice * current - previous;
            previous = current;
            current = next;
        }
        depth += step_depth;
        from = exp(-depth);
    }
    for (int j = 0; j < COEFFICIENTS; ++j) {
        // The mean of the cosine over a step is its midpoint times sinc of half the phase across the step.
        float half_phase = 0.5 * PI * float(j) / count;
        c[j >> 2][j & 3] *= 2.0 / count * (j == 0 ? 1.0 : sin(half_phase) / half_phase);
    }
}
#endif

void main() {
    vec4 c[MAP_LAYERS];
    for (int i = 0; i < MAP_LAYERS; ++i) c[i] = vec4(0.0);
    c[0].x = 2.0;  // the cosine series of 1
    float tail = 0.0;
    float total_depth = 0.0;
    vec4 stored_range = vec4(EMPTY, 2.0 * EMPTY, EMPTY, 0.0);

    light_ray();
    vec2 span = bounds_interval();
    if (map_kind != MAP_ORTHOGRAPHIC) {
        float behind = -dot(origin + from_light.xyz, direction);  // where the light itself is
        span.x = max(span.x, behind);
    }
    if (span.x < span.y) {
        float offset = distance_along_light(map_kind, origin, from_light);
        float length_ = span.y - span.x;
        float count = ceil(length_ / step_length);
        float h = length_ / count;
        float begin = span.x;
        float end = span.y;
        float depth = 0.0;        // stored optical depth at the start of the projected range
        bool any_density = true;
        bool dense = false;
        float total = 0.0;
#if MAP_ADAPTIVE
        float first = -1.0;       // step with the first density
        float start = -1.0;       // a step before the curve begins to fall, in steps
        float start_depth = 0.0;
        float before = 0.0;       // total one step ago
        float last = 0.0;
        float longest = 0.0;      // steps of the longest gap
        float gap_first = 0.0;
        for (float n = 0.0; n < count; n += 1.0) {
            float step_depth = stored * density_along(span.x + (n + 0.5) * h) * h;
            if (step_depth > 0.0) {
                if (first < 0.0) first = n;
                else if (n - last > longest) {
                    longest = n - last;
                    gap_first = last;
                }
                last = n + 1.0;
            }
            if (start < 0.0 && total + step_depth > begin_depth) {
                // Inside the step, so that neighbouring texels begin where a smooth front does, and not on steps.
                float part = (begin_depth - total) / step_depth;
                start = n + part - 1.0;
                start_depth = mix(before, total, part);
                if (start < 0.0) start = start_depth = 0.0;
            }
            if (total + step_depth >= end_depth) {
                end = span.x + (n + (end_depth - total) / step_depth) * h;
                dense = true;
                break;
            }
            before = total;
            total += step_depth;
        }
        any_density = first >= 0.0;
        if (start < 0.0) start = max(first, 0.0);
        begin = span.x + start * h;
        depth = start_depth;
        if (!dense) end = span.x + last * h;
        end = max(end, begin + 1e-3 * h);
        length_ = end - begin;
        // A step at each end of the gap stays in the range: density may begin inside it.
        if (longest > 4.0 && gap_first >= start) {
            gap_begin = span.x + (gap_first + 1.0) * h;
            gap_length = (longest - 2.0) * h;
            length_ -= gap_length;
        }
        count = clamp(ceil(length_ / h), SECOND_MARCH_STEPS, 4096.0);
        h = length_ / count;
#endif
        if (any_density) {
#if MAP_CURVE == CURVE_QUANTILE
            if (dense) total = end_depth;
            project(c, begin, h, count, depth, total);
            depth = total;
#else
            project(c, begin, h, count, depth);
#endif
            if (dense) {
                float reach = min(h, (span.y - end) / 3.0);
                float sum = 0.0;
                if (reach > 0.0) for (int n = 0; n < 3; ++n) sum += density_along(end + (float(n) + 0.5) * reach);
                tail = stored * sum / 3.0 * length_;
            }
            total_depth = depth;
            stored_range = vec4(vec2(begin, end) + offset, gap_begin - begin, gap_length);
        }
    }
    c[COEFFICIENTS >> 2][COEFFICIENTS & 3] = min(tail, 6e4);
    c[(COEFFICIENTS + 1) >> 2][(COEFFICIENTS + 1) & 3] =
#if MAP_CURVE == CURVE_QUANTILE
        total_depth;
#else
        exp(-total_depth);
#endif
    range = stored_range;
    values0 = c[0];
#if MAP_LAYERS > 1
    values1 = c[1];
#endif
#if MAP_LAYERS > 2
    values2 = c[2];
#endif
#if MAP_LAYERS > 3
    values3 = c[3];
#endif
#if MAP_LAYERS > 4
    values4 = c[4];
#endif
}
