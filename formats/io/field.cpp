#include "formats/io/field.h"

namespace loom {

std::string_view element_name(ElementType type) {
    switch (type) {
        case ElementType::float16:
            return "float16";
        case ElementType::float32:
            return "float32";
        case ElementType::float64:
            return "float64";
        case ElementType::int16:
            return "int16";
        case ElementType::int32:
            return "int32";
        case ElementType::int64:
            return "int64";
        case ElementType::uint8:
            return "uint8";
        case ElementType::uint16:
            return "uint16";
        case ElementType::uint32:
            return "uint32";
        case ElementType::uint64:
            return "uint64";
        case ElementType::text:
            break;
    }
    return "text";
}

std::size_t element_size(ElementType type) {
    switch (type) {
        case ElementType::uint8:
            return 1;
        case ElementType::float16:
        case ElementType::int16:
        case ElementType::uint16:
            return 2;
        case ElementType::float32:
        case ElementType::int32:
        case ElementType::uint32:
            return 4;
        case ElementType::float64:
        case ElementType::int64:
        case ElementType::uint64:
            return 8;
        case ElementType::text:
            break;
    }
    return 0;
}

}  // namespace loom
