// Adds the weighted extra view samples of one light to their pixels of its image. One thread per pixel.
// Twin: src/bake/framebuffer/view_samples.rs.

void main() {
    uint index = thread_index();
    if (index >= push.pixel_count) {
        return;
    }
    ExtraPixel p = push.pixels.at[index];
    uvec3 at = p.pixel + uvec3(0, 1, 2) * push.pixel_stride;
    vec3 sum = p.first_weight * vec3(push.image.at[at.r], push.image.at[at.g], push.image.at[at.b]);
    for (uint k = p.first; k < p.first + p.count; ++k) {
        uint i = push.indices.at[k];
        ExtraSample s = push.samples.at[i];
        if (((push.layers >> min(s.layer, 31)) & 1) != 0) {
            uvec3 from = i + uvec3(0, 1, 2) * push.extra_stride;
            sum += s.weight * vec3(push.extras.at[from.r], push.extras.at[from.g], push.extras.at[from.b]);
        }
    }
    push.image.at[at.r] = sum.r;
    push.image.at[at.g] = sum.g;
    push.image.at[at.b] = sum.b;
}
