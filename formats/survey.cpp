#include "formats/survey.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cmath>
#include <cstring>
#include <limits>

#include "formats/image.h"
#include "formats/io/error.h"
#include "formats/io/hdf5_handle.h"
#include "formats/io/mapped_file.h"

namespace loom {
namespace {

constexpr std::size_t max_values_shown = 16;
constexpr std::size_t block_bytes = std::size_t{1} << 22;

struct Accumulator {
    Statistics s{0, 0, 0, std::numeric_limits<double>::infinity(), 0, -std::numeric_limits<double>::infinity()};
    double sum = 0;

    template <class T>
    void add(std::span<const T> values) {
        s.n += values.size();
        for (const T& value : values) {
            double x;
            if constexpr (std::is_same_v<T, Half>)
                x = float_from_half(value);
            else
                x = static_cast<double>(value);
            if (!std::isfinite(x)) {
                (std::isnan(x) ? s.n_nan : s.n_inf) += 1;
                continue;
            }
            s.min = std::min(s.min, x);
            s.max = std::max(s.max, x);
            sum += x;
        }
    }
    Statistics result() const {
        Statistics out = s;
        const std::uint64_t n_finite = s.n - s.n_nan - s.n_inf;
        if (n_finite == 0)
            out.min = out.max = 0;
        else
            out.mean = sum / static_cast<double>(n_finite);
        return out;
    }
};

/// Calls `body` with a null pointer of the element's C++ type.
template <class Body>
void with_element(ElementType type, Body body) {
    switch (type) {
        case ElementType::float16:
            return body(static_cast<Half*>(nullptr));
        case ElementType::float32:
            return body(static_cast<float*>(nullptr));
        case ElementType::float64:
            return body(static_cast<double*>(nullptr));
        case ElementType::int16:
            return body(static_cast<std::int16_t*>(nullptr));
        case ElementType::int32:
            return body(static_cast<std::int32_t*>(nullptr));
        case ElementType::int64:
            return body(static_cast<std::int64_t*>(nullptr));
        case ElementType::uint8:
            return body(static_cast<std::uint8_t*>(nullptr));
        case ElementType::uint16:
            return body(static_cast<std::uint16_t*>(nullptr));
        case ElementType::uint32:
            return body(static_cast<std::uint32_t*>(nullptr));
        case ElementType::uint64:
            return body(static_cast<std::uint64_t*>(nullptr));
        case ElementType::text:
            return;
    }
}

template <class T>
std::string number_text(T value) {
    if constexpr (std::is_same_v<T, Half>)
        return fmt::format("{}", float_from_half(value));
    else
        return fmt::format("{}", value);
}

class DatasetSurveyor {
  public:
    DatasetSurveyor(hid_t file, const std::string& name, const std::filesystem::path& path)
        : path_(path),
          dataset_(H5Dopen2(file, name.c_str(), H5P_DEFAULT), H5Dclose),
          type_(H5Dget_type(dataset_.get()), H5Tclose),
          space_(H5Dget_space(dataset_.get()), H5Sclose) {
        summary_.name = name;
        if (!dataset_ || !type_ || !space_) fail();
    }

    DatasetSummary survey() {
        const auto attribute = [&](const char* name) {
            const auto texts = text_attribute(dataset_.get(), name);
            return texts && texts->size() == 1 ? texts->front() : std::string();
        };
        summary_.type = type_text(type_.get());
        summary_.units = attribute("units");
        summary_.axes = attribute("axes");
        summary_.description = attribute("description");
        summary_.extents = extents_of(space_.get());
        const Hdf5Handle creation(H5Dget_create_plist(dataset_.get()), H5Pclose);
        const H5D_layout_t layout = H5Pget_layout(creation.get());
        summary_.storage = layout == H5D_CONTIGUOUS ? "contiguous" : layout == H5D_COMPACT ? "compact" : "chunked";
        n_ = static_cast<std::size_t>(std::max<hssize_t>(0, H5Sget_simple_extent_npoints(space_.get())));
        summary_.bytes = n_ * H5Tget_size(type_.get());
        const auto element = known_element(type_.get());
        if (!element || n_ == 0) return summary_;
        if (*element == ElementType::text) {
            if (summary_.bytes <= block_bytes) read_texts();
        } else {
            summary_.is_number = true;
            with_element(*element, [&](auto* type) { read_numbers<std::remove_pointer_t<decltype(type)>>(); });
        }
        return summary_;
    }

  private:
    [[noreturn]] void fail() const {
        throw InputError(fmt::format("{}: {}: cannot read: {}", path_.native(), summary_.name, hdf5_error_text()));
    }

    void read_texts() {
        std::vector<char> buffer(summary_.bytes);
        if (H5Dread(dataset_.get(), type_.get(), H5S_ALL, H5S_ALL, H5P_DEFAULT, buffer.data()) < 0) fail();
        summary_.values = texts_from_buffer(buffer, H5Tget_size(type_.get()));
        if (summary_.values.size() > max_values_shown) summary_.values.resize(max_values_shown);
    }

    /// Reads block by block along the first axis, without conversion inside HDF5.
    template <class T>
    void read_numbers() {
        Accumulator sums;
        std::vector<hsize_t> start(summary_.extents.size(), 0), count(summary_.extents.begin(), summary_.extents.end());
        const std::size_t n_rows = count.empty() ? 1 : count[0];
        const std::size_t row_size = n_ / n_rows;
        const std::size_t step = std::max<std::size_t>(1, block_bytes / (row_size * sizeof(T)));
        std::vector<T> buffer;
        for (std::size_t row = 0; row < n_rows; row += step) {
            const std::size_t rows = std::min(step, n_rows - row);
            buffer.resize(rows * row_size);
            if (!count.empty()) {
                start[0] = row;
                count[0] = rows;
                H5Sselect_hyperslab(space_.get(), H5S_SELECT_SET, start.data(), nullptr, count.data(), nullptr);
            }
            const hsize_t n_buffer = buffer.size();
            const Hdf5Handle memory(H5Screate_simple(1, &n_buffer, nullptr), H5Sclose);
            if (H5Dread(dataset_.get(), type_.get(), memory.get(), space_.get(), H5P_DEFAULT, buffer.data()) < 0)
                fail();
            sums.add(std::span<const T>(buffer));
        }
        summary_.statistics = sums.result();
        if (n_ <= max_values_shown) {
            for (const T& value : buffer) summary_.values.push_back(number_text(value));
        }
    }

    std::filesystem::path path_;
    Hdf5Handle dataset_, type_, space_;
    DatasetSummary summary_;
    std::size_t n_ = 0;
};

std::vector<std::string> dataset_names(hid_t file) {
    std::vector<std::string> names;
    H5Ovisit2(
        file, H5_INDEX_NAME, H5_ITER_INC,
        [](hid_t, const char* name, const H5O_info_t* info, void* data) -> herr_t {
            if (info->type == H5O_TYPE_DATASET) static_cast<std::vector<std::string>*>(data)->emplace_back(name);
            return 0;
        },
        &names, H5O_INFO_BASIC);
    return names;
}

NamedTexts root_attributes(hid_t file) {
    std::vector<std::string> names;
    H5Aiterate2(
        file, H5_INDEX_NAME, H5_ITER_INC, nullptr,
        [](hid_t, const char* name, const H5A_info_t*, void* data) -> herr_t {
            static_cast<std::vector<std::string>*>(data)->emplace_back(name);
            return 0;
        },
        &names);
    NamedTexts attributes;
    for (const auto& name : names) {
        std::string value;
        if (const auto texts = text_attribute(file, name.c_str())) {
            value = fmt::format("{}", fmt::join(*texts, "\n"));
        } else if (const auto numbers = integer_attribute(file, name.c_str())) {
            for (std::uint64_t number : *numbers) value += (value.empty() ? "" : ".") + std::to_string(number);
        }
        attributes.emplace_back(name, value);
    }
    return attributes;
}

Survey survey_hdf5(const std::filesystem::path& path) {
    const Hdf5Handle file = open_hdf5(path);
    Survey survey;
    survey.attributes = root_attributes(file.get());
    for (const auto& name : dataset_names(file.get())) {
        survey.datasets.push_back(DatasetSurveyor(file.get(), name, path).survey());
    }
    return survey;
}

Survey survey_exr(const std::filesystem::path& path) {
    Survey survey;
    survey.kind = Survey::Kind::exr;
    survey.attributes = exr_attributes(path);
    const Image image = read_any_exr(path);
    for (const auto& channel : image.channels) {
        Accumulator sums;
        sums.add(std::span<const float>(channel.values));
        DatasetSummary summary;
        summary.name = channel.name;
        summary.type = "float32";
        summary.axes = "y,x";
        summary.extents = {image.height, image.width};
        summary.bytes = channel.values.size() * sizeof(float);
        summary.is_number = true;
        summary.statistics = sums.result();
        survey.datasets.push_back(std::move(summary));
    }
    return survey;
}

}  // namespace

std::string Survey::attribute(std::string_view name) const {
    for (const auto& [key, value] : attributes) {
        if (key == name) return value;
    }
    return {};
}

Survey survey_file(const std::filesystem::path& path) {
    require_readable(path);
    constexpr unsigned char exr_magic[] = {0x76, 0x2f, 0x31, 0x01};
    const MappedFile file(path);
    const bool is_exr =
        file.bytes().size() >= sizeof exr_magic && std::memcmp(file.bytes().data(), exr_magic, sizeof exr_magic) == 0;
    start_hdf5();
    if (!is_exr && H5Fis_hdf5(path.c_str()) <= 0) {
        throw InputError(fmt::format("{}: is neither an HDF5 nor an EXR file", path.native()));
    }
    Survey survey = is_exr ? survey_exr(path) : survey_hdf5(path);
    survey.file_bytes = file.bytes().size();
    return survey;
}

}  // namespace loom
