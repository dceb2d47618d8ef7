// Sums of exposed light images -> tone-mapped pixels, row by row. Twin: src/reference/composite.rs.

#include "lib/color.glsl"
#include "lib/display.glsl"
#include "lib/read_pixel.glsl"
#include "lib/tiles.glsl"

// One workgroup per tile: its reads are contiguous, and no pixel needs a division by the width.
void main() {
    uvec2 pixel = tile_pixel();
    if (pixel.x >= push.width || pixel.y >= push.height) {
        return;
    }
    uint stride = tiled_length(uvec2(push.width, push.height));
    uint tile = gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
    uint at = tile * GROUP_SIZE + gl_LocalInvocationIndex;
    uint index = pixel.y * push.width + pixel.x;

    vec3 c = vec3(0.0);
    [[unroll]] for (uint i = 0; i < MAX_TERMS; ++i) {
        if (i < push.term_count) {
            c += push.terms[i].scale * read_pixel(push.terms[i].image, at, stride);
        }
    }
    write_pixel(index, c);
}
