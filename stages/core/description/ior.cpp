#include "stages/core/description/ior.h"

#include <utility>

namespace loom {
namespace {

constexpr std::pair<std::string_view, float> dielectrics[] = {
    {"vacuum", 1.0f},      {"helium", 1.000036f},        {"hydrogen", 1.000132f},
    {"air", 1.000277f},    {"carbon dioxide", 1.00045f}, {"water", 1.333f},
    {"acetone", 1.36f},    {"ethanol", 1.361f},          {"carbon tetrachloride", 1.461f},
    {"glycerol", 1.4729f}, {"benzene", 1.501f},          {"silicone oil", 1.52045f},
    {"bromine", 1.661f},   {"water ice", 1.31f},         {"fused quartz", 1.458f},
    {"pyrex", 1.47f},      {"acrylic glass", 1.49f},     {"polypropylene", 1.49f},
    {"bk7", 1.5046f},      {"sodium chloride", 1.544f},  {"amber", 1.55f},
    {"pet", 1.575f},       {"diamond", 2.419f},
};

struct Conductor {
    std::string_view name;
    bool also_palik;  // scene files also name the data NAME_palik
    Spectrum eta, k;
};
constexpr std::string_view palik_suffix = "_palik";
constexpr Conductor conductors[] = {
    {"none", false, {0, 0, 0}, {1, 1, 1}},
    {"Ag", false, {0.155276f, 0.116728f, 0.138388f}, {4.82835f, 3.12222f, 2.1469f}},
    {"Al", false, {1.6575f, 0.880405f, 0.521244f}, {9.22381f, 6.2695f, 4.837f}},
    {"AlAs", true, {3.6053f, 3.23294f, 2.21632f}, {0.000679437f, 0, 0.00751271f}},
    {"AlSb", true, {0, 4.13937f, 4.66925f}, {0, 0.0940091f, 1.30057f}},
    {"Au", false, {0.143036f, 0.375307f, 1.44205f}, {3.983f, 2.38556f, 1.60336f}},
    {"Be", true, {4.18501f, 3.18503f, 2.78406f}, {3.83547f, 3.01012f, 2.86899f}},
    {"Cr", false, {4.36967f, 2.91651f, 1.6549f}, {5.20655f, 4.23131f, 3.7547f}},
    {"CsI", true, {2.1449f, 1.70232f, 1.66243f}, {0, 0, 0}},
    {"Cu", false, {0.201005f, 0.92375f, 1.10222f}, {3.91326f, 2.45305f, 2.14209f}},
    {"Cu2O", true, {3.55177f, 2.94987f, 2.75188f}, {0.114207f, 0.193897f, 0.606134f}},
    {"CuO", true, {3.24754f, 2.44781f, 2.21022f}, {0.52109f, 0.570031f, 0.722179f}},
    {"Cu_palik", false, {0.213229f, 0.919715f, 1.10241f}, {3.92187f, 2.45733f, 2.13658f}},
    {"Hg", true, {2.39894f, 1.44003f, 0.90957f}, {6.32759f, 4.37192f, 3.42176f}},
    {"HgTe", true, {4.77904f, 3.2312f, 2.6599f}, {1.63161f, 1.58081f, 1.72929f}},
    {"Ir", true, {3.0863f, 2.08219f, 1.61791f}, {5.59215f, 4.06709f, 3.26731f}},
    {"K", true, {0.0640432f, 0.0464098f, 0.0381849f}, {2.1042f, 1.34894f, 0.913126f}},
    {"Li", true, {0.265791f, 0.195618f, 0.220949f}, {3.54015f, 2.31112f, 1.66861f}},
    {"MgO", true, {2.08958f, 1.65072f, 1.59488f}, {4.3327e-12f, 0, 2.49865e-11f}},
    {"Mo", true, {4.48397f, 3.52513f, 2.77631f}, {4.11144f, 3.42083f, 3.15061f}},
    {"Na_palik", false, {0.0602694f, 0.0561409f, 0.0619884f}, {3.17927f, 2.11249f, 1.57904f}},
    {"Nb", true, {3.42007f, 2.79009f, 2.39563f}, {3.44139f, 2.73767f, 2.57975f}},
    {"Ni_palik", false, {2.3673f, 1.66337f, 1.46708f}, {4.49881f, 3.05015f, 2.34544f}},
    {"Rh", true, {2.58579f, 1.86022f, 1.55426f}, {6.78226f, 4.70299f, 3.97607f}},
    {"Se", true, {4.05831f, 2.84294f, 2.82085f}, {0.75405f, 0.638444f, 0.521808f}},
    {"Se-e", true, {5.72285f, 4.16574f, 4.08134f}, {0.871136f, 1.10516f, 1.56532f}},
    {"SiC", true, {3.17234f, 2.52597f, 2.47937f}, {7.53766e-07f, 0, 1.01925e-05f}},
    {"SnTe", true, {4.52425f, 1.98164f, 1.28159f}, {0, 0, 0}},
    {"Ta", true, {2.06272f, 2.39294f, 2.62793f}, {2.40836f, 1.74149f, 1.94703f}},
    {"Te", true, {7.39023f, 4.4821f, 2.63711f}, {3.25602f, 3.52706f, 3.29205f}},
    {"Te-e", true, {7.50891f, 4.29643f, 2.36999f}, {5.58393f, 4.94721f, 3.99759f}},
    {"ThF4", true, {1.83071f, 1.44223f, 1.38765f}, {0, 0, 0}},
    {"TiC", true, {3.70053f, 2.83742f, 2.58229f}, {3.26564f, 2.35159f, 2.17279f}},
    {"TiN", true, {1.64845f, 1.15052f, 1.37982f}, {3.36833f, 1.9435f, 1.10207f}},
    {"TiO2", true, {3.45661f, 2.80174f, 2.90517f}, {0.000105265f, 0, 0.000652887f}},
    {"TiO2-e", true, {3.10656f, 2.51317f, 2.58244f}, {2.97516e-05f, 0, 0.000182698f}},
    {"VC", true, {3.65757f, 2.75274f, 2.53267f}, {3.0683f, 2.19869f, 1.96319f}},
    {"VN", true, {2.8656f, 2.11919f, 1.94009f}, {3.03224f, 2.05612f, 1.61631f}},
    {"V_palik", false, {4.27758f, 3.51295f, 2.76107f}, {3.4913f, 2.88945f, 3.11152f}},
    {"W", false, {4.37082f, 3.30025f, 2.99841f}, {3.50064f, 2.60487f, 2.27323f}},
    {"a-C", false, {2.94405f, 2.22714f, 1.96816f}, {0.887465f, 0.799299f, 0.81529f}},
    {"d-C", true, {2.70872f, 2.31883f, 2.2289f}, {0, 0, 0}},
};

}  // namespace

std::optional<float> dielectric_ior(std::string_view name) {
    for (const auto& [known, ior] : dielectrics)
        if (known == name) return ior;
    return std::nullopt;
}

std::vector<std::string> dielectric_names() {
    std::vector<std::string> names;
    for (const auto& [name, ior] : dielectrics) names.emplace_back(name);
    return names;
}

std::optional<ConductorIor> conductor_ior(std::string_view name) {
    const bool palik = name.ends_with(palik_suffix);
    const std::string_view stem = palik ? name.substr(0, name.size() - palik_suffix.size()) : name;
    for (const Conductor& c : conductors)
        if (c.name == name || (palik && c.also_palik && c.name == stem)) return ConductorIor{c.eta, c.k};
    return std::nullopt;
}

std::vector<std::string> conductor_names() {
    std::vector<std::string> names;
    for (const Conductor& c : conductors) {
        names.emplace_back(c.name);
        if (c.also_palik) names.emplace_back(std::string(c.name).append(palik_suffix));
    }
    return names;
}

}  // namespace loom
