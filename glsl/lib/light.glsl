// Punctual lights [KHR_lights_punctual], and facets. Twin: src/physics/light.rs.

// RGB in half precision.
vec3 unpack_factor(uvec2 halves) {
    return vec3(unpackHalf2x16(halves.x), unpackHalf2x16(halves.y).x);
}

// Colour of the light at unit intensity.
vec3 light_color(PackedLight light) {
    return light.kind == LIGHT_DIRECTIONAL ? light.position : vec3(1.0);
}

// Unit direction towards the light, and irradiance at normal incidence for unit intensity.
float incident(PackedLight light, vec3 position, out vec3 wi) {
    if (light.kind == LIGHT_DIRECTIONAL) {
        wi = -light.direction;
        return light.strength;
    }
    vec3 to_light = light.position - position;
    float d2 = dot(to_light, to_light);
    if (d2 == 0.0) { // at the light itself the direction is undefined
        wi = vec3(0.0);
        return 0.0;
    }
    wi = to_light / sqrt(d2);
    float x2 = d2 * light.inverse_range * light.inverse_range;
    float irradiance = light.strength * clamp(1.0 - x2 * x2, 0.0, 1.0) / d2;
    irradiance *= d2 < light.squared_radius ? d2 / light.squared_radius : 1.0;
    if (light.kind == LIGHT_SPOT) {
        // 1 - cos of the angle off the axis is half the squared chord: exact for narrow cones.
        vec3 chord = wi + light.direction;
        float cone = clamp((light.cone_versine - 0.5 * dot(chord, chord)) * light.cone_scale, 0.0, 1.0);
        irradiance *= cone * cone;
    } else if (light.kind >= LIGHT_FACET) {
        float cosine = -dot(wi, light.direction);
        cosine = light.kind == LIGHT_TWO_SIDED_FACET ? abs(cosine) : cosine;
        irradiance *= max(cosine - light.narrowing * sqrt(max(1.0 - cosine * cosine, 0.0)), 0.0);
    }
    return irradiance;
}
