// Tile order: pixels tile by tile, those of a tile row by row.

// Number of pixels, padded to whole tiles.
uint tiled_length(uvec2 size) {
    uvec2 tiles = (size + TILE_SIZE - 1) / TILE_SIZE;
    return tiles.x * tiles.y * (TILE_SIZE * TILE_SIZE);
}

// Index of a pixel.
uint tiled(uvec2 pixel, uint width) {
    uint tiles_x = (width + TILE_SIZE - 1) / TILE_SIZE;
    uvec2 tile = pixel / TILE_SIZE;
    uvec2 inside = pixel % TILE_SIZE;
    return (tile.y * tiles_x + tile.x) * (TILE_SIZE * TILE_SIZE) + inside.y * TILE_SIZE + inside.x;
}
