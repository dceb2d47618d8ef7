// Shadow maps -> visibility of one light at all view samples, percentage-closer filtered [Reeves 1987].
// Each thread writes one word: the visibility of four samples.

layout(set = 0, binding = 0) uniform sampler2DArrayShadow shadow_map;

// Index of the cube face of direction v, in the order +X, -X, +Y, -Y, +Z, -Z.
uint cube_face(vec3 v) {
    vec3 a = abs(v);
    if (a.x >= a.y && a.x >= a.z) {
        return v.x >= 0.0 ? 0 : 1;
    }
    if (a.y >= a.z) {
        return v.y >= 0.0 ? 2 : 3;
    }
    return v.z >= 0.0 ? 4 : 5;
}

float lookup(vec3 position) {
    uint face = push.face_count == 1 ? 0 : cube_face(position - push.light_position);
    vec4 clip = push.faces.at[face].clip_from_mesh * vec4(position, 1.0);
    vec3 ndc = clip.xyz / clip.w;
    // Outside a spot's map its light is zero anyway.
    if (clip.w <= 0.0 || max(abs(ndc.x), abs(ndc.y)) > 1.0) {
        return 1.0;
    }
    vec2 uv = 0.5 * ndc.xy + 0.5;
    float sum = 0.0;
    for (int y = -1; y <= 1; ++y) {
        for (int x = -1; x <= 1; ++x) {
            sum += texture(shadow_map, vec4(uv + push.texel * vec2(x, y), face, ndc.z));
        }
    }
    return sum / 9.0;
}

void main() {
    uint first = 4 * thread_index();
    if (first >= push.sample_count) {
        return;
    }
    vec4 visibility;
    for (uint i = 0; i < 4; ++i) {
        visibility[i] = lookup(push.samples.at[min(first + i, push.sample_count - 1)].position);
    }
    push.visibility.at[thread_index()] = packUnorm4x8(visibility);
}
