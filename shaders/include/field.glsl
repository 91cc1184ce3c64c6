// Density fields: dense blocks of voxels in an atlas, or with HAS_SPARSE bricks that are found through a table. A dense block then is
// one brick.

uniform sampler3D density_atlas;
#if HAS_SPARSE
uniform usampler3D density_bricks;  // the texel at which a brick begins, 11 bits along x, 11 along y, 10 along z; or all bits set
uniform vec3 density_texel;         // 1 / size of the atlas

const uint NO_BRICK = 0xFFFFFFFFu;
#endif

// Density at a place in the field's unit box.
//   atlas_scale    box (with HAS_SPARSE brick) -> atlas; w: density of a texel of value 1
//   bricks_scale   bricks that the box spans; w: value of texels that are not stored
//   bricks_shift   where in its brick the box begins, in bricks
//   bricks_offset  first entry of the field's table
float field_density(vec3 box, vec4 atlas_scale, vec3 atlas_offset, vec4 bricks_scale, vec3 bricks_shift, vec3 bricks_offset) {
#if HAS_SPARSE
    vec3 place = box * bricks_scale.xyz + bricks_shift;
    vec3 brick = clamp(floor(place), vec3(0.0), ceil(bricks_scale.xyz + bricks_shift) - 1.0);
    uint entry = texelFetch(density_bricks, ivec3(brick + bricks_offset), 0).r;
    if (entry == NO_BRICK) return bricks_scale.w * atlas_scale.w;
    vec3 begin = vec3(float(entry & 2047u), float((entry >> 11u) & 2047u), float(entry >> 22u));
    return texture(density_atlas, (place - brick) * atlas_scale.xyz + (begin * density_texel + atlas_offset)).r * atlas_scale.w;
#else
    return texture(density_atlas, box * atlas_scale.xyz + atlas_offset).r * atlas_scale.w;
#endif
}
