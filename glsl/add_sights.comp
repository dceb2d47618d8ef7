// Adds what the eye sees of a light itself to the light's image. One thread per pixel that can see one.

void main() {
    uint index = thread_index();
    if (index >= push.count) {
        return;
    }
    uint pixel = push.pixels.at[index];
    vec3 value = push.values.at[index];
    for (uint plane = 0; plane < 3; plane++) {
        push.image.at[plane * push.pixel_stride + pixel] += value[plane];
    }
}
