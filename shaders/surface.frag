// What surfaces send to the camera without any light: emission, and the ambient light that they reflect. Lights are added to it.

uniform sampler2D gbuffer_normal_distance;
uniform sampler2D gbuffer_diffuse_roughness;
uniform sampler2D gbuffer_emissive;
uniform vec3 ambient;
uniform float background_distance;

out vec4 radiance;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec3 sum = vec3(0.0);
#if HAS_EMISSIVE
    sum += texelFetch(gbuffer_emissive, pixel, 0).rgb;
#endif
#if HAS_AMBIENT
    sum += texelFetch(gbuffer_diffuse_roughness, pixel, 0).rgb * ambient;
#endif
    bool covered = texelFetch(gbuffer_normal_distance, pixel, 0).w < background_distance;
    radiance = covered ? vec4(sum, 1.0) : vec4(0.0);
}
