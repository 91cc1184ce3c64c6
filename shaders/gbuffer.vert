// Meshes before the camera.
in vec3 in_position;
in vec3 in_normal;
in vec3 in_color;
in mat4 in_instance;  // local -> relative to the render origin

uniform mat4 view_projection;

out vec3 position;
out vec3 normal;
out vec3 color;

void main() {
    vec4 p = in_instance * vec4(in_position, 1.0);
    position = p.xyz;
    // Normals go with the cofactors of the matrix, which exist even where it is singular and keep the side under a mirror.
    mat3 m = mat3(in_instance);
    mat3 cofactors = mat3(cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1]));
    normal = cofactors * in_normal * (dot(m[0], cofactors[0]) < 0.0 ? -1.0 : 1.0);
    color = in_color;
    gl_Position = view_projection * p;
}
