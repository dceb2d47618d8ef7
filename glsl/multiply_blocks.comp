// A block matrix times a vector of RGB: ROWS rows of a panel a thread. Twin: src/bake/transfer/blocks.rs.
#version 460
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#include "shared.glsl"
#include "lib/thread.glsl"

layout(local_size_x = GROUP_SIZE) in;
layout(push_constant, scalar) uniform Block { MultiplyBlocksPush push; };
// 3: R, G and B have factors of their own; 1: they share them.
layout(constant_id = 0) const uint CHANNELS = 1;
// Whether rows are view samples, whose radiance is added to; else elements of the vector itself.
layout(constant_id = 1) const bool TO_VIEW_SAMPLES = false;
// PANEL_ROWS / GROUP_SIZE or less.
layout(constant_id = 2) const uint ROWS = 1;

#include "lib/add_radiance.glsl"

const uint PARTS = PANEL_ROWS / (GROUP_SIZE * ROWS);

void store(uint output_index, vec3 sum) {
    if (!TO_VIEW_SAMPLES) {
        push.vector.at[output_index] = vec4(sum, 0.0);
    } else {
        add_radiance(output_index, sum);
    }
}

void main() {
    uint group = group_index();
    if (group / PARTS >= push.panel_count) {
        return;
    }
    Panel panel = push.panels.at[group / PARTS];
    uint row = ((group % PARTS) * GROUP_SIZE + gl_LocalInvocationIndex) * ROWS;
    if (row >= panel.row_count) {
        return;
    }
    uint stride = (panel.row_count + ROW_ALIGNMENT - 1) & ~(ROW_ALIGNMENT - 1);
    vec3 sums[ROWS];
    [[unroll]] for (uint r = 0; r < ROWS; ++r) {
        sums[r] = vec3(0.0);
    }
    for (uint octet = 0; octet < panel.octet_count; ++octet) {
        uint first = panel.first_input + octet * PANEL_COLUMNS;
        vec3 x[PANEL_COLUMNS];
        [[unroll]] for (uint k = 0; k < PANEL_COLUMNS; ++k) {
            x[k] = push.vector.at[push.inputs.at[first + k]].rgb;
        }
        uint value = panel.first_value + octet * CHANNELS * stride + row;
        [[unroll]] for (uint r = 0; r < ROWS; ++r) {
            [[unroll]] for (uint c = 0; c < CHANNELS; ++c) {
                uvec4 packed = push.values.at[value + c * stride + r];
                [[unroll]] for (uint k = 0; k < PANEL_COLUMNS / 2; ++k) {
                    vec2 pair = unpackHalf2x16(packed[k]);
                    if (CHANNELS == 1) {
                        sums[r] += pair.x * x[2 * k] + pair.y * x[2 * k + 1];
                    } else {
                        sums[r][c] += pair.x * x[2 * k][c] + pair.y * x[2 * k + 1][c];
                    }
                }
            }
        }
    }
    [[unroll]] for (uint r = 0; r < ROWS; ++r) {
        if (row + r < panel.row_count) {
            store(push.outputs.at[panel.first_output + row + r], panel.scale * sums[r]);
        }
    }
}
