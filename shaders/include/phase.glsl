// Phase functions, 1/sr, each integrating to 1 over the sphere. `cosine` is between the direction in which light travels
// before the event and the one after it: positive anisotropy scatters forward.

const float PI = 3.14159265358979;

const int PHASE_ISOTROPIC = 0;
const int PHASE_HG = 1;
const int PHASE_SCHLICK = 2;
const int PHASE_RAYLEIGH = 3;
const int PHASE_TWO_LOBE = 4;

// Henyey-Greenstein [RTR4] eq. 14.9. The denominator is written so that it keeps its digits at the peak, where
// 1 + g^2 - 2 g cos = (1 - g)^2 + 2 g (1 - cos).
float phase_hg(float g, float cosine) {
    float side = g >= 0.0 ? 1.0 - cosine : 1.0 + cosine;
    float a = 1.0 - abs(g);
    float denominator = a * a + 2.0 * abs(g) * max(side, 0.0);
    return (1.0 - g * g) / (4.0 * PI * denominator * sqrt(denominator));
}

// Schlick's rational fit [RTR4] eq. 14.11, with the sign for this angle. The fit of k leaves [-1, 1] for |g| in (0.938, 1).
float phase_schlick(float g, float cosine) {
    float k = clamp(1.55 * g - 0.55 * g * g * g, -0.999, 0.999);
    float d = 1.0 - k * cosine;
    return (1.0 - k * k) / (4.0 * PI * d * d);
}

float phase_rayleigh(float cosine) {
    return 3.0 / (16.0 * PI) * (1.0 + cosine * cosine);
}

// `parameters`: anisotropy, second anisotropy, lobe mix, kind.
float phase(vec4 parameters, float cosine) {
#if PHASE >= 0
    const int kind = PHASE;
#else
    int kind = int(parameters.w);
#endif
    if (kind == PHASE_HG) return phase_hg(parameters.x, cosine);
    if (kind == PHASE_SCHLICK) return phase_schlick(parameters.x, cosine);
    if (kind == PHASE_RAYLEIGH) return phase_rayleigh(cosine);
    if (kind == PHASE_TWO_LOBE)
        return mix(phase_hg(parameters.x, cosine), phase_hg(parameters.y, cosine), parameters.z);
    return 1.0 / (4.0 * PI);
}
