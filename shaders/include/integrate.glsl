// Integrals over a step with constant properties inside it, taken analytically ([RTR4] section 14.2.1, after Hillaire).

// (1 - exp(-x)) / x, by its series where the subtraction would lose all digits.
float mean_transmittance(float x) {
    return x < 0.02 ? 1.0 - x * (0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0))) : (1.0 - exp(-x)) / x;
}

vec3 mean_transmittance(vec3 x) {
    return vec3(mean_transmittance(x.r), mean_transmittance(x.g), mean_transmittance(x.b));
}

// Mean depth, as a fraction of the step, of what a step of optical depth x takes out of a ray:
// 1/x - exp(-x)/(1 - exp(-x)); one half for a thin step, near the front for a thick one.
float extinction_centroid(float x) {
    return x < 0.1 ? 0.5 - x * (1.0 / 12.0) : 1.0 / x - 1.0 / (exp(min(x, 60.0)) - 1.0);
}
