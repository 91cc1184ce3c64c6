// A point of a surface that the camera sees, and the light that falls on it before shadows and media.

#include "include/camera.glsl"
#include "include/pixel.glsl"

uniform sampler2D gbuffer_normal_distance;
uniform sampler2D gbuffer_diffuse_roughness;
uniform sampler2D gbuffer_specular;
uniform float background_distance;

struct SurfacePoint {
    Ray ray;
    vec3 position;
    vec3 normal;
    float distance;  // along the ray
};

SurfacePoint surface_point() {
    vec4 geometry = texelFetch(gbuffer_normal_distance, ivec2(gl_FragCoord.xy), 0);
    Ray ray = camera_ray(picture_position());
    return SurfacePoint(ray, ray.anchor + geometry.w * ray.direction, geometry.xyz, geometry.w);
}

// Irradiance of the light of this draw on a surface, 0 where it faces away; `travel` is the direction of the light there.
vec3 surface_irradiance(SurfacePoint point, out vec3 travel) {
    float inverse_square;
    travel = light_travel(0, point.position, inverse_square);
    float cosine = max(-dot(point.normal, travel), 0.0);
    return lights[0].strength.rgb * shaping(0, travel, true) * (inverse_square * cosine);
}
