#include "stages/core/assets/image_decoder.h"

#include <dlfcn.h>
#include <fmt/format.h>

#include <stdexcept>

#include "formats/io/error.h"

namespace loom {
namespace {

/// Loads the module from lib/ beside bin/, in an installation or a build folder.
ImageDecoder* load_decoder() {
    const auto folder = std::filesystem::read_symlink("/proc/self/exe").parent_path();
    std::string tried;
    for (const auto& lib : {folder.parent_path() / "lib", folder / "lib"}) {
        const auto file = lib / image_decoder_module;
        void* module = ::dlopen(file.c_str(), RTLD_NOW | RTLD_LOCAL);
        void* symbol = module ? ::dlsym(module, image_decoder_symbol) : nullptr;
        if (symbol) return reinterpret_cast<ImageDecoder*>(symbol);
        tried += fmt::format("\n  {}", ::dlerror());
    }
    throw std::runtime_error("textures cannot be read; their decoder cannot be loaded:" + tried);
}

}  // namespace

DecodedImage decode_image(const std::filesystem::path& file) {
    std::error_code error;
    if (!std::filesystem::is_regular_file(file, error)) throw InputError(file.string() + ": no such file");
    static ImageDecoder* const decoder = load_decoder();
    DecodedImage image;
    const std::string problem = decoder(file.string(), image);
    if (!problem.empty()) throw InputError(fmt::format("{}: {}", file.string(), problem));
    return image;
}

}  // namespace loom
