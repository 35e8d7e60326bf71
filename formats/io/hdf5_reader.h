#pragma once
#include <filesystem>
#include <memory>

#include "formats/io/field.h"
#include "formats/io/mapped_file.h"
#include "formats/io/provenance.h"

namespace loom {

/// Returns the root attribute `filetype` of an HDF5 file; empty for a file of another program, of another kind, or none.
std::string filetype_of(const std::filesystem::path& path);

/// Reads the fields of a format. It compares type, rank and width of each dataset before it reads a number. Its columns
/// borrow the mapped file.
class Hdf5Reader : public FieldVisitor<Hdf5Reader> {
  public:
    /// throws:  InputError when the file has another format or an unsupported major version
    Hdf5Reader(const std::filesystem::path& path, const FormatId& format);
    ~Hdf5Reader();

    Provenance provenance() const;
    /// Returns the memory that the columns borrow; must outlive the columns.
    std::shared_ptr<const MappedFile> storage() const { return storage_; }

    template <class T>
    void column_of(const Field& field, Column<T>& column) {
        const Found found = find(field);
        if (found.mapped != nullptr) {
            column = Column<T>::borrow({reinterpret_cast<const T*>(found.mapped), found.n_elements});
        } else {
            std::vector<T> values(found.n_elements);
            read(field, values.data(), values.size() * sizeof(T));
            column = Column<T>(std::move(values));
        }
    }
    template <class V>
    void value_of(const Field& field, V& value) {
        if constexpr (std::is_same_v<V, std::string>) {
            value = texts(field, 0).front();
        } else {
            find_value(field);
            read(field, &value, sizeof(V));
        }
    }
    void names_of(const Field& field, std::vector<std::string>& strings) { strings = texts(field, 1); }

  private:
    struct Impl;
    struct Found {
        std::size_t n_elements = 0;
        const std::byte* mapped = nullptr;  // null: copied, because the dataset is small, unaligned or filtered
    };
    Found find(const Field& field) const;
    void find_value(const Field& field) const;
    void read(const Field& field, void* to, std::size_t n_bytes) const;
    std::vector<std::string> texts(const Field& field, std::size_t rank) const;

    std::unique_ptr<Impl> impl_;
    std::shared_ptr<const MappedFile> storage_;
};

}  // namespace loom
