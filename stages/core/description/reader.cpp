// Reads the XML tree into objects. References are kept and resolved when all ids are known.

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <optional>
#include <set>
#include <utility>

#include "formats/io/error.h"
#include "stages/core/description/values.h"

namespace loom {
namespace {

using namespace description;

std::optional<Category> category_of(std::string_view tag) {
    for (int i = 1; i < n_categories; ++i)
        if (name(Category(i)) == tag && Category(i) != Category::spectrum) return Category(i);
    return std::nullopt;
}

std::vector<std::string> object_tags() {
    std::vector<std::string> tags;
    for (int i = 1; i < n_categories; ++i)
        if (Category(i) != Category::spectrum) tags.emplace_back(name(Category(i)));
    return tags;
}

/// A reference whose target may come later in the file.
struct PendingRef {
    std::shared_ptr<Object> parent;
    const PluginSchema* parent_plugin;
    std::string name;       // of the parameter; may be empty or free
    std::size_t nested_at;  // index of its child among the parent's nested objects
    Text id;
    bool legacy;
};

/// A file name whose file is searched for when all <path>s are known.
struct PendingFile {
    std::shared_ptr<Object> object;
    std::size_t property;
    Text name;
    Folders folders;  // of the scene file that contains the name
};

/// An object that cannot be rendered: an error when the image depends on it, else a note.
struct Unsupported {
    std::shared_ptr<Object> object;
    Location at;
    std::string message;
};

/// Returns the note on a plugin that is rendered as another; printed once.
std::string said_of(Category category, std::string_view type) {
    switch (category) {
        case Category::integrator:
            if (type.starts_with("direct")) return "rendered by path tracing with max_depth 2, which has the same mean";
            return "rendered by path tracing with its max_depth, rr_depth and hide_emitters";
        case Category::film:
            if (type == "phasor_hdr_film") return "rendered as a cube over time, not as phasors";
            return "rendered as an image of R, G, B of its size and filter";
        case Category::rfilter:
            return "rendered as a gaussian of stddev 0.5 pixels";
        default:
            return "has no effect here: --spp, --seed and --sampler choose the samples";
    }
}

class Reader {
  public:
    Reader(const std::filesystem::path& file, const Defines& defines, const std::string& sensor,
           const std::set<std::string>& absent)
        : substitutions_(defines) {
        substitutions_.set_absent(absent);
        const std::string name = file.string();
        SceneFile main{XmlDocument(file, name), {file.parent_path()}, &resources_};
        scene_ = make_object(Category::scene, "scene", main.document.at(main.document.root()));
        description_.files.push_back(name);
        open_files_.insert(canonical(file));
        reading_.push_back(&main);
        try {
            read_file(main, scene_, scene_schema(), {}, 0);
            resolve_references();
            find_files();
            spell_out_defaults();
            check_cycles();
            keep_first_integrators();
            drop_what_shapes_hold();
            choose_sensor(sensor);
            check_used();
            for (std::size_t i = objects_.size(); i-- > 0;) check_object(*objects_[i].object, *objects_[i].plugin);
            substitutions_.check_all_used();
            forget_reads();
        } catch (...) {
            // References may have closed a cycle of shared pointers: break it.
            for (const Made& made : objects_) {
                made.object->nested.clear();
                made.object->properties.clear();
            }
            throw;
        }
        for (const auto& [plugin, parameters] : ignored_)
            note(fmt::format("{}: without effect here: {}", plugin, fmt::join(parameters, ", ")));
        description_.root = scene_;
        description_.parameters = substitutions_.used();
        description_.files.insert(description_.files.end(), resources_.begin(), resources_.end());
    }

    SceneDescription take() { return std::move(description_); }

  private:
    struct Made {
        std::shared_ptr<Object> object;
        const PluginSchema* plugin;
    };

    static std::string canonical(const std::filesystem::path& file) {
        return std::filesystem::weakly_canonical(file).string();
    }

    std::shared_ptr<Object> make_object(Category category, std::string_view type, const Location& at,
                                        bool legacy = false) {
        auto object = std::make_shared<Object>();
        object->category = category;
        object->plugin = type;
        object->legacy = legacy;
        object->at = at;
        const int order = ++made_of_category_[int(category)];
        object->id = fmt::format("{}-{}", name(category), order);
        objects_.push_back({object, category == Category::scene ? &scene_schema() : find_plugin(category, type)});
        return object;
    }

    void note(const std::string& text) {
        if (noted_.insert(text).second) description_.notes.push_back(text);
    }
    void note_ignored(const std::string& plugin, const std::string& parameter) {
        std::vector<std::string>& known = ignored_[plugin];
        if (std::find(known.begin(), known.end(), parameter) == known.end()) known.push_back(parameter);
    }
    void warn(const Location& at, const std::string& text) {
        description_.warnings.push_back(locate(at, "warning: " + text));
    }

    /// Reads a scene, or one object that a file includes.
    void read_file(SceneFile& file, const std::shared_ptr<Object>& parent, const PluginSchema& parent_plugin,
                   const Text& given_name, int depth) {
        const Element root{file.document.root(), &file, &substitutions_};
        const std::optional<Category> one_object = depth > 0 ? category_of(root.tag()) : std::nullopt;
        if (root.tag() != "scene" && !one_object)
            fail(root.at(), fmt::format("<{}> is not a Mitsuba scene; expected <scene>", root.tag()));
        if (root.tag() == "scene" && parent != scene_)
            fail(root.at(), fmt::format("a <scene> cannot be included in a {}", name(parent->category)));
        if (!one_object) root.allow({"version", "id"});
        const Text version = root.text("version");
        const int major = std::atoi(version.text.c_str());
        if (version.text.empty() || !std::isdigit(static_cast<unsigned char>(version.text[0])) || major == 1 ||
            major > 3)
            fail(version.at, fmt::format("version '{}' is not known; expected 0.5, 0.6, 2.x or 3.x", version.text));
        file.legacy = major == 0;
        if (one_object)
            read_nested(root, *one_object, parent, parent_plugin, depth, given_name);
        else
            read_children(root, scene_, scene_schema(), depth + 1);
    }

    void include(const Element& e, const std::shared_ptr<Object>& parent, const PluginSchema& parent_plugin,
                 int depth) {
        e.allow({"filename", "name"});
        const Text name = e.text("filename");
        const std::filesystem::path path = find_file(name, e.file->folders);
        const std::string key = canonical(path);
        if (open_files_.contains(key))
            fail(name.at, fmt::format("'{}' includes itself, directly or through others", name.text));
        open_files_.insert(key);
        add_file(description_.files, path);
        SceneFile included{XmlDocument(path, path.string()), e.file->folders, &resources_};
        included.folders.insert(included.folders.begin(), path.parent_path());
        reading_.push_back(&included);
        read_file(included, parent, parent_plugin, e.has("name") ? e.text("name") : Text{{}, e.at()}, depth);
        reading_.pop_back();
        open_files_.erase(key);
    }

    /// Reads a <path>: from here on, files are searched for in that folder first. [Mitsuba 3.8, FileResolver::prepend]
    void add_folder(const Element& e) {
        e.allow({"value"});
        Folders& folders = reading_.back()->folders;
        folders.insert(folders.begin(), find_folder(e.text("value"), folders));
    }

    void set_default(const Element& e) {
        e.allow({"name", "value"});
        substitutions_.set_default(e.text("name").text, e.text("value").text);
    }

    void add_alias(const Element& e) {
        e.allow({"id", "as"});
        const Text id = e.text("id"), as = e.text("as");
        const auto [other, added] = aliases_.emplace(as.text, id);
        if (!added) fail(as.at, fmt::format("alias '{}' exists already, at {}", as.text, other->second.at.where()));
    }

    void read_children(const Element& parent, const std::shared_ptr<Object>& object, const PluginSchema& plugin,
                       int depth) {
        constexpr int deepest = 64;
        if (depth > deepest) fail(parent.at(), fmt::format("objects are nested deeper than {}", deepest));
        const bool in_scene = object == scene_;
        for (const pugi::xml_node& node : parent.node.children()) {
            const Element e = parent.with(node);
            if (node.type() != pugi::node_element) fail(e.at(), "unexpected text");
            const std::string_view tag = e.tag();
            if (in_scene && tag == "default")
                set_default(e);
            else if (tag == "include")
                include(e, object, plugin, depth);
            else if (in_scene && tag == "alias")
                add_alias(e);
            else if (in_scene && tag == "path")
                add_folder(e);
            else if (tag == "ref")
                read_reference(e, object, plugin);
            else if (const std::optional<Category> category = category_of(tag))
                read_nested(e, *category, object, plugin, depth, e.has("name") ? e.text("name") : Text{{}, e.at()});
            else if (is_value_tag(tag))
                read_property(e, object, plugin);
            else if (plugin.flags & flag::unsupported)
                skip(e);
            else
                unknown_tag(e, in_scene);
        }
        if (object->category == Category::texture) fold_uv_scale(*object);
    }

    [[noreturn]] void unknown_tag(const Element& e, bool in_scene) {
        std::vector<std::string> allowed = value_tags();
        for (const std::string& tag : object_tags()) allowed.push_back(tag);
        allowed.insert(allowed.end(), {"ref", "include"});
        if (in_scene) allowed.insert(allowed.end(), {"default", "alias", "path"});
        fail(e.at(), fmt::format("<{}> is not known here; allowed: {}", e.tag(), nearest_first(e.tag(), allowed)));
    }

    /// Skips an element; its $names count as used.
    void skip(const Element& e) {
        for (const pugi::xml_attribute& attribute : e.node.attributes()) e.text(attribute.name());
        for (const pugi::xml_node& child : e.node.children())
            if (child.type() == pugi::node_element) skip(e.with(child));
    }

    /// Calls visit(text) for each attribute of an element and of those in it, until it returns true.
    template <class Visit>
    static bool any_attribute(const pugi::xml_node& element, Visit&& visit) {
        const auto of_node = [&](const pugi::xml_node& node) {
            for (const pugi::xml_attribute& attribute : node.attributes())
                if (visit(attribute.value())) return true;
            return false;
        };
        return of_node(element) || element.find_node(of_node);
    }

    /// Leaves out an element that uses an absent parameter; its $names count as used.
    bool is_left_out(const Element& e) {
        if (!any_attribute(e.node, [&](std::string_view text) { return substitutions_.has_absent(text); }))
            return false;
        any_attribute(e.node, [&](std::string_view text) {
            substitutions_.leave_out(text);
            return false;
        });
        return true;
    }

    const PluginSchema& plugin_of(const Element& e, Category category, const Text& type) {
        const bool legacy = e.file->legacy;
        const PluginSchema* plugin = find_plugin(category, type.text);
        if (!plugin || ((plugin->flags & flag::legacy) && !legacy))
            fail(type.at, fmt::format("{} '{}' is not known; allowed: {}", name(category), type.text,
                                      nearest_first(type.text, plugin_names(category, legacy))));
        if (plugin->flags & flag::ignored)
            note(fmt::format("{} '{}': {}", name(category), type.text, said_of(category, type.text)));
        return *plugin;
    }

    void read_nested(const Element& e, Category category, const std::shared_ptr<Object>& parent,
                     const PluginSchema& parent_plugin, int depth, const Text& given_name) {
        if (category == Category::shape && is_left_out(e)) return;
        if (e.node == e.file->document.root())
            e.allow({"type", "id", "name", "version"});
        else
            e.allow({"type", "id", "name"});
        const Text type = e.text("type");
        const PluginSchema& plugin = plugin_of(e, category, type);
        const std::shared_ptr<Object> object = make_object(category, type.text, e.at(), e.file->legacy);
        if (plugin.flags & flag::unsupported)
            unsupported_.push_back(
                {object, type.at, fmt::format("{} '{}' is not supported yet", name(category), type.text)});
        if (e.has("id")) {
            const Text id = e.text("id");
            object->id = id.text;
            object->has_own_id = true;
            const auto [other, added] = by_id_.emplace(id.text, object);
            if (!added) fail(id.at, fmt::format("id '{}' exists already, at {}", id.text, other->second->at.where()));
        }
        read_children(e, object, plugin, depth + 1);
        attach(parent, parent_plugin, given_name.text, object, e.at(), parent->nested.size(), e.file->legacy);
    }

    void read_reference(const Element& e, const std::shared_ptr<Object>& parent, const PluginSchema& plugin) {
        e.allow({"id", "name"});
        pending_.push_back({parent, &plugin, e.has("name") ? e.text("name").text : std::string(), parent->nested.size(),
                            e.text("id"), e.file->legacy});
        parent->nested.emplace_back(nullptr, e.at());
    }

    /// Attaches `child` to the parent: as the parameter of that name, or among the unnamed children at index `slot`,
    /// which a reference has reserved.
    void attach(const std::shared_ptr<Object>& parent, const PluginSchema& plugin, const std::string& written_name,
                const std::shared_ptr<Object>& child, const Location& at, std::size_t slot, bool legacy) {
        const std::string key = legacy ? snake_case(written_name) : written_name;
        const Parameter* parameter = key.empty() ? nullptr : plugin.find(key);
        if (parameter && (parameter->flags & (legacy ? flag::modern : flag::legacy))) parameter = nullptr;
        const bool fits = parameter && child->category == Category::texture &&
                          ((parameter->flags & flag::textured) || parameter->kind == ValueKind::texture_only);
        if (fits) {
            add_property(parent, plugin, *parameter, ObjectPtr(child), at);
            return;
        }
        if (parameter)
            fail(at, fmt::format("{} '{}': parameter '{}' must be {}, not {}", name(plugin.category), plugin.type,
                                 parameter->name, expected_kinds(*parameter), name(child->category)));
        if (plugin.rule(child->category)) {
            // Children of a category with a rule may have any name, as in Mitsuba.
            if (slot < parent->nested.size())
                parent->nested[slot] = {child, at};
            else
                parent->nested.emplace_back(child, at);
            return;
        }
        if (plugin.flags & (flag::unsupported | flag::open)) {
            if (plugin.flags & flag::open)
                note_ignored(title(plugin, *parent), key.empty() ? std::string(name(child->category)) : key);
            else
                parent->nested.emplace_back(child, at);  // names what the plugin would use
            return;
        }
        std::string message;
        if (!key.empty()) {
            message = fmt::format("{} '{}' has no parameter '{}'; allowed: {}", name(plugin.category), plugin.type,
                                  written_name, nearest_first(written_name, parameter_names(plugin, legacy)));
        } else {
            std::vector<std::string> allowed;
            for (const ChildRule& rule : plugin.children) allowed.emplace_back(name(rule.category));
            message = fmt::format("{} '{}' takes no {} without a name; allowed: {}", name(plugin.category), plugin.type,
                                  name(child->category), nearest_first(name(child->category), allowed));
        }
        if (key.empty() || !legacy) fail(at, message);
        warn(at, message);
    }

    static std::string title(const PluginSchema& plugin, const Object& object) {
        return fmt::format("{} '{}'", name(plugin.category), object.plugin);
    }

    void add_property(const std::shared_ptr<Object>& object, const PluginSchema& plugin, const Parameter& parameter,
                      Value value, const Location& at) {
        if (object->has(parameter.name))
            fail(at, fmt::format("parameter '{}' is given twice, first at {}", parameter.name,
                                 object->find(parameter.name)->at.where()));
        if (parameter.flags & flag::unsupported)
            unsupported_.push_back(
                {object, at,
                 fmt::format("{}: parameter '{}' is not supported yet", title(plugin, *object), parameter.name)});
        if (parameter.flags & flag::ignored) note_ignored(title(plugin, *object), std::string(parameter.name));
        object->properties.push_back({std::string(parameter.name), std::move(value), at});
    }

    void read_property(const Element& e, const std::shared_ptr<Object>& object, const PluginSchema& plugin) {
        const Text written = e.text("name");
        const bool legacy = e.file->legacy;
        const std::string key = legacy ? snake_case(written.text) : written.text;
        const Parameter* parameter = plugin.find(key);
        if (legacy && object->category == Category::texture && read_uv_scale(e, *object, key)) return;
        const bool known = parameter && !(parameter->flags & (legacy ? flag::modern : flag::legacy));
        if (!known && (plugin.flags & (flag::unsupported | flag::open))) {
            skip(e);
            if (plugin.flags & flag::open) note_ignored(title(plugin, *object), written.text);
            return;
        }
        if (!known) {
            const std::string message =
                fmt::format("{} '{}' has no parameter '{}'; allowed: {}", name(plugin.category), plugin.type,
                            written.text, nearest_first(written.text, parameter_names(plugin, legacy)));
            if (!legacy) fail(written.at, message);
            // Its $names still count as used.
            if (e.has("value")) e.text("value");
            warn(written.at, message);
            return;
        }
        Value value =
            read_value(e, *parameter, plugin, [this](const Location& at, const std::string& text) { warn(at, text); });
        if (legacy) value = modern_value(key, std::move(value), e);
        const Location at = e.has("value") ? e.file->document.at(e.node, "value") : e.at();
        if (parameter->kind == ValueKind::file)
            pending_files_.push_back({object, object->properties.size(), e.text("value"), e.file->folders});
        add_property(object, plugin, *parameter, std::move(value), at);
    }

    /// Replaces values of the 0.x dialect alone by the nearest value in Mitsuba 3.
    Value modern_value(const std::string& key, Value value, const Element& e) {
        const auto* word = std::get_if<std::string>(&value);
        if (!word) return value;
        const Location at = e.file->document.at(e.node, "value");
        if (key == "distribution" && (*word == "phong" || *word == "as")) {
            warn(at, fmt::format("distribution '{}' is rendered as beckmann", *word));
            return std::string("beckmann");
        }
        if (key == "filter_type" && (*word == "trilinear" || *word == "ewa")) {
            note(fmt::format("texture filter '{}' is rendered as bilinear; many samples per pixel replace it", *word));
            return std::string("bilinear");
        }
        return value;
    }

    /// Reads uscale, vscale, uoffset, voffset of any 0.x texture; true when `key` is one of them.
    bool read_uv_scale(const Element& e, const Object& texture, const std::string& key) {
        if (key != "uscale" && key != "vscale" && key != "uoffset" && key != "voffset") return false;
        auto [entry, first] = uv_scales_.try_emplace(&texture, std::array<double, 4>{1, 1, 0, 0});
        const double value = parse_number(e.text("value"));
        entry->second[std::size_t((key[0] == 'v') + 2 * (key.ends_with("offset")))] = value;
        return true;
    }

    void fold_uv_scale(Object& texture) {
        const auto entry = uv_scales_.find(&texture);
        if (entry == uv_scales_.end()) return;
        const std::array<double, 4>& s = entry->second;
        texture.properties.push_back(
            {"to_uv", Matrix4d::translation(s[2], s[3], 0) * Matrix4d::scaling(s[0], s[1], 1), texture.at});
    }

    std::shared_ptr<Object> target_of(const Text& id) {
        std::string wanted = id.text;
        std::set<std::string> seen;
        for (auto alias = aliases_.find(wanted); alias != aliases_.end() && seen.insert(wanted).second;
             alias = aliases_.find(wanted))
            wanted = alias->second.text;
        const auto found = by_id_.find(wanted);
        if (found != by_id_.end()) return found->second;
        std::vector<std::string> known;
        for (const auto& [key, object] : by_id_) known.push_back(key);
        for (const auto& [key, other] : aliases_) known.push_back(key);
        constexpr std::size_t shown = 8;
        std::string list = nearest_first(id.text, known);
        std::size_t end = 0;
        for (std::size_t i = 0; i < shown && end != std::string::npos; ++i) end = list.find(", ", end + 1);
        if (end != std::string::npos) list = list.substr(0, end) + ", ...";
        fail(id.at, fmt::format("no object has the id '{}'; nearest: {}", id.text, list));
    }

    void resolve_references() {
        for (const auto& [as, id] : aliases_)
            if (const auto other = by_id_.find(as); other != by_id_.end())
                fail(id.at, fmt::format("alias '{}' is the id of an object, at {}", as, other->second->at.where()));
        for (const PendingRef& ref : pending_) {
            const std::shared_ptr<Object> target = target_of(ref.id);
            attach(ref.parent, *ref.parent_plugin, ref.name, target, ref.id.at, ref.nested_at, ref.legacy);
        }
        // Remove the reserved indices of references that became parameters, or nothing.
        for (const Made& made : objects_)
            std::erase_if(made.object->nested, [](const auto& child) { return child.first == nullptr; });
    }

    /// Adds implicit properties of an object that differ from the defaults of its plugin in Mitsuba 3.
    void spell_out_defaults() {
        const std::size_t n = objects_.size();
        for (std::size_t i = 0; i < n; ++i) {
            const std::shared_ptr<Object> object = objects_[i].object;
            const auto set = [&](std::string_view parameter, const char* value) {
                if (!object->has(parameter))
                    object->properties.push_back({std::string(parameter), std::string(value), object->at});
            };
            if (object->legacy && (object->plugin == "conductor" || object->plugin == "roughconductor")) {
                set("material", "Cu");
                set("ext_eta", "air");
            }
            if (object->category == Category::shape && object->has_child(Category::emitter) &&
                !object->has_child(Category::bsdf))
                object->nested.emplace_back(black_bsdf(object->at), object->at);
        }
    }

    /// Returns the BSDF of an emitter without one: black, in both dialects.
    ObjectPtr black_bsdf(const Location& at) {
        if (!black_bsdf_) {
            black_bsdf_ = make_object(Category::bsdf, "diffuse", at);
            black_bsdf_->id = "emitter-without-bsdf";
            black_bsdf_->properties.push_back({"reflectance", Spectrum(0.0f), at});
        }
        return black_bsdf_;
    }

    /// Finds meshes and textures in the folders of the main file, for every file that names them; then in those of the
    /// naming file.
    void find_files() {
        for (const PendingFile& pending : pending_files_) {
            Folders folders = reading_.front()->folders;
            for (const std::filesystem::path& folder : pending.folders)
                if (std::find(folders.begin(), folders.end(), folder) == folders.end()) folders.push_back(folder);
            const std::filesystem::path file = find_file(pending.name, folders);
            add_file(resources_, file);
            pending.object->properties[pending.property].value = file.string();
        }
    }

    /// Replaces an integrator that contains several others by the first of them.
    void keep_first_integrators() {
        for (const Made& made : objects_) {
            if (made.object->category != Category::integrator) continue;
            const std::size_t n = made.object->children(Category::integrator).size();
            if (n < 2) continue;
            note(fmt::format("integrator '{}': the first of its {} integrators is rendered", made.object->plugin, n));
            bool first = true;
            std::erase_if(made.object->nested, [&](const auto& child) {
                return child.first->category == Category::integrator && !std::exchange(first, false);
            });
        }
    }

    static bool belongs_to_shape(const Object& object) {
        return (object.category == Category::emitter && object.plugin == "area") ||
               (object.category == Category::sensor && object.plugin == "nlos_capture_meter");
    }

    /// Removes area emitters and captures of a relay wall from the top level, where they may be written for shapes to
    /// refer to.
    void drop_what_shapes_hold() {
        std::set<const Object*> held;
        for (const ObjectPtr& shape : scene_->children(Category::shape))
            for (const auto& [child, at] : shape->nested) held.insert(child.get());
        std::erase_if(scene_->nested, [&](const auto& child) {
            const Object& object = *child.first;
            if (!belongs_to_shape(object)) return false;
            if (!held.contains(&object))
                note(fmt::format("{} '{}' at {} has no effect: no shape refers to it", name(object.category),
                                 object.plugin, object.at.where()));
            return true;
        });
    }

    /// Keeps one sensor, among those of the scene and of its shapes in the order of the file.
    void choose_sensor(const std::string& wanted) {
        std::vector<const Object*> sensors;
        for (const auto& [child, at] : scene_->nested) {
            if (child->category == Category::sensor) sensors.push_back(child.get());
            if (child->category == Category::shape)
                for (const ObjectPtr& sensor : child->children(Category::sensor)) sensors.push_back(sensor.get());
        }
        if (sensors.empty()) return;
        const auto listed = [&](std::size_t i) {
            return fmt::format("{} ({} '{}')", i, sensors[i]->plugin, sensors[i]->id);
        };
        std::size_t chosen = 0;
        if (!wanted.empty()) {
            const auto named = std::find_if(sensors.begin(), sensors.end(),
                                            [&](const Object* o) { return o->has_own_id && o->id == wanted; });
            chosen = std::size_t(named - sensors.begin());
            if (named == sensors.end()) {
                const char* end = wanted.data() + wanted.size();
                const auto [stop, error] = std::from_chars(wanted.data(), end, chosen);
                if (error != std::errc{} || stop != end || chosen >= sensors.size()) {
                    std::vector<std::string> all;
                    for (std::size_t i = 0; i < sensors.size(); ++i) all.push_back(listed(i));
                    throw InputError(fmt::format("--sensor {}: the scene has no such sensor; it has {}", wanted,
                                                 fmt::join(all, ", ")));
                }
            }
        }
        if (sensors.size() > 1) {
            std::vector<std::string> others;
            for (std::size_t i = 0; i < sensors.size(); ++i)
                if (i != chosen) others.push_back(listed(i));
            note(fmt::format("sensor {} is rendered; --sensor chooses another: {}", listed(chosen),
                             fmt::join(others, ", ")));
        }
        description_.sensor = int(chosen);
        const auto is_other = [&](const auto& child) {
            return child.first->category == Category::sensor && child.first.get() != sensors[chosen];
        };
        std::erase_if(scene_->nested, is_other);
        for (const Made& made : objects_)
            if (made.object->category == Category::shape) std::erase_if(made.object->nested, is_other);
    }

    void check_used() {
        std::set<const Object*> used;
        for (const auto& [child, at] : scene_->nested)
            if (child->category == Category::shape || child->category == Category::emitter ||
                child->category == Category::sensor || child->category == Category::integrator)
                collect(*child, used);
        for (const Unsupported& found : unsupported_) {
            if (used.contains(found.object.get())) fail(found.at, found.message);
            note(fmt::format("{} ({}); it has no effect, nothing uses it", found.message, found.at.where()));
        }
    }

    static void collect(const Object& object, std::set<const Object*>& used) {
        if (!used.insert(&object).second) return;
        for (const auto& [child, at] : object.nested) collect(*child, used);
        for (const Property& property : object.properties)
            if (const auto* child = std::get_if<ObjectPtr>(&property.value)) collect(**child, used);
    }

    /// Clears the read flags: the reader's own checks have read parameters that may have no effect.
    void forget_reads() {
        for (const Made& made : objects_) {
            made.object->is_used = false;
            for (const Property& property : made.object->properties) property.is_read = false;
        }
    }

    void check_cycles() {
        std::map<const Object*, int> state;  // 1: on the current path, 2: done
        for (const Made& made : objects_) descend(*made.object, made.object->at, state);
    }

    void descend(const Object& object, const Location& at, std::map<const Object*, int>& state) {
        int& mine = state[&object];
        if (mine == 2) return;
        if (mine == 1) fail(at, fmt::format("'{}' contains itself: the reference is cyclic", object.id));
        mine = 1;
        for (const auto& [child, place] : object.nested) descend(*child, place, state);
        for (const Property& property : object.properties)
            if (const auto* child = std::get_if<ObjectPtr>(&property.value)) descend(**child, property.at, state);
        state[&object] = 2;
    }

    Substitutions substitutions_;
    SceneDescription description_;
    std::shared_ptr<Object> scene_;
    std::vector<Made> objects_;  // parents before the objects nested in them
    std::shared_ptr<Object> black_bsdf_;
    std::map<int, int> made_of_category_;
    std::map<std::string, std::shared_ptr<Object>> by_id_;
    std::map<std::string, Text> aliases_;
    std::vector<PendingRef> pending_;
    std::vector<PendingFile> pending_files_;
    std::vector<Unsupported> unsupported_;
    std::vector<SceneFile*> reading_;  // the main file, then the included files in progress
    std::map<const Object*, std::array<double, 4>> uv_scales_;
    std::map<std::string, std::vector<std::string>> ignored_;  // [plugin] parameters, for one note each
    std::set<std::string> open_files_, noted_;
    std::vector<std::string> resources_;
};

}  // namespace

SceneDescription read_scene(const std::filesystem::path& file, const Defines& defines, const std::string& sensor,
                            const std::set<std::string>& absent) {
    return Reader(file, defines, sensor, absent).take();
}

}  // namespace loom
