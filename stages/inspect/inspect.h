#pragma once
// loom-inspect: describes any file, one path of a graph, paths as lines, an image as a preview.

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
    std::vector<std::string> files;    // one HDF5 or EXR file; with stamp, any files
    bool json = false;                 // print JSON instead of a table
    std::string path;                  // "PIXEL,SAMPLE": print this path of a graph
    std::string obj;                   // write the paths of a graph as lines to this file
    std::uint64_t max_paths = 1000;    // largest number of paths in the OBJ file
    std::string png;                   // write a preview of an image to this file
    double exposure_ev = 0;            // of the preview, in stops
    std::string graph;                 // path graph of the clusters in `files`, for their radii
    bool iterations = false;           // print the convergence of the refinement in a radiance file, as TSV
    std::string stamp;                 // write the content hashes of the files to this file
    std::string scene;                 // with stamp: a scene and all files that it names; with frames: their scene
    std::string absent;                // value of a parameter whose shapes a frame lacks
    std::string frames;                // print the content hashes of the static scene and of these frames
    std::vector<std::string> defines;  // of the scene, "NAME=VALUE"
    std::string sensor;                // of the scene, id or index; empty: the first
    bool check = false;                // with stamp: compare only
    bool formats = false;              // print the documentation of all formats
};

/// Binds the options to the command line; `options` must outlive `command`.
void declare(app::Command& command, Options& options);

/// Executes the options; answers go to stdout through `report`. Returns an app::Exit.
/// throws:  InputError
int run(const Options& options, app::Report& report);

/// Describes a survey: the kind of file, its lineage, a table of its datasets. A path graph adds counts, endings and
/// bytes per vertex by column. Clusters add their sizes and, with their graph, radii and normal spread. A transient
/// cube adds window, response and the distribution of its light. JSON has the same content.
std::string text_of(const Survey& survey, const std::string& file, const std::string& graph = "");
std::string json_of(const Survey& survey, const std::string& file, const std::string& graph = "");

/// Lists the steps of the refinement, one line each, numbered from 1: the change over all vertices and over first hits.
std::string iterations_tsv(const Radiance& radiance);

/// Prints one path, vertex by vertex. `which` is "PIXEL,SAMPLE": the pixel as x:y or as the index y width + x, the
/// sample by its index in the whole render (counted from first_sample on).
/// throws:  InputError when the graph has no such path
std::string path_text(const PathGraph& graph, const std::string& which);

/// Writes camera paths as polylines and finite light edges as segments of a Wavefront OBJ, selected evenly from all
/// paths.
std::string obj_text(const PathGraph& graph, std::uint64_t max_paths);

}  // namespace loom::inspect
