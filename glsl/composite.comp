// Sums of light images -> exposed, tone-mapped pixels, row by row.
#version 460
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#include "shared.glsl"
#include "lib/color.glsl"

layout(local_size_x = GROUP_SIZE) in;
layout(push_constant, scalar) uniform Block { CompositePush push; };
layout(constant_id = 0) const uint OUTPUT = OUTPUT_LINEAR;

void main() {
    uint index = gl_GlobalInvocationID.x;
    if (index >= push.width * push.height) {
        return;
    }
    uvec2 pixel = uvec2(index % push.width, index / push.width);
    uint tiles_x = (push.width + TILE_SIZE - 1) / TILE_SIZE;
    uvec2 tile = pixel / TILE_SIZE;
    uvec2 inside = pixel % TILE_SIZE;
    uint at = (tile.y * tiles_x + tile.x) * TILE_SIZE * TILE_SIZE + inside.y * TILE_SIZE + inside.x;

    vec3 c = vec3(0.0);
    for (uint i = 0; i < push.term_count; ++i) {
        SumTerm term = push.terms.at[i];
        Read_float image = Read_float(term.image);
        c += term.scale * vec3(image.at[at], image.at[at + push.pixel_stride], image.at[at + 2 * push.pixel_stride]);
    }
    if (OUTPUT == OUTPUT_LINEAR) {
        push.target.at[3 * index] = floatBitsToUint(c.r);
        push.target.at[3 * index + 1] = floatBitsToUint(c.g);
        push.target.at[3 * index + 2] = floatBitsToUint(c.b);
        return;
    }
    c *= push.exposure;
    if (OUTPUT == OUTPUT_AGX) {
        c = agx(c);
    } else if (OUTPUT == OUTPUT_PBR_NEUTRAL) {
        c = srgb_from_linear(clamp(pbr_neutral(c), 0.0, 1.0));
    } else {
        c = srgb_from_linear(clamp(c, 0.0, 1.0));
    }
    push.target.at[index] = packUnorm4x8(vec4(c, 1.0));
}
