// One light on the surfaces that the camera sees, through shadows of meshes, and where IN_MEDIA says so through media.

#include "include/phase.glsl"
#include "include/medium.glsl"
#include "include/lights.glsl"
#include "include/transmittance.glsl"
#include "include/surface_point.glsl"
#include "include/surface_shadow.glsl"

uniform sampler2D gbuffer_emissive;

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
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    SurfacePoint point = surface_point();
    vec3 travel;
    vec3 irradiance = surface_irradiance(point, travel);
    vec4 diffuse = texelFetch(gbuffer_diffuse_roughness, pixel, 0);
    vec4 specular = texelFetch(gbuffer_specular, pixel, 0);
    float seen = surface_visibility(0, point.position, octahedral_direction(vec2(specular.w, texelFetch(gbuffer_emissive, pixel, 0).w)));
    vec3 arriving = irradiance * seen;
#if IN_MEDIA
    arriving *= light_transmittance(0, point.position, travel);
#endif
    vec3 reflected = diffuse.rgb / PI;
#if HAS_SPECULAR
    if (specular.r + specular.g + specular.b > 0.0)
        reflected += specular_lobe(point.normal, -travel, -point.ray.direction, specular.rgb, diffuse.a);
#endif
    radiance = vec4(reflected * arriving, 0.0);
}
