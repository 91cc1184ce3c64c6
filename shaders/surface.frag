// Light on the surfaces that the camera sees, through shadows and media.

#include "include/phase.glsl"
#include "include/camera.glsl"
#include "include/transmittance.glsl"

#include "include/pixel.glsl"

uniform sampler2D gbuffer_normal_distance;
uniform sampler2D gbuffer_diffuse_roughness;
uniform sampler2D gbuffer_specular;
uniform sampler2D gbuffer_emissive;
uniform vec3 ambient;
uniform float background_distance;
uniform bool first_batch;

out vec4 radiance;

// GGX with Smith's height-correlated shadowing and Schlick's Fresnel, as UsdPreviewSurface specifies its specular lobe.
vec3 specular_lobe(vec3 n, vec3 to_light, vec3 to_camera, vec3 at_normal, float roughness) {
    float alpha = max(roughness * roughness, 1e-3);
    float square = alpha * alpha;
    vec3 h = normalize(to_light + to_camera);
    float nh = max(dot(n, h), 0.0);
    float nl = max(dot(n, to_light), 1e-4);
    float nv = max(dot(n, to_camera), 1e-4);
    float d = nh * nh * (square - 1.0) + 1.0;
    float distribution = square / (PI * d * d);
    float masking = 0.5 / (nl * sqrt(nv * nv * (1.0 - square) + square) + nv * sqrt(nl * nl * (1.0 - square) + square));
    vec3 fresnel = at_normal + (1.0 - at_normal) * pow(1.0 - max(dot(h, to_camera), 0.0), 5.0);
    return distribution * masking * fresnel;
}

// The direction that gbuffer.frag put into two numbers from -1 to 1.
vec3 octahedral_direction(vec2 p) {
    vec3 d = vec3(p, 1.0 - abs(p.x) - abs(p.y));
    if (d.z < 0.0) d.xy = (1.0 - abs(d.yx)) * vec2(p.x >= 0.0 ? 1.0 : -1.0, p.y >= 0.0 ? 1.0 : -1.0);
    return normalize(d);
}

void main() {
    vec4 geometry = texelFetch(gbuffer_normal_distance, ivec2(gl_FragCoord.xy), 0);
    radiance = vec4(0.0);
    if (geometry.w >= background_distance) return;
    Ray ray = camera_ray(picture_position());
    vec3 position = ray.anchor + geometry.w * ray.direction;
    vec3 n = geometry.xyz;
    vec4 diffuse = texelFetch(gbuffer_diffuse_roughness, ivec2(gl_FragCoord.xy), 0);
    vec4 specular = texelFetch(gbuffer_specular, ivec2(gl_FragCoord.xy), 0);
    vec4 emissive = texelFetch(gbuffer_emissive, ivec2(gl_FragCoord.xy), 0);
    vec3 plane = octahedral_direction(vec2(specular.w, emissive.w));
    vec3 sum = vec3(0.0);
    if (first_batch) {
#if HAS_EMISSIVE
        sum += emissive.rgb;
#endif
#if HAS_AMBIENT
        sum += diffuse.rgb * ambient;
#endif
    }
#if HAS_SPECULAR
    vec3 at_normal = specular.rgb;
#endif
#if HAS_LIGHTS
    for (int i = 0; i < light_count; ++i) {
        float inverse_square;
        vec3 travel = light_travel(i, position, inverse_square);
        float cosine = -dot(n, travel);
        if (cosine <= 0.0) continue;
        vec3 irradiance = lights[i].strength.rgb * shaping(i, travel, true) * (inverse_square * cosine);
        if (max(max(irradiance.r, irradiance.g), irradiance.b) <= 0.0) continue;
        float seen = surface_visibility(i, position, plane);
        if (seen <= 0.0) continue;
        vec3 arriving = irradiance * seen * light_transmittance(i, position, travel);
        vec3 reflected = diffuse.rgb / PI;
#if HAS_SPECULAR
        if (at_normal.r + at_normal.g + at_normal.b > 0.0)
            reflected += specular_lobe(n, -travel, -ray.direction, at_normal, diffuse.a);
#endif
        sum += reflected * arriving;
    }
#endif
    radiance = vec4(sum, first_batch ? 1.0 : 0.0);  // batches are added, coverage counts once
}
