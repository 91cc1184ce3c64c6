// One texel: the transmittance f = exp(-stored strength * optical density) along one light ray through one volume, as MAP_CURVE says:
//   cosine    c_j = (2/D) int_0^D f(x) cos(j pi x / D) dx [TFM11 alg. 2]
//   quantile  the depths at which f crosses evenly spaced levels between 1 and its end
// The curve is exponential inside a step; its mean over the step times the mean of the basis over the step is summed.
// Without MAP_ADAPTIVE the range is the whole way through the bounds [TFM11]. With it the ray is marched twice [ATFM12 alg. 2]: once to
// find the range in which the curve falls from 1 to a threshold, once inside it.

#include "include/light_map.glsl"
#include "include/map_curve.glsl"
#include "include/integrate.glsl"

const float PI = 3.14159265358979;
const float EMPTY = 1e30;

in vec2 uv;

#if MAP_BYTES
layout(location = 0) out uvec4 values0;
#if MAP_LAYERS > 1
layout(location = 1) out uvec4 values1;
#endif
#else
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
layout(location = MAP_LAYERS) out vec2 range;
#endif

uniform sampler3D density_atlas;
uniform mat4 centre_to_box;  // point relative to the volume's centre -> unit cube
uniform vec4 atlas_scale;    // w: density of a texel of value 1
uniform vec3 atlas_offset;
uniform int map_kind;
uniform mat3 ray_origin;     // columns: at (0, 0), change along u, change along v
uniform mat3 ray_direction;
uniform vec4 from_light;     // light -> centre, or direction of travel; w: length
uniform float stored;        // extinction per unit of density at which the curve is stored
uniform float end_depth;     // stored optical depth at which the adaptive range ends
uniform float begin_depth;   // stored optical depth that the start of the range may leave out
uniform float step_length;

vec3 origin, direction;

float density(float s) {
    vec3 box = clamp((centre_to_box * vec4(origin + s * direction, 1.0)).xyz, 0.0, 1.0);
    return texture(density_atlas, box * atlas_scale.xyz + atlas_offset).r * atlas_scale.w;
}

vec2 bounds_interval() {
    vec3 o = (centre_to_box * vec4(origin, 1.0)).xyz;
    vec3 d = mat3(centre_to_box) * direction;
    d = mix(d, vec3(1e-20), lessThan(abs(d), vec3(1e-20)));
    vec3 a = -o / d;
    vec3 b = (1.0 - o) / d;
    vec3 first = min(a, b);
    vec3 last = max(a, b);
    return vec2(max(max(first.x, first.y), first.z), min(min(last.x, last.y), last.z));
}

#if MAP_CURVE == CURVE_QUANTILE
// Depths, as parts of the range, at which the curve crosses the levels; `total` is the stored optical depth at its end.
void project(inout vec4 c[CURVE_VECTORS], float begin, float h, float count, float depth, float total) {
    for (int i = 0; i < CURVE_VECTORS; ++i) c[i] = vec4(1.0);
    float drop = (1.0 - exp(-total)) / float(COEFFICIENTS);
    float level = drop;
    float wanted = -log(1.0 - level);
    int next = 0;
    for (float n = 0.0; n < count && next < COEFFICIENTS - 1; n += 1.0) {
        float step_depth = stored * density(begin + (n + 0.5) * h) * h;
        while (next < COEFFICIENTS - 1 && depth + step_depth >= wanted) {
            c[next >> 2][next & 3] = (n + clamp((wanted - depth) / step_depth, 0.0, 1.0)) / count;
            ++next;
            level += drop;
            wanted = -log(max(1.0 - level, 1e-30));
        }
        depth += step_depth;
    }
}
#else
// Coefficients of the curve; `depth` becomes the stored optical depth at its end.
void project(inout vec4 c[CURVE_VECTORS], float begin, float h, float count, inout float depth) {
    for (int i = 0; i < CURVE_VECTORS; ++i) c[i] = vec4(0.0);
    float from = exp(-depth);
    for (float n = 0.0; n < count; n += 1.0) {
        float step_depth = stored * density(begin + (n + 0.5) * h) * h;
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

#if MAP_BYTES
uint byte_at(vec4 c[CURVE_VECTORS], int j) {
    return j < COEFFICIENTS - 1 ? uint(clamp(c[j >> 2][j & 3], 0.0, 1.0) * 255.0 + 0.5) : 255u;
}

uint bytes_at(vec4 c[CURVE_VECTORS], int j) {
    return byte_at(c, j) | byte_at(c, j + 1) << 8u | byte_at(c, j + 2) << 16u | byte_at(c, j + 3) << 24u;
}
#endif

void main() {
    vec4 c[CURVE_VECTORS];
    for (int i = 0; i < CURVE_VECTORS; ++i) c[i] = vec4(0.0);
    c[0].x = 2.0;  // the cosine series of 1
    float tail = 0.0;
    float total_depth = 0.0;
    vec2 stored_range = vec2(EMPTY, 2.0 * EMPTY);

    if (map_kind == MAP_OCTAHEDRAL) {
        origin = -from_light.xyz;
        direction = octahedral_decode(uv);
    } else {
        origin = ray_origin[0] + uv.x * ray_origin[1] + uv.y * ray_origin[2];
        direction = normalize(ray_direction[0] + uv.x * ray_direction[1] + uv.y * ray_direction[2]);
    }
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
        for (float n = 0.0; n < count; n += 1.0) {
            float step_depth = stored * density(span.x + (n + 0.5) * h) * h;
            if (step_depth > 0.0) {
                if (first < 0.0) first = n;
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
                if (reach > 0.0) for (int n = 0; n < 3; ++n) sum += density(end + (float(n) + 0.5) * reach);
                tail = stored * sum / 3.0 * length_;
            }
            total_depth = depth;
            stored_range = vec2(begin, end) + offset;
        }
    }
#if MAP_BYTES
    uint tail_code = tail > 0.0 ? uint(clamp((log2(tail) + TAIL_LEAST) / TAIL_STEP + 1.5, 1.0, 255.0)) : 0u;
    uint end_code = uint(exp(-total_depth) * 65535.0 + 0.5);
    values0 = uvec4(floatBitsToUint(stored_range), bytes_at(c, 0), byte_at(c, 4) | tail_code << 8u | end_code << 16u);
#if MAP_LAYERS > 1
    values1 = uvec4(bytes_at(c, 5), bytes_at(c, 9), byte_at(c, 13) | byte_at(c, 14) << 8u, 0u);
#endif
#else
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
#endif
}
