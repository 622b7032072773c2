// A conductor in GLSL: GGX, height-correlated Smith. v and l are unit vectors above the surface, whose normal is +z.
const float PI = 3.14159265;

// Reflectance of the index n + ik at the cosine between v and the half vector.
vec3 fresnel(float c, vec3 n, vec3 k) {
    float c2 = c * c, s2 = 1.0 - c2;
    vec3 t = n * n - k * k - s2;
    vec3 m = sqrt(t * t + 4.0 * n * n * k * k);
    vec3 a = sqrt(0.5 * (m + t));
    vec3 rs = (m + c2 - 2.0 * a * c) / (m + c2 + 2.0 * a * c);
    return 0.5 * rs * (1.0 + (c2 * m + s2 * s2 - 2.0 * a * c * s2) / (c2 * m + s2 * s2 + 2.0 * a * c * s2));
}

// cos(theta) (1 + Lambda) of GGX (Heitz 2014, eq. 86).
float projected_area(vec3 w, vec2 alpha) {
    return 0.5 * (w.z + length(vec3(alpha * w.xy, w.z)));
}

// A renderer's own microfacet lobe: f in 1/sr without the cosine, and in w the pdf per steradian.
vec4 forward(vec3 ior, vec3 extinction, vec2 alpha, vec3 v, vec3 l) {
    vec3 h = v + l;
    float c = 0.5 * length(h);
    h /= 2.0 * c;
    vec3 stretched = vec3(h.xy / alpha, h.z);
    float q = dot(stretched, stretched); // sums of squares do not cancel, as n.h^2 (alpha^2 - 1) + 1 does
    float d = 1.0 / (PI * alpha.x * alpha.y * q * q);
    float area_v = projected_area(v, alpha), area_l = projected_area(l, alpha);
    float lobe = 0.25 * d / (area_v * l.z + area_l * v.z - v.z * l.z); // D G2 / (4 n.v n.l)
    return vec4(lobe * fresnel(c, ior, extinction), 0.25 * d / area_v); // D G1 / (4 n.v)
}

// The rule: the same lobe seen from v' = 2 (n.v) n - v, blended by the weight.
vec4 mrm(vec3 ior, vec3 extinction, vec2 alpha, float retroreflectivity, vec3 v, vec3 l) {
    vec3 n = vec3(0.0, 0.0, 1.0);
    vec3 turned = 2.0 * dot(n, v) * n - v;
    vec4 one = forward(ior, extinction, alpha, v, l);
    return mix(one, forward(ior, extinction, alpha, turned, l), retroreflectivity);
}
