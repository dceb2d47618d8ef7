// Counts infinite and NaN values in an image's three planes. One thread per pixel.

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
