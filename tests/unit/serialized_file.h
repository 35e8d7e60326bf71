#pragma once
// Makes bytes of mesh files for tests.

#include <zlib.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

namespace loom {

template <class T>
inline void append(std::string& bytes, T value, bool swap = false) {
    char raw[sizeof value];
    std::memcpy(raw, &value, sizeof value);
    if (swap) std::reverse(raw, raw + sizeof value);
    bytes.append(raw, sizeof value);
}

/// Makes two shapes; the second lies one unit higher.
inline std::string serialized_file(int version, bool doubles, std::uint32_t flags) {
    std::string file;
    std::vector<std::uint64_t> starts;
    for (int k = 0; k < 2; ++k) {
        std::string body;
        append(body, flags | (doubles ? 0x2000u : 0x1000u));
        if (version == 4) body.append("name", 5);
        append(body, std::uint64_t{3}), append(body, std::uint64_t{1});
        const auto number = [&](double x) { doubles ? append(body, x) : append(body, float(x)); };
        for (const double x : {0.0, 0.0, double(k), 1.0, 0.0, double(k), 0.0, 1.0, double(k)}) number(x);
        if (flags & 1)
            for (int i = 0; i < 3; ++i) number(1), number(0), number(0);
        if (flags & 2)
            for (int i = 0; i < 3; ++i) number(0.5), number(0.25);
        if (flags & 8)
            for (int i = 0; i < 9; ++i) number(0.1);
        for (std::uint32_t i = 0; i < 3; ++i) append(body, i);
        uLongf size = compressBound(body.size());
        std::string packed(size, '\0');
        compress(reinterpret_cast<Bytef*>(packed.data()), &size, reinterpret_cast<const Bytef*>(body.data()),
                 body.size());
        starts.push_back(file.size());
        append(file, std::uint16_t{0x041C}), append(file, std::uint16_t(version));
        file.append(packed, 0, size);
    }
    for (const std::uint64_t start : starts) version == 4 ? append(file, start) : append(file, std::uint32_t(start));
    append(file, std::uint32_t{2});
    return file;
}

}  // namespace loom
