#pragma once
// Reads and writes a whole format from its declaration. A Format has `format`, `fields()`, `provenance`, `storage` (the
// memory that its columns borrow) and `problem()` (the first violated invariant; empty when all hold).

#include <fmt/format.h>

#include <new>

#include "formats/io/check.h"
#include "formats/io/error.h"
#include "formats/io/field_checker.h"
#include "formats/io/hdf5_reader.h"
#include "formats/io/hdf5_writer.h"

namespace loom {

/// Writes by write-then-rename; equal formats give equal bytes.
/// in:      as  version stored in the file
/// needs:   columns that share an axis have the same length (else std::logic_error: a bug of the caller)
template <class Format>
void write_format(const Format& data, const std::filesystem::path& path, Sync sync = Sync::yes,
                  const FormatId& as = Format::format) {
    FieldChecker checker(false);
    Format::fields(data, checker);
    if (!checker.problem().empty()) throw std::logic_error(path.native() + ": " + checker.problem());
    Hdf5Writer writer(path, as, data.provenance);
    Format::fields(data, writer);
    writer.commit(sync);
}

/// Reads and checks a file. Columns of 64 KiB and more borrow the mapped file.
/// in:      check  extent of the checks; passed to problem() where the Format's problem() takes it
/// throws:  InputError naming the file and the dataset
template <class Format>
Format read_format(const std::filesystem::path& path, Check check = Check::everything) {
    Format data;
    Hdf5Reader reader(path, Format::format);
    try {
        Format::fields(data, reader);
    } catch (const std::bad_alloc&) {
        throw InputError(path.native() + ": a dataset is too large for the memory of this machine");
    } catch (const std::length_error&) {
        throw InputError(path.native() + ": a dataset has an impossible length");
    }
    data.provenance = reader.provenance();
    data.storage = reader.storage();
    FieldChecker checker(check == Check::everything);
    Format::fields(data, checker);
    std::string problem = checker.problem();
    if (problem.empty()) {
        if constexpr (requires { data.problem(check); })
            problem = data.problem(check);
        else
            problem = data.problem();
    }
    if (!problem.empty()) throw InputError(path.native() + ": " + problem);
    return data;
}

}  // namespace loom
