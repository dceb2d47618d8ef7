// Linear indices of workgroup and thread, where a dispatch is a grid with rows of MAX_COLUMNS workgroups. Where it has
// a workgroup for each tile of a picture (`Pass::dispatch_tiles`), only `tile_pixel` is right.

layout(local_size_x = GROUP_SIZE) in;

uint group_index() {
    return gl_WorkGroupID.y * MAX_COLUMNS + gl_WorkGroupID.x;
}

uint thread_index() {
    return gl_GlobalInvocationID.y * (MAX_COLUMNS * GROUP_SIZE) + gl_GlobalInvocationID.x;
}

// The thread's pixel of a picture whose tiles are the workgroups.
uvec2 tile_pixel() {
    uvec2 inside = uvec2(gl_LocalInvocationIndex % TILE_SIZE, gl_LocalInvocationIndex / TILE_SIZE);
    return gl_WorkGroupID.xy * TILE_SIZE + inside;
}
