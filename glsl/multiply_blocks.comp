// A block matrix times the vectors of some lights, RGB: a panel a workgroup. Twin: src/bake/transfer/blocks.rs.
#version 460
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_GOOGLE_include_directive : require
#include "shared.glsl"
#include "lib/thread.glsl"

layout(local_size_x = GROUP_SIZE) in;
layout(push_constant, scalar) uniform Block { MultiplyBlocksPush push; };
// 3: R, G and B have factors of their own; 1: they share them.
layout(constant_id = 0) const uint CHANNELS = 1;
// Whether rows are view samples, whose radiance is added to; else elements of the vector itself.
layout(constant_id = 1) const bool TO_VIEW_SAMPLES = false;
// Vectors, element by element side by side: factors are read once for all.
layout(constant_id = 2) const uint LIGHTS = 1;

#include "lib/add_radiance.glsl"

// Threads that share a strip. Without a GPU each read of 16 bytes becomes four gathers: the first ones together touch every cache
// line that the rest need, so that a strip waits for memory once an octet.
const uint LANES = PANEL_COLUMNS;
const uint ROWS = STRIP_ROWS / LANES;

void store(uint output_index, uint light, vec3 sum) {
    if (!TO_VIEW_SAMPLES) {
        push.vector.at[output_index * LIGHTS + light] = vec4(sum, 0.0);
    } else {
        add_radiance(output_index, light, sum);
    }
}

void main() {
    uint group = group_index();
    if (group >= push.panel_count) {
        return;
    }
    Panel panel = push.panels.at[group];
    uint lane = gl_SubgroupInvocationID % LANES;
    uint strip = (gl_SubgroupID * gl_SubgroupSize + gl_SubgroupInvocationID) / LANES * STRIP_ROWS;
    if (strip >= panel.row_count) {
        return;
    }
    uint stride = min(panel.row_count - strip, STRIP_ROWS);
    uint value = panel.first_value + CHANNELS * panel.octet_count * strip;
    vec3 sums[LIGHTS][ROWS];
    [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
        [[unroll]] for (uint r = 0; r < ROWS; ++r) {
            sums[l][r] = vec3(0.0);
        }
    }
    for (uint octet = 0; octet < panel.octet_count; ++octet) {
        vec3 own[LIGHTS];
        // Octets that no light falls on are passed over, with their factors: what a light does not reach.
        for (;; ++octet) {
            // Each lane reads one column's input, for all.
            uint input_index = push.inputs.at[panel.first_input + octet * PANEL_COLUMNS + lane];
            bool lit = octet + 1 == panel.octet_count;
            [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
                own[l] = push.vector.at[input_index * LIGHTS + l].rgb;
                lit = lit || own[l] != vec3(0.0);
            }
            if (subgroupBallot(lit) != uvec4(0)) {
                break;
            }
        }
        vec3 x[LIGHTS][PANEL_COLUMNS];
        [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
            [[unroll]] for (uint k = 0; k < PANEL_COLUMNS; ++k) {
                x[l][k] = subgroupBroadcast(own[l], k);
            }
        }
        uint of_octet = value + octet * CHANNELS * stride;
        [[unroll]] for (uint r = 0; r < ROWS; ++r) {
            // Lanes beyond the last row read that.
            uint place = of_octet + min(lane * ROWS + r, stride - 1);
            uvec4 packed[CHANNELS];
            [[unroll]] for (uint c = 0; c < CHANNELS; ++c) {
                packed[c] = push.values.at[place + c * stride];
            }
            [[unroll]] for (uint c = 0; c < CHANNELS; ++c) {
                [[unroll]] for (uint k = 0; k < PANEL_COLUMNS / 2; ++k) {
                    vec2 pair = unpackHalf2x16(packed[c][k]);
                    [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
                        if (CHANNELS == 1) {
                            sums[l][r] += pair.x * x[l][2 * k] + pair.y * x[l][2 * k + 1];
                        } else {
                            sums[l][r][c] += pair.x * x[l][2 * k][c] + pair.y * x[l][2 * k + 1][c];
                        }
                    }
                }
            }
        }
    }
    [[unroll]] for (uint r = 0; r < ROWS; ++r) {
        uint row = strip + lane * ROWS + r;
        if (row < panel.row_count) {
            [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
                store(push.outputs.at[panel.first_output + row], l, panel.scale * sums[l][r]);
            }
        }
    }
}
