// Exposed scene-linear radiance -> pixels in the format of OUTPUT. The kernel has the constant OUTPUT, and `push` with
// target, display_table and blue_first.

vec3 false_color(vec3 c) {
    float band = clamp(floor(stops(c) + 0.5) + float(MIDDLE_STOP), 0.0, float(STOP_COUNT - 1));
    return unpackUnorm4x8(STOP_COLORS[uint(band)]).rgb;
}

// Values of a display, by tetrahedral interpolation in its table [Kasson 1995].
vec3 display_table_entry(uvec3 at) {
    uvec2 packed = push.display_table.at[(at.z * DISPLAY_TABLE_SIDE + at.y) * DISPLAY_TABLE_SIDE + at.x];
    return vec3(unpackUnorm2x16(packed.x), unpackUnorm2x16(packed.y).x);
}

vec3 from_display_table(vec3 c) {
    const float steps = float(DISPLAY_TABLE_SIDE - 1) / log2(1.0 + DISPLAY_TABLE_END / DISPLAY_TABLE_TOE);
    vec3 place = steps * log2(1.0 + clamp(c, 0.0, DISPLAY_TABLE_END) / DISPLAY_TABLE_TOE);
    uvec3 low = min(uvec3(place), uvec3(DISPLAY_TABLE_SIDE - 2));
    vec3 f = place - vec3(low);
    // The tetrahedron's corners: low, one step along the longest axis, one along the two longest, one along all.
    bool xy = f.x >= f.y, yz = f.y >= f.z, xz = f.x >= f.z;
    uvec3 longest = uvec3(xy && xz, !xy && yz, !xz && !yz);
    uvec3 two_longest = uvec3(xy || xz, !xy || yz, !xz || !yz);
    float most = max(f.x, max(f.y, f.z));
    float least = min(f.x, min(f.y, f.z));
    float middle = f.x + f.y + f.z - most - least;
    return (1.0 - most) * display_table_entry(low) + (most - middle) * display_table_entry(low + longest) +
           (middle - least) * display_table_entry(low + two_longest) + least * display_table_entry(low + 1);
}

void write_pixel(uint index, vec3 c) {
    if (OUTPUT == OUTPUT_LINEAR) {
        push.target.at[3 * index] = floatBitsToUint(c.r);
        push.target.at[3 * index + 1] = floatBitsToUint(c.g);
        push.target.at[3 * index + 2] = floatBitsToUint(c.b);
        return;
    }
    if (OUTPUT == OUTPUT_AGX) {
        c = agx(c);
    } else if (OUTPUT == OUTPUT_PBR_NEUTRAL) {
        c = srgb_from_linear(clamp(pbr_neutral(c), 0.0, 1.0));
    } else if (OUTPUT == OUTPUT_FALSE_COLOR) {
        c = false_color(c);
    } else if (OUTPUT == OUTPUT_TABLE) {
        c = from_display_table(c);
    } else {
        c = srgb_from_linear(clamp(c, 0.0, 1.0));
    }
    push.target.at[index] = packUnorm4x8(vec4(push.blue_first != 0 ? c.bgr : c, 1.0));
}
