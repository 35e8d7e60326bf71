#pragma once
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "stages/denoise/layers.h"

namespace loom::denoise {

/// Open Image Denoise [Afra2019], loaded at run time: one build serves machines with and without it.
class Oidn {
  public:
    /// Loads the library; looks, in this order, at `path` (--oidn), at the variable LOOM_OIDN, in the folder oidn/
    /// beside the one of the program (`make oidn` fills it) and where the system keeps libraries. A path is that of
    /// libOpenImageDenoise.so.2 or of its folder.
    /// out:     nothing when it is in none of these places; `missing` then says why
    /// throws:  InputError when the library of --oidn or LOOM_OIDN cannot be used
    static std::optional<Oidn> load(const std::string& path, std::string& missing);

    /// "2.5.1"
    std::string version() const;

    /// The picture without noise; albedo and, only beside it, normal are auxiliary images as they are.
    /// out:     color   [y, x] by channel
    /// throws:  std::runtime_error with the library's own words
    /// differs: the network takes no negative values: a signed picture is filtered as max(x, 0) and max(-x, 0) apart
    void denoise(const Layers& layers, int threads, std::vector<float> (&color)[3]) const;

  private:
    struct Library;
    std::shared_ptr<const Library> library_;
};

}  // namespace loom::denoise
