#pragma once
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "stages/denoise/layers.h"

namespace loom::denoise {

/// Open Image Denoise [Afra2019], loaded at run time: one build runs on machines with and without it.
class Oidn {
  public:
    /// Loads the library. It searches, in this order: `path` (--oidn), the variable LOOM_OIDN, the folder oidn/ beside
    /// the program's folder (filled by `make oidn`), and the system's library folders. A path names
    /// libOpenImageDenoise.so.2 or its folder.
    /// out:     nothing when it is in none of these places; `missing` then has the reason
    /// throws:  InputError when the library of --oidn or LOOM_OIDN cannot be used
    static std::optional<Oidn> load(const std::string& path, std::string& missing);

    /// Version of the library, for example "2.5.1".
    std::string version() const;

    /// Denoises an image. Albedo and, only together with it, normal are auxiliary images, used unfiltered.
    /// out:     color   [y, x] by channel
    /// throws:  std::runtime_error with the library's own message
    /// differs: the network takes no negative values; max(x, 0) and max(-x, 0) of a signed image are filtered
    ///          separately
    void denoise(const Layers& layers, int threads, std::vector<float> (&color)[3]) const;

  private:
    struct Library;
    std::shared_ptr<const Library> library_;
};

}  // namespace loom::denoise
