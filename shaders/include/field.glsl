// Density fields: dense blocks of voxels in an atlas, or with HAS_SPARSE bricks that are found through a table. A dense block then is
// one brick.

uniform sampler3D density_atlas;
#if HAS_SPARSE
// Tables of bricks. An entry is the texel at which something begins, 11 bits along x, 11 along y, 10 along z, or NO_BRICK. Those of the
// directory, which comes first, are of a page of the table, and those of a page are of a brick in the atlas.
uniform usampler3D density_bricks;
uniform vec3 density_texel;         // 1 / size of the atlas

const uint NO_BRICK = 0xFFFFFFFFu;
const float PAGE = 8.0;  // bricks along a page

vec3 entry_texel(uint entry) {
    return vec3(float(entry & 2047u), float((entry >> 11u) & 2047u), float(entry >> 22u));
}
#endif

// Density at a place in the field's unit box.
//   atlas_scale    box (with HAS_SPARSE brick) -> atlas; w: density of a texel of value 1
//   bricks_scale   bricks that the box spans; w: value of texels that are not stored
//   bricks_shift   where in its brick the box begins, in bricks
//   bricks_offset  where the field's table begins
float field_density(vec3 box, vec4 atlas_scale, vec3 atlas_offset, vec4 bricks_scale, vec3 bricks_shift, vec3 bricks_offset) {
#if HAS_SPARSE
    vec3 place = box * bricks_scale.xyz + bricks_shift;
    vec3 brick = clamp(floor(place), vec3(0.0), ceil(bricks_scale.xyz + bricks_shift) - 1.0);
    vec3 page = floor(brick * (1.0 / PAGE));
    uint entry = texelFetch(density_bricks, ivec3(page + bricks_offset), 0).r;
    if (entry == NO_BRICK) return bricks_scale.w * atlas_scale.w;
    entry = texelFetch(density_bricks, ivec3(entry_texel(entry) + (brick - PAGE * page) + bricks_offset), 0).r;
    if (entry == NO_BRICK) return bricks_scale.w * atlas_scale.w;
    vec3 begin = entry_texel(entry);
    return texture(density_atlas, (place - brick) * atlas_scale.xyz + (begin * density_texel + atlas_offset)).r * atlas_scale.w;
#else
    return texture(density_atlas, box * atlas_scale.xyz + atlas_offset).r * atlas_scale.w;
#endif
}
