#pragma once
#include <filesystem>
#include <memory>
#include <span>

#include "formats/io/field.h"
#include "formats/io/output_file.h"
#include "formats/io/provenance.h"

namespace loom {

/// Writes the fields of a format as contiguous datasets of exact extent, without filters. Datasets are page-aligned so
/// that readers can map them; each has `units`, `axes`, `description`. Equal fields give equal bytes.
class Hdf5Writer : public FieldVisitor<Hdf5Writer> {
  public:
    Hdf5Writer(const std::filesystem::path& path, const FormatId& format, const Provenance& provenance);
    ~Hdf5Writer();
    /// Writes elements of a LateColumn from element `first` on, immediately and in any order. All fields must be
    /// declared before.
    template <class T>
    void fill(std::string_view name, std::size_t first, std::span<const T> values) {
        fill_bytes(name, first * sizeof(T), std::as_bytes(values));
    }
    /// Syncs the file and renames it to its final name. Without commit() no file remains.
    /// throws:  NonfiniteError when a float of a dataset is NaN or infinite
    void commit(Sync sync);

    /// Registers a column. Its memory MUST stay valid until commit(), which writes it.
    template <class C>
    void column_of(const Field& field, const C& column) {
        if (field.presence == Presence::optional && column.empty()) return;
        std::vector<std::size_t> extents = field.row_shape;
        extents.insert(extents.begin(), column.size() / field.row_size());
        Pieces pieces;
        for (const auto piece : column.pieces()) pieces.push_back(std::as_bytes(piece));
        reserve(field, extents, std::move(pieces));
    }
    template <class V>
    void value_of(const Field& field, const V& value) {
        if constexpr (std::is_same_v<V, std::string>)
            write_texts(field, {}, {&value, 1});
        else
            write(field, field.row_shape, std::as_bytes(std::span(&value, 1)));
    }
    void names_of(const Field& field, const std::vector<std::string>& texts) {
        if (field.presence == Presence::optional && texts.empty()) return;
        write_texts(field, {texts.size()}, texts);
    }

  private:
    using Pieces = std::vector<std::span<const std::byte>>;
    struct Impl;
    void fill_bytes(std::string_view name, std::size_t first, std::span<const std::byte> bytes);
    void reserve(const Field& field, const std::vector<std::size_t>& extents, Pieces pieces);
    void write(const Field& field, const std::vector<std::size_t>& extents, std::span<const std::byte> data);
    void write_texts(const Field& field, const std::vector<std::size_t>& extents, std::span<const std::string> texts);
    std::unique_ptr<Impl> impl_;
};

}  // namespace loom
