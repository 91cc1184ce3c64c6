// What the camera sees first: distance, normal and the constants of its surface.

#include "include/camera.glsl"

in vec3 position;
in vec3 normal;
in vec3 color;

uniform vec2 image_size;
uniform vec3 diffuse_color;
uniform vec3 specular_at_normal;  // Fresnel reflectance at normal incidence; 0 for a plain Lambertian
uniform float roughness;
uniform vec3 emissive_color;

layout(location = 0) out vec4 normal_distance;
layout(location = 1) out vec4 diffuse_roughness;
layout(location = 2) out vec4 specular;
layout(location = 3) out vec4 emissive;

// A direction in two numbers from -1 to 1 (Cigolle et al. 2014).
vec2 octahedral(vec3 d) {
    d /= abs(d.x) + abs(d.y) + abs(d.z);
    return d.z >= 0.0 ? d.xy : (1.0 - abs(d.yx)) * vec2(d.x >= 0.0 ? 1.0 : -1.0, d.y >= 0.0 ? 1.0 : -1.0);
}

void main() {
    Ray ray = camera_ray(gl_FragCoord.xy / image_size);
    float l = length(normal);
    vec3 n = l > 0.0 ? normal / l : -ray.direction;
    // Both sides are shown: the normal that is lit is the one on the camera's side.
    if (dot(n, ray.direction) > 0.0) n = -n;
    normal_distance = vec4(n, dot(position - ray.anchor, ray.direction));
    diffuse_roughness = vec4(diffuse_color * color, roughness);
    // The plane of the triangle, which shadows are looked up on: a normal that is smoothed is not that plane's.
    vec3 across = cross(dFdx(position), dFdy(position));
    float area = length(across);
    vec2 plane = octahedral(area > 0.0 ? across / area : n);
    specular = vec4(specular_at_normal, plane.x);
    emissive = vec4(emissive_color, plane.y);
}
