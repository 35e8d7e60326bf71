#include "stages/core/edit/animation.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <ranges>
#include <set>
#include <span>

#include "formats/io/content_hash.h"
#include "formats/io/error.h"
#include "stages/core/edit/scene_match.h"
#include "stages/core/table/table.h"

namespace loom {
namespace {

constexpr std::uint32_t most_frames = 1000000;

bool parse(const std::string& text, std::uint32_t& number) {
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    return !text.empty() && error == std::errc{} && end == text.data() + text.size();
}

std::uint32_t frame_number(const std::string& text, const std::string& where) {
    std::uint32_t number = 0;
    if (!parse(text, number) || number >= most_frames)
        throw InputError(fmt::format("{}: frame '{}': expected a number from 0 to {}", where, text, most_frames - 1));
    return number;
}

std::string hash_of(const std::string& text) {
    return content_hash_text(content_hash(std::as_bytes(std::span(text))));
}

std::string name_of(const ObjectPtr& o, std::size_t place) {
    return o->has_own_id ? fmt::format("'{}'", o->id) : fmt::format("number {} ({})", place + 1, o->plugin);
}

bool is_light(const ObjectPtr& o) {
    return o->category == Category::emitter || o->has_child(Category::emitter);
}

void add_missing(std::vector<std::string>& names, const std::set<std::string>& others) {
    for (const std::string& name : others)
        if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
}

}  // namespace

Defines Frames::values_of(const Frame& frame, Defines others) const {
    for (std::size_t i = 0; i < parameters.size(); ++i) others.emplace_back(parameters[i], frame.values[i]);
    return others;
}

std::set<std::string> Frames::absent_in(const Frame& frame) const {
    std::set<std::string> names;
    for (std::size_t i = 0; i < parameters.size(); ++i)
        if (!absent.empty() && frame.values[i] == absent) names.insert(parameters[i]);
    return names;
}

SceneDescription read_frame(const std::filesystem::path& scene, const Frames& frames, const Frames::Frame& frame,
                            const Defines& defines, const std::string& sensor) {
    try {
        return read_scene(scene, frames.values_of(frame, defines), sensor, frames.absent_in(frame));
    } catch (const InputError& bad) {
        throw InputError(fmt::format("{}:{}: frame {}: {}", frames.file, frame.line, frame.number, bad.what()));
    }
}

Frames read_frames(const std::string& file, const std::string& absent) {
    const Table table = read_tables({file});
    const std::size_t number_column = table.column("frame");
    Frames out;
    out.file = file;
    out.absent = absent;
    for (std::size_t i = 0; i < table.names.size(); ++i) {
        const std::string& name = table.names[i];
        if (name.empty()) throw InputError(fmt::format("{}: column {} has no name", file, i + 1));
        if (std::count(table.names.begin(), table.names.end(), name) > 1)
            throw InputError(fmt::format("{}: column '{}' is there twice", file, name));
        if (i != number_column) out.parameters.push_back(name);
    }
    std::set<std::uint32_t> known;
    for (std::size_t row = 0; row < table.rows.size(); ++row) {
        Frames::Frame frame;
        frame.line = table.lines[row];
        frame.row = row;
        const std::string where = fmt::format("{}:{}", file, frame.line);
        frame.number = frame_number(table.rows[row][number_column], where);
        if (!known.insert(frame.number).second)
            throw InputError(fmt::format("{}: frame {} is there twice", where, frame.number));
        for (std::size_t i = 0; i < table.names.size(); ++i) {
            if (i == number_column) continue;
            const std::string& value = table.rows[row][i];
            if (value.empty())
                throw InputError(fmt::format("{}: frame {}: '{}' has no value", where, frame.number, table.names[i]));
            frame.values.push_back(value);
        }
        out.frames.push_back(std::move(frame));
    }
    return out;
}

std::string Animation::describe() const {
    const auto list = [](const char* what, const std::vector<std::string>& names) {
        return names.empty() ? std::string() : fmt::format("{} {}", what, fmt::join(names, ", "));
    };
    const std::string out = list("static: without", moving), lights = list("lights of the first frame:", relit);
    std::string text = out + (out.empty() || lights.empty() ? "" : "; ") + lights;
    if (camera_moves) return text.empty() ? "static: all but the camera" : text + "; the camera moves";
    return text.empty() ? "static: nothing differs between the frames" : text;
}

std::vector<Frames::Frame> frames_of(const Frames& frames, const std::string& only) {
    if (only.empty()) return frames.frames;
    std::array<std::uint32_t, 3> numbers = {0, 0, 1};  // first, end, step
    std::size_t n = 0;
    bool readable = true;
    for (const auto part : std::views::split(only, ':')) {
        const std::string text(part.begin(), part.end());
        readable &= n < numbers.size() && parse(text, numbers[n]);
        ++n;
    }
    const auto [first, end, step] = numbers;
    if (!readable || n < 2 || first >= end || step == 0)
        throw InputError(
            fmt::format("--only {}: expected FIRST:END or FIRST:END:STEP, numbers of frames, FIRST below END, "
                        "STEP from 1",
                        only));
    std::vector<Frames::Frame> chosen;
    for (const Frames::Frame& frame : frames.frames)
        if (frame.number >= first && frame.number < end && (frame.number - first) % step == 0) chosen.push_back(frame);
    if (chosen.empty())
        throw InputError(fmt::format("--only {}: {} has no frame with such a number", only, frames.file));
    return chosen;
}

Animation find_animation(const std::filesystem::path& scene, const Defines& defines, const std::string& sensor,
                         const Frames& frames, Cameras cameras) {
    CanonicalTexts texts;  // of objects that must live as long
    std::vector<SceneDescription> descriptions;
    for (const Frames::Frame& frame : frames.frames)
        descriptions.push_back(read_frame(scene, frames, frame, defines, sensor));

    // Shapes and lights that differ from those of the first frame, or that it lacks.
    const Object& first = *descriptions[0].root;
    const Objects shapes = first.children(Category::shape), emitters = first.children(Category::emitter);
    std::vector<char> shape_differs(shapes.size()), emitter_differs(emitters.size());
    std::set<std::string> lacking, lacking_lights;
    bool camera_moves = false;
    for (std::size_t i = 1; i < descriptions.size(); ++i) {
        const Object& other = *descriptions[i].root;
        const auto where = [&] {
            return fmt::format("{}:{}: frame {}", frames.file, frames.frames[i].line, frames.frames[i].number);
        };
        const auto differs = [&](const ObjectPtr& a, const ObjectPtr& b) { return texts.text(a) != texts.text(b); };
        if (differs(first.child(Category::integrator), other.child(Category::integrator)))
            throw InputError(fmt::format("{}: has another integrator than frame {}; frames need one length of paths",
                                         where(), frames.frames[0].number));
        if (const ObjectPtr a = first.child(Category::sensor), b = other.child(Category::sensor); differs(a, b)) {
            if (cameras == Cameras::one)
                throw InputError(fmt::format(
                    "{}: has another sensor than frame {}. Where the camera moves, the frames have no image in "
                    "common, but a radiance cache: loom-residual --cache (make animation CACHE=points), or "
                    "trace each frame by itself: loom-trace --frames (make animation METHOD=pt)",
                    where(), frames.frames[0].number));
            if (!a || !b || a->plugin != b->plugin || differs(a->child(Category::film), b->child(Category::film)))
                throw InputError(fmt::format("{}: has another kind of sensor or another film than frame {}", where(),
                                             frames.frames[0].number));
            camera_moves = true;
        }
        const auto compare = [&](const Objects& ours, const Objects& theirs, const SceneMatch& match,
                                 std::vector<char>& differs) {
            for (std::size_t k = 0; k < ours.size(); ++k) {
                const std::uint32_t partner = match.new_of_old[k];
                differs[k] |= partner == SceneMatch::none || texts.text(ours[k]) != texts.text(theirs[partner]);
            }
            for (std::size_t k = 0; k < theirs.size(); ++k)
                if (match.old_of_new[k] == SceneMatch::none)
                    (is_light(theirs[k]) ? lacking_lights : lacking).insert(name_of(theirs[k], k));
        };
        const Objects new_shapes = other.children(Category::shape), new_emitters = other.children(Category::emitter);
        compare(shapes, new_shapes, match_shapes(shapes, new_shapes, texts), shape_differs);
        compare(emitters, new_emitters, match_emitters(emitters, new_emitters, texts), emitter_differs);
    }

    Animation out;
    for (const SceneDescription& frame : descriptions) out.frame_hashes.push_back(hash_of(texts.text(*frame.root)));
    auto root = std::make_shared<Object>(first), fixed = std::make_shared<Object>(first);
    for (std::size_t k = 0; k < shapes.size(); ++k) {
        if (!shape_differs[k]) continue;
        const auto remove_from = [&](Object& scene) {
            std::erase_if(scene.nested, [&](const auto& child) { return child.first == shapes[k]; });
        };
        remove_from(*fixed);
        if (is_light(shapes[k])) {
            out.relit.push_back(name_of(shapes[k], k));
            continue;
        }
        out.moving.push_back(name_of(shapes[k], k));
        remove_from(*root);
    }
    const bool has_less = fixed->nested.size() < root->nested.size();
    for (std::size_t k = 0; k < emitters.size(); ++k)
        if (emitter_differs[k]) out.relit.push_back(name_of(emitters[k], k));
    add_missing(out.moving, lacking);
    add_missing(out.relit, lacking_lights);
    out.still = descriptions[0];
    out.camera_moves = camera_moves;
    // Its content alone identifies it, so that other frames of the same static scene share its files.
    const auto without_camera = std::make_shared<Object>(*root);
    if (camera_moves)
        std::erase_if(without_camera->nested,
                      [](const auto& child) { return child.first->category == Category::sensor; });
    out.still_hash = hash_of(texts.text(*without_camera));
    out.still.parameters = {{"static scene", out.still_hash}};
    out.still.files.clear();
    if (has_less) {
        out.fixed = out.still;
        out.fixed->root = std::move(fixed);
    }
    out.still.root = std::move(root);
    out.frames = std::move(descriptions);
    return out;
}

SceneDescription with_camera_of(const SceneDescription& scene, const SceneDescription& frame) {
    SceneDescription out = scene;
    auto root = std::make_shared<Object>(*scene.root);
    const ObjectPtr camera = frame.root->child(Category::sensor);
    for (auto& child : root->nested)
        if (child.first->category == Category::sensor && camera) child.first = camera;
    out.root = std::move(root);
    return out;
}

KnownParts known_parts(std::shared_ptr<const Scene> old_scene, const Edit& edit) {
    if (old_scene->nlos) return {};
    KnownParts out;
    out.shape_idx.assign(edit.new_shapes.size(), KnownParts::none);
    for (std::size_t k = 0; k < edit.old_shapes.size(); ++k) {
        if (edit.old_shapes[k].dynamic()) return {};
        out.shape_idx[edit.old_shapes[k].partner_idx] = std::uint32_t(k);
    }
    out.scene = std::move(old_scene);
    return out;
}

}  // namespace loom
