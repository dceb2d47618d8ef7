// Adds to λ0 what a light's rays bring to gather samples. A coefficient a thread.
#version 460
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#include "shared.glsl"
#include "lib/thread.glsl"

layout(local_size_x = GROUP_SIZE) in;

void main() {
    uint index = thread_index();
    if (index >= push.count) {
        return;
    }
    Contribution caught = push.contributions.at[index];
    push.coefficients.at[caught.index * push.stride + push.offset].rgb += caught.value;
}
