#pragma once
// RAII handles of HDF5 identifiers, and calls shared by writer, reader and survey. HDF5 must be used by one thread at a
// time.

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
    /// Returns false when the library could not close the object (a file whose last bytes did not reach the disk).
    bool close() { return id_ < 0 || closer_(std::exchange(id_, -1)) >= 0; }

  private:
    hid_t id_ = -1;
    Closer closer_ = nullptr;
};

/// Initialises HDF5: no printed error stacks, no work at exit. Must be called before any other HDF5 call.
void start_hdf5();
/// Returns the innermost message of HDF5's error stack: "No space left on device", …
std::string hdf5_error_text();

/// Returns the type on disk. It is also the type in memory: HDF5 converts nothing.
Hdf5Handle disk_type(ElementType type);
/// Returns the type of fixed-length text, padded with zeros.
Hdf5Handle text_type(std::size_t n_bytes);
/// Describes a type as text: "float32", "text[5]", "big-endian float32", "compound".
std::string type_text(hid_t type);
/// Returns the project's element type of an HDF5 type; nothing for a foreign one.
std::optional<ElementType> known_element(hid_t type);

/// Opens a file for reading.
/// throws:  InputError saying whether the file is foreign, truncated or damaged
Hdf5Handle open_hdf5(const std::filesystem::path& path);

/// Returns the texts of a fixed- or variable-length string attribute (one for a scalar); nothing when it is absent.
std::optional<std::vector<std::string>> text_attribute(hid_t object, const char* name);
/// Returns the numbers of an integer attribute; nothing when it is absent.
std::optional<std::vector<std::uint64_t>> integer_attribute(hid_t object, const char* name);

/// Returns the extents of a dataspace.
std::vector<std::size_t> extents_of(hid_t space);
/// Splits a buffer of fixed-length strings.
std::vector<std::string> texts_from_buffer(const std::vector<char>& buffer, std::size_t n_bytes);

}  // namespace loom
