#include <OpenEXR/ImfBoxAttribute.h>
#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfCompressionAttribute.h>
#include <OpenEXR/ImfFloatAttribute.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfIO.h>
#include <OpenEXR/ImfInputFile.h>
#include <OpenEXR/ImfIntAttribute.h>
#include <OpenEXR/ImfOutputFile.h>
#include <OpenEXR/ImfPartType.h>
#include <OpenEXR/ImfStringAttribute.h>
#include <fmt/format.h>

#include <cerrno>
#include <charconv>
#include <cstdio>
#include <cstring>
#include <stdexcept>

#include "formats/image.h"
#include "formats/io/error.h"
#include "formats/io/field_checker.h"
#include "formats/io/mapped_file.h"

namespace loom {
namespace {

// A header may claim any size. An image above this many bytes is accepted only if compression could explain the size of
// its file.
constexpr std::size_t unquestioned_bytes = std::size_t{1} << 30;
constexpr std::size_t believable_ratio = 4096;

std::string joined_inputs(const Provenance& provenance) {
    std::string text;
    for (const auto& input : provenance.inputs) text += input_text(input) + "\n";
    return text;
}

std::string text_of(const Imf::Header& header, const char* name) {
    const auto* attribute = header.findTypedAttribute<Imf::StringAttribute>(name);
    return attribute == nullptr ? std::string() : attribute->value();
}

std::uint64_t number_of(const Imf::Header& header, const char* name, const std::filesystem::path& path) {
    const std::string text = text_of(header, name);
    std::uint64_t number = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    if (!text.empty() && (error != std::errc{} || end != text.data() + text.size())) {
        throw InputError(fmt::format("{}: header attribute {} is \"{}\", not a number", path.native(), name, text));
    }
    return number;
}

void write_header(Imf::Header& header, const Image& image) {
    const auto text = [&](const char* name, const std::string& value) {
        header.insert(name, Imf::StringAttribute(value));
    };
    text("filetype", std::string(Image::format.name));
    text("version", fmt::format("{}.{}", Image::format.major, Image::format.minor));
    text("producer", producer_text(image.provenance));
    text("command", image.provenance.command);
    text("seed", std::to_string(image.provenance.seed));
    text("inputs", joined_inputs(image.provenance));
    text("plan", image.provenance.plan);
    text("samples", std::to_string(image.samples));
    if (!image.scene.hash.empty()) text("scene", input_text(image.scene));
    if (!image.ledger.empty()) text("ledger", ledger_text(image.ledger));
}

void read_header(const Imf::Header& header, const std::filesystem::path& path, Image& image) {
    image.filetype = text_of(header, "filetype");
    if (image.filetype == Image::format.name) {
        const std::string version = text_of(header, "version");
        if (!version.starts_with(fmt::format("{}.", Image::format.major))) {
            throw InputError(fmt::format("{}: image version {}, this build reads {}.x", path.native(), version,
                                         Image::format.major));
        }
    }
    image.samples = number_of(header, "samples", path);
    image.provenance.seed = number_of(header, "seed", path);
    set_producer(image.provenance, text_of(header, "producer"));
    image.provenance.command = text_of(header, "command");
    image.provenance.plan = text_of(header, "plan");
    const std::string inputs = text_of(header, "inputs");
    for (std::size_t at = 0, end; (end = inputs.find('\n', at)) != std::string::npos; at = end + 1) {
        image.provenance.inputs.push_back(input_from_text(inputs.substr(at, end - at)));
    }
    if (image.filetype != Image::format.name) return;  // in files of other programs these names have other meanings
    image.scene = input_from_text(text_of(header, "scene"));
    image.ledger = ledger_from_text(text_of(header, "ledger"), path);
}

/// Returns width and height of the data window, if a file of this size can hold it.
void check_size(const Imath::Box2i& window, std::size_t n_channels, const std::filesystem::path& path, Image& image) {
    const std::int64_t width = std::int64_t{window.max.x} - window.min.x + 1;
    const std::int64_t height = std::int64_t{window.max.y} - window.min.y + 1;
    const auto refuse = [&] {
        throw InputError(fmt::format("{}: impossible size {} x {} with {} channels in a file of {} bytes",
                                     path.native(), width, height, n_channels, std::filesystem::file_size(path)));
    };
    if (width < 1 || height < 1 || width > (1 << 20) || height > (1 << 20)) refuse();
    const std::size_t bytes = static_cast<std::size_t>(width * height) * n_channels * sizeof(float);
    if (bytes > unquestioned_bytes && bytes / believable_ratio > std::filesystem::file_size(path)) refuse();
    image.width = static_cast<std::uint32_t>(width);
    image.height = static_cast<std::uint32_t>(height);
}

Image read_exr(const std::filesystem::path& path, bool needs_rgb) {
    Imf::InputFile file(path.c_str());
    const Imf::Header& header = file.header();
    if (header.hasType() && !Imf::isImage(header.type())) {
        throw InputError(fmt::format("{}: is a deep EXR, expected a flat one", path.native()));
    }
    Image image;
    read_header(header, path, image);
    std::string names;
    std::size_t n_channels = 0;
    for (auto c = header.channels().begin(); c != header.channels().end(); ++c, ++n_channels) {
        names += fmt::format("{}{}", n_channels == 0 ? "" : ", ", c.name());
        if (c.channel().xSampling != 1 || c.channel().ySampling != 1) {
            throw InputError(
                fmt::format("{}: channel {} is subsampled, expected one value per pixel", path.native(), c.name()));
        }
    }
    for (const char* name : {"R", "G", "B"}) {
        if (needs_rgb && header.channels().findChannel(name) == nullptr) {
            throw InputError(fmt::format("{}: there is no channel {} (it has {})", path.native(), name, names));
        }
    }
    if (!file.isComplete()) throw InputError(fmt::format("{}: the EXR file is cut short", path.native()));
    const Imath::Box2i& window = header.dataWindow();
    check_size(window, n_channels, path, image);

    Imf::FrameBuffer frame;
    image.channels.reserve(n_channels);  // slices point into the channels
    for (auto c = header.channels().begin(); c != header.channels().end(); ++c) {
        image.add(c.name());
        frame.insert(c.name(), Imf::Slice::Make(Imf::FLOAT, image.channels.back().values.data(), window, sizeof(float),
                                                sizeof(float) * image.width));
    }
    file.setFrameBuffer(frame);
    file.readPixels(window.min.y, window.max.y);
    return image;
}

/// Runs a reader and converts OpenEXR's exceptions to an InputError that names the file.
template <class Body>
auto as_input(const std::filesystem::path& path, Body body) {
    require_readable(path);
    try {
        return body();
    } catch (const InputError&) {
        throw;
    } catch (const std::exception& error) {
        throw InputError(fmt::format("{}: is not a whole EXR file: {}", path.native(), error.what()));
    }
}

/// OpenEXR writes its last bytes in a destructor, which reports no failure; close() does.
class ExrStream : public Imf::OStream {
  public:
    explicit ExrStream(const OutputFile& output) : Imf::OStream(output.path().c_str()), stream_(output) {}
    void write(const char bytes[], int n) override { stream_.write(bytes, static_cast<std::size_t>(n)); }
    std::uint64_t tellp() override { return static_cast<std::uint64_t>(::ftello(stream_.get())); }
    void seekp(std::uint64_t at) override {
        if (::fseeko(stream_.get(), static_cast<off_t>(at), SEEK_SET) != 0)
            throw std::runtime_error(std::strerror(errno));
    }
    void close() { stream_.close(); }

  private:
    OutputStream stream_;
};

std::string nonfinite_text(const Image& image) {
    std::string text;
    for (const auto& channel : image.channels) {
        const std::size_t first = first_nonfinite(channel.values);
        if (first == channel.values.size()) continue;
        text += fmt::format("{}{} of {}, the first in pixel ({}, {})", text.empty() ? "" : "; ",
                            count_nonfinite(channel.values), channel.name, first % image.width, first / image.width);
    }
    return text;
}

}  // namespace

void write_image(const Image& image, const std::filesystem::path& path, Compression compression, Sync sync) {
    for (const char* name : {"R", "G", "B"}) {
        if (image.find(name).empty()) throw std::logic_error(fmt::format("{}: no channel {}", path.native(), name));
    }
    Imf::Header header(static_cast<int>(image.width), static_cast<int>(image.height));
    header.compression() = compression == Compression::zip ? Imf::ZIP_COMPRESSION : Imf::NO_COMPRESSION;
    write_header(header, image);
    Imf::FrameBuffer frame;
    for (const auto& channel : image.channels) {
        if (channel.values.size() != image.n_pixels()) {
            throw std::logic_error(fmt::format("{}: channel {} has {} values for {} pixels", path.native(),
                                               channel.name, channel.values.size(), image.n_pixels()));
        }
        header.channels().insert(channel.name, Imf::Channel(Imf::FLOAT));
        // The library has one type of slice for reading and writing; it does not write to this one.
        frame.insert(channel.name, Imf::Slice::Make(Imf::FLOAT, const_cast<float*>(channel.values.data()),
                                                    header.dataWindow(), sizeof(float), sizeof(float) * image.width));
    }
    OutputFile output(path);
    ExrStream stream(output);
    {
        Imf::OutputFile file(stream, header);
        file.setFrameBuffer(frame);
        file.writePixels(static_cast<int>(image.height));
    }
    stream.close();
    output.commit(sync, nonfinite_text(image));
}

Image read_image(const std::filesystem::path& path) {
    return as_input(path, [&] { return read_exr(path, true); });
}

Image read_any_exr(const std::filesystem::path& path) {
    return as_input(path, [&] { return read_exr(path, false); });
}

std::vector<std::pair<std::string, std::string>> exr_attributes(const std::filesystem::path& path) {
    return as_input(path, [&] {
        const Imf::InputFile file(path.c_str());
        std::vector<std::pair<std::string, std::string>> texts;
        for (auto a = file.header().begin(); a != file.header().end(); ++a) {
            const Imf::Attribute& attribute = a.attribute();
            if (const auto* text = dynamic_cast<const Imf::StringAttribute*>(&attribute)) {
                texts.emplace_back(a.name(), text->value());
            } else if (const auto* real = dynamic_cast<const Imf::FloatAttribute*>(&attribute)) {
                texts.emplace_back(a.name(), fmt::format("{}", real->value()));
            } else if (const auto* whole = dynamic_cast<const Imf::IntAttribute*>(&attribute)) {
                texts.emplace_back(a.name(), fmt::format("{}", whole->value()));
            } else if (const auto* box = dynamic_cast<const Imf::Box2iAttribute*>(&attribute)) {
                const Imath::Box2i& b = box->value();
                texts.emplace_back(a.name(), fmt::format("x {} to {}, y {} to {}", b.min.x, b.max.x, b.min.y, b.max.y));
            } else if (const auto* packing = dynamic_cast<const Imf::CompressionAttribute*>(&attribute)) {
                texts.emplace_back(a.name(), packing->value() == Imf::NO_COMPRESSION
                                                 ? "none"
                                                 : fmt::format("kind {}", static_cast<int>(packing->value())));
            }
        }
        return texts;
    });
}

}  // namespace loom
