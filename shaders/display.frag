// Pictures as they are shown: exposure and a display transform, of one picture, of two beside a divider, or the error of one against
// the other as a false colour. Texels are fetched, never filtered by the texture unit, so that no sampler state matters.

const int VIEW_DISABLED = 0;
const int VIEW_SRGB = 1;
const int VIEW_LUT = 2;
const int COMPARE_OFF = 0;
const int COMPARE_WIPE = 1;
const int COMPARE_ERROR = 2;

in vec2 uv;

uniform sampler2D picture_a;
uniform sampler2D picture_b;
uniform sampler3D lut;
uniform sampler2D colormap;
uniform sampler2D mean_level;

uniform ivec2 target_size;
uniform float gain;        // 2^exposure
uniform vec2 lut_shaper;   // offset, maximum
uniform float divider;     // in pixels
uniform vec2 error_range;  // relative errors at the ends of the table
uniform vec3 alarm;

out vec4 color;

// What io.display makes of values that are none.
vec3 shown(vec3 c) {
    c *= gain;
    for (int i = 0; i < 3; ++i) c[i] = isnan(c[i]) ? 0.0 : clamp(c[i], 0.0, 1e6);
    return c;
}

// The picture's values here, bilinear where it is of another size than the target.
vec3 fetched(sampler2D picture, bool broken_is_black) {
    ivec2 size = textureSize(picture, 0);
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    if (size == target_size) {
        vec3 c = texelFetch(picture, pixel, 0).rgb;
        return broken_is_black ? shown(c) : c;
    }
    vec2 p = gl_FragCoord.xy * vec2(size) / vec2(target_size) - 0.5;
    ivec2 corner = ivec2(floor(p));
    vec2 f = p - vec2(corner);
    vec3 sum = vec3(0.0);
    for (int k = 0; k < 4; ++k) {
        ivec2 side = ivec2(k & 1, k >> 1);
        vec2 w = mix(1.0 - f, f, vec2(side));
        vec3 c = texelFetch(picture, clamp(corner + side, ivec2(0), size - 1), 0).rgb;
        sum += w.x * w.y * (broken_is_black ? shown(c) : c);
    }
    return sum;
}

// Tetrahedral: along the grey axis and on the planes where two channels are equal it follows the lattice's edges, where trilinear
// interpolation mixes in saturated corners.
vec3 looked_up(vec3 c) {
    ivec3 last = textureSize(lut, 0) - 1;
    vec3 p = log2(1.0 + sqrt(min(c, vec3(lut_shaper.y)) / lut_shaper.x)) * vec3(last);
    p /= log2(1.0 + sqrt(lut_shaper.y / lut_shaper.x));
    ivec3 base = min(ivec3(p), last - 1);
    vec3 f = clamp(p - vec3(base), 0.0, 1.0);
    // The way from the cell's first corner to its last, the channel with the largest fraction first.
    ivec3 first, second;
    vec3 o;
    if (f.r >= f.g) {
        if (f.g >= f.b) { first = ivec3(1, 0, 0); second = ivec3(1, 1, 0); o = f.rgb; }
        else if (f.r >= f.b) { first = ivec3(1, 0, 0); second = ivec3(1, 0, 1); o = f.rbg; }
        else { first = ivec3(0, 0, 1); second = ivec3(1, 0, 1); o = f.brg; }
    } else {
        if (f.r >= f.b) { first = ivec3(0, 1, 0); second = ivec3(1, 1, 0); o = f.grb; }
        else if (f.g >= f.b) { first = ivec3(0, 1, 0); second = ivec3(0, 1, 1); o = f.gbr; }
        else { first = ivec3(0, 0, 1); second = ivec3(0, 1, 1); o = f.bgr; }
    }
    return (1.0 - o.x) * texelFetch(lut, base, 0).rgb + (o.x - o.y) * texelFetch(lut, base + first, 0).rgb
        + (o.y - o.z) * texelFetch(lut, base + second, 0).rgb + o.z * texelFetch(lut, base + 1, 0).rgb;
}

vec3 displayed(vec3 c) {
#if VIEW == 1
    vec3 curved = 1.055 * pow(max(c, vec3(1e-9)), vec3(1.0 / 2.4)) - 0.055;
    c = mix(curved, 12.92 * c, vec3(lessThanEqual(c, vec3(0.0031308))));
#elif VIEW == 2
    c = looked_up(c);
#endif
    c = clamp(c, 0.0, 1.0);
#if DITHER
    // Interleaved gradient noise (Jimenez 2014), half a step of 8 bits either way: its errors are of a high frequency.
    float noise = fract(52.9829189 * fract(dot(floor(gl_FragCoord.xy), vec2(0.06711056, 0.00583715))));
    c += 0.998 * (noise - 0.5) / 255.0;  // less than half, so that black and white stay
#endif
    return c;
}

bool is_broken(vec3 c) { return any(isnan(c)) || any(isinf(c)); }

vec3 compared() {
    vec3 a = fetched(picture_a, false);
    vec3 b = fetched(picture_b, false);
    if (is_broken(a) || is_broken(b)) return alarm;
    if (all(lessThanEqual(a, vec3(0.0))) && all(lessThanEqual(b, vec3(0.0)))) return vec3(0.0);
    vec3 d = abs(a - b);
    float difference = max(max(d.r, d.g), d.b);
    float mean = texelFetch(mean_level, ivec2(0), 0).r;
    float position = 0.0;
    if (difference > error_range.x * mean)
        position = mean > 0.0 ? log2(difference / (mean * error_range.x)) / log2(error_range.y / error_range.x) : 1.0;
    int last = textureSize(colormap, 0).x - 1;
    return texelFetch(colormap, ivec2(int(clamp(position, 0.0, 1.0) * float(last) + 0.5), 0), 0).rgb;
}

void main() {
#if COMPARE == 2
    color = vec4(compared(), 1.0);
#elif COMPARE == 1
    bool left = gl_FragCoord.x < divider;
    vec3 c;
    if (left) c = fetched(picture_a, true); else c = fetched(picture_b, true);
    color = vec4(displayed(c), 1.0);
#else
    color = vec4(displayed(fetched(picture_a, true)), 1.0);
#endif
}
