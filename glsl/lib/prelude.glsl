// Included by src/gpu/compile.rs at the start of every shader.

#extension GL_EXT_buffer_reference : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_KHR_shader_subgroup_ballot : require

#include "shared.glsl"

#ifdef GL_COMPUTE_SHADER
#include "lib/thread.glsl"
#endif
