// The curve of a texel over its range, from the values stored: `map_curve(c, x, end)`, x in [0, 1];
// `end` is the curve's value at 1. MAP_CURVE picks what the values are.

#define CURVE_COSINE 0
#define CURVE_LEGENDRE 1
#define CURVE_QUANTILE 2

#if MAP_BYTES
#define CURVE_VECTORS 4
#else
#define CURVE_VECTORS MAP_LAYERS
#endif

#if MAP_CURVE == CURVE_COSINE

// c_0/2 + sum_j c_j cos(j pi x) [TFM11 eq. 13], by Clenshaw's recurrence.
float map_curve(vec4 c[CURVE_VECTORS], float x, float end) {
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

#elif MAP_CURVE == CURVE_LEGENDRE

// sum_j c_j P_j(2x - 1), by Clenshaw's recurrence with P_{j+1} = ((2j + 1) t P_j - j P_{j-1}) / (j + 1).
float map_curve(vec4 c[CURVE_VECTORS], float x, float end) {
    float t = 2.0 * x - 1.0;
    float b1 = 0.0;
    float b2 = 0.0;
    for (int j = COEFFICIENTS - 1; j > 0; --j) {
        float n = float(j);
        float b0 = c[j >> 2][j & 3] + (2.0 * n + 1.0) / (n + 1.0) * t * b1 - (n + 1.0) / (n + 2.0) * b2;
        b2 = b1;
        b1 = b0;
    }
    return c[0].x + t * b1 - 0.5 * b2;
}

#else

// Depth, as a part of the range, at which the curve crosses the i-th of COEFFICIENTS + 1 evenly spaced levels from 1 to its end.
float quantile_depth(vec4 c[CURVE_VECTORS], int i) {
    return i < COEFFICIENTS ? c[(i - 1) >> 2][(i - 1) & 3] : 1.0;
}

// Slope at a node between cells of widths a and b, for levels 1 apart: the weighted harmonic mean of Fritsch and Butland (1984).
float node_slope(float a, float b) {
    return 3.0 * (a + b) / (a * a + 4.0 * a * b + b * b);
}

// Slope at the open end of a cell of width b whose neighbour has width a: that of the parabola through three nodes, kept monotone.
float end_slope(float b, float a) {
    return clamp(((2.0 * b + a) / b - b / a) / (a + b), 0.0, 3.0 / b);
}

// A monotone cubic through the nodes (Fritsch and Carlson 1980).
float map_curve(vec4 c[CURVE_VECTORS], float x, float end) {
    float za = 0.0;
    float zb = 0.0;
    float zc = quantile_depth(c, 1);
    float zd = quantile_depth(c, 2);
    float level = 0.0;
    for (int i = 1; i < COEFFICIENTS; ++i) {
        if (x >= quantile_depth(c, i)) {
            za = zb;
            zb = zc;
            zc = zd;
            zd = i + 2 <= COEFFICIENTS ? quantile_depth(c, i + 2) : 2.0;
            level = float(i);
        }
    }
    const float least = 1e-6;
    float a = max(zb - za, least);
    float b = max(zc - zb, least);
    float d = max(zd - zc, least);
    float slope_b = level > 0.5 ? node_slope(a, b) : end_slope(b, d);
    float slope_c = level < float(COEFFICIENTS) - 1.5 ? node_slope(b, d) : end_slope(b, a);
    float t = clamp((x - zb) / b, 0.0, 1.0);
    float fall = t * t * (3.0 - 2.0 * t) + b * t * (1.0 - t) * (slope_b * (1.0 - t) - slope_c * t);
    return 1.0 - (1.0 - end) / float(COEFFICIENTS) * (level + fall);
}

#endif
