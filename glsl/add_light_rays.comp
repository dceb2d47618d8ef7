// Adds to λ0 what a light's rays bring to gather samples. A coefficient a thread.

void main() {
    uint index = thread_index();
    if (index >= push.count) {
        return;
    }
    Contribution caught = push.contributions.at[index];
    push.coefficients.at[caught.index * push.stride + push.offset].rgb += caught.value;
}
