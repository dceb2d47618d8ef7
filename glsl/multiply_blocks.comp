// Multiplies a block matrix by the RGB vectors of LIGHTS lights. One workgroup per panel. Twin:
// src/bake/transfer/blocks.rs.

#include "lib/add_radiance.glsl"

// Threads that share a strip. lavapipe splits each read of 16 bytes into four gathers of 4 bytes. The first gathers of
// a column group touch all of its cache lines, so the others hit the cache.
const uint LANES = PANEL_COLUMNS;
const uint ROWS = STRIP_ROWS / LANES;

void store(uint output_index, uint light, vec3 sum) {
    if (!TO_VIEW_SAMPLES) {
        push.vector.at[output_index * LIGHTS + light] = vec4(sum, 0.0);
    } else {
        add_radiance(output_index, light, sum);
    }
}

// Column groups per batch. The first reads of all of them are issued before any result is used, which hides latency.
const uint BATCH = 4;

struct Batch {
    // Per column group: the first word of this lane's first row in each channel, and the input of this lane's column.
    uvec3 words[BATCH];
    vec3 inputs[BATCH][LIGHTS];
    // Bit i: column group i has a non-zero input. The others are skipped, and their factors are not read.
    uint lit;
};

// Of one of the vectors, tinted where channels share factors.
vec3 read_input(uint column, uint light, uint channels) {
    vec3 tint = CHANNELS == 3 && channels == 1 ? push.tints.at[column] : vec3(1.0);
    return push.vector.at[push.inputs.at[column] * LIGHTS + light].rgb * tint;
}

// Whether light falls on any column of a group, where lanes cannot ask each other.
bool is_lit(uint first_column) {
    for (uint k = 0; k < PANEL_COLUMNS; ++k) {
        uint input_index = push.inputs.at[first_column + k];
        for (uint l = 0; l < push.light_count; ++l) {
            if (push.vector.at[input_index * LIGHTS + l].rgb != vec3(0.0)) {
                return true;
            }
        }
    }
    return false;
}

// From `column_group` on, of those before `end`. The first words of column group o are from `place + o * channels *
// stride` on, a stride apart.
Batch read_batch(Panel panel, uint column_group, uint end, uint place, uint channels, uint stride, uint lane) {
    Batch batch;
    batch.lit = 0;
    [[unroll]] for (uint i = 0; i < BATCH; ++i) {
        uint first_column = panel.first_input + min(column_group + i, end - 1) * PANEL_COLUMNS;
        if (!WIDE) {
            batch.lit |= column_group + i < end && is_lit(first_column) ? 1 << i : 0;
            continue;
        }
        uint column = first_column + lane;
        uint input_index = push.inputs.at[column];
        vec3 tint = CHANNELS == 3 && channels == 1 ? push.tints.at[column] : vec3(1.0);
        bool lit = false;
        [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
            vec3 own = push.vector.at[input_index * LIGHTS + l].rgb;
            lit = lit || l < push.light_count && own != vec3(0.0);
            batch.inputs[i][l] = own * tint;
        }
        batch.lit |= column_group + i < end && subgroupBallot(lit) != uvec4(0) ? 1 << i : 0;
    }
    if (batch.lit == 0) {
        return batch;
    }
    // A dark column group is replaced by a lit one, whose words are read anyway.
    uint lit = column_group + findLSB(batch.lit);
    [[unroll]] for (uint i = 0; i < BATCH; ++i) {
        lit = (batch.lit >> i & 1) != 0 ? column_group + i : lit;
        [[unroll]] for (uint c = 0; c < channels; ++c) {
            batch.words[i][c] = push.values.at[place + (lit * channels + c) * stride].x;
        }
    }
    return batch;
}

// The first word of a column group of the batch, and its inputs, for all lanes. Its columns are from `first_column` on.
uvec3 read_column_group(
    Batch batch, uint column_group, uint first_column, uint channels, out vec3 x[LIGHTS][PANEL_COLUMNS]
) {
    // Picked, not indexed: the batch stays in registers.
    uvec3 words = batch.words[0];
    vec3 own[LIGHTS];
    [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
        own[l] = batch.inputs[0][l];
        [[unroll]] for (uint i = 1; i < BATCH; ++i) {
            own[l] = i == column_group ? batch.inputs[i][l] : own[l];
        }
    }
    [[unroll]] for (uint i = 1; i < BATCH; ++i) {
        words = i == column_group ? batch.words[i] : words;
    }
    [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
        [[unroll]] for (uint k = 0; k < PANEL_COLUMNS; ++k) {
            x[l][k] = WIDE ? subgroupBroadcast(own[l], k) : read_input(first_column + k, l, channels);
        }
    }
    return words;
}

void main() {
    uint group = group_index();
    if (group >= push.panel_count) {
        return;
    }
    Panel panel = push.panels.at[group];
    // Does not use gl_SubgroupSize: subgroups may be narrower than the device reports.
    uint lane = gl_LocalInvocationIndex % LANES;
    uint strip = gl_LocalInvocationIndex / LANES * STRIP_ROWS;
    if (strip >= panel.row_count) {
        return;
    }
    uint stride = min(panel.row_count - strip, STRIP_ROWS);
    uint own_count = CHANNELS == 1 ? 0 : panel.own_column_group_count;
    uint first = panel.first_value + (panel.column_group_count + 2 * own_count) * strip;
    vec3 sums[LIGHTS][ROWS];
    [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
        [[unroll]] for (uint r = 0; r < ROWS; ++r) {
            sums[l][r] = vec3(0.0);
        }
    }
    vec3 x[LIGHTS][PANEL_COLUMNS];
    // Lanes beyond the last row read the last row.
    uint first_row = min(lane * ROWS, stride - 1);
    for (uint column_group = 0; column_group < own_count; column_group += BATCH) {
        Batch batch = read_batch(panel, column_group, own_count, first + first_row, 3, stride, lane);
        for (uint i = 0; i < BATCH && column_group + i < own_count; ++i) {
            if ((batch.lit >> i & 1) == 0) {
                continue;
            }
            uint first_column = panel.first_input + (column_group + i) * PANEL_COLUMNS;
            uvec3 words = read_column_group(batch, i, first_column, 3, x);
            uint of_column_group = first + 3 * (column_group + i) * stride;
            [[unroll]] for (uint r = 0; r < ROWS; ++r) {
                uint place = of_column_group + min(lane * ROWS + r, stride - 1);
                uvec4 packed[3];
                [[unroll]] for (uint c = 0; c < 3; ++c) {
                    packed[c] = push.values.at[place + c * stride];
                    packed[c].x = r == 0 ? words[c] : packed[c].x;
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
    for (uint column_group = own_count; column_group < panel.column_group_count; column_group += BATCH) {
        Batch batch = read_batch(panel, column_group, panel.column_group_count, first + first_row, 1, stride, lane);
        for (uint i = 0; i < BATCH && column_group + i < panel.column_group_count; ++i) {
            if ((batch.lit >> i & 1) == 0) {
                continue;
            }
            uint first_column = panel.first_input + (column_group + i) * PANEL_COLUMNS;
            uint word = read_column_group(batch, i, first_column, 1, x).x;
            uint of_column_group = first + (column_group + i) * stride;
            [[unroll]] for (uint r = 0; r < ROWS; ++r) {
                uvec4 packed = push.values.at[of_column_group + min(lane * ROWS + r, stride - 1)];
                packed.x = r == 0 ? word : packed.x;
                [[unroll]] for (uint k = 0; k < PANEL_COLUMNS / 2; ++k) {
                    vec2 pair = unpackHalf2x16(packed[k]);
                    [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
                        sums[l][r] += pair.x * x[l][2 * k] + pair.y * x[l][2 * k + 1];
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
