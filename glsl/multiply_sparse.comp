// Multiplies a sparse matrix by the RGB vectors of LIGHTS lights and adds the result to view samples. One thread per
// row. Twin: src/bake/transfer/sparse.rs.

#include "lib/add_radiance.glsl"

void main() {
    uint group = group_index();
    if (group >= push.slice_count) {
        return;
    }
    Slice slice = push.slices.at[group];
    uint row = gl_LocalInvocationIndex;
    if (row >= slice.row_count) {
        return;
    }
    vec3 sums[LIGHTS];
    [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
        sums[l] = vec3(0.0);
    }
    uint column = 0;
    uint value = slice.first_value + row;
    for (uint pair = 0; pair < slice.pair_count; ++pair, value += GROUP_SIZE) {
        uvec4 packed = push.values.at[value];
        [[unroll]] for (uint k = 0; k < 4; k += 2) {
            column += packed[k + 1] >> 16;
            vec3 factors = vec3(unpackHalf2x16(packed[k]), unpackHalf2x16(packed[k + 1]).x);
            [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
                sums[l] += factors * push.vector.at[column * LIGHTS + l].rgb;
            }
        }
    }
    [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
        add_radiance(push.outputs.at[slice.first_output + row], l, slice.scale * sums[l]);
    }
}
