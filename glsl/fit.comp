// Resamples a picture. Enlarging is bilinear; shrinking uses a tent filter two target pixels wide.

vec4 source(ivec2 at) {
    uvec2 inside = uvec2(clamp(at, ivec2(0), ivec2(push.source_size) - 1));
    return unpackUnorm4x8(push.source.at[inside.y * push.source_size.x + inside.x]);
}

vec4 bilinear(vec2 center) {
    vec2 corner = floor(center);
    vec2 weight = center - corner;
    ivec2 at = ivec2(corner);
    vec4 upper = mix(source(at), source(at + ivec2(1, 0)), weight.x);
    vec4 lower = mix(source(at + ivec2(0, 1)), source(at + ivec2(1, 1)), weight.x);
    return mix(upper, lower, weight.y);
}

vec4 tent(vec2 center, vec2 support) {
    ivec2 first = ivec2(ceil(center - support));
    ivec2 last = ivec2(floor(center + support));
    vec4 sum = vec4(0.0);
    float weights = 0.0;
    for (int y = first.y; y <= last.y; ++y) {
        for (int x = first.x; x <= last.x; ++x) {
            vec2 weight = max(1.0 - abs(vec2(x, y) - center) / support, 0.0);
            sum += weight.x * weight.y * source(ivec2(x, y));
            weights += weight.x * weight.y;
        }
    }
    return sum / weights;
}

void main() {
    uint index = thread_index();
    if (index >= push.target_size.x * push.target_size.y) {
        return;
    }
    vec2 ratio = vec2(push.source_size) / vec2(push.target_size);
    // In source pixels, whose centres lie at integers.
    vec2 center = (vec2(index % push.target_size.x, index / push.target_size.x) + 0.5) * ratio - 0.5;
    vec4 pixel = SHRINKS ? tent(center, max(ratio, 1.0)) : bilinear(center);
    push.target.at[index] = packUnorm4x8(pixel);
}
