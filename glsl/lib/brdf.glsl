// glTF's BRDF [glTF 2.0, Appendix B]. Twin: src/physics/brdf/mod.rs.

const float PI = 3.14159265358979;

// Unit vector from its octahedral map [Cigolle 2014].
vec3 octahedral(vec2 e) {
    vec3 v = vec3(e, 1.0 - abs(e.x) - abs(e.y));
    float fold = max(-v.z, 0.0);
    v.x += v.x >= 0.0 ? -fold : fold;
    v.y += v.y >= 0.0 ? -fold : fold;
    return v / sqrt(dot(v, v));
}

// GGX, normalized over projected area [Walter 2007, Eq. 33]. 1 - (n.h)^2 is computed as |n x h|^2, which is
// accurate also for lobes far narrower than the rounding error of n.h.
float ggx(vec3 n, vec3 h, float nh, float alpha) {
    vec3 sine = cross(n, h);
    float x = alpha / (alpha * alpha * nh * nh + dot(sine, sine));
    return x * x / PI;
}

// Height-correlated Smith masking over 4 n.wi n.wo [Heitz 2014, Eq. 99]. Cosines are clamped to at least 1e-6.
float smith(float ni, float no, float alpha) {
    float a2 = alpha * alpha;
    ni = max(ni, 1e-6);
    no = max(no, 1e-6);
    return 0.5 / (ni * sqrt(no * no * (1.0 - a2) + a2) + no * sqrt(ni * ni * (1.0 - a2) + a2));
}

// Density of directions mirrored at visible normals [Heitz 2018, Eq. 17], rearranged to stay finite at the horizon.
float lobe_density(float alpha, vec3 n, vec3 wi, vec3 wo) {
    float no = dot(n, wo);
    vec3 h = wi + wo;
    h /= sqrt(max(dot(h, h), 1e-20));
    float root = sqrt(alpha * alpha + (1.0 - alpha * alpha) * no * no);
    return ggx(n, h, dot(n, h), alpha) * 0.5 / (no + root);
}

// Weight of a light's point that stands for `solid_angle`, beside directions drawn from a narrow lobe: power heuristic
// [Veach 1995, Eq. 15].
float point_share(float alpha, vec3 n, vec3 wi, vec3 wo, float solid_angle) {
    float drawn = min(solid_angle, 1e15) * lobe_density(alpha, n, wi, wo);
    return dot(n, wo) > 0.0 ? 1.0 / (1.0 + drawn * drawn) : 1.0;
}

// BRDF times the cosine at wi; zero below either horizon.
vec3 reflected(Brdf brdf, vec3 n, vec3 wi, vec3 wo, bool specular) {
    float ni = dot(n, wi);
    float no = dot(n, wo);
    if (min(ni, no) <= 0.0) {
        return vec3(0.0);
    }
    vec3 h = wi + wo;
    h /= sqrt(max(dot(h, h), 1e-20));
    float x = 1.0 - clamp(dot(wo, h), 0.0, 1.0);
    float x2 = x * x;
    float schlick = x2 * x2 * x;
    float fresnel = mix(brdf.dielectric_f0, brdf.dielectric_f90, schlick);
    vec3 value = brdf.diffuse * ((1.0 - fresnel) / PI);
    if (specular && brdf.alpha > 0.0) {
        float lobe = ggx(n, h, dot(n, h), brdf.alpha) * smith(ni, no, brdf.alpha);
        value += mix(brdf.f0, vec3(brdf.f90), schlick) * lobe;
    }
    return value * ni;
}
