// Discards transparent fragments. Masks compare alpha with the cutoff; blended materials discard at random
// [Enderton 2010]. Alpha is filtered as `Texture::sample` does at the finest level.

layout(location = 0) in vec2 uv;
layout(location = 1) in float alpha;
layout(location = 2) flat in uvec2 cutout_and_triangle;

float wrapped(float t, uint wrap) {
    return wrap == WRAP_CLAMP ? clamp(t, 0.0, 1.0) : mod(t, wrap == WRAP_MIRROR ? 2.0 : 1.0);
}

// Texel index with wrapping; -1 <= i <= 2 size.
uint index(int i, int size, uint wrap) {
    if (wrap == WRAP_CLAMP) {
        return uint(clamp(i, 0, size - 1));
    }
    int period = wrap == WRAP_MIRROR ? 2 * size : size;
    i = (i + period) % period;
    return uint(wrap == WRAP_MIRROR ? min(i, period - 1 - i) : i);
}

float texel(uint i) {
    return float((push.texels.at[i / 4] >> (8 * (i & 3))) & 255) / 255.0;
}

float texture_alpha(Cutout c) {
    if (c.first == NO_TEXELS) {
        return 1.0;
    }
    ivec2 size = ivec2(c.width, c.height);
    vec2 at = vec2(wrapped(uv.x, c.wrap_u), wrapped(uv.y, c.wrap_v)) * vec2(size) - 0.5;
    ivec2 low = ivec2(floor(at));
    vec2 along = at - vec2(low);
    uvec2 x = uvec2(index(low.x, size.x, c.wrap_u), index(low.x + 1, size.x, c.wrap_u));
    uvec2 y = c.first + c.width * uvec2(index(low.y, size.y, c.wrap_v), index(low.y + 1, size.y, c.wrap_v));
    float top = mix(texel(y.x + x.x), texel(y.x + x.y), along.x);
    float bottom = mix(texel(y.y + x.x), texel(y.y + x.y), along.x);
    return mix(top, bottom, along.y);
}

// Pseudorandom number in [0, 1) per texel of the shadow map and triangle [MurmurHash3].
float chance() {
    uint hash = cutout_and_triangle.y * 0x9e3779b9u ^ (uint(gl_FragCoord.y) << 16 | uint(gl_FragCoord.x));
    hash = (hash ^ hash >> 16) * 0x85ebca6bu;
    hash = (hash ^ hash >> 13) * 0xc2b2ae35u;
    return float((hash ^ hash >> 16) >> 8) * exp2(-24.0);
}

void main() {
    Cutout c = push.cutouts.at[cutout_and_triangle.x];
    float there = alpha * texture_alpha(c);
    if (there < c.cutoff || (c.cutoff < 0.0 && there <= chance())) {
        discard;
    }
}
