// Depth is linear: along the light for an orthographic face, distance over the farthest distance otherwise.
in vec3 position;

uniform vec3 light_position;
uniform float light_far;
uniform bool orthographic;

void main() {
    gl_FragDepth = orthographic ? gl_FragCoord.z : length(position - light_position) / light_far;
}
