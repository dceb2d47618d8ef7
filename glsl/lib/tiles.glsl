// Index of a pixel in tile order.

uint tiled(uvec2 pixel, uint width) {
    uint tiles_x = (width + TILE_SIZE - 1) / TILE_SIZE;
    uvec2 tile = pixel / TILE_SIZE;
    uvec2 inside = pixel % TILE_SIZE;
    return (tile.y * tiles_x + tile.x) * (TILE_SIZE * TILE_SIZE) + inside.y * TILE_SIZE + inside.x;
}
