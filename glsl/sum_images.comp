// Weighted sum of images. Each thread sums four floats. Twin: src/reference/mod.rs.

void main() {
    uint index = thread_index();
    if (index >= 3 * push.plane_length) {
        return;
    }
    uint plane = uint(index >= push.plane_length) + uint(index >= 2 * push.plane_length);
    vec4 sum = push.kept > 0.0 ? push.kept * push.sum.at[index] : vec4(0.0);
    [[unroll]] for (uint i = 0; i < MAX_TERMS; ++i) {
        if (i < push.term_count) {
            sum += push.terms[i].scale[plane] * push.terms[i].image.at[index];
        }
    }
    push.sum.at[index] = sum;
}
