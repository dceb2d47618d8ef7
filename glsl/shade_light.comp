// Direct light of a punctual light at unit intensity on all view samples. One thread per sample.
// Twin: src/reference/mod.rs.

#include "lib/brdf.glsl"
#include "lib/light.glsl"

// What a point of the light stands for.
float solid_angle(vec3 position, vec3 wi) {
    if (push.light.kind == LIGHT_DIRECTIONAL) {
        return push.drawn_area;
    }
    vec3 to_light = push.light.position - position;
    return push.drawn_area * abs(dot(wi, push.light.direction)) / dot(to_light, to_light);
}

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
    vec3 factor = light_color(push.light);
    if (push.has_factors != 0) {
        factor *= unpack_factor(push.factors.at[index]);
    }
    Brdf brdf = push.brdfs.at[s.brdf];
    if (push.light.kind == LIGHT_DIRECTIONAL && push.light.narrowing > 0.0 && brdf.alpha > 0.0) {
        brdf.alpha = sqrt(min(brdf.alpha * brdf.alpha + push.light.narrowing, 1.0));
    }
    vec3 normal = octahedral(s.normal);
    vec3 wo = octahedral(s.wo);
    vec3 radiance = irradiance * factor * reflected(brdf, normal, wi, wo, SPECULAR);
    if (SPECULAR && push.drawn_area > 0.0 && brdf.alpha > 0.0 && brdf.alpha < NARROW_ALPHA) {
        radiance *= point_share(brdf.alpha, normal, wi, wo, solid_angle(s.position, wi));
    }
    return radiance;
}

void main() {
    uint index = thread_index();
    if (index >= push.sample_count) {
        return;
    }
    vec3 radiance = shade(index);
    bool is_added = push.accumulate != 0;
    if (index < push.pixel_stride) {
        uvec3 at = index + uvec3(0, 1, 2) * push.pixel_stride;
        if (is_added) {
            radiance += vec3(push.image.at[at.r], push.image.at[at.g], push.image.at[at.b]);
        }
        push.image.at[at.r] = radiance.r;
        push.image.at[at.g] = radiance.g;
        push.image.at[at.b] = radiance.b;
    } else {
        uvec3 at = index - push.pixel_stride + uvec3(0, 1, 2) * push.extra_stride;
        if (is_added) {
            radiance += vec3(push.extras.at[at.r], push.extras.at[at.g], push.extras.at[at.b]);
        }
        push.extras.at[at.r] = radiance.r;
        push.extras.at[at.g] = radiance.g;
        push.extras.at[at.b] = radiance.b;
    }
}
