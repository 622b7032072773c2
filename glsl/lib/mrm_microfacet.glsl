// What the conductor, dielectric and generalized Schlick nodes share: the microfacet lobe, forward and retro.
//
// [MRM]   Portsmouth, Raab, Belcour, Liu: The Minimal Retroreflective Microfacet Model, JCGT 15(1), 2026
// [Heitz] Heitz: Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs, JCGT 3(2), 2014
//
// V and L point away from the surface; a trailing t marks the shading frame (tangent, bitangent, normal).
#include "mrm_host.glsl"

// The order of the enumerations in mrm_defs.mtlx.
#define MRM_GGX 0
#define MRM_BECKMANN 1
#define MRM_PHONG 2
#define MRM_SMITH 0
#define MRM_VCAVITY 1

struct MrmLobe
{
    vec2 alpha;
    int distribution;
    int masking;
};

// log(1 + x) for x >= 0 without the rounding of 1 + x.
float mrm_log1p(float x)
{
    float s = x / (2.0 + x);
    float s2 = s * s;
    float series = 2.0 * s * (1.0 + s2 * (1.0 / 3.0 + s2 * (1.0 / 5.0 + s2 * (1.0 / 7.0))));
    return x < 0.25 ? series : log(1.0 + x);
}

// Distribution of microfacet normals.
float mrm_ndf(vec3 Ht, MrmLobe lobe)
{
    if (lobe.distribution == MRM_GGX)
    {
        // [Heitz] eq. 85, as MaterialX writes it: nothing cancels at Ht = N, where retro shading lives.
        return mx_ggx_NDF(Ht, lobe.alpha);
    }
    vec2 slope = Ht.xy / Ht.z;
    vec2 slope2 = slope * slope;
    vec2 width2 = lobe.alpha * lobe.alpha;
    // [Heitz] eq. 79
    float exponent = dot(slope2, vec2(1.0) / width2);
    float cos4 = mx_square(Ht.z * Ht.z);
    if (lobe.distribution == MRM_PHONG)
    {
        // Ashikhmin and Shirley 2000, normalized to a projected area of one, with exponents 2 / alpha^2 - 2:
        // cos^e = (1 + tan^2)^(-e/2) keeps its digits at exponents of a million.
        float tan2 = slope2.x + slope2.y;
        float growth = tan2 > 0.0 ? mrm_log1p(tan2) / tan2 : 1.0;
        exponent = growth * dot(slope2, vec2(1.0) / width2 - vec2(1.0));
        cos4 = 1.0;
    }
    return exp(-exponent) / (M_PI * lobe.alpha.x * lobe.alpha.y * cos4);
}

bool mrm_is_vcavity(MrmLobe lobe)
{
    return lobe.masking == MRM_VCAVITY || lobe.distribution == MRM_PHONG;
}

// 1 + 2 Lambda of Smith's masking, the same for a direction and its mirror about the normal.
// Masking is 2 / (1 + smith(V)), [Heitz] eq. 43; with shadowing it is 2 / (smith(V) + smith(L)), eq. 99.
float mrm_smith(vec3 Wt, MrmLobe lobe)
{
    // The roughness that the direction sees, [Heitz] eq. 80 and 86, times its tangent is length(stretched) / Wt.z.
    vec2 stretched = Wt.xy * lobe.alpha;
    float stretched2 = dot(stretched, stretched);
    if (lobe.distribution == MRM_BECKMANN)
    {
        // [Heitz] eq. 67, with erfc from Abramowitz and Stegun 7.1.26 (1.5e-7):
        // the exponential is common to both of its terms.
        float a = Wt.z / max(sqrt(stretched2), M_FLOAT_EPS);
        float t = 1.0 / (1.0 + 0.3275911 * a);
        float erfcx = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))));
        return 1.0 + exp(-a * a) * (0.5641895835 / a - erfcx);
    }
    // [Heitz] eq. 72
    return sqrt(stretched2 + Wt.z * Wt.z) / Wt.z;
}

// V-cavity masking and shadowing: [MRM] eq. 9 for both directions; the smaller of the two, [Heitz] section 4.
float mrm_vcavity(float NdotV, float NdotL, float NdotH, float halfCosine)
{
    return min(1.0, 2.0 * NdotH * min(NdotV, NdotL) / halfCosine);
}

// Split sum of the directional albedo: albedo = F0 * result.x + F90 * result.y.
// GGX with Smith is the host's own. Each other pair has its own fit, made never to lie below the true albedo,
// so that the compensation built on it never makes energy (mrm_nodes/reference/fit_albedo.py).
vec2 mrm_directional_albedo(float NdotV, MrmLobe lobe)
{
    float alpha = mx_average_alpha(lobe.alpha);
    vec2 albedo = mx_ggx_dir_albedo(NdotV, alpha, vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0)).xy;
    // A loop, not a branch: software GL runs both sides of a branch, and here that is all of the fits.
    for (int i = lobe.distribution == MRM_GGX && lobe.masking == MRM_SMITH ? 1 : 0; i < 1; i++)
    {
        float x = NdotV;
        float y = alpha;
        float x2 = x * x;
        float y2 = y * y;
        vec4 r = vec4(0.0);
        if (lobe.distribution == MRM_PHONG)
        {
            r = vec4(0.08913, 0.964842, 1.0, 1.0)
                + vec4(2.616, -2.50751, 0.570903, 1.06384) * x
                + vec4(2.08616, 9.08648, 0.528736, 12.8548) * y
                + vec4(8.02243, -20.8134, 14.0484, 32.7231) * x * y
                + vec4(12.1187, 1.59183, 13.0638, 9.81871) * x2
                + vec4(-0.626121, -1.39751, 0.420407, 27.6483) * y2
                + vec4(-37.2993, 11.6757, -42.9426, -95.0587) * x2 * y
                + vec4(-10.2897, 4.58033, -16.1699, 212.028) * x * y2
                + vec4(27.2182, -2.59107, 38.947, 284.87) * x2 * y2;
        }
        else if (lobe.distribution == MRM_GGX)
        {
            r = vec4(0.0803966, 0.967925, 1.0, 1.0)
                + vec4(2.7595, -2.50922, 1.02541, 1.20187) * x
                + vec4(3.6312, 8.71976, 2.86007, 14.6826) * y
                + vec4(8.33639, -19.4702, 10.4527, 38.693) * x * y
                + vec4(14.0144, 1.59174, 14.3571, 8.96971) * x2
                + vec4(0.299377, 0.576299, 1.17927, 33.4676) * y2
                + vec4(-27.8601, 10.6316, -23.6969, -83.5233) * x2 * y
                + vec4(-4.33858, -0.723628, -7.42861, 248.805) * x * y2
                + vec4(11.9557, 0.906006, 23.5901, 335.757) * x2 * y2;
        }
        else if (lobe.masking == MRM_SMITH)
        {
            r = vec4(0.0946861, 0.967962, 1.0, 1.0)
                + vec4(2.5994, -2.48216, 0.436913, 1.19956) * x
                + vec4(3.12764, 3.37487, 4.49907, 8.35735) * y
                + vec4(-4.37287, -7.20072, -6.60675, -11.6218) * x * y
                + vec4(12.7692, 1.55673, 13.9937, 9.70631) * x2
                + vec4(25.7803, -1.8122, 25.0374, 27.8384) * y2
                + vec4(-22.7625, 3.82591, -23.7459, -18.5952) * x2 * y
                + vec4(-41.0986, 4.9172, -33.2682, 152.147) * x * y2
                + vec4(26.7961, -3.16218, 25.009, -45.6325) * x2 * y2;
        }
        else
        {
            r = vec4(0.093397, 0.960774, 1.0, 1.0)
                + vec4(2.67898, -2.48274, 0.444015, 0.997426) * x
                + vec4(1.91866, 7.45955, 0.368186, 10.8893) * y
                + vec4(6.17382, -17.4874, 14.3399, 33.6533) * x * y
                + vec4(10.2466, 1.56777, 11.555, 10.085) * x2
                + vec4(0.286226, 0.089415, 1.5982, 25.4723) * y2
                + vec4(-24.892, 10.0404, -34.2631, -119.027) * x2 * y
                + vec4(-1.14729, 3.44741, -9.85759, 167.69) * x * y2
                + vec4(9.78894, -3.30176, 26.0562, 392.26) * x2 * y2;
        }
        albedo = clamp(r.xy / r.zw, 0.0, 1.0);
    }
    return albedo;
}

// Fresnel reflectance, which the 82 degree tint of MaterialX's can make negative.
vec3 mrm_fresnel(float cosine, FresnelData fd)
{
    // Where a film lies on a Schlick curve with the exponent 0, its pow(0, 0) is undefined.
    bool isConstant = fd.airy && fd.model == FRESNEL_MODEL_SCHLICK && fd.exponent == 0.0;
    return clamp(mx_compute_fresnel(isConstant ? min(cosine, 0.999999) : cosine, fd), 0.0, 1.0);
}

// Fresnel reflectance at normal and at grazing incidence, for what the host computes from these two alone.
vec3 mrm_f0(FresnelData fd)
{
    return mrm_fresnel(1.0, fd);
}

vec3 mrm_f90(FresnelData fd)
{
    return fd.model == FRESNEL_MODEL_SCHLICK && !fd.airy ? fd.F90 : vec3(1.0);
}

// Turquin's compensation factor as the host's own nodes have it, for a single-scattering albedo E of a white lobe.
// F: Fresnel reflectance of the light's half vector, or of N.V where light comes from an environment.
vec3 mrm_energy_compensation(vec3 F, FresnelData fd, float E)
{
#if MRM_COMPENSATION_BY_AVERAGE_FRESNEL
    // The cosine-weighted average of Schlick's curve over the hemisphere, whatever the curve.
    vec3 F0 = mrm_f0(fd);
    F = F0 + (mrm_f90(fd) - F0) * (1.0 / 21.0);
#endif
    return vec3(1.0) + F * ((1.0 - E) / E);
}

// The microfacet BSDF of one lobe in direct light, the light's cosine included; its compensation comes out too.
// sum, difference: in the shading frame, of the light and the view that the lobe sees: the view itself, or its mirror.
// scale: G / (4 N.V), or that without V-cavity masking.
vec3 mrm_reflection(vec3 sum, vec3 difference, float NdotV, float NdotL, float scale, float E, FresnelData fd, MrmLobe lobe, inout vec3 compensation)
{
    // Of unit vectors they are perpendicular. What rounding left of their lengths would turn the half vector of two
    // that are nearly opposite; where they are not, it does not matter.
    sum = sum - difference * (dot(sum, difference) / max(dot(difference, difference), 1.0));
    float size = max(length(sum), 2.0 * M_FLOAT_EPS);
    vec3 Ht = sum / size;
    // The cosine of the half angle, without the rounding of a product with the half vector.
    float VdotH = min(0.5 * size, 1.0);

    vec3 F = mrm_fresnel(VdotH, fd);
    compensation = mrm_energy_compensation(F, fd, E);
    if (mrm_is_vcavity(lobe))
    {
        scale = scale * mrm_vcavity(NdotV, NdotL, Ht.z, VdotH);
    }
    return F * compensation * (mrm_ndf(Ht, lobe) * scale);
}

#include "mrm_environment.glsl"

// One microfacet BSDF with its retro twin, blended by retroreflectivity: [MRM] eq. 10 and section 4.
// N, X: shading normal and tangent in world space. AB: the split sum of the directional albedo, for the layers below.
// Out: response (the light's cosine and occlusion included, weight and tint not) and the compensation that layering needs.
void mrm_microfacet(ClosureData closureData, FresnelData fd, MrmLobe lobe, float retroreflectivity, vec3 N, vec3 X, inout vec2 AB, inout vec3 compensation, inout vec3 response)
{
    vec3 V = closureData.V;
    vec3 L = closureData.L;
    float retro = clamp(retroreflectivity, 0.0, 1.0);

    N = mx_forward_facing_normal(N, V);
    float NdotV = clamp(dot(N, V), M_FLOAT_EPS, 1.0);

    if (closureData.closureType == CLOSURE_TYPE_REFLECTION)
    {
        X = normalize(X - dot(X, N) * N);
        vec3 Y = cross(N, X);
        AB = mrm_directional_albedo(NdotV, lobe);
        float E = AB.x + AB.y;

        float NdotL = clamp(dot(N, L), M_FLOAT_EPS, 1.0);
        vec3 Vt = vec3(dot(V, X), dot(V, Y), NdotV);
        vec3 Lt = vec3(dot(L, X), dot(L, Y), NdotL);
        float scale = (mrm_is_vcavity(lobe) ? 1.0 : 2.0 / (mrm_smith(Vt, lobe) + mrm_smith(Lt, lobe))) / (4.0 * NdotV);

        // Added up before they are turned into the frame, L and V keep the digits that they do not share.
        vec3 S = L + V;
        vec3 D = L - V;
        vec3 sum = vec3(dot(S, X), dot(S, Y), dot(S, N));
        vec3 difference = vec3(dot(D, X), dot(D, Y), dot(D, N));
        // The virtual mirror of V, [MRM] eq. 3, is (-x, -y, z) of it: its sum with L has this difference's x and y.
        vec3 retroSum = vec3(difference.xy, sum.z);
        vec3 retroDifference = vec3(sum.xy, difference.z);

        compensation = vec3(0.0);
        response = vec3(0.0);
        // A loop, not two branches: software GL runs both sides of a branch.
        int last = retro > 0.0 ? 1 : 0;
        for (int i = retro < 1.0 ? 0 : 1; i <= last; i++)
        {
            float share = i == 0 ? 1.0 - retro : retro;
            vec3 ofLobe = vec3(1.0);
            response = response + share * mrm_reflection(i == 0 ? sum : retroSum, i == 0 ? difference : retroDifference, NdotV, NdotL, scale, E, fd, lobe, ofLobe);
            compensation = compensation + share * ofLobe;
        }
        // Nothing comes from below the horizon, where MaterialX's clamp leaks a little.
        response = dot(N, L) > 0.0 ? response * closureData.occlusion : vec3(0.0);
    }
    else
    {
        // Both lobes see the same N.V, so they share Fresnel, compensation and albedo.
#if MRM_ENVIRONMENT != MRM_ENVIRONMENT_FIS
        // The host's environment functions are GGX with Smith, whatever the node asks for.
        lobe.distribution = MRM_GGX;
        lobe.masking = MRM_SMITH;
#endif
        vec3 F = mrm_fresnel(NdotV, fd);
        AB = mrm_directional_albedo(NdotV, lobe);
        compensation = mrm_energy_compensation(F, fd, AB.x + AB.y);

        if (closureData.closureType == CLOSURE_TYPE_INDIRECT)
        {
            vec3 Li = mrm_environment_radiance(N, V, X, retro, fd, lobe, AB, F);
            response = Li * compensation;
        }
    }
}

// Transmission as MaterialX has it, an environment look-up, with the view turned about the normal for the retro part.
vec3 mrm_transmission(ClosureData closureData, FresnelData fd, MrmLobe lobe, float retroreflectivity, bool retroTransmission, vec3 tint, vec3 N, vec3 X)
{
    vec3 V = closureData.V;
    float retro = retroTransmission ? clamp(retroreflectivity, 0.0, 1.0) : 0.0;
    vec3 Vr = reflect(-V, N);
    N = mx_forward_facing_normal(N, V);
    vec3 transmitted = vec3(0.0);
    // A loop, not two branches: software GL runs both sides of a branch.
    int last = retro > 0.0 ? 1 : 0;
    for (int i = retro < 1.0 ? 0 : 1; i <= last; i++)
    {
        float share = i == 0 ? 1.0 - retro : retro;
        transmitted = transmitted + share * mx_surface_transmission(N, i == 0 ? V : Vr, X, lobe.alpha, MRM_GGX, fd, tint);
    }
    return transmitted;
}

MrmLobe mrm_init_lobe(vec2 roughness, int distribution, int masking)
{
    MrmLobe lobe;
    lobe.alpha = clamp(roughness, M_FLOAT_EPS, 1.0);
    lobe.distribution = distribution;
    lobe.masking = masking;
    return lobe;
}
