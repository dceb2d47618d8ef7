// Radiance of a view sample, added to the image or to the extra samples; for kernels whose `push` has both.

void add_radiance(uint view_sample, vec3 radiance) {
    if (view_sample < push.pixel_stride) {
        push.image.at[view_sample] += radiance.r;
        push.image.at[view_sample + push.pixel_stride] += radiance.g;
        push.image.at[view_sample + 2 * push.pixel_stride] += radiance.b;
    } else {
        uint extra = view_sample - push.pixel_stride;
        push.extras.at[extra] += radiance.r;
        push.extras.at[extra + push.extra_stride] += radiance.g;
        push.extras.at[extra + 2 * push.extra_stride] += radiance.b;
    }
}
