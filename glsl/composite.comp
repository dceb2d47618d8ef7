// Sums of light images -> exposed, tone-mapped pixels, row by row.
#version 460
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#include "shared.glsl"
#include "lib/thread.glsl"
#include "lib/color.glsl"

layout(local_size_x = GROUP_SIZE) in;
layout(push_constant, scalar) uniform Block { CompositePush push; };
layout(constant_id = 0) const uint OUTPUT = OUTPUT_LINEAR;

#include "lib/display.glsl"

// One workgroup per tile: its reads are contiguous, and no pixel needs a division by the width.
void main() {
    uint tiles_x = (push.width + TILE_SIZE - 1) / TILE_SIZE;
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
            Read_float image = Read_float(push.terms[i].image);
            vec3 term = vec3(image.at[at], image.at[at + push.pixel_stride], image.at[at + 2 * push.pixel_stride]);
            c += push.terms[i].scale * term;
        }
    }
    write_pixel(index, c);
}
