// Scene-linear radiance -> pixels in the format of OUTPUT. The kernel has the constant OUTPUT, and `push` with target,
// exposure and blue_first.

vec3 false_color(vec3 c) {
    float band = clamp(floor(stops(c) + 0.5) + float(MIDDLE_STOP), 0.0, float(STOP_COUNT - 1));
    return unpackUnorm4x8(STOP_COLORS[uint(band)]).rgb;
}

void write_pixel(uint index, vec3 c) {
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
    } else if (OUTPUT == OUTPUT_FALSE_COLOR) {
        c = false_color(c);
    } else {
        c = srgb_from_linear(clamp(c, 0.0, 1.0));
    }
    push.target.at[index] = packUnorm4x8(vec4(push.blue_first != 0 ? c.bgr : c, 1.0));
}
