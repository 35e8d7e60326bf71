#include "formats/io/hdf5_writer.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <map>
#include <mutex>
#include <utility>

#include "formats/io/field_checker.h"
#include "formats/io/hdf5_handle.h"

namespace loom {
namespace {

constexpr hsize_t page_bytes = 4096;
constexpr hsize_t aligned_from_bytes = 65536;
/// Bytes after which writeback to the device is started, so that the final sync has little left.
constexpr off_t writeback_bytes = 32 << 20;
/// Size of a block that is checked, then written while it is cached.
constexpr std::size_t block_bytes = 256 << 10;

/// Makes property lists without times, so that two equal runs give equal bytes.
Hdf5Handle timeless(hid_t property_class) {
    Hdf5Handle list(H5Pcreate(property_class), H5Pclose);
    H5Pset_obj_track_times(list.get(), false);
    return list;
}

Hdf5Handle space_of(const std::vector<std::size_t>& extents) {
    if (extents.empty()) return {H5Screate(H5S_SCALAR), H5Sclose};
    const std::vector<hsize_t> dims(extents.begin(), extents.end());
    return {H5Screate_simple(static_cast<int>(dims.size()), dims.data(), nullptr), H5Sclose};
}

/// Converts texts to fixed-length strings as long as the longest, padded with zeros.
std::vector<char> buffer_from_texts(std::span<const std::string> texts, std::size_t& n_bytes) {
    n_bytes = 1;
    for (const auto& text : texts) n_bytes = std::max(n_bytes, text.size());
    std::vector<char> buffer(n_bytes * texts.size(), '\0');
    for (std::size_t i = 0; i < texts.size(); ++i) std::memcpy(&buffer[i * n_bytes], texts[i].data(), texts[i].size());
    return buffer;
}

bool write_at(int fd, std::span<const std::byte> bytes, off_t at) {
    while (!bytes.empty()) {
        const ssize_t n = ::pwrite(fd, bytes.data(), bytes.size(), at);
        if (n < 0 && errno == EINTR) continue;
        if (n <= 0) return false;
        bytes = bytes.subspan(static_cast<std::size_t>(n));
        at += n;
    }
    return true;
}

}  // namespace

struct Hdf5Writer::Impl {
    explicit Impl(const std::filesystem::path& path) : output(path) {}

    [[noreturn]] void fail(std::string_view what, const std::string& why = hdf5_error_text()) const {
        throw std::runtime_error(fmt::format("{}: cannot write {}: {}", output.path().native(), what, why));
    }

    void attribute(hid_t object, const char* name, hid_t type, const std::vector<std::size_t>& extents,
                   const void* data) const {
        const Hdf5Handle space = space_of(extents);
        const Hdf5Handle made(H5Acreate2(object, name, type, space.get(), H5P_DEFAULT, H5P_DEFAULT), H5Aclose);
        const bool empty = !extents.empty() && extents[0] == 0;
        if (!made || (!empty && H5Awrite(made.get(), type, data) < 0)) fail(fmt::format("attribute {}", name));
    }
    void text(hid_t object, const char* name, std::string_view value) const {
        const std::string text(value);
        std::size_t n_bytes = 0;
        const auto buffer = buffer_from_texts({&text, 1}, n_bytes);
        attribute(object, name, text_type(n_bytes).get(), {}, buffer.data());
    }

    void make_groups(const std::string& dataset) {
        for (auto slash = dataset.find('/'); slash != std::string::npos; slash = dataset.find('/', slash + 1)) {
            const std::string group = dataset.substr(0, slash);
            if (H5Lexists(file.get(), group.c_str(), H5P_DEFAULT) > 0) continue;
            const Hdf5Handle made(
                H5Gcreate2(file.get(), group.c_str(), H5P_DEFAULT, timeless(H5P_GROUP_CREATE).get(), H5P_DEFAULT),
                H5Gclose);
            if (!made) fail(group);
        }
    }

    Hdf5Handle make_dataset(const Field& field, const std::vector<std::size_t>& extents, hid_t type) {
        const std::string name(field.name);
        make_groups(name);
        const Hdf5Handle creation = timeless(H5P_DATASET_CREATE);
        H5Pset_layout(creation.get(), H5D_CONTIGUOUS);
        H5Pset_fill_time(creation.get(), H5D_FILL_TIME_NEVER);
        const Hdf5Handle space = space_of(extents);
        Hdf5Handle made(
            H5Dcreate2(file.get(), name.c_str(), type, space.get(), H5P_DEFAULT, creation.get(), H5P_DEFAULT),
            H5Dclose);
        if (!made) fail(name);
        text(made.get(), "units", field.units);
        text(made.get(), "axes", field.axes);
        text(made.get(), "description", field.text);
        return made;
    }

    void dataset(const Field& field, const std::vector<std::size_t>& extents, hid_t type, const void* data) {
        const Hdf5Handle made = make_dataset(field, extents, type);
        const bool empty = !extents.empty() && extents[0] == 0;
        if (!empty && H5Dwrite(made.get(), type, H5S_ALL, H5S_ALL, H5P_DEFAULT, data) < 0) fail(field.name);
    }

    /// Makes a dataset without its data. Writing one zero makes the library allocate the whole dataset after the
    /// attributes. (Early allocation would too, but it is recorded in the file and moves its parts.)
    void reserve(const Field& field, const std::vector<std::size_t>& extents, hid_t type, Pieces pieces) {
        const Hdf5Handle made = make_dataset(field, extents, type);
        if (extents[0] == 0) return;
        const Hdf5Handle space = space_of(extents), one = space_of({});
        const std::vector<hsize_t> start(extents.size(), 0), count(extents.size(), 1);
        const std::uint64_t zero = 0;
        if (H5Sselect_hyperslab(space.get(), H5S_SELECT_SET, start.data(), nullptr, count.data(), nullptr) < 0 ||
            H5Dwrite(made.get(), type, one.get(), space.get(), H5P_DEFAULT, &zero) < 0)
            fail(field.name);
        const haddr_t offset = H5Dget_offset(made.get());
        if (offset == HADDR_UNDEF) fail(field.name);
        reserved.push_back({std::string(field.name), field.type, offset, std::move(pieces)});
    }

    /// Ends the structure of the file; from here on only the bytes of reserved datasets are written.
    void close_structure() {
        if (fd >= 0) return;
        if (H5Fflush(file.get(), H5F_SCOPE_LOCAL) < 0 || !file.close()) fail("the file");
        fd = ::open(output.partial().c_str(), O_WRONLY | O_CLOEXEC);
        if (fd < 0) fail("the file", std::strerror(errno));
    }

    /// Fills the reserved datasets whose pieces are registered, in the order of their offsets.
    void fill_reserved(Sync sync) {
        bool good = true;
        for (auto r = reserved.begin(); good && r != reserved.end(); ++r) {
            off_t at = static_cast<off_t>(r->offset), kicked = at;
            for (const std::span<const std::byte> piece : r->pieces) {
                for (std::size_t begin = 0; good && begin < piece.size(); begin += block_bytes) {
                    const auto block = piece.subspan(begin, std::min(block_bytes, piece.size() - begin));
                    good = write_counted(*r, block, at);
                    at += static_cast<off_t>(block.size());
                }
                if (sync == Sync::yes && at - kicked >= writeback_bytes) {
                    ::sync_file_range(fd, kicked, at - kicked, SYNC_FILE_RANGE_WRITE);
                    kicked = at;
                }
            }
        }
        const int error = errno;
        if (::close(std::exchange(fd, -1)) != 0 && good) fail("the file", std::strerror(errno));
        if (!good) fail("the file", std::strerror(error));
    }

    struct Reserved {
        std::string name;
        ElementType type;
        haddr_t offset;
        Pieces pieces;
    };

    /// Writes bytes and counts their non-finite values. Thread-safe.
    bool write_counted(const Reserved& r, std::span<const std::byte> bytes, off_t at) {
        count(r.name, r.type, bytes);
        return write_at(fd, bytes, at);
    }
    void count(const std::string& name, ElementType type, std::span<const std::byte> bytes) {
        const std::size_t n = count_nonfinite(type, bytes);
        if (n == 0) return;
        const std::lock_guard lock(mutex);
        nonfinite[name] += n;
    }
    std::string nonfinite_text() const {
        std::string text;
        for (const auto& [name, n] : nonfinite) text += fmt::format("{}{} of {}", text.empty() ? "" : ", ", n, name);
        return text;
    }

    std::vector<Reserved> reserved;
    std::map<std::string, std::size_t> nonfinite;  // [dataset] number of values
    std::mutex mutex;                              // guards nonfinite
    OutputFile output;
    Hdf5Handle file;
    int fd = -1;  // of the file, once its structure is complete

    ~Impl() {
        if (fd >= 0) ::close(fd);
    }
};

Hdf5Writer::Hdf5Writer(const std::filesystem::path& path, const FormatId& format, const Provenance& provenance)
    : impl_(std::make_unique<Impl>(path)) {
    start_hdf5();
    const Hdf5Handle creation = timeless(H5P_FILE_CREATE);
    const Hdf5Handle access(H5Pcreate(H5P_FILE_ACCESS), H5Pclose);
    // Checksummed metadata, in one version of the format with any library version.
    H5Pset_libver_bounds(access.get(), H5F_LIBVER_V110, H5F_LIBVER_V110);
    H5Pset_alignment(access.get(), aligned_from_bytes, page_bytes);
    H5Pset_file_locking(access.get(), false, true);
    impl_->file =
        Hdf5Handle(H5Fcreate(impl_->output.partial().c_str(), H5F_ACC_TRUNC, creation.get(), access.get()), H5Fclose);
    if (!impl_->file) impl_->fail("the file");

    const hid_t root = impl_->file.get();
    impl_->text(root, "filetype", format.name);
    const std::int32_t version[] = {format.major, format.minor};
    impl_->attribute(root, "version", disk_type(ElementType::int32).get(), {2}, version);
    impl_->text(root, "producer", producer_text(provenance));
    impl_->text(root, "command", provenance.command);
    impl_->attribute(root, "seed", disk_type(ElementType::uint64).get(), {}, &provenance.seed);
    std::vector<std::string> inputs;
    for (const auto& input : provenance.inputs) inputs.push_back(input_text(input));
    std::size_t n_bytes = 0;
    const auto buffer = buffer_from_texts(inputs, n_bytes);
    impl_->attribute(root, "inputs", text_type(n_bytes).get(), {inputs.size()}, buffer.data());
    impl_->text(root, "plan", provenance.plan);
}

Hdf5Writer::~Hdf5Writer() = default;

void Hdf5Writer::commit(Sync sync) {
    impl_->close_structure();
    impl_->fill_reserved(sync);
    impl_->output.commit(sync, impl_->nonfinite_text());
}

void Hdf5Writer::write(const Field& field, const std::vector<std::size_t>& extents, std::span<const std::byte> data) {
    impl_->count(std::string(field.name), field.type, data);
    impl_->dataset(field, extents, disk_type(field.type).get(), data.data());
}

void Hdf5Writer::fill_bytes(std::string_view name, std::size_t first, std::span<const std::byte> bytes) {
    impl_->close_structure();
    for (const Impl::Reserved& r : impl_->reserved)
        if (r.name == name && !impl_->write_counted(r, bytes, static_cast<off_t>(r.offset + first)))
            impl_->fail(name, std::strerror(errno));
}

void Hdf5Writer::reserve(const Field& field, const std::vector<std::size_t>& extents, Pieces pieces) {
    impl_->reserve(field, extents, disk_type(field.type).get(), std::move(pieces));
}

void Hdf5Writer::write_texts(const Field& field, const std::vector<std::size_t>& extents,
                             std::span<const std::string> texts) {
    std::size_t n_bytes = 0;
    const auto buffer = buffer_from_texts(texts, n_bytes);
    impl_->dataset(field, extents, text_type(n_bytes).get(), buffer.data());
}

}  // namespace loom
