// Counts values of an image's planes that are infinite or not a number.
#version 460
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#include "shared.glsl"
#include "lib/thread.glsl"

layout(local_size_x = GROUP_SIZE) in;
layout(push_constant, scalar) uniform Block { CountNonFinitePush push; };

void main() {
    uint index = thread_index();
    if (index >= 3 * push.plane_length) {
        return;
    }
    uint plane = index / push.plane_length;
    uint bits = push.values.at[plane * push.plane_stride + index % push.plane_length];
    // By the exponent: no compiler takes that for always false.
    if ((bits & 0x7f800000) == 0x7f800000) {
        atomicAdd(push.counts.at[push.slot], 1);
    }
}
