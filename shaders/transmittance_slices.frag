// One texel of a light-space grid: the optical depth between the light and evenly spaced distances along one light ray, of one volume.
// A draw makes SLICES_PER_DRAW of them and takes up the depth that the one before it came to.

#include "include/light_ray.glsl"

layout(location = 0) out vec4 depths0;
layout(location = 1) out vec4 depths1;
layout(location = 2) out vec4 depths2;
layout(location = 3) out vec4 depths3;
layout(location = 4) out vec4 depths4;
layout(location = 5) out vec4 depths5;
layout(location = 6) out vec4 depths6;
layout(location = 7) out vec4 reached;

uniform sampler2D previous_depth;
uniform int first_slice;
uniform vec2 slices;      // distance of the first along the light's rays from the centre's, and from one to the next
uniform int parts;        // steps from one slice to the next
uniform float stored;     // extinction per unit of density at which optical depth is stored

vec4 four_slices(float begin, float h, int first, vec2 span, inout float depth) {
    vec4 found = vec4(0.0);
    for (int n = 0; n < 4 * parts; ++n) {
        int slice = n / parts;
        // What of the step is in the volume: neighbouring rays enter it at places of their own.
        float s0 = max(begin + float(first * parts + n) * h, span.x);
        float s1 = min(begin + float(first * parts + n + 1) * h, span.y);
        float density = density_along(0.5 * (s0 + s1));
        if (s1 > s0 && slice + first + first_slice > 0) depth += stored * density * (s1 - s0);
        vec4 here = vec4(greaterThanEqual(vec4(0.0, 1.0, 2.0, 3.0), vec4(float(slice))));
        found = mix(found, vec4(min(depth, 6e4)), here);
    }
    return found;
}

void main() {
    light_ray();
    vec2 span = bounds_interval();
    if (map_kind != MAP_ORTHOGRAPHIC) span.x = max(span.x, -dot(origin + from_light.xyz, direction));  // where the light itself is
    float offset = distance_along_light(map_kind, origin, from_light);
    float h = slices.y / float(parts);
    float begin = slices.x + float(first_slice - 1) * slices.y - offset;
    float depth = first_slice > 0 ? texelFetch(previous_depth, ivec2(gl_FragCoord.xy), 0).r : 0.0;
    // Written out: software cannot index what a loop leaves behind without going through memory.
    depths0 = four_slices(begin, h, 0, span, depth);
    depths1 = four_slices(begin, h, 4, span, depth);
    depths2 = four_slices(begin, h, 8, span, depth);
    depths3 = four_slices(begin, h, 12, span, depth);
    depths4 = four_slices(begin, h, 16, span, depth);
    depths5 = four_slices(begin, h, 20, span, depth);
    depths6 = four_slices(begin, h, 24, span, depth);
    reached = vec4(depth);
}
