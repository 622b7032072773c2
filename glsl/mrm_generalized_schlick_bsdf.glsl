#include "lib/mrm_microfacet.glsl"

void mrm_generalized_schlick_bsdf(ClosureData closureData, float weight, vec3 color0, vec3 color82, vec3 color90, float exponent, vec2 roughness, float retroreflectivity, float thinfilm_thickness, float thinfilm_ior, vec3 N, vec3 X, int distribution, int masking, int scatter_mode, inout BSDF bsdf)
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

    vec3 safeColor0 = max(color0, 0.0);
    vec3 safeColor82 = max(color82, 0.0);
    vec3 safeColor90 = max(color90, 0.0);
    // x^0 is 1, at the mirror angle too, where pow(0, 0) is undefined: the curve is color90 everywhere. Under a film
    // color0 is an index too, and mrm_fresnel keeps off that angle.
    bool isConstant = exponent == 0.0 && !(thinfilm_thickness > 0.0);
    FresnelData fd = mx_init_fresnel_schlick(isConstant ? safeColor90 : safeColor0, safeColor82, safeColor90, isConstant ? 5.0 : exponent, thinfilm_thickness, thinfilm_ior);
    MrmLobe lobe = mrm_init_lobe(roughness, distribution, masking);
    vec2 AB = vec2(0.0);
    vec3 compensation = vec3(1.0);
    vec3 response = vec3(0.0);
    mrm_microfacet(closureData, fd, lobe, retroreflectivity, N, X, AB, compensation, response);

    vec3 albedo = compensation * (safeColor0 * AB.x + safeColor90 * AB.y);
    bsdf.throughput = vec3(1.0 - dot(albedo, vec3(1.0 / 3.0)) * weight);
    bsdf.response = response * weight;

    if (closureData.closureType == CLOSURE_TYPE_TRANSMISSION && scatter_mode != 0)
    {
        // The host's transmission refracts with one index, from the mean reflectivity at normal incidence.
        fd.ior = vec3(mx_f0_to_ior(dot(safeColor0, vec3(1.0 / 3.0))));
        if (exponent == 0.0)
        {
            // Nothing keeps the host off the mirror angle here: color90 is the index under a film too.
            fd.F0 = safeColor90;
            fd.exponent = 5.0;
        }
        bsdf.response = mrm_transmission(closureData, fd, lobe, retroreflectivity, false, vec3(1.0), N, X) * weight;
    }
}
