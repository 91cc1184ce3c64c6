// The media at every pixel, from those that were marched: bilinear between the four around a pixel, but not across the edges of
// surfaces, whose rays end elsewhere. How far two rays see is compared by the medium that may lie between their ends, so that edges
// of what is behind or before all media are none. A pixel that none of the four stands for is left to be marched: its depth says so.

#include "include/camera.glsl"
#include "include/medium.glsl"

uniform sampler2D march_scattered;
uniform sampler2D march_transmittance;
#if HAS_EMISSION
uniform sampler2D march_emission;
#endif
uniform vec2 image_size;
uniform int pixel_stride;  // of the marched pixels
#if HAS_MESHES
uniform sampler2D gbuffer_normal_distance;
uniform float background_distance;
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

// Optical depth up to a distance of a medium that is everywhere as dense as its densest voxel, in the weakest channel.
float depth_until(Ray ray, vec2 spans[VOLUME_COUNT], float end) {
    vec3 depth = vec3(0.0);
    for (int v = 0; v < VOLUME_COUNT; ++v) {
        float peak = is_grid(v) ? volumes[v].atlas_scale.w : 1.0;
        depth += max(min(spans[v].y, end) - spans[v].x, 0.0) * peak * volumes[v].strength.rgb;
    }
    return max(max(depth.r, depth.g), depth.b);
}

// How much what lies between two optical depths may count at the most, where a marched ray that ends at the second transmits so much.
float difference(float wanted, float found, float transmittance) {
    return (wanted < found ? 1.0 : transmittance) * (1.0 - exp(-abs(wanted - found)));
}
#endif

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    ivec2 low = pixel / pixel_stride;
    ivec2 first = low * pixel_stride;
    ivec2 next = min(first + pixel_stride, ivec2(image_size) - 1);
    ivec2 high = low + ivec2(greaterThan(next, first));
    vec2 part = vec2(pixel - first) / vec2(max(next - first, 1));
    ivec2 texel[4] = ivec2[4](low, ivec2(high.x, low.y), ivec2(low.x, high.y), high);
    vec4 weight = vec4(1.0 - part.x, part.x, 1.0 - part.x, part.x) * vec4(vec2(1.0 - part.y), vec2(part.y));
    vec3 transmittance[4];
    for (int i = 0; i < 4; ++i) transmittance[i] = texelFetch(march_transmittance, texel[i], 0).rgb;
#if HAS_MESHES
    gl_FragDepth = 0.0;
    vec4 end = vec4(texelFetch(gbuffer_normal_distance, first, 0).w,
                    texelFetch(gbuffer_normal_distance, ivec2(next.x, first.y), 0).w,
                    texelFetch(gbuffer_normal_distance, ivec2(first.x, next.y), 0).w,
                    texelFetch(gbuffer_normal_distance, next, 0).w);
    float own = texelFetch(gbuffer_normal_distance, pixel, 0).w;
    if (own < background_distance || any(lessThan(end, vec4(background_distance)))) {
        Ray ray = camera_ray((vec2(pixel) + 0.5) / image_size);
        vec2 visible = camera_range(ray);
        vec2 spans[VOLUME_COUNT];
        for (int v = 0; v < VOLUME_COUNT; ++v) {
            vec2 span = volume_interval(v, ray.anchor, ray.direction);
            spans[v] = vec2(max(span.x, visible.x), min(span.y, visible.y));
        }
        float wanted = depth_until(ray, spans, own);
        vec4 found = vec4(0.0);
        vec4 clear = vec4(0.0);
        for (int i = 0; i < 4; ++i) {
            found[i] = depth_until(ray, spans, end[i]);
            clear[i] = max(max(transmittance[i].r, transmittance[i].g), transmittance[i].b);
        }
        // A surface that is seen aslant is as far as its neighbours are together, however much they differ.
        if (difference(wanted, dot(weight, found), max(max(clear.x, clear.y), max(clear.z, clear.w))) > SAME) {
            for (int i = 0; i < 4; ++i)
                weight[i] *= 1.0 - smoothstep(SAME, OTHER, difference(wanted, found[i], clear[i]));
            float total = dot(weight, vec4(1.0));
            if (total < LEAST_WEIGHT) gl_FragDepth = 1.0;
            weight /= max(total, 1e-6);
        }
    }
#endif
    vec3 scattered = vec3(0.0);
    vec3 through = vec3(0.0);
    for (int i = 0; i < 4; ++i) {
        scattered += weight[i] * texelFetch(march_scattered, texel[i], 0).rgb;
        through += weight[i] * transmittance[i];
    }
    out_scattered = vec4(scattered, 1.0);
    out_transmittance = vec4(through, 1.0);
#if HAS_EMISSION
    vec3 emission = vec3(0.0);
    for (int i = 0; i < 4; ++i) emission += weight[i] * texelFetch(march_emission, texel[i], 0).rgb;
    out_emission = vec4(emission, 1.0);
#endif
}
