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
// 3: the first columns have factors for R, G and B each, the others a tint of their input; 1: R, G and B share all factors.
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

// Inputs of the next of the octets before `end` that light falls on, or of the last; others are passed over, with their factors:
// what a light does not reach.
uint next_octet(Panel panel, uint octet, uint end, bool tinted, uint lane, out vec3 x[LIGHTS][PANEL_COLUMNS]) {
    vec3 own[LIGHTS];
    uint column;
    for (;; ++octet) {
        // Each lane reads one column's input, for all.
        column = panel.first_input + octet * PANEL_COLUMNS + lane;
        uint input_index = push.inputs.at[column];
        bool lit = octet + 1 == end;
        [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
            own[l] = push.vector.at[input_index * LIGHTS + l].rgb;
            lit = lit || own[l] != vec3(0.0);
        }
        if (subgroupBallot(lit) != uvec4(0)) {
            break;
        }
    }
    vec3 tint = tinted ? push.tints.at[column] : vec3(1.0);
    [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
        own[l] *= tint;
        [[unroll]] for (uint k = 0; k < PANEL_COLUMNS; ++k) {
            x[l][k] = subgroupBroadcast(own[l], k);
        }
    }
    return octet;
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
    uint own_count = CHANNELS == 1 ? 0 : panel.own_octet_count;
    uint first = panel.first_value + (panel.octet_count + 2 * own_count) * strip;
    vec3 sums[LIGHTS][ROWS];
    [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
        [[unroll]] for (uint r = 0; r < ROWS; ++r) {
            sums[l][r] = vec3(0.0);
        }
    }
    vec3 x[LIGHTS][PANEL_COLUMNS];
    if (CHANNELS == 3) {
        for (uint octet = 0; octet < own_count; ++octet) {
            octet = next_octet(panel, octet, own_count, false, lane, x);
            uint of_octet = first + 3 * octet * stride;
            [[unroll]] for (uint r = 0; r < ROWS; ++r) {
                // Lanes beyond the last row read that.
                uint place = of_octet + min(lane * ROWS + r, stride - 1);
                uvec4 packed[3];
                [[unroll]] for (uint c = 0; c < 3; ++c) {
                    packed[c] = push.values.at[place + c * stride];
                }
                [[unroll]] for (uint c = 0; c < 3; ++c) {
                    [[unroll]] for (uint k = 0; k < PANEL_COLUMNS / 2; ++k) {
                        vec2 pair = unpackHalf2x16(packed[c][k]);
                        [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
                            sums[l][r][c] += pair.x * x[l][2 * k][c] + pair.y * x[l][2 * k + 1][c];
                        }
                    }
                }
            }
        }
    }
    first += 2 * own_count * stride;
    for (uint octet = own_count; octet < panel.octet_count; ++octet) {
        octet = next_octet(panel, octet, panel.octet_count, CHANNELS == 3, lane, x);
        uint of_octet = first + octet * stride;
        [[unroll]] for (uint r = 0; r < ROWS; ++r) {
            uvec4 packed = push.values.at[of_octet + min(lane * ROWS + r, stride - 1)];
            [[unroll]] for (uint k = 0; k < PANEL_COLUMNS / 2; ++k) {
                vec2 pair = unpackHalf2x16(packed[k]);
                [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
                    sums[l][r] += pair.x * x[l][2 * k] + pair.y * x[l][2 * k + 1];
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
