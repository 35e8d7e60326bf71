#include "formats/documentation.h"

#include <fmt/format.h>

#include "formats/clusters.h"
#include "formats/derivative.h"
#include "formats/doppler.h"
#include "formats/fit.h"
#include "formats/gradient.h"
#include "formats/image.h"
#include "formats/path_graph.h"
#include "formats/radiance.h"
#include "formats/radiance_cache.h"
#include "formats/transient_cube.h"

namespace loom {
namespace {

constexpr std::string_view preamble = R"(# Formats

Printed by `loom-inspect --formats` from the declarations in this folder; a test fails when it is stale.

Stages exchange files. HDF5 files hold contiguous datasets of exact extent without filters, little-endian, those of 64 KiB
and more aligned to 4 KiB, so that a reader may map them. Each dataset has the attributes `units`, `axes` (slowest first)
and `description`. Equal inputs, options and seed give equal bytes.

Attributes of the root, and text attributes in the header of an EXR file:

| attribute | what it is |
|---|---|
| `filetype` | name of the format |
| `version` | [major, minor]; readers take any minor of their major and of older ones (in EXR files "major.minor") |
| `producer` | stage, release and commit |
| `command` | options as resolved, defaults included |
| `seed` | seed of the random numbers |
| `inputs` | content hash (XXH64) and name of each input |
| `plan` | what was on, what was off and why |

What it cost to make a file (seconds, rays, samples, memory, parents, the command and the plan) is in `FILE.cost.json` beside it.

A stage whose output holds NaN or infinity ends with exit code 3, reports which datasets hold how many, and keeps the file as
`NAME.not-finite.EXT`. Readers take such a file where a dataset says "NaN allowed", and count.

A dataset with `?` is there only when the scene needs it. Datasets that share the name of their first axis have the same
number of rows; `path+1` is one row more than `path`. Octahedral directions are two signed 16-bit numbers: with (x, y) =
(u, v) / 32767 and z = 1 - |x| - |y|, where z < 0 replace (x, y) by ((1 - |y|) sign x, (1 - |x|) sign y); then normalize.
)";

template <class Format>
std::string section() {
    Format data;
    Documenter documenter;
    Format::fields(data, documenter);
    return fmt::format("\n## {} {}.{} (HDF5)\n\n{}", Format::format.name, Format::format.major, Format::format.minor,
                       documenter.markdown());
}

}  // namespace

std::string formats_markdown() {
    return std::string(preamble) + section<PathGraph>() + section<Clusters>() + section<Radiance>() +
           section<RadianceCache>() + section<TransientCube>() + section<Derivative>() + section<Gradient>() +
           section<Doppler>() + section<Fit>() +
           fmt::format("\n## {} {}.{} (OpenEXR)\n\nfloat32, row 0 on top.\n\n{}", Image::format.name,
                       Image::format.major, Image::format.minor, image_markdown());
}

}  // namespace loom
