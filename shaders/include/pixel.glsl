// Which pixel of the picture a fragment is: its own; every n-th along both sides, and the last, where the target is smaller than the
// picture; or where scattered pixels are drawn, the one that a texture gives.

uniform vec2 image_size;
#if SCATTERED_PIXELS
uniform sampler2D scattered_pixels;  // centre in pixels from the lower left, negative where there is none
#else
in vec2 uv;
uniform int pixel_stride;  // pixels of the picture from one fragment to the next
#endif

// Texel of the G-buffer that belongs to a fragment.
ivec2 geometry_texel() {
#if SCATTERED_PIXELS
    return ivec2(gl_FragCoord.xy);
#else
    return min(ivec2(gl_FragCoord.xy) * pixel_stride, ivec2(image_size) - 1);
#endif
}

// Place in the picture, 0 to 1 from the lower left; negative for a fragment that is no pixel.
vec2 picture_position() {
#if SCATTERED_PIXELS
    return texelFetch(scattered_pixels, ivec2(gl_FragCoord.xy), 0).xy / image_size;
#else
    return pixel_stride == 1 ? uv : (vec2(geometry_texel()) + 0.5) / image_size;
#endif
}
