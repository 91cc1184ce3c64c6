// The mean of a picture's lit values, in two draws: sums over blocks of pixels into a small square target, then their ratio.
// A pixel is lit when a channel is above a part of an earlier mean; without one, when a channel is above 0.

in vec2 uv;

uniform sampler2D picture_b;   // the picture, or the sums
uniform sampler2D mean_level;  // r: the earlier mean
uniform float lit_part;
uniform int blocks;            // along a side of the target of sums

out vec4 level;

void main() {
#if SUMS
    ivec2 size = textureSize(picture_b, 0);
    ivec2 block = ivec2(gl_FragCoord.xy);
    ivec2 first = block * size / blocks;
    ivec2 last = (block + 1) * size / blocks;
    float lit = lit_part > 0.0 ? lit_part * texelFetch(mean_level, ivec2(0), 0).r : 0.0;
    vec2 sum = vec2(0.0);
    for (int y = first.y; y < last.y; ++y)
        for (int x = first.x; x < last.x; ++x) {
            vec3 c = texelFetch(picture_b, ivec2(x, y), 0).rgb;
            float all_ = c.r + c.g + c.b;
            if (isnan(all_) || isinf(all_)) continue;
            if (max(max(c.r, c.g), c.b) > lit) sum += vec2(all_, 3.0);
        }
    level = vec4(sum, 0.0, 1.0);
#else
    vec2 sum = vec2(0.0);
    for (int y = 0; y < blocks; ++y)
        for (int x = 0; x < blocks; ++x) sum += texelFetch(picture_b, ivec2(x, y), 0).rg;
    level = vec4(sum.y > 0.0 ? sum.x / sum.y : 0.0, sum, 1.0);
#endif
}
