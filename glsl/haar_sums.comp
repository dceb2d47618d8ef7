// Normalised sums of coefficients over subtrees whose Haar terms are not needed, in place, for LIGHTS vectors. One
// thread per sum. Twin: src/bake/compression/haar.rs.

void main() {
    uint index = thread_index();
    if (index >= push.sum_count) {
        return;
    }
    uint first = push.first_place.at[index];
    uint end = push.first_place.at[index + 1];
    vec3 sums[LIGHTS];
    [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
        sums[l] = vec3(0.0);
    }
    for (uint i = first; i < end; ++i) {
        uint place = push.places.at[i];
        [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
            sums[l] += push.vector.at[place * LIGHTS + l].rgb;
        }
    }
    float scale = inversesqrt(float(end - first));
    uint place = push.places.at[first];
    [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
        push.vector.at[place * LIGHTS + l].rgb = scale * sums[l];
    }
}
