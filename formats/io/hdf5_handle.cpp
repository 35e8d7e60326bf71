#include "formats/io/hdf5_handle.h"

#include <fmt/format.h>

#include <cstring>

#include "formats/io/error.h"
#include "formats/io/mapped_file.h"

namespace loom {
namespace {

std::size_t product(const std::vector<std::size_t>& extents) {
    std::size_t n = 1;
    for (std::size_t extent : extents) n *= extent;
    return n;
}

}  // namespace

void start_hdf5() {
    // Every handle closes itself. The library's own cleanup at exit crashes after a failed write.
    H5dont_atexit();
    H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);
}

std::string hdf5_error_text() {
    std::string text;
    H5Ewalk2(
        H5E_DEFAULT, H5E_WALK_UPWARD,
        [](unsigned, const H5E_error2_t* error, void* data) -> herr_t {
            auto& found = *static_cast<std::string*>(data);
            if (found.empty() && error->desc != nullptr) found = error->desc;
            return 0;
        },
        &text);
    return text.empty() ? "HDF5 gives no reason" : text;
}

Hdf5Handle disk_type(ElementType type) {
    const auto copy = [](hid_t standard) { return Hdf5Handle(H5Tcopy(standard), H5Tclose); };
    switch (type) {
        case ElementType::float16: {
            Hdf5Handle half = copy(H5T_IEEE_F32LE);
            H5Tset_fields(half.get(), 15, 10, 5, 0, 10);
            H5Tset_size(half.get(), 2);
            H5Tset_ebias(half.get(), 15);
            return half;
        }
        case ElementType::float32:
            return copy(H5T_IEEE_F32LE);
        case ElementType::float64:
            return copy(H5T_IEEE_F64LE);
        case ElementType::int16:
            return copy(H5T_STD_I16LE);
        case ElementType::int32:
            return copy(H5T_STD_I32LE);
        case ElementType::int64:
            return copy(H5T_STD_I64LE);
        case ElementType::uint8:
            return copy(H5T_STD_U8LE);
        case ElementType::uint16:
            return copy(H5T_STD_U16LE);
        case ElementType::uint32:
            return copy(H5T_STD_U32LE);
        case ElementType::uint64:
            return copy(H5T_STD_U64LE);
        case ElementType::text:
            break;
    }
    return text_type(1);
}

Hdf5Handle text_type(std::size_t n_bytes) {
    Hdf5Handle type(H5Tcopy(H5T_C_S1), H5Tclose);
    H5Tset_size(type.get(), std::max<std::size_t>(n_bytes, 1));
    H5Tset_strpad(type.get(), H5T_STR_NULLPAD);
    H5Tset_cset(type.get(), H5T_CSET_UTF8);
    return type;
}

std::optional<ElementType> known_element(hid_t type) {
    if (H5Tget_class(type) == H5T_STRING) {
        if (H5Tis_variable_str(type) > 0) return std::nullopt;
        return ElementType::text;
    }
    for (int k = 0; k < static_cast<int>(ElementType::text); ++k) {
        const auto element = static_cast<ElementType>(k);
        if (H5Tequal(type, disk_type(element).get()) > 0) return element;
    }
    return std::nullopt;
}

std::string type_text(hid_t type) {
    const std::size_t size = H5Tget_size(type);
    if (const auto element = known_element(type)) {
        return *element == ElementType::text ? fmt::format("text[{}]", size) : std::string(element_name(*element));
    }
    const char* order = H5Tget_order(type) == H5T_ORDER_BE ? "big-endian " : "";
    switch (H5Tget_class(type)) {
        case H5T_INTEGER:
            return fmt::format("{}{}int{}", order, H5Tget_sign(type) == H5T_SGN_NONE ? "u" : "", 8 * size);
        case H5T_FLOAT:
            return fmt::format("{}float{}", order, 8 * size);
        case H5T_STRING:
            return "text of variable length";
        case H5T_COMPOUND:
            return "compound";
        case H5T_ENUM:
            return "enumeration";
        case H5T_ARRAY:
            return "array";
        case H5T_VLEN:
            return "variable-length list";
        default:
            return "another type";
    }
}

Hdf5Handle open_hdf5(const std::filesystem::path& path) {
    require_readable(path);
    start_hdf5();
    if (H5Fis_hdf5(path.c_str()) <= 0) {
        throw InputError(fmt::format("{}: is not an HDF5 file (or is cut off in its first bytes)", path.native()));
    }
    // Shared folders often have no locks, and files here appear complete or not at all.
    const Hdf5Handle access(H5Pcreate(H5P_FILE_ACCESS), H5Pclose);
    H5Pset_file_locking(access.get(), false, true);
    Hdf5Handle file(H5Fopen(path.c_str(), H5F_ACC_RDONLY, access.get()), H5Fclose);
    if (!file) {
        throw InputError(
            fmt::format("{}: the HDF5 file is cut short or damaged: {}", path.native(), hdf5_error_text()));
    }
    return file;
}

std::vector<std::size_t> extents_of(hid_t space) {
    const int rank = H5Sget_simple_extent_ndims(space);
    std::vector<hsize_t> dims(static_cast<std::size_t>(std::max(rank, 0)));
    H5Sget_simple_extent_dims(space, dims.data(), nullptr);
    return {dims.begin(), dims.end()};
}

std::vector<std::string> texts_from_buffer(const std::vector<char>& buffer, std::size_t n_bytes) {
    std::vector<std::string> texts;
    for (std::size_t at = 0; at + n_bytes <= buffer.size(); at += n_bytes) {
        texts.emplace_back(&buffer[at], strnlen(&buffer[at], n_bytes));
    }
    return texts;
}

std::optional<std::vector<std::string>> text_attribute(hid_t object, const char* name) {
    if (H5Aexists(object, name) <= 0) return std::nullopt;
    const Hdf5Handle attribute(H5Aopen(object, name, H5P_DEFAULT), H5Aclose);
    const Hdf5Handle type(H5Aget_type(attribute.get()), H5Tclose);
    const Hdf5Handle space(H5Aget_space(attribute.get()), H5Sclose);
    if (!attribute || H5Tget_class(type.get()) != H5T_STRING) return std::nullopt;
    const std::size_t n = product(extents_of(space.get()));
    if (H5Tis_variable_str(type.get()) > 0) {
        std::vector<char*> pointers(n, nullptr);
        std::vector<std::string> texts;
        if (n == 0 || H5Aread(attribute.get(), type.get(), pointers.data()) < 0) return texts;
        for (const char* text : pointers) texts.emplace_back(text == nullptr ? "" : text);
        H5Dvlen_reclaim(type.get(), space.get(), H5P_DEFAULT, pointers.data());
        return texts;
    }
    std::vector<char> buffer(n * H5Tget_size(type.get()));
    if (n > 0 && H5Aread(attribute.get(), type.get(), buffer.data()) < 0) return std::nullopt;
    return texts_from_buffer(buffer, H5Tget_size(type.get()));
}

std::optional<std::vector<std::uint64_t>> integer_attribute(hid_t object, const char* name) {
    if (H5Aexists(object, name) <= 0) return std::nullopt;
    const Hdf5Handle attribute(H5Aopen(object, name, H5P_DEFAULT), H5Aclose);
    const Hdf5Handle type(H5Aget_type(attribute.get()), H5Tclose);
    const Hdf5Handle space(H5Aget_space(attribute.get()), H5Sclose);
    if (!attribute || H5Tget_class(type.get()) != H5T_INTEGER) return std::nullopt;
    std::vector<std::uint64_t> numbers(product(extents_of(space.get())));
    if (!numbers.empty() && H5Aread(attribute.get(), H5T_NATIVE_UINT64, numbers.data()) < 0) return std::nullopt;
    return numbers;
}

}  // namespace loom
