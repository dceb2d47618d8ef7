// Luminance histogram of a picture, or the radiance of one pixel.

#include "lib/color.glsl"
#include "lib/read_pixel.glsl"

shared uint bins[HISTOGRAM_BINS];

vec3 radiance(uint at) {
    vec3 c = vec3(0.0);
    [[unroll]] for (uint i = 0; i < MAX_TERMS; ++i) {
        if (i < push.term_count) {
            c += push.terms[i].scale * read_pixel(push.terms[i].image, at, push.pixel_stride);
        }
    }
    return c;
}

void main() {
    if (!HISTOGRAM) {
        if (thread_index() == 0) {
            vec3 c = radiance(push.pixels.x);
            push.result.at[0] = floatBitsToUint(c.r);
            push.result.at[1] = floatBitsToUint(c.g);
            push.result.at[2] = floatBitsToUint(c.b);
        }
        return;
    }
    uint lane = gl_LocalInvocationIndex;
    for (uint bin = lane; bin < HISTOGRAM_BINS; bin += GROUP_SIZE) {
        bins[bin] = 0;
    }
    barrier();
    uint tiles_x = (push.pixels.x + TILE_SIZE - 1) / TILE_SIZE;
    for (uint i = 0; i < TILES_PER_GROUP; ++i) {
        uint tile = group_index() * TILES_PER_GROUP + i;
        uvec2 pixel = uvec2(tile % tiles_x, tile / tiles_x) * TILE_SIZE + uvec2(lane % TILE_SIZE, lane / TILE_SIZE);
        if (pixel.x < push.pixels.x && pixel.y < push.pixels.y) {
            // All bins but the first and last cover as many stops below middle grey as above it.
            float above = stops(push.exposure * radiance(tile * GROUP_SIZE + lane));
            float bin = floor(above * float(BINS_PER_STOP)) + float(HISTOGRAM_BINS / 2);
            atomicAdd(bins[uint(clamp(bin, 0.0, float(HISTOGRAM_BINS - 1)))], 1);
        }
    }
    barrier();
    for (uint bin = lane; bin < HISTOGRAM_BINS; bin += GROUP_SIZE) {
        if (bins[bin] != 0) {
            atomicAdd(push.result.at[bin], bins[bin]);
        }
    }
}
