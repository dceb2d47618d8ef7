// Copies the Haar terms of a sky, which the host computes, to the vector that the transfer reads. One thread per term.

void main() {
    uint index = thread_index();
    if (index < push.count) {
        push.vector.at[index] = push.terms.at[index];
    }
}
