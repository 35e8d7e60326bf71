#include "stages/core/app/depfile.h"

#include "formats/io/output_file.h"

namespace loom::app {
namespace {

std::string escaped(const std::string& name) {
    std::string out;
    for (char c : name) {
        if (c == ' ' || c == '#') out += '\\';
        if (c == '$') out += '$';
        out += c;
    }
    return out;
}

}  // namespace

void write_depfile(const std::filesystem::path& path, std::span<const std::string> outputs,
                   std::span<const std::string> dependencies) {
    std::string text;
    for (const std::string& output : outputs) text += (text.empty() ? "" : " ") + escaped(output);
    text += ":";
    for (const std::string& file : dependencies) text += " \\\n  " + escaped(file);
    for (const std::string& file : dependencies) text += "\n" + escaped(file) + ":";
    write_text_file(path, text + "\n");
}

}  // namespace loom::app
