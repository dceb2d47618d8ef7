// Counts values of an image's planes that are infinite or not a number: the same place of all three a thread.
#version 460
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#include "shared.glsl"
#include "lib/thread.glsl"

layout(local_size_x = GROUP_SIZE) in;
layout(push_constant, scalar) uniform Block { CountNonFinitePush push; };

void main() {
    uint index = thread_index();
    if (index >= push.plane_length) {
        return;
    }
    uint count = 0;
    [[unroll]] for (uint plane = 0; plane < 3; ++plane) {
        // Tests the exponent bits: a compiler may assume that isinf and isnan are always false.
        count += uint((push.values.at[plane * push.plane_stride + index] & 0x7f800000) == 0x7f800000);
    }
    if (count > 0) {
        atomicAdd(push.counts.at[push.slot], count);
    }
}
