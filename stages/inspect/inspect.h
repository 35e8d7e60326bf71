#pragma once
// loom-inspect: what any file is, one path of a graph, paths as lines, an image as a preview.

#include <cstdint>
#include <string>
#include <vector>

#include "formats/path_graph.h"
#include "formats/radiance.h"
#include "formats/survey.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::inspect {

struct Options {
    std::vector<std::string> files;    // one HDF5 or EXR file; of a stamp, any files
    bool json = false;                 // print JSON instead of a table
    std::string path;                  // "PIXEL,SAMPLE": print this path of a graph
    std::string obj;                   // write the paths of a graph as lines to this file
    std::uint64_t max_paths = 1000;    // at most so many paths in the OBJ file
    std::string png;                   // write a preview of an image to this file
    double exposure_ev = 0;            // of the preview, in stops
    std::string graph;                 // path graph of the clusters in `file`, for their radii
    bool iterations = false;           // print how the refinement of a radiance file converged, as TSV
    std::string stamp;                 // write the content hashes of the files to this file
    std::string scene;                 // of a stamp: a scene, with all files that it names
    std::vector<std::string> defines;  // of the scene, "NAME=VALUE"
    std::string sensor;                // of the scene, id or number; empty: the first
    bool check = false;                // of a stamp: only compare
    bool formats = false;              // print the documentation of all formats
};

/// Binds the options to the command line; `options` must outlive `command`.
void declare(app::Command& command, Options& options);

/// Does what the options ask for; answers go to stdout through `report`. Returns an app::Exit.
/// throws:  InputError
int run(const Options& options, app::Report& report);

/// Text of a survey: what the file is, its lineage, a table of its datasets, and for a path graph counts,
/// endings and bytes per vertex by column; for clusters their sizes and, with the graph that they were made from,
/// radii and normal spread; for a transient cube window, response and where its light is. JSON has the same.
std::string text_of(const Survey& survey, const std::string& file, const std::string& graph = "");
std::string json_of(const Survey& survey, const std::string& file, const std::string& graph = "");

/// A line per step of the refinement, numbered from 1: what changed, over all vertices and over those that cameras see.
std::string iterations_tsv(const Radiance& radiance);

/// One path, vertex by vertex. `which` is "PIXEL,SAMPLE": the pixel as x:y or as the index y width + x, the
/// sample by its number in the whole render (from first_sample on).
/// throws:  InputError when the graph has no such path
std::string path_text(const PathGraph& graph, const std::string& which);

/// Camera paths as polylines and finite light edges as segments of a Wavefront OBJ, evenly drawn from all
/// paths.
std::string obj_text(const PathGraph& graph, std::uint64_t max_paths);

}  // namespace loom::inspect
