// Adds the radiance of a view sample under one light to the light's image or to its extra samples. The kernel's
// `push` has both.

void add_radiance(uint view_sample, uint light, vec3 radiance) {
    if (light >= push.light_count) {
        return;
    }
    if (view_sample < push.pixel_stride) {
        push.images[light].at[view_sample] += radiance.r;
        push.images[light].at[view_sample + push.pixel_stride] += radiance.g;
        push.images[light].at[view_sample + 2 * push.pixel_stride] += radiance.b;
    } else {
        uint extra = view_sample - push.pixel_stride;
        push.extras[light].at[extra] += radiance.r;
        push.extras[light].at[extra + push.extra_stride] += radiance.g;
        push.extras[light].at[extra + 2 * push.extra_stride] += radiance.b;
    }
}
