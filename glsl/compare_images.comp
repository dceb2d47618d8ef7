// Sums of squares: of the differences between two images, and of one of them. Each thread sums a part, and the host the
// parts. Twin: tests/kernels.rs.

void main() {
    uint index = thread_index();
    if (index >= push.threads) {
        return;
    }
    vec2 sums = vec2(0.0);
    for (uint i = index; i < push.count; i += push.threads) {
        vec4 a = push.image.at[i];
        vec4 difference = push.other.at[i] - a;
        sums += vec2(dot(difference, difference), dot(a, a));
    }
    push.sums.at[index] = sums;
}
