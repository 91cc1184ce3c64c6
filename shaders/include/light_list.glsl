// Lights that can reach a place, by the cell of a grid over the media; all of them where the plan makes no lists:
//   int count; int first = light_first(position, count);
//   for (int n = first; n < first + count; ++n) { int i = listed_light(n); ... }

#if HAS_LIGHT_LISTS
layout(std140) uniform LightLists {
    vec4 list_origin;                // corner of the grid, relative to the render origin; w: cells along an edge
    vec4 list_scale;                 // cells per unit of length along each axis
    uvec4 list_cells[MOST_CELLS / 4];  // count << 16 | first, x fastest
    uvec4 list_lights[MOST_INDICES / 16];                        // a byte each
};

int light_first(vec3 position, out int count) {
    int cells = int(list_origin.w);
    ivec3 cell = clamp(ivec3((position - list_origin.xyz) * list_scale.xyz), ivec3(0), ivec3(cells - 1));
    int number = (cell.z * cells + cell.y) * cells + cell.x;
    uint list = list_cells[number >> 2][number & 3];
    count = int(list >> 16u);
    return int(list & 65535u);
}

int listed_light(int n) {
    return int((list_lights[n >> 4][(n >> 2) & 3] >> uint(8 * (n & 3))) & 255u);
}
#else
int light_first(vec3 position, out int count) {
    count = light_count;
    return 0;
}

int listed_light(int n) {
    return n;
}
#endif
