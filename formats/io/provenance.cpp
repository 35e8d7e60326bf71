#include "formats/io/provenance.h"

#include <map>
#include <sstream>

#include "formats/io/content_hash.h"
#include "formats/io/error.h"
#include "version.h"

namespace loom {

InputId identify(const std::filesystem::path& path) {
    return {path.filename().native(), file_content_hash(path)};
}

std::vector<InputId> identify_parts(const std::vector<std::string>& files) {
    std::vector<InputId> ids;
    std::map<std::string, std::string> name_by_hash;
    for (const std::string& file : files) {
        ids.push_back(identify(file));
        const auto [known, inserted] = name_by_hash.try_emplace(ids.back().hash, file);
        if (!inserted) throw InputError(file + ": holds the same samples as " + known->second);
    }
    return ids;
}

std::string build_release() {
    return LOOM_RELEASE;
}
std::string build_commit() {
    return LOOM_COMMIT;
}

std::string producer_text(const Provenance& provenance) {
    return provenance.stage + " " + provenance.release + " " + provenance.commit;
}

void set_producer(Provenance& provenance, const std::string& text) {
    provenance.stage = provenance.release = provenance.commit = "";
    std::istringstream words(text);
    words >> provenance.stage >> provenance.release >> provenance.commit;
}

std::string input_text(const InputId& input) {
    return input.hash + " " + input.name;
}

InputId input_from_text(const std::string& text) {
    const auto space = text.find(' ');
    if (space == std::string::npos) return {text, ""};
    return {text.substr(space + 1), text.substr(0, space)};
}

}  // namespace loom
