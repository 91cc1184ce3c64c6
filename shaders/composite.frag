// Media over surfaces; alpha is what the medium and the surfaces hide of the background.
in vec2 uv;

#if HAS_MEDIA
uniform sampler2D march_scattered;
uniform sampler2D march_transmittance;
#if HAS_EMISSION
uniform sampler2D march_emission;
#endif
#endif
#if HAS_MESHES
uniform sampler2D surface_radiance;
#endif

out vec4 color;

void main() {
    ivec2 p = ivec2(gl_FragCoord.xy);
    vec3 transmittance = vec3(1.0);
    vec3 radiance = vec3(0.0);
    float covered = 0.0;
#if HAS_MEDIA
    transmittance = texelFetch(march_transmittance, p, 0).rgb;
    radiance += texelFetch(march_scattered, p, 0).rgb;
#if HAS_EMISSION
    radiance += texelFetch(march_emission, p, 0).rgb;
#endif
#endif
#if HAS_MESHES
    vec4 surface = texelFetch(surface_radiance, p, 0);
    radiance += transmittance * surface.rgb;
    covered = surface.a;
#endif
    float open_to_background = (1.0 - covered) * dot(transmittance, vec3(1.0 / 3.0));
    color = vec4(radiance, 1.0 - open_to_background);
}
