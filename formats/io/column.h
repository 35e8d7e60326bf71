#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <span>
#include <utility>
#include <vector>

namespace loom {

/// One array of a format. It owns its memory or borrows it from a mapped file or an arena. Rows of several numbers are
/// contiguous. An absent optional column is empty.
template <class T>
class Column {
  public:
    using Element = T;

    Column() = default;
    Column(std::vector<T> values) : owned_(std::move(values)), view_(owned_) {}
    Column(std::initializer_list<T> values) : Column(std::vector<T>(values)) {}
    Column(Column&& other) noexcept
        : owned_(std::move(other.owned_)), view_(std::exchange(other.view_, std::span<const T>{})) {}
    Column& operator=(Column&& other) noexcept {
        owned_ = std::move(other.owned_);
        view_ = std::exchange(other.view_, std::span<const T>{});
        return *this;
    }

    /// Makes a column over memory that must outlive it.
    static Column borrow(std::span<const T> values) {
        Column column;
        column.view_ = values;
        return column;
    }

    std::span<const T> values() const { return view_; }
    /// Returns the whole column as one piece (the interface of PiecedColumn).
    std::array<std::span<const T>, 1> pieces() const { return {view_}; }
    operator std::span<const T>() const { return view_; }
    const T* data() const { return view_.data(); }
    std::size_t size() const { return view_.size(); }
    bool empty() const { return view_.empty(); }
    const T& operator[](std::size_t i) const { return view_[i]; }
    auto begin() const { return view_.begin(); }
    auto end() const { return view_.end(); }
    /// Returns row i of a column of the given width.
    std::span<const T> row(std::size_t i, std::size_t width) const { return view_.subspan(i * width, width); }

  private:
    std::vector<T> owned_;
    std::span<const T> view_;
};

/// One short array that is copied with the header that holds it.
template <class T>
class CopiedColumn : public Column<T> {
  public:
    using Column<T>::Column;
    CopiedColumn(const CopiedColumn& other) : Column<T>(std::vector<T>(other.begin(), other.end())) {}
    CopiedColumn(CopiedColumn&&) noexcept = default;
    CopiedColumn& operator=(CopiedColumn other) noexcept {
        Column<T>::operator=(std::move(other));
        return *this;
    }
};

/// One array of known length that is filled at its final address; empty when it is not wanted.
template <class T>
struct PlacedColumn {
    using Element = T;
    bool wanted = true;
    std::span<T> values;

    /// Stores row `row`; the column's width is the count of the arguments.
    template <class... Numbers>
    void put(std::size_t row, Numbers... numbers) const {
        if (!wanted) return;
        T* at = values.data() + row * sizeof...(numbers);
        ((*at++ = numbers), ...);
    }
    template <std::size_t width>
    void put(std::size_t row, const std::array<T, width>& numbers) const {
        if (wanted) std::copy(numbers.begin(), numbers.end(), values.data() + row * width);
    }
};

/// One array of known length whose elements are written to the file in parts, by Hdf5Writer::fill().
template <class T>
class LateColumn {
  public:
    using Element = T;

    LateColumn() = default;
    explicit LateColumn(std::size_t size) : size_(size) {}
    std::array<std::span<const T>, 0> pieces() const { return {}; }
    std::size_t size() const { return size_; }
    bool empty() const { return size_ == 0; }

  private:
    std::size_t size_ = 0;
};

/// One array in consecutive pieces at separate addresses, in memory that must outlive it. A writer takes the pieces
/// without joining them.
template <class T>
class PiecedColumn {
  public:
    using Element = T;

    void add(std::span<T> piece) {
        pieces_.push_back(piece);
        size_ += piece.size();
    }
    const std::vector<std::span<T>>& pieces() const { return pieces_; }
    std::size_t size() const { return size_; }
    bool empty() const { return size_ == 0; }

  private:
    std::vector<std::span<T>> pieces_;
    std::size_t size_ = 0;
};

}  // namespace loom
