// The G-buffer of scattered pixels, taken from that of the whole picture.

uniform sampler2D scattered_pixels;
uniform sampler2D gbuffer_normal_distance;
uniform sampler2D gbuffer_diffuse_roughness;
uniform sampler2D gbuffer_specular;
uniform sampler2D gbuffer_emissive;
uniform float no_distance;

layout(location = 0) out vec4 normal_distance;
layout(location = 1) out vec4 diffuse_roughness;
layout(location = 2) out vec4 specular;
layout(location = 3) out vec4 emissive;

void main() {
    vec2 centre = texelFetch(scattered_pixels, ivec2(gl_FragCoord.xy), 0).xy;
    normal_distance = vec4(0.0, 0.0, 0.0, no_distance);
    diffuse_roughness = specular = emissive = vec4(0.0);
    if (centre.x < 0.0) return;
    ivec2 pixel = ivec2(centre);
    normal_distance = texelFetch(gbuffer_normal_distance, pixel, 0);
    diffuse_roughness = texelFetch(gbuffer_diffuse_roughness, pixel, 0);
    specular = texelFetch(gbuffer_specular, pixel, 0);
    emissive = texelFetch(gbuffer_emissive, pixel, 0);
}
