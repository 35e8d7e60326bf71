#pragma once
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "stages/core/math/vector.h"

namespace loom {

/// Returns the index of refraction of a named dielectric ("bk7", "air", "water", …); nothing for an unknown name.
std::optional<float> dielectric_ior(std::string_view name);
std::vector<std::string> dielectric_names();

/// Complex index eta + i k of a conductor relative to vacuum, as linear RGB.
struct ConductorIor {
    Spectrum eta, k;
};
/// Returns the index of a named conductor ("Al", "Au", "Cr", …; "none" is a perfect mirror: eta 0, k 1); nothing for an
/// unknown name.
std::optional<ConductorIor> conductor_ior(std::string_view name);
std::vector<std::string> conductor_names();

}  // namespace loom
