// Fixed work per sample, the unit of measure for other kernels: reads 32 bytes, multiplies and adds, writes 12 bytes.

void main() {
    uint index = thread_index();
    if (index >= push.sample_count) {
        return;
    }
    vec4 a = push.samples.at[2 * index];
    vec4 b = push.samples.at[2 * index + 1];
    for (uint i = 0; i < push.multiply_adds; i += 4) {
        a = a * b + b;
    }
    push.results.at[3 * index] = a.x;
    push.results.at[3 * index + 1] = a.y;
    push.results.at[3 * index + 2] = a.z + a.w;
}
