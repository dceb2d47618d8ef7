// Linear indices of workgroup and thread. A dispatch is a grid with rows of MAX_COLUMNS workgroups.

layout(local_size_x = GROUP_SIZE) in;

uint group_index() {
    return gl_WorkGroupID.y * MAX_COLUMNS + gl_WorkGroupID.x;
}

uint thread_index() {
    return gl_GlobalInvocationID.y * (MAX_COLUMNS * GROUP_SIZE) + gl_GlobalInvocationID.x;
}
