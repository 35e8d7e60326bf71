#include "formats/io/hdf5_reader.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cstdint>

#include "formats/io/error.h"
#include "formats/io/hdf5_handle.h"

namespace loom {

std::string filetype_of(const std::filesystem::path& path) {
    try {
        const auto filetype = text_attribute(open_hdf5(path).get(), "filetype");
        return filetype && filetype->size() == 1 ? filetype->front() : std::string();
    } catch (const InputError&) {
        return {};
    }
}

struct Hdf5Reader::Impl {
    std::filesystem::path path;
    Hdf5Handle file;

    [[noreturn]] void refuse(std::string_view what) const {
        throw InputError(fmt::format("{}: {}", path.native(), what));
    }

    void check_format(const FormatId& format) const {
        const auto filetype = text_attribute(file.get(), "filetype");
        if (!filetype || filetype->size() != 1) {
            refuse(
                fmt::format("is an HDF5 file of another program (no attribute filetype), expected a {}", format.name));
        }
        if (filetype->front() != format.name) {
            refuse(fmt::format("is a {}, expected a {}", filetype->front(), format.name));
        }
        const auto version = integer_attribute(file.get(), "version");
        if (!version || version->size() != 2) refuse("attribute version is not [major, minor]");
        if ((*version)[0] < static_cast<std::uint64_t>(format.oldest_major) ||
            (*version)[0] > static_cast<std::uint64_t>(format.major)) {
            const std::string readable = format.oldest_major < format.major
                                             ? fmt::format("{}.x to {}.x", format.oldest_major, format.major)
                                             : fmt::format("{}.x", format.major);
            refuse(fmt::format("{} version {}.{}, this build reads {}", format.name, (*version)[0], (*version)[1],
                               readable));
        }
    }

    bool exists(const std::string& name) const {
        for (auto slash = name.find('/'); slash != std::string::npos; slash = name.find('/', slash + 1)) {
            if (H5Lexists(file.get(), name.substr(0, slash).c_str(), H5P_DEFAULT) <= 0) return false;
        }
        return H5Lexists(file.get(), name.c_str(), H5P_DEFAULT) > 0;
    }

    Hdf5Handle open(const Field& field) const {
        const std::string name(field.name);
        if (!exists(name)) refuse(fmt::format("there is no dataset {}", name));
        Hdf5Handle dataset(H5Dopen2(file.get(), name.c_str(), H5P_DEFAULT), H5Dclose);
        if (!dataset) refuse(fmt::format("{}: not a dataset, or damaged", name));
        return dataset;
    }

    /// Returns the extents of a dataset after checking its type and rank.
    std::vector<std::size_t> checked_extents(const Field& field, hid_t dataset, std::size_t rank) const {
        const Hdf5Handle type(H5Dget_type(dataset), H5Tclose);
        const Hdf5Handle space(H5Dget_space(dataset), H5Sclose);
        if (known_element(type.get()) != field.type) {
            refuse(fmt::format("{}: type is {}, expected {}", field.name, type_text(type.get()),
                               element_name(field.type)));
        }
        if (H5Sget_simple_extent_type(space.get()) == H5S_NULL) refuse(fmt::format("{}: has no extent", field.name));
        auto extents = extents_of(space.get());
        if (extents.size() != rank) {
            refuse(fmt::format("{}: rank is {}, expected {}", field.name, extents.size(), rank));
        }
        return extents;
    }
};

Hdf5Reader::Hdf5Reader(const std::filesystem::path& path, const FormatId& format)
    : impl_(std::make_unique<Impl>(Impl{path, open_hdf5(path)})) {
    impl_->check_format(format);
    storage_ = std::make_shared<const MappedFile>(path);
}

Hdf5Reader::~Hdf5Reader() = default;

Provenance Hdf5Reader::provenance() const {
    const auto text = [&](const char* name) {
        const auto found = text_attribute(impl_->file.get(), name);
        if (!found || found->size() != 1) impl_->refuse(fmt::format("there is no text attribute {}", name));
        return found->front();
    };
    Provenance provenance;
    set_producer(provenance, text("producer"));
    provenance.command = text("command");
    provenance.plan = text("plan");
    const auto seed = integer_attribute(impl_->file.get(), "seed");
    const auto inputs = text_attribute(impl_->file.get(), "inputs");
    if (!seed || seed->size() != 1) impl_->refuse("there is no integer attribute seed");
    if (!inputs) impl_->refuse("there is no text attribute inputs");
    provenance.seed = seed->front();
    for (const auto& input : *inputs) provenance.inputs.push_back(input_from_text(input));
    return provenance;
}

Hdf5Reader::Found Hdf5Reader::find(const Field& field) const {
    if (field.presence == Presence::optional && !impl_->exists(std::string(field.name))) return {};
    const Hdf5Handle dataset = impl_->open(field);
    const auto extents = impl_->checked_extents(field, dataset.get(), field.row_shape.size() + 1);
    const std::vector<std::size_t> row_shape(extents.begin() + 1, extents.end());
    if (row_shape != field.row_shape) {
        impl_->refuse(fmt::format("{}: width is {}, expected {}", field.name, fmt::join(row_shape, " x "),
                                  fmt::join(field.row_shape, " x ")));
    }
    const std::size_t element_bytes = element_size(field.type);
    const std::size_t n_elements = extents[0] * field.row_size();
    if (extents[0] != 0 && n_elements / extents[0] != field.row_size()) {
        impl_->refuse(fmt::format("{}: impossible length {}", field.name, extents[0]));
    }
    const Hdf5Handle creation(H5Dget_create_plist(dataset.get()), H5Pclose);
    if (n_elements == 0 || H5Pget_layout(creation.get()) != H5D_CONTIGUOUS) return {n_elements, nullptr};
    const haddr_t offset = H5Dget_offset(dataset.get());
    if (offset == HADDR_UNDEF) impl_->refuse(fmt::format("{}: was never written", field.name));
    const auto bytes = storage_->bytes();
    if (offset > bytes.size() || n_elements > (bytes.size() - offset) / element_bytes) {
        impl_->refuse(fmt::format("{}: the file ends before the data of this dataset", field.name));
    }
    const std::byte* mapped = bytes.data() + offset;
    const bool aligned = reinterpret_cast<std::uintptr_t>(mapped) % element_bytes == 0;
    return {n_elements, aligned ? mapped : nullptr};
}

void Hdf5Reader::find_value(const Field& field) const {
    const Hdf5Handle dataset = impl_->open(field);
    const auto extents = impl_->checked_extents(field, dataset.get(), field.row_shape.size());
    if (extents != field.row_shape) {
        impl_->refuse(fmt::format("{}: shape is {}, expected {}", field.name, fmt::join(extents, " x "),
                                  fmt::join(field.row_shape, " x ")));
    }
}

void Hdf5Reader::read(const Field& field, void* to, std::size_t n_bytes) const {
    if (n_bytes == 0) return;
    const Hdf5Handle dataset = impl_->open(field);
    if (H5Dread(dataset.get(), disk_type(field.type).get(), H5S_ALL, H5S_ALL, H5P_DEFAULT, to) < 0) {
        impl_->refuse(fmt::format("{}: cannot read: {}", field.name, hdf5_error_text()));
    }
}

std::vector<std::string> Hdf5Reader::texts(const Field& field, std::size_t rank) const {
    if (field.presence == Presence::optional && !impl_->exists(std::string(field.name))) return {};
    const Hdf5Handle dataset = impl_->open(field);
    const auto extents = impl_->checked_extents(field, dataset.get(), rank);
    const std::size_t n = rank == 0 ? 1 : extents[0];
    const Hdf5Handle type(H5Dget_type(dataset.get()), H5Tclose);
    const std::size_t n_bytes = H5Tget_size(type.get());
    if (n > storage_->bytes().size() || n_bytes > storage_->bytes().size()) {
        impl_->refuse(fmt::format("{}: impossible length {} x {}", field.name, n, n_bytes));
    }
    std::vector<char> buffer(n * n_bytes);
    if (n > 0 && H5Dread(dataset.get(), type.get(), H5S_ALL, H5S_ALL, H5P_DEFAULT, buffer.data()) < 0) {
        impl_->refuse(fmt::format("{}: cannot read: {}", field.name, hdf5_error_text()));
    }
    return texts_from_buffer(buffer, n_bytes);
}

}  // namespace loom
