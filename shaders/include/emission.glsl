// Emitted radiance: a colour, times an emission field, times the blackbody colour of a temperature field. Outside its own
// box a field has its background's value, which the outermost texels of its block hold.

struct Emission {
    mat4 world_to_temperature;  // -> the unit cube of the temperature field
    vec4 temperature_scale;     // cube -> atlas; w: kelvin of a texel of value 1
    vec4 temperature_offset;    // xyz; w: kelvin added, with scale folded into temperature_scale.w
    mat4 world_to_field;
    vec4 field_scale;           // w: value of a texel of value 1
    vec4 field_offset;          // xyz; w: bits: 1 has temperature, 2 has an emission field
};

layout(std140) uniform Emissions { Emission emissions[VOLUME_COUNT]; };

#if HAS_TEMPERATURE
uniform sampler3D temperature_atlas;
layout(std140) uniform Blackbody { vec4 blackbody_table[BLACKBODY_SIZE]; };  // no texture, as samplers are few
uniform vec2 blackbody_range;  // lowest temperature of the table, 1 / (highest - lowest), kelvin
#endif
#if HAS_EMISSION_FIELD
uniform sampler3D emission_atlas;
#endif

vec3 emitted_radiance(int v, vec3 position) {
    vec3 radiance = volumes[v].emission.rgb;
    if (radiance.r + radiance.g + radiance.b == 0.0) return radiance;
    int fields = int(emissions[v].field_offset.w);
#if HAS_TEMPERATURE
    if ((fields & 1) != 0) {
        vec3 cube = clamp((emissions[v].world_to_temperature * vec4(position, 1.0)).xyz, 0.0, 1.0);
        vec3 texel = cube * emissions[v].temperature_scale.xyz + emissions[v].temperature_offset.xyz;
        float kelvin = texture(temperature_atlas, texel).r * emissions[v].temperature_scale.w
            + emissions[v].temperature_offset.w;
        float place = clamp((kelvin - blackbody_range.x) * blackbody_range.y, 0.0, 1.0) * float(BLACKBODY_SIZE - 1);
        int entry = min(int(place), BLACKBODY_SIZE - 2);
        radiance *= mix(blackbody_table[entry].rgb, blackbody_table[entry + 1].rgb, place - float(entry));
    }
#endif
#if HAS_EMISSION_FIELD
    if ((fields & 2) != 0) {
        vec3 cube = clamp((emissions[v].world_to_field * vec4(position, 1.0)).xyz, 0.0, 1.0);
        radiance *= texture(emission_atlas, cube * emissions[v].field_scale.xyz + emissions[v].field_offset.xyz).rgb
            * emissions[v].field_scale.w;
    }
#endif
    return radiance;
}
