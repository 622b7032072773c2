#include "lib/mrm_microfacet.glsl"

void mrm_dielectric_bsdf(ClosureData closureData, float weight, vec3 tint, float ior, vec2 roughness, float retroreflectivity, float thinfilm_thickness, float thinfilm_ior, vec3 N, vec3 X, int distribution, int masking, int scatter_mode, bool retro_transmission, inout BSDF bsdf)
{
    if (weight < M_FLOAT_EPS)
    {
        return;
    }
    // scatter_mode: 0 R, 1 T, 2 RT
    if (closureData.closureType != CLOSURE_TYPE_TRANSMISSION && scatter_mode == 1)
    {
        return;
    }

    FresnelData fd = mx_init_fresnel_dielectric(ior, thinfilm_thickness, thinfilm_ior);
    MrmLobe lobe = mrm_init_lobe(roughness, distribution, masking);
    vec3 safeTint = max(tint, 0.0);
    vec2 AB = vec2(0.0);
    vec3 compensation = vec3(1.0);
    vec3 response = vec3(0.0);
    mrm_microfacet(closureData, fd, lobe, retroreflectivity, N, X, AB, compensation, response);

    vec3 albedo = compensation * (mx_ior_to_f0(ior) * AB.x + AB.y);
    bsdf.throughput = vec3(1.0) - albedo * weight;
    bsdf.response = response * safeTint * weight;

    if (closureData.closureType == CLOSURE_TYPE_TRANSMISSION && scatter_mode != 0)
    {
        bsdf.response = mrm_transmission(closureData, fd, lobe, retroreflectivity, retro_transmission, safeTint, N, X) * weight;
    }
}
