// Haar transform over subtrees of gather samples, in place, bottom up, for LIGHTS vectors. One workgroup per subtree.
// Twin: src/bake/compression/haar.rs.

void main() {
    uint group = group_index();
    if (group >= push.subtree_count) {
        return;
    }
    uint first = group * (push.height_count + 1);
    for (uint height = 0; height < push.height_count; ++height) {
        uint end = push.ranges.at[first + height + 1];
        for (uint i = push.ranges.at[first + height] + gl_LocalInvocationIndex; i < end; i += GROUP_SIZE) {
            Rotation r = push.rotations.at[i];
            [[unroll]] for (uint l = 0; l < LIGHTS; ++l) {
                uint sum = r.sum * LIGHTS + l;
                uint term = r.term * LIGHTS + l;
                vec3 left = push.vector.at[sum].rgb;
                vec3 right = push.vector.at[term].rgb;
                push.vector.at[sum].rgb = r.cosine * left + r.sine * right;
                push.vector.at[term].rgb = r.sine * left - r.cosine * right;
            }
        }
        // At the next height, other threads of the workgroup read what this height wrote.
        memoryBarrierBuffer();
        barrier();
    }
}
