// A picture -> the same at another size: a tent filter as wide as the larger of both pixels.
#version 460
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#include "shared.glsl"
#include "lib/thread.glsl"

layout(local_size_x = GROUP_SIZE) in;
layout(push_constant, scalar) uniform Block { FitPush push; };

void main() {
    uint index = thread_index();
    if (index >= push.target_size.x * push.target_size.y) {
        return;
    }
    vec2 ratio = vec2(push.source_size) / vec2(push.target_size);
    vec2 support = max(ratio, 1.0);
    // In units of source pixels, whose centres lie at whole numbers.
    vec2 center = (vec2(index % push.target_size.x, index / push.target_size.x) + 0.5) * ratio - 0.5;
    ivec2 first = ivec2(ceil(center - support));
    ivec2 last = ivec2(floor(center + support));
    ivec2 edge = ivec2(push.source_size) - 1;

    vec4 sum = vec4(0.0);
    float weights = 0.0;
    for (int y = first.y; y <= last.y; ++y) {
        float weight_y = max(0.0, 1.0 - abs(float(y) - center.y) / support.y);
        uint row = uint(clamp(y, 0, edge.y)) * push.source_size.x;
        for (int x = first.x; x <= last.x; ++x) {
            float weight = weight_y * max(0.0, 1.0 - abs(float(x) - center.x) / support.x);
            sum += weight * unpackUnorm4x8(push.source.at[row + uint(clamp(x, 0, edge.x))]);
            weights += weight;
        }
    }
    push.target.at[index] = packUnorm4x8(sum / weights);
}
