// Image light on a microfacet lobe and its retro twin, blended: no compensation, weight or tint.
//
// Turning the view about N turns the light instead: E_mrm(v) is the integral of f(v, l) Li(Rl), [MRM] eq. 3 and 10.
// One sample of the forward lobe so serves both, with the same Fresnel, masking and density.
#if MRM_ENVIRONMENT == MRM_ENVIRONMENT_FIS

// Filtered importance sampling, Krivanek and Colbert 2008, with the host's sampler and filter and the node's own lobe.
vec3 mrm_environment_radiance(vec3 N, vec3 V, vec3 X, float retro, FresnelData fd, MrmLobe lobe, vec2 AB, vec3 F)
{
    X = normalize(X - dot(X, N) * N);
    vec3 Y = cross(N, X);
    vec3 Vt = vec3(dot(V, X), dot(V, Y), clamp(dot(V, N), M_FLOAT_EPS, 1.0));
    float smithV = mrm_smith(Vt, lobe);
    // What is drawn are the visible normals of GGX, whatever the node asks for.
    MrmLobe drawn = lobe;
    drawn.distribution = MRM_GGX;
    float G1 = 2.0 / (1.0 + mrm_smith(Vt, drawn));
    float perNormal = G1 / (4.0 * Vt.z);

    // The frame in the space of the map: a rotation less in the loop.
    vec3 mapX = normalize(MRM_MATRIX_MUL($envMatrix, vec4(X, 0.0)).xyz);
    vec3 mapY = normalize(MRM_MATRIX_MUL($envMatrix, vec4(Y, 0.0)).xyz);
    vec3 mapN = normalize(MRM_MATRIX_MUL($envMatrix, vec4(N, 0.0)).xyz);
    mat4 identity = mat4(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);

    vec3 radiance = vec3(0.0);
    int count = $envRadianceSamples;
    for (int i = 0; i < count; i++)
    {
        vec3 Ht = mx_ggx_importance_sample_VNDF(mx_spherical_fibonacci(i, count), Vt, lobe.alpha);
        float VdotH = clamp(dot(Vt, Ht), M_FLOAT_EPS, 1.0);
        vec3 Lt = 2.0 * VdotH * Ht - Vt;
        float sampled = mx_ggx_NDF(Ht, lobe.alpha);
        float pdf = sampled * perNormal;

        vec3 up = mapN * Lt.z;
        vec3 across = mapX * Lt.x + mapY * Lt.y;
        vec3 Li = vec3(0.0);
        if (retro < 1.0)
        {
            float lod = mx_latlong_compute_lod(up + across, pdf, float($envRadianceMips - 1), count);
            Li = Li + (1.0 - retro) * mx_latlong_map_lookup(up + across, identity, lod, $envRadiance);
        }
        if (retro > 0.0)
        {
            float lod = mx_latlong_compute_lod(up - across, pdf, float($envRadianceMips - 1), count);
            Li = Li + retro * mx_latlong_map_lookup(up - across, identity, lod, $envRadiance);
        }

        vec3 FH = mrm_fresnel(VdotH, fd);
        Lt.z = max(Lt.z, M_FLOAT_EPS);
        float G = mrm_is_vcavity(lobe) ? mrm_vcavity(Vt.z, Lt.z, Ht.z, VdotH) : 2.0 / (smithV + mrm_smith(Lt, lobe));
        if (lobe.distribution != MRM_GGX)
        {
            G = G * (mrm_ndf(Ht, lobe) / sampled);
        }
        radiance = radiance + FH * Li * G;
    }
    return count == 0 ? vec3(0.0) : radiance * ($envLightIntensity / (G1 * float(count)));
}

#elif MRM_ENVIRONMENT == MRM_ENVIRONMENT_PREFILTER

// The host's prefiltered method: GGX with Smith, whatever the node asks for. The mirror's retro twin looks back along V.
// AB, F: the split sum of the lobe's directional albedo and Fresnel at N.V, as the host's mx_ggx_dir_albedo joins them.
vec3 mrm_environment_radiance(vec3 N, vec3 V, vec3 X, float retro, FresnelData fd, MrmLobe lobe, vec2 AB, vec3 F)
{
    float alpha = mx_average_alpha(lobe.alpha);
    float lod = mx_latlong_alpha_to_lod(alpha);
    vec3 Li = vec3(0.0);
    if (retro < 1.0)
    {
        Li = Li + (1.0 - retro) * mx_latlong_map_lookup(reflect(-V, N), $envMatrix, lod, $envRadiance);
    }
    if (retro > 0.0)
    {
        Li = Li + retro * mx_latlong_map_lookup(V, $envMatrix, lod, $envRadiance);
    }
    vec3 albedo = mrm_f0(fd) * AB.x + mrm_f90(fd) * AB.y;
    if (fd.airy)
    {
        albedo = mix(F, albedo, sqrt(alpha));
    }
    return Li * albedo * $envLightIntensity;
}

#else

// The host's own function, once for each lobe: GGX with Smith, whatever the node asks for.
vec3 mrm_environment_radiance(vec3 N, vec3 V, vec3 X, float retro, FresnelData fd, MrmLobe lobe, vec2 AB, vec3 F)
{
    vec3 Li = vec3(0.0);
    if (retro < 1.0)
    {
        Li = Li + (1.0 - retro) * mx_environment_radiance(N, V, X, lobe.alpha, MRM_GGX, fd);
    }
    if (retro > 0.0)
    {
        Li = Li + retro * mx_environment_radiance(N, reflect(-V, N), X, lobe.alpha, MRM_GGX, fd);
    }
    return Li;
}

#endif
