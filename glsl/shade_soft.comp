// Direct light of an area light at unit intensity on all view samples, while it moves. One thread per sample.
//
// The light is shaded by points without shadows, times the fraction of it that the sample and its neighbours see:
// smooth shading times filtered visibility [Heitz 2018b]. Where nothing stops the light, tests/area_lights.rs has
// closed forms.

#include "lib/brdf.glsl"
#include "lib/light.glsl"

// Squared radius of the directions for which a point stands, up to which its light is accurate.
const float SMALL = 0.01;
const uint MOST_POINTS = 64;
// Points that shade a narrow lobe; most of its light is found by directions that are drawn from it.
const uint NARROW_POINTS = 16;
// Factor from the squared radius of a disk of directions to the increase of a lobe's squared alpha. Half vectors turn
// half as far as directions.
const float WIDENING = 0.25;
const float GOLDEN_RATIO = 0.618033989;
// Cosine and sine of the golden angle.
const vec2 GOLDEN_TURN = vec2(-0.737368878, 0.675490294);

// Light from a point or a direction of the light.
struct Arriving {
    vec3 wi;
    float irradiance;
    float solid_angle; // for which a direction drawn from a lobe stands, where NARROW_POINTS shade
};

// `light`, a point of the light that stands for `area` of its surface, seen from `position`.
Arriving from_point(PackedLight light, vec3 position, float area) {
    Arriving arriving;
    arriving.irradiance = incident(light, position, arriving.wi);
    vec3 to_light = light.position - position;
    float d2 = SHAPE == SHAPE_SUN ? 1.0 : dot(to_light, to_light);
    arriving.solid_angle = area * abs(dot(arriving.wi, light.direction)) / d2;
    return arriving;
}

// Light of all directions of a dome.
vec3 of_dome(Brdf brdf, vec3 normal, vec3 wo) {
    const float EACH = 1.0 / float(SOFT_POINTS);
    bool has_lobe = SPECULAR && brdf.alpha > 0.0;
    bool is_narrow = has_lobe && brdf.alpha < NARROW_ALPHA;
    vec3 radiance = vec3(0.0);
    for (uint i = 0; i < SOFT_POINTS; ++i) {
        PackedLight point = push.points.at[i];
        float solid_angle = point.squared_radius;
        Brdf widened = brdf;
        float share = 1.0;
        if (is_narrow) {
            share = point_share(brdf.alpha, normal, -point.direction, wo, DIRECTIONS_PER_POINT * solid_angle);
        } else if (has_lobe) {
            widened.alpha = sqrt(min(brdf.alpha * brdf.alpha + WIDENING * solid_angle * EACH / PI, 1.0));
        }
        vec3 irradiance = point.strength * point.position;
        radiance += share * irradiance * reflected(widened, normal, -point.direction, wo, SPECULAR);
    }
    return EACH * radiance;
}

vec3 unshadowed(ViewSample s, vec3 normal, vec3 wo) {
    Brdf brdf = push.brdfs.at[s.brdf];
    if (SHAPE == SHAPE_DOME) {
        return of_dome(brdf, normal, wo);
    }
    PackedLight middle = push.points.at[SOFT_POINTS];
    vec3 to_light = middle.position - s.position;
    float d2 = SHAPE == SHAPE_SUN ? 1.0 : max(dot(to_light, to_light), 1e-30);
    float width2 = dot(push.across, push.across);
    float height2 = push.half_height * push.half_height;
    // Of the directions in which the light is seen.
    float squared_radius = min((SHAPE == SHAPE_RECT ? 0.5 * (width2 + height2) : height2) / d2, 1e12);
    bool has_lobe = SPECULAR && brdf.alpha > 0.0;
    bool is_narrow = has_lobe && brdf.alpha < NARROW_ALPHA;
    float small = has_lobe ? min(SMALL, 0.5 * brdf.alpha * brdf.alpha) : SMALL;
    // Light that changes more with the direction of emission needs more points.
    float narrowing = middle.narrowing;
    small *= SHAPE == SHAPE_SPOT ? min(middle.cone_versine, 1.0) : 1.0 / (1.0 + narrowing * narrowing);
    uint count = is_narrow ? NARROW_POINTS : uint(clamp(squared_radius / small + 2.0, 4.0, float(MOST_POINTS))) & ~1u;
    float each = 1.0 / float(count);
    if (has_lobe && !is_narrow) {
        brdf.alpha = sqrt(min(brdf.alpha * brdf.alpha + WIDENING * squared_radius * each, 1.0));
    }
    // Towards the middle of the light; of flat lights away from it.
    vec3 axis = SHAPE == SHAPE_SUN ? -middle.direction : middle.direction;
    vec3 across = push.across;
    float versine = 0.5 * squared_radius; // of the cone of a ball or sun: 1 - cos of its edge
    float of_cone = middle.strength;
    if (SHAPE == SHAPE_BALL) {
        float in_front = squared_radius < 1.0 ? 1.0 / (1.0 + sqrt(1.0 - squared_radius)) : 0.0;
        versine = squared_radius * in_front;
        of_cone = incident(middle, s.position, axis) * 2.0 * in_front;
    }
    if (SHAPE == SHAPE_BALL || SHAPE == SHAPE_SUN) {
        across = abs(axis.x) > 0.5 ? vec3(-axis.y, axis.x, 0.0) : vec3(0.0, -axis.z, axis.y);
        across /= sqrt(max(dot(across, across), 1e-30));
    }
    vec3 along = cross(axis, across);
    float surface = PI * height2;
    if (SHAPE == SHAPE_RECT) {
        along *= push.half_height * inversesqrt(max(width2, 1e-30));
        surface = 4.0 * push.half_height * sqrt(width2);
    } else if (SHAPE == SHAPE_BALL) {
        surface *= 4.0;
    }
    float area = DIRECTIONS_PER_POINT * surface;
    vec3 radiance = vec3(0.0);
    vec2 turn = vec2(1.0, 0.0);
    for (uint i = 0; i < count; ++i) {
        // In pairs on both sides of the middle, so that few points have no preferred side.
        float along_lattice = float(i / 2) + 0.5;
        float u = 2.0 * along_lattice * each;
        float side = i % 2 == 0 ? 1.0 : -1.0;
        vec3 aside = (across * turn.x + along * turn.y) * side;
        Arriving arriving;
        PackedLight light = middle;
        if (SHAPE == SHAPE_RECT) {
            float v = fract(along_lattice * GOLDEN_RATIO);
            light.position += (across * (2.0 * u - 1.0) + along * (2.0 * v - 1.0)) * side;
        } else if (SHAPE == SHAPE_DISK || SHAPE == SHAPE_SPOT) {
            light.position += aside * sqrt(u);
        } else {
            // Directions spread evenly over a cone.
            float down = u * versine;
            float squared_sine = down * (2.0 - down);
            arriving.wi = axis * (1.0 - down) + aside * sqrt(squared_sine);
            arriving.irradiance = of_cone;
            arriving.solid_angle = area;
            if (SHAPE == SHAPE_BALL) {
                float cosine = sqrt(max(1.0 - squared_sine / max(squared_radius, 1e-30), 0.0));
                float d = 1.0 - down - sqrt(squared_radius) * cosine;
                arriving.solid_angle *= cosine / (d2 * d * d);
            }
        }
        if (SHAPE == SHAPE_DISK || SHAPE == SHAPE_RECT) {
            light.squared_radius = max(light.squared_radius, surface * each / PI);
        }
        if (SHAPE != SHAPE_BALL && SHAPE != SHAPE_SUN) {
            arriving = from_point(light, s.position, area);
        }
        if (side < 0.0) {
            turn = turn.x * GOLDEN_TURN + turn.y * vec2(-GOLDEN_TURN.y, GOLDEN_TURN.x);
        }
        float share = 1.0;
        if (is_narrow) {
            share = point_share(brdf.alpha, normal, arriving.wi, wo, arriving.solid_angle);
        }
        radiance += arriving.irradiance * share * reflected(brdf, normal, arriving.wi, wo, SPECULAR);
    }
    return radiance * each;
}

vec3 shade(uint index) {
    ViewSample s = push.samples.at[index];
    float visibility = float((push.visibility.at[index / 4] >> (8 * (index & 3))) & 255) * (1.0 / 255.0);
    bool counts = index < push.pixel_stride ? (push.layers & 1) != 0 : push.layers != 0;
    if (s.brdf == NO_BRDF || visibility == 0.0 || !counts) {
        return vec3(0.0);
    }
    vec3 factor = FACTORS ? unpack_factor(push.factors.at[index]) : vec3(1.0);
    return visibility * factor * unshadowed(s, octahedral(s.normal), octahedral(s.wo));
}

void main() {
    uint index = thread_index();
    if (index >= push.sample_count) {
        return;
    }
    vec3 radiance = shade(index);
    if (index < push.pixel_stride) {
        uvec3 at = index + uvec3(0, 1, 2) * push.pixel_stride;
        push.image.at[at.r] = radiance.r;
        push.image.at[at.g] = radiance.g;
        push.image.at[at.b] = radiance.b;
    } else {
        uint extra_stride = (push.sample_count - push.pixel_stride + 3) & ~3u;
        uvec3 at = index - push.pixel_stride + uvec3(0, 1, 2) * extra_stride;
        push.extras.at[at.r] = radiance.r;
        push.extras.at[at.g] = radiance.g;
        push.extras.at[at.b] = radiance.b;
    }
}
