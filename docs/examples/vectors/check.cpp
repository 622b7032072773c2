// Compares a conductor in C++ with the test vectors: g++ -std=c++17 check.cpp -o check && ./check vectors.json
// Says what is wrong, and ends in status 1 where something is. Needs nlohmann/json on the include path.
#include <nlohmann/json.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <fstream>
#include <iostream>

using Vec3 = std::array<double, 3>;
using Vec2 = std::array<double, 2>;
struct Result { Vec3 f; double pdf; };  // 1/sr without the cosine; per steradian
const double PI = 3.141592653589793;

// Reflectance of the index n + ik at the cosine between v and the half vector.
double fresnel(double c, double n, double k) {
    std::complex<double> n2 = std::complex<double>(n, k) * std::complex<double>(n, k), g = std::sqrt(n2 - 1.0 + c * c);
    return (std::norm((c - g) / (c + g)) + std::norm((n2 * c - g) / (n2 * c + g))) / 2;
}

// cos(theta) (1 + Lambda) of GGX (Heitz 2014, eq. 86).
double projected_area(Vec3 w, Vec2 alpha) {
    return (w[2] + std::sqrt(w[2] * w[2] + std::pow(alpha[0] * w[0], 2) + std::pow(alpha[1] * w[1], 2))) / 2;
}

// A renderer's own microfacet lobe: GGX, height-correlated Smith, v and l above the surface.
Result forward(Vec3 ior, Vec3 extinction, Vec2 alpha, Vec3 v, Vec3 l) {
    Vec3 h = {v[0] + l[0], v[1] + l[1], v[2] + l[2]};
    double c = std::sqrt(h[0] * h[0] + h[1] * h[1] + h[2] * h[2]) / 2;
    for (double& x : h) x /= 2 * c;
    double q = std::pow(h[0] / alpha[0], 2) + std::pow(h[1] / alpha[1], 2) + h[2] * h[2];
    double d = 1 / (PI * alpha[0] * alpha[1] * q * q);
    double area_v = projected_area(v, alpha), area_l = projected_area(l, alpha);
    double lobe = d / (4 * (area_v * l[2] + area_l * v[2] - v[2] * l[2]));  // D G2 / (4 n.v n.l)
    Result result = {{}, d / (4 * area_v)};                                 // D G1 / (4 n.v)
    for (int i = 0; i < 3; ++i) result.f[i] = lobe * fresnel(c, ior[i], extinction[i]);
    return result;
}

// The rule: the same lobe seen from v' = 2 (n.v) n - v, blended by the weight.
Result mrm(Vec3 ior, Vec3 extinction, Vec2 alpha, double retroreflectivity, Vec3 v, Vec3 l) {
    Vec3 turned = {-v[0], -v[1], v[2]};
    Result result = forward(ior, extinction, alpha, v, l), retro = forward(ior, extinction, alpha, turned, l);
    for (int i = 0; i < 3; ++i) result.f[i] += retroreflectivity * (retro.f[i] - result.f[i]);
    result.pdf += retroreflectivity * (retro.pdf - result.pdf);
    return result;
}

int main(int, char** arguments) {
    auto file = nlohmann::json::parse(std::ifstream(arguments[1]));
    int points = 0, wrong = 0;
    for (auto& c : file["cases"]) {
        auto& p = c["parameters"];
        if (c["lobe"] != "Conductor" || p["distribution"] != "ggx" || p["masking"] != "smith") continue;
        if (!p["energy_compensation"].is_null()) continue;
        for (auto& q : c["points"]) {
            Result found = mrm(p["ior"], p["extinction"], p["alpha"], p["retroreflectivity"], q["v"], q["l"]);
            bool good = std::abs(found.pdf - double(q["pdf"])) <= 1e-12 * std::max(double(q["pdf"]), 1e-4);
            for (int i = 0; i < 3; ++i) {
                double expected = q["eval"][i];
                good = good && std::abs(found.f[i] - expected) <= 1e-12 * std::max(expected, 1e-4);
            }
            ++points;
            if (good) continue;
            ++wrong;
            std::cout << std::string(c["name"]) << ": eval " << nlohmann::json(found.f) << " is not " << q["eval"]
                      << ", or pdf " << found.pdf << " is not " << q["pdf"] << "\n";
        }
    }
    std::cout << points - wrong << " of " << points << " points agree\n";
    return wrong > 0 || points == 0;
}
