// Depth is linear: along the light for an orthographic face, as it is rasterised; distance over the farthest distance otherwise.
#if ORTHOGRAPHIC
void main() {}
#else
in vec3 position;

uniform vec3 light_position;
uniform float light_far;

void main() {
    gl_FragDepth = length(position - light_position) / light_far;
}
#endif
