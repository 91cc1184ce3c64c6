// The curve of a texel over its range, from the values stored. MAP_CURVE picks what the values are.

#define CURVE_COSINE 0
#define CURVE_QUANTILE 1
#define CURVE_SLICES 2

#if MAP_CURVE == CURVE_COSINE

// Stored transmittance at x in [0, 1] of the range: c_0/2 + sum_j c_j cos(j pi x) [TFM11], by Clenshaw's recurrence.
float map_curve(vec4 c[MAP_LAYERS], float x) {
    float twice = 2.0 * cos(3.14159265358979 * x);
    float b1 = 0.0;
    float b2 = 0.0;
    for (int j = COEFFICIENTS - 1; j > 0; --j) {
        float b0 = c[j >> 2][j & 3] + twice * b1 - b2;
        b2 = b1;
        b1 = b0;
    }
    return 0.5 * c[0].x + 0.5 * twice * b1 - b2;
}

#elif MAP_CURVE == CURVE_QUANTILE

// Where, as a part of the range, the curve crosses the i-th of COEFFICIENTS + 1 evenly spaced levels between 1 and its end.
float quantile(vec4 c[MAP_LAYERS], int i) {
    return i < COEFFICIENTS ? c[(i - 1) >> 2][(i - 1) & 3] : 1.0;
}

// Levels are of exp(-depth), or stretched of exp(-sqrt(depth)): over many powers of ten of optical depth, for a curve that has to serve
// channels which differ much.
float curve_level(float depth, bool stretched) {
    return exp(-(stretched ? sqrt(depth) : depth));
}

float level_depth(float level, bool stretched) {
    float depth = -log(max(level, 1e-30));
    return stretched ? depth * depth : depth;
}

// Slope at the open end of a cell of width b and slope `rise` whose neighbour has width d and slope `beside`: that of the parabola
// through three nodes, kept monotone.
float end_slope(float b, float d, float rise, float beside) {
    return clamp(((2.0 * b + d) * rise - b * beside) / (b + d), 0.0, 3.0 * rise);
}

// Slope at a node between two cells: that of the parabola through three nodes, no more than keeps the curve monotone (Hyman 1983).
float node_slope(float a, float b, float rise_a, float rise_b) {
    return min((b * rise_a + a * rise_b) / (a + b), 3.0 * min(rise_a, rise_b));
}

// Stored optical depth at x in [0, 1] of the range, whose whole is `total`: a monotone cubic through the nodes. It is interpolated and not the transmittance because it is a straight line in a homogeneous medium.
float map_depth(vec4 c[MAP_LAYERS], float x, float total, bool stretched) {
    float za = 0.0;
    float zb = 0.0;
    float zc = quantile(c, 1);
    float zd = quantile(c, 2);
    float level = 0.0;
    for (int i = 1; i < COEFFICIENTS; ++i) {
        if (x >= quantile(c, i)) {
            za = zb;
            zb = zc;
            zc = zd;
            zd = i + 2 <= COEFFICIENTS ? quantile(c, i + 2) : 2.0;
            level = float(i);
        }
    }
    const float last = float(COEFFICIENTS);
    const float least = 1e-6;
    float a = max(zb - za, least);
    float b = max(zc - zb, least);
    float d = max(zd - zc, least);
    float drop = (1.0 - curve_level(total, stretched)) / last;
    float depth_b = level_depth(1.0 - drop * level, stretched);
    float depth_c = level > last - 1.5 ? total : level_depth(1.0 - drop * (level + 1.0), stretched);
    float depth_d = level > last - 2.5 ? total : level_depth(1.0 - drop * (level + 2.0), stretched);
    float rise_a = max(depth_b - level_depth(1.0 - drop * max(level - 1.0, 0.0), stretched), least) / a;
    float rise_b = max(depth_c - depth_b, least) / b;
    float rise_d = max(depth_d - depth_c, least) / d;
    float slope_b = level < 0.5 ? end_slope(b, d, rise_b, rise_d) : node_slope(a, b, rise_a, rise_b);
    float slope_c = level > last - 1.5 ? end_slope(b, a, rise_b, rise_a) : node_slope(b, d, rise_b, rise_d);
    float t = clamp((x - zb) / b, 0.0, 1.0);
    float rest = 1.0 - t;
    return depth_b + (depth_c - depth_b) * t * t * (3.0 - 2.0 * t) + b * t * rest * (slope_b * rest - slope_c * t);
}

#endif
