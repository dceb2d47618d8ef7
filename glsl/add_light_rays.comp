// Adds the contributions of a light's rays to λ0. One thread per contribution.

void main() {
    uint index = thread_index();
    if (index >= push.count) {
        return;
    }
    Contribution caught = push.contributions.at[index];
    push.coefficients.at[caught.index * push.stride + push.offset].rgb += caught.value;
}
