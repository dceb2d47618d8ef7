// Sums of coefficients over subtrees whose Haar terms nothing reads, normalised, in place, under some lights: a sum a thread.
// Twin: src/bake/compression/haar.rs.
#version 460
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#include "shared.glsl"
#include "lib/thread.glsl"

layout(local_size_x = GROUP_SIZE) in;

void main() {
    uint index = thread_index();
    if (index >= push.sum_count) {
        return;
    }
    uint first = push.first_place.at[index];
    uint end = push.first_place.at[index + 1];
    vec3 sums[LIGHTS];
    [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
        sums[l] = vec3(0.0);
    }
    for (uint i = first; i < end; ++i) {
        uint place = push.places.at[i];
        [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
            sums[l] += push.vector.at[place * LIGHTS + l].rgb;
        }
    }
    float scale = inversesqrt(float(end - first));
    uint place = push.places.at[first];
    [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
        push.vector.at[place * LIGHTS + l].rgb = scale * sums[l];
    }
}
