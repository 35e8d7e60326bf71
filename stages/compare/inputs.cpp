#include "stages/compare/inputs.h"

#include <fmt/format.h>

#include <filesystem>

#include "formats/image.h"
#include "formats/io/error.h"
#include "formats/io/field_checker.h"
#include "stages/core/app/values.h"

namespace loom::compare {

namespace fs = std::filesystem;

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

std::map<std::uint64_t, std::string> files_of_sequence(const std::string& pattern) {
    const std::size_t at = pattern.find('%');
    if (at == std::string::npos)
        throw InputError(fmt::format("{}: a sequence needs a % for the number of the frame", pattern));
    const fs::path folder = fs::path(pattern).parent_path();
    if (folder.string().find('%') != std::string::npos)
        throw InputError(fmt::format("{}: the % must be in the name of the file", pattern));
    const std::string name = fs::path(pattern).filename().string();
    const std::string before = name.substr(0, name.find('%')), after = name.substr(name.find('%') + 1);
    std::map<std::uint64_t, std::string> files;
    std::error_code error;
    for (const fs::directory_entry& entry : fs::directory_iterator(folder.empty() ? "." : folder, error)) {
        const std::string file = entry.path().filename().string();
        if (file.size() <= before.size() + after.size() || !file.starts_with(before) || !file.ends_with(after))
            continue;
        const std::string digits = file.substr(before.size(), file.size() - before.size() - after.size());
        if (digits.find_first_not_of("0123456789") != std::string::npos) continue;
        const auto number = app::parse_number<std::uint64_t>(digits);
        if (!number) continue;
        const auto [known, is_new] = files.try_emplace(*number, (folder / file).string());
        if (!is_new)
            throw InputError(fmt::format("{}: is the same frame as {}", (folder / file).string(), known->second));
    }
    if (files.empty()) throw InputError(fmt::format("{}: no such files", pattern));
    return files;
}

}  // namespace loom::compare
