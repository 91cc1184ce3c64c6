// The media at every pixel, from those that were marched: bilinear between the four around a pixel, but not across the edges of
// surfaces, whose rays end elsewhere. How far two rays see is compared by the medium that may lie between their ends, so that edges
// of what is behind or before all media are none. A pixel that none of the four stands for is left to be marched: its depth says so.

#include "include/camera.glsl"
#include "include/medium.glsl"

uniform sampler2D march_scattered;  // a: how far the ray sees
uniform sampler2D march_transmittance;
#if HAS_EMISSION
uniform sampler2D march_emission;
#endif
uniform vec2 image_size;
uniform int pixel_stride;  // of the marched pixels
#if HAS_MESHES
uniform sampler2D gbuffer_normal_distance;
#endif

layout(location = 0) out vec4 out_scattered;
layout(location = 1) out vec4 out_transmittance;
#if HAS_EMISSION
layout(location = 2) out vec4 out_emission;
#endif

#if HAS_MESHES
// What a pixel may be off for the medium that its ray and a marched one do not share: less than the first counts as nothing, and a
// marched pixel that is off by more than the second is not taken.
const float SAME = 0.01;
const float OTHER = 0.05;
// Less weight than this of the four is too little to go by.
const float LEAST_WEIGHT = 0.2;

float strongest(vec3 c) {
    return max(max(c.r, c.g), c.b);
}

// Of the densest voxel.
float strongest_extinction(int v) {
    return strongest(volumes[v].strength.rgb) * (is_grid(v) ? volumes[v].atlas_scale.w : 1.0);
}

// How much what lies between two optical depths may count at the most, where a marched ray that ends at the second transmits so much.
vec4 difference(float wanted, vec4 found, vec4 transmittance) {
    return mix(transmittance, vec4(1.0), lessThan(vec4(wanted), found)) * (1.0 - exp(-abs(wanted - found)));
}
#endif

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    ivec2 low = pixel / pixel_stride;
    ivec2 first = low * pixel_stride;
    ivec2 next = min(first + pixel_stride, ivec2(image_size) - 1);
    ivec2 high = low + ivec2(greaterThan(next, first));
    vec2 part = vec2(pixel - first) / vec2(max(next - first, 1));
    ivec2 right = ivec2(high.x, low.y);
    ivec2 above = ivec2(low.x, high.y);
    vec4 weight = vec4(1.0 - part.x, part.x, 1.0 - part.x, part.x) * vec4(vec2(1.0 - part.y), vec2(part.y));
    vec4 scattered0 = texelFetch(march_scattered, low, 0);
    vec4 scattered1 = texelFetch(march_scattered, right, 0);
    vec4 scattered2 = texelFetch(march_scattered, above, 0);
    vec4 scattered3 = texelFetch(march_scattered, high, 0);
    vec3 transmittance0 = texelFetch(march_transmittance, low, 0).rgb;
    vec3 transmittance1 = texelFetch(march_transmittance, right, 0).rgb;
    vec3 transmittance2 = texelFetch(march_transmittance, above, 0).rgb;
    vec3 transmittance3 = texelFetch(march_transmittance, high, 0).rgb;
#if HAS_MESHES
    gl_FragDepth = 0.0;
    vec4 end = vec4(scattered0.a, scattered1.a, scattered2.a, scattered3.a);
    float own = texelFetch(gbuffer_normal_distance, pixel, 0).w;
    Ray ray = camera_ray((vec2(pixel) + 0.5) / image_size);
    vec2 visible = camera_range(ray);
    float nearest = min(min(min(end.x, end.y), min(end.z, end.w)), own);
    float most = 0.0;
    for (int v = 0; v < VOLUME_COUNT; ++v) most += strongest_extinction(v);
    // Along a surface, and before an empty background, the ends are as far as they should be, wherever the media are.
    if (nearest < 0.999 * visible.y && most * abs(dot(weight, end) - own) > SAME) {
        float wanted = 0.0;
        vec4 found = vec4(0.0);
        for (int v = 0; v < VOLUME_COUNT; ++v) {
            vec2 span = volume_interval(v, ray.anchor, ray.direction);
            span = vec2(max(span.x, visible.x), min(span.y, visible.y));
            float extinction = strongest_extinction(v);
            wanted += extinction * max(min(span.y, own) - span.x, 0.0);
            found += extinction * max(min(vec4(span.y), end) - span.x, 0.0);
        }
        vec4 clear = vec4(strongest(transmittance0), strongest(transmittance1), strongest(transmittance2), strongest(transmittance3));
        // A surface that is seen aslant is as far as its neighbours are together, however much they differ.
        vec4 together = vec4(dot(weight, found));
        vec4 clearest = vec4(max(max(clear.x, clear.y), max(clear.z, clear.w)));
        if (difference(wanted, together, clearest).x > SAME) {
            weight *= 1.0 - smoothstep(SAME, OTHER, difference(wanted, found, clear));
            float total = dot(weight, vec4(1.0));
            if (total < LEAST_WEIGHT) gl_FragDepth = 1.0;
            weight /= max(total, 1e-6);
        }
    }
#endif
    out_scattered = weight.x * scattered0 + weight.y * scattered1 + weight.z * scattered2 + weight.w * scattered3;
    out_transmittance = vec4(weight.x * transmittance0 + weight.y * transmittance1 + weight.z * transmittance2
        + weight.w * transmittance3, 1.0);
#if HAS_EMISSION
    out_emission = weight.x * texelFetch(march_emission, low, 0) + weight.y * texelFetch(march_emission, right, 0)
        + weight.z * texelFetch(march_emission, above, 0) + weight.w * texelFetch(march_emission, high, 0);
#endif
}
