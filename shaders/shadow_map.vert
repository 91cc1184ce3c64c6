// Meshes into one face of a light's shadow map.
in vec3 in_position;
in mat4 in_instance;  // local -> relative to the render origin

uniform mat4 view_projection;

out vec3 position;

void main() {
    vec4 p = in_instance * vec4(in_position, 1.0);
    position = p.xyz;
    gl_Position = view_projection * p;
}
