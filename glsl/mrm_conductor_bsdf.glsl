#include "lib/mrm_microfacet.glsl"

void mrm_conductor_bsdf(ClosureData closureData, float weight, vec3 ior, vec3 extinction, vec2 roughness, float retroreflectivity, float thinfilm_thickness, float thinfilm_ior, vec3 N, vec3 X, int distribution, int masking, inout BSDF bsdf)
{
    bsdf.throughput = vec3(0.0);

    if (weight < M_FLOAT_EPS || closureData.closureType == CLOSURE_TYPE_TRANSMISSION)
    {
        return;
    }

    FresnelData fd = mx_init_fresnel_conductor(ior, extinction, thinfilm_thickness, thinfilm_ior);
    MrmLobe lobe = mrm_init_lobe(roughness, distribution, masking);
    vec2 AB = vec2(0.0);
    vec3 compensation = vec3(1.0);
    vec3 response = vec3(0.0);
    mrm_microfacet(closureData, fd, lobe, retroreflectivity, N, X, AB, compensation, response);
    bsdf.response = response * weight;
}
