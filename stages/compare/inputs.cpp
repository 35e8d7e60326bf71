#include "stages/compare/inputs.h"

#include <fmt/format.h>

#include "formats/image.h"
#include "formats/io/error.h"
#include "formats/io/field_checker.h"
#include "stages/core/app/values.h"

namespace loom::compare {

std::vector<Input> inputs_of(const std::vector<std::string>& texts) {
    std::vector<Input> inputs;
    for (const std::string& text : texts) {
        const auto [label, file] = app::split_label(text);
        inputs.push_back({label.empty() ? file : label, file});
        if (inputs.back().label.find_first_of("\t\n") != std::string::npos)
            throw InputError(fmt::format("'{}': a label must not hold tabs or line ends", text));
    }
    return inputs;
}

NoisyImage read_noisy_image(const std::string& file) {
    const Image image = read_image(file);
    if (image.n_pixels() == 0) throw InputError(fmt::format("{}: has no pixels", file));
    require_finite(image, {""}, file);
    NoisyImage out{image.width, image.height, image.samples, image.interleaved(""), {}};
    // One sample has no variance estimate, even if the layer has values.
    if (!image.find("VarMean.R").empty() && image.samples != 1) {
        require_finite(image, {"VarMean"}, file);
        out.var_mean = image.interleaved("VarMean");
    }
    return out;
}

}  // namespace loom::compare
