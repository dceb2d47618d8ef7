// λ0 of the thesis: coefficients of one light at unit intensity in gather samples whose BRDFs are factored by SVD
// [Yang 2007, Section 4.4]. One thread per sample. Twin: src/bake/baselines/thesis.rs.

#include "lib/brdf.glsl"
#include "lib/light.glsl"
#include "lib/soft.glsl"

void main() {
    uint index = thread_index();
    if (index >= push.sample_count) {
        return;
    }
    FactoredSample s = push.samples.at[index];
    uint byte = (push.visibility.at[index / 4] >> (8 * (index & 3))) & 255;
    vec3 wi;
    PackedLight from = push.light;
    if (SOFT) {
        from = push.lights.at[point_in_list(index)];
    }
    float irradiance = incident(from, push.points.at[index].position, wi) * float(byte) / 255.0;
    vec3 factor = light_color(from);
    if (push.has_factors != 0) {
        factor *= unpack_factor(push.factors.at[index]);
    }
    float light = irradiance * max(dot(s.normal, wi), 0.0);
    // Bilinear interpolation. Texels outside the disc have w = 0; dividing by the interpolated w leaves them out.
    vec2 on_disc = vec2(dot(s.tangent, wi), dot(cross(s.normal, s.tangent), wi));
    vec2 place = clamp((on_disc + 1.0) * 0.5 * float(DISC_SIDE) - 0.5, 0.0, float(DISC_SIDE - 1));
    uvec2 low = min(uvec2(place), uvec2(DISC_SIDE - 2));
    vec2 along = place - vec2(low);
    uint texel = s.table + (low.y * DISC_SIDE + low.x) * s.terms;
    for (uint term = 0; term < s.terms; ++term) {
        vec4 k = vec4(0.0);
        if (light > 0.0) {
            uint at = texel + term;
            vec4 lower = mix(push.tables.at[at], push.tables.at[at + s.terms], along.x);
            at += DISC_SIDE * s.terms;
            k = mix(lower, mix(push.tables.at[at], push.tables.at[at + s.terms], along.x), along.y);
        }
        uint at = (s.first + term) * push.stride + push.offset;
        vec4 before = push.accumulate != 0 ? push.coefficients.at[at] : vec4(0.0);
        push.coefficients.at[at] = before + vec4(k.w > 0.0 ? light / k.w * factor * k.rgb : vec3(0.0), 0.0);
    }
}
