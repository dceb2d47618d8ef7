// λ0: coefficients of a punctual light at unit intensity in gather samples, the mean over each sample's points; or
// of an area light, of which each point sees another point. One thread per sample. Twin:
// src/bake/transport/direct.rs.

#include "lib/brdf.glsl"
#include "lib/light.glsl"
#include "lib/soft.glsl"

const uint RADIALS = HARMONIC_DEGREES * (HARMONIC_DEGREES + 1) / 2;
const uint SCHLICK = TABLE_ROUGHNESSES * TABLE_COSINES * RADIALS * 2;

// Lower of the two neighbouring entries of x in [0, 1] in a table of `count`; `along` is the fraction to the upper one.
uint place(float x, uint count, out float along) {
    x *= float(count - 1);
    uint index = min(uint(x), count - 2);
    along = x - float(index);
    return index;
}

// Position in the tables of k: lower row and column, and the fractions to the next ones.
struct Lookup {
    uint row;
    float across;
    uint column;
    float along;
};

vec2 specular(uint row, uint column, uint radial) {
    uint at = ((row * TABLE_COSINES + column) * RADIALS + radial) * 2;
    return vec2(push.tables.at[at], push.tables.at[at + 1]);
}

// Radial part of k: `Projection::radials`, before the cap.
vec3 radial(Brdf brdf, Lookup at, uint i) {
    vec3 value = vec3(0.0);
    if (brdf.diffuse != vec3(0.0)) {
        uint entry = SCHLICK + at.column * RADIALS + i;
        float schlick = mix(push.tables.at[entry], push.tables.at[entry + RADIALS], at.along);
        float even = i == 0 ? (1.0 - brdf.dielectric_f0) * inversesqrt(PI) : 0.0;
        value = (even - (brdf.dielectric_f90 - brdf.dielectric_f0) * schlick) * brdf.diffuse;
    }
    if (brdf.alpha > 0.0) {
        vec2 near = mix(specular(at.row, at.column, i), specular(at.row, at.column + 1, i), at.along);
        vec2 far = mix(specular(at.row + 1, at.column, i), specular(at.row + 1, at.column + 1, i), at.along);
        vec2 k = mix(near, far, at.across);
        value += brdf.f0 * (k.x - k.y) + brdf.f90 * k.y;
    }
    return value;
}

// Reflectance of a perfect mirror. Twin: `brdf::mirror`.
vec3 mirror(Brdf brdf, float cosine) {
    float x = 1.0 - clamp(cosine, 0.0, 1.0);
    float x2 = x * x;
    return brdf.alpha > 0.0 ? vec3(0.0) : mix(brdf.f0, vec3(brdf.f90), x2 * x2 * x);
}

// Rotates v by 180 degrees around the unit axis.
vec3 half_turn(vec3 axis, vec3 v) {
    return 2.0 * dot(axis, v) * axis - v;
}

// Index of a coefficient of this light.
uint element(uint index) {
    return index * push.stride + push.offset;
}

void add(uint index, vec3 value) {
    push.coefficients.at[element(index)].rgb += value;
}

void main() {
    uint index = thread_index();
    if (index >= push.sample_count) {
        return;
    }
    LightSample s = push.samples.at[index];
    for (uint i = 0; (push.flags & ACCUMULATE) == 0 && i < s.degrees * s.degrees; ++i) {
        push.coefficients.at[element(s.first + i)] = vec4(0.0);
    }
    vec3 first = vec3(0.0);
    Lookup at;
    at.row = place(s.roughness, TABLE_ROUGHNESSES, at.across);
    vec3 bitangent = cross(s.normal, s.tangent);
    for (uint p = index * POINTS_PER_SAMPLE; p < (index + 1) * POINTS_PER_SAMPLE; ++p) {
        uint byte = (push.visibility.at[p / 4] >> (8 * (p & 3))) & 255;
        if (byte == 0) {
            continue;
        }
        vec3 normal = octahedral(push.points.at[p].normal);
        vec3 wi;
        PackedLight from = push.light;
        if (SOFT) {
            from = push.lights.at[point_in_list(p)];
        }
        float irradiance = incident(from, push.points.at[p].position, wi);
        float cosine = dot(normal, wi);
        if (irradiance == 0.0 || cosine <= 0.0) {
            continue;
        }
        irradiance *= cosine / float(POINTS_PER_SAMPLE);
        if (push.per_solid_angle > 0.0) {
            // If the point stands for much of the light's power, rays replace it: `weight_of_rays` in light_rays.rs.
            float share = irradiance / from.strength * s.area * push.per_solid_angle;
            float rays = smoothstep(0.5 * EVEN_SHARE, 1.5 * EVEN_SHARE, share);
            if (rays == 1.0) { // so near that irradiance may be unbounded
                continue;
            }
            irradiance *= 1.0 - rays;
        }
        irradiance *= float(byte) / 255.0;
        at.column = place(sqrt(min(cosine, 1.0)), TABLE_COSINES, at.along);
        vec3 lowest = radial(s.brdf, at, 0);
        vec3 cap = max(vec3(ALBEDO_CAP) - mirror(s.brdf, cosine), vec3(0.0));
        vec3 factor = light_color(from);
        if ((push.flags & HAS_FACTORS) != 0) {
            factor *= unpack_factor(push.factors.at[p]);
        }
        vec3 light = irradiance * factor * min(cap / max(lowest * sqrt(PI), vec3(1e-6)), vec3(1.0));
        first += light * lowest;
        if (DEGREES < 2 || s.degrees < 2) {
            continue;
        }
        // Two rotations by 180 degrees are the shortest rotation from the point's normal to the sample's.
        vec3 between = normal + s.normal;
        between /= sqrt(max(dot(between, between), 1e-20));
        vec3 turned = half_turn(s.normal, half_turn(between, wi));
        float x = dot(s.tangent, turned);
        float y = dot(bitangent, turned);
        uint i = 1;
        uint function = s.first + 1;
        for (uint degree = 1; degree < s.degrees; ++degree) {
            vec2 power = vec2(1.0, 0.0); // (x + iy)^order
            for (uint order = 0; order <= degree; ++order) {
                vec3 value = light * radial(s.brdf, at, i);
                add(function, value * power.x);
                if (order > 0) {
                    add(function + 1, value * power.y);
                }
                function += order > 0 ? 2 : 1;
                ++i;
                power = vec2(power.x * x - power.y * y, power.x * y + power.y * x);
            }
        }
    }
    add(s.first, first);
}
