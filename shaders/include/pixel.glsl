// Which pixel of the picture a fragment is: its own, or where scattered pixels are drawn, the one that a texture gives.

#if SCATTERED_PIXELS
uniform sampler2D scattered_pixels;  // centre in pixels from the lower left, negative where there is none
uniform vec2 image_size;
#else
in vec2 uv;
#endif

// Place in the picture, 0 to 1 from the lower left; negative for a fragment that is no pixel.
vec2 picture_position() {
#if SCATTERED_PIXELS
    return texelFetch(scattered_pixels, ivec2(gl_FragCoord.xy), 0).xy / image_size;
#else
    return uv;
#endif
}
