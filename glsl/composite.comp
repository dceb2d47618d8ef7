// Sums of exposed light images -> tone-mapped pixels, row by row. Twin: src/reference/composite.rs.

#include "lib/color.glsl"
#include "lib/display.glsl"
#include "lib/read_pixel.glsl"
#include "lib/tiles.glsl"

// One workgroup per tile: its reads are contiguous, and no pixel needs a division by the width.
void main() {
    uint tiles_x = (push.width + TILE_SIZE - 1) / TILE_SIZE;
    uint stride = tiled_length(uvec2(push.width, push.height));
    uvec2 tile = uvec2(group_index() % tiles_x, group_index() / tiles_x);
    uint inside = gl_LocalInvocationIndex;
    uvec2 pixel = tile * TILE_SIZE + uvec2(inside % TILE_SIZE, inside / TILE_SIZE);
    if (pixel.x >= push.width || pixel.y >= push.height) {
        return;
    }
    uint at = thread_index();
    uint index = pixel.y * push.width + pixel.x;

    vec3 c = vec3(0.0);
    [[unroll]] for (uint i = 0; i < MAX_TERMS; ++i) {
        if (i < push.term_count) {
            c += push.terms[i].scale * read_pixel(push.terms[i].image, at, stride);
        }
    }
    write_pixel(index, c);
}
