// Draws one light's image into its cell of the contact sheet with a box filter. One thread per pixel of the cell.

#include "lib/tiles.glsl"
#include "lib/color.glsl"
#include "lib/display.glsl"
#include "lib/read_pixel.glsl"

void main() {
    uvec2 inside = tile_pixel();
    if (inside.x >= push.cell.x || inside.y >= push.cell.y) {
        return;
    }
    vec3 sum = vec3(0.0);
    if (push.term_count != 0) {
        uvec2 first = inside * push.size / push.cell;
        uvec2 end = min(max((inside + 1) * push.size / push.cell, first + 1), push.size);
        for (uint y = first.y; y < end.y; ++y) {
            for (uint x = first.x; x < end.x; ++x) {
                uint at = tiled(uvec2(x, y), push.size.x);
                sum += read_pixel(push.term.image, at, tiled_length(push.size));
            }
        }
        sum *= push.term.scale / float((end.x - first.x) * (end.y - first.y));
    }
    uvec2 pixel = push.corner + inside;
    write_pixel(pixel.y * push.size.x + pixel.x, sum);
}
