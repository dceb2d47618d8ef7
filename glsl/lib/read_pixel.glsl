// Pixel `at` of an image that is stored as planes R, G, B, four pixels to an element. The image is not cast to floats:
// SwiftShader cannot cast references.
vec3 read_pixel(Read_vec4 image, uint at, uint pixel_stride) {
    uvec3 element = (at + uvec3(0, 1, 2) * pixel_stride) / 4;
    return vec3(image.at[element.r][at % 4], image.at[element.g][at % 4], image.at[element.b][at % 4]);
}
