#pragma once
// HDF5 identifiers that close themselves, and the few calls that writer, reader and survey share.
// HDF5 is used by one thread at a time.

#include <hdf5.h>

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "formats/io/field.h"

namespace loom {

class Hdf5Handle {
  public:
    using Closer = herr_t (*)(hid_t);

    Hdf5Handle() = default;
    Hdf5Handle(hid_t id, Closer closer) : id_(id), closer_(closer) {}
    Hdf5Handle(Hdf5Handle&& other) noexcept : id_(std::exchange(other.id_, -1)), closer_(other.closer_) {}
    Hdf5Handle& operator=(Hdf5Handle&& other) noexcept {
        close();
        id_ = std::exchange(other.id_, -1);
        closer_ = other.closer_;
        return *this;
    }
    ~Hdf5Handle() { close(); }

    hid_t get() const { return id_; }
    explicit operator bool() const { return id_ >= 0; }
    /// False when the library could not close it (a file whose last bytes did not reach the disk).
    bool close() { return id_ < 0 || closer_(std::exchange(id_, -1)) >= 0; }

  private:
    hid_t id_ = -1;
    Closer closer_ = nullptr;
};

/// Before any other call: HDF5 prints no error stack of its own and does nothing at exit.
void start_hdf5();
/// The innermost message of HDF5's error stack: "No space left on device", …
std::string hdf5_error_text();

/// The type on disk, which is also the type in memory: nothing is converted inside HDF5.
Hdf5Handle disk_type(ElementType type);
/// Fixed-length text, padded with zeros.
Hdf5Handle text_type(std::size_t n_bytes);
/// A type in words: "float32", "text[5]", "big-endian float32", "compound".
std::string type_text(hid_t type);
/// Which of our element types this is; nothing for a foreign one.
std::optional<ElementType> known_element(hid_t type);

/// Opens for reading; says whether a file is foreign, cut short or damaged.
/// throws:  InputError
Hdf5Handle open_hdf5(const std::filesystem::path& path);

/// Texts of a fixed- or variable-length string attribute (one for a scalar); nothing when there is none.
std::optional<std::vector<std::string>> text_attribute(hid_t object, const char* name);
/// Numbers of an integer attribute.
std::optional<std::vector<std::uint64_t>> integer_attribute(hid_t object, const char* name);

/// Extents of a dataset or attribute space.
std::vector<std::size_t> extents_of(hid_t space);
/// Texts in a buffer of fixed-length strings.
std::vector<std::string> texts_from_buffer(const std::vector<char>& buffer, std::size_t n_bytes);

}  // namespace loom
