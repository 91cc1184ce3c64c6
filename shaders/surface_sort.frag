// Sorts pixels by what one light needs there: the depth is raised where it lights a surface with nothing on its way, lowered where it
// passes a medium, and left where there is nothing to light. Draws after it run, by the depth test, where they have something to do: a
// processor that draws many pixels at once skips none by a branch.

#include "include/medium.glsl"
#include "include/lights.glsl"
#include "include/surface_point.glsl"

#if IN_MEDIA && VOLUME_COUNT > 0
// A map blurs what a volume holds across its texels: past the bounds by so much of a grid's size a ray counts as inside.
const float MARGIN = 0.06;

bool passes_media(vec3 position, vec3 travel) {
    float far = 1e30;
#if HAS_POINT
    far = length(position - lights[0].position.xyz);
#endif
    for (int v = 0; v < VOLUME_COUNT; ++v) {
        vec2 span;
        if (is_grid(v)) {
            vec3 o = (volumes[v].world_to_box * vec4(position, 1.0)).xyz;
            vec3 d = -(mat3(volumes[v].world_to_box) * travel);
            const float scale = 1.0 / (1.0 + 2.0 * MARGIN);
            span = unit_cube_interval((o + MARGIN) * scale, d * scale);
        } else {
            span = volume_interval(v, position, -travel);
        }
        if (max(span.x, 0.0) < min(span.y, far)) return true;
    }
    return false;
}
#endif

void main() {
    gl_FragDepth = 0.5;
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    SurfacePoint point = surface_point();
    if (point.distance >= background_distance) return;
    vec3 reflecting = texelFetch(gbuffer_diffuse_roughness, pixel, 0).rgb;
#if HAS_SPECULAR
    reflecting += texelFetch(gbuffer_specular, pixel, 0).rgb;
#endif
    float inverse_square;
    vec3 travel = light_travel(0, point.position, inverse_square);
    if (dot(point.normal, travel) >= 0.0 || dot(reflecting, vec3(1.0)) <= 0.0) return;
#if HAS_SHAPING || HAS_COSINE
    float cosine = dot(travel, lights[0].axis.xyz);
#endif
#if HAS_SHAPING
    if (cosine < lights[0].cone.w) return;
#endif
#if HAS_COSINE
    if (cosine <= 0.0) return;
#endif
    gl_FragDepth = 1.0;
#if IN_MEDIA && VOLUME_COUNT > 0
    if (passes_media(point.position, travel)) gl_FragDepth = 0.0;
#endif
}
