#pragma once
// Reading and writing a whole format from its one declaration. A Format has `format`, `fields()`,
// `provenance`, `storage` (what its columns are borrowed from) and `problem()` (its own invariants; empty
// when they hold).

#include <fmt/format.h>

#include <new>

#include "formats/io/check.h"
#include "formats/io/error.h"
#include "formats/io/field_checker.h"
#include "formats/io/hdf5_reader.h"
#include "formats/io/hdf5_writer.h"

namespace loom {

/// Writes by write-then-rename; equal data give equal bytes.
/// in:      as  the version that the file says
/// needs:   columns of one axis of one length (else std::logic_error: a bug of the caller)
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

/// Reads and checks a file; columns of 64 KiB and more are borrowed from the mapped file.
/// in:      check  a Format that knows less than everything takes it in problem()
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
