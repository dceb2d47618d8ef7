// Direct light of one light at unit intensity on all view samples. One thread per sample.
// Twin: src/reference/mod.rs.

#include "lib/brdf.glsl"
#include "lib/light.glsl"

vec3 shade(uint index) {
    ViewSample s = push.samples.at[index];
    uint word = push.visibility.at[index / 4];
    float visibility = float((word >> (8 * (index & 3))) & 255) * (1.0 / 255.0);
    bool counts = index < push.pixel_stride ? (push.layers & 1) != 0 : push.layers != 0;
    if (s.brdf == NO_BRDF || visibility == 0.0 || !counts) {
        return vec3(0.0);
    }
    vec3 wi;
    float irradiance = visibility * incident(push.light, s.position, wi);
    if (irradiance == 0.0) {
        return vec3(0.0);
    }
    return irradiance * reflected(push.brdfs.at[s.brdf], octahedral(s.normal), wi, octahedral(s.wo), SPECULAR);
}

void main() {
    uint index = thread_index();
    if (index >= push.sample_count) {
        return;
    }
    vec3 radiance = shade(index);
    if (index < push.pixel_stride) {
        push.image.at[index] = radiance.r;
        push.image.at[index + push.pixel_stride] = radiance.g;
        push.image.at[index + 2 * push.pixel_stride] = radiance.b;
    } else {
        uint extra = index - push.pixel_stride;
        push.extras.at[extra] = radiance.r;
        push.extras.at[extra + push.extra_stride] = radiance.g;
        push.extras.at[extra + 2 * push.extra_stride] = radiance.b;
    }
}
