// Reads the XML tree into objects; references are kept aside and filled in when all ids are known.

#include <fmt/format.h>

#include <algorithm>
#include <optional>
#include <set>

#include "formats/io/error.h"
#include "stages/core/scene/description_values.h"

namespace loom {
namespace {

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
    std::size_t nested_at;  // where its child stands among the parent's nested objects
    Text id;
    bool legacy;
};

class Reader {
  public:
    Reader(const std::filesystem::path& file, const Defines& defines) : substitutions_(defines) {
        const std::string name = file.string();
        SceneFile main{XmlDocument(file, name), file.parent_path(), file.parent_path()};
        scene_ = make_object(Category::scene, "scene", main.document.at(main.document.root()));
        description_.files.push_back(name);
        open_files_.insert(canonical(file));
        try {
            read_file(std::move(main));
            resolve_references();
            spell_out_defaults();
            check_cycles();
            for (std::size_t i = objects_.size(); i-- > 0;)
                check_object(*objects_[i].object, *objects_[i].plugin);
            substitutions_.check_all_used();
        } catch (...) {
            // References may have closed a ring of shared pointers: open it.
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
        objects_.push_back(
            {object, category == Category::scene ? &scene_schema() : find_plugin(category, type)});
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

    void read_file(SceneFile file) {
        const Element root{file.document.root(), &file, &substitutions_};
        if (root.tag() != "scene")
            fail(root.at(), fmt::format("<{}> is not a Mitsuba scene; expected <scene>", root.tag()));
        root.allow({"version", "id"});
        const Text version = root.text("version");
        const int major = std::atoi(version.text.c_str());
        if (version.text.empty() || !std::isdigit(static_cast<unsigned char>(version.text[0])) ||
            major == 1 || major > 3)
            fail(version.at,
                 fmt::format("version '{}' is not known; expected 0.5, 0.6, 2.x or 3.x", version.text));
        file.legacy = major == 0;
        read_children(root, scene_, scene_schema(), 1);
    }

    void include(const Element& e) {
        e.allow({"filename"});
        const Text name = e.text("filename");
        std::filesystem::path path = e.file->folder / name.text;
        if (!std::filesystem::is_regular_file(path)) path = find_file(name, *e.file);
        const std::string key = canonical(path);
        if (open_files_.contains(key))
            fail(name.at, fmt::format("'{}' includes itself, directly or through others", name.text));
        open_files_.insert(key);
        const std::string shown = path.lexically_normal().string();
        if (std::find(description_.files.begin(), description_.files.end(), shown) ==
            description_.files.end())
            description_.files.push_back(shown);
        read_file({XmlDocument(path, shown), path.parent_path(), e.file->main_folder});
        open_files_.erase(key);
    }

    void set_default(const Element& e) {
        e.allow({"name", "value"});
        substitutions_.set_default(e.text("name").text, e.text("value").text);
    }

    void add_alias(const Element& e) {
        e.allow({"id", "as"});
        const Text id = e.text("id"), as = e.text("as");
        const auto [other, added] = aliases_.emplace(as.text, id);
        if (!added)
            fail(as.at, fmt::format("alias '{}' exists already, at {}", as.text, other->second.at.where()));
    }

    void read_children(const Element& parent, const std::shared_ptr<Object>& object,
                       const PluginSchema& plugin, int depth) {
        constexpr int deepest = 64;
        if (depth > deepest) fail(parent.at(), fmt::format("objects are nested deeper than {}", deepest));
        const bool in_scene = object == scene_;
        for (const pugi::xml_node& node : parent.node.children()) {
            const Element e = parent.with(node);
            if (node.type() != pugi::node_element) fail(e.at(), "unexpected text");
            const std::string_view tag = e.tag();
            if (in_scene && tag == "default")
                set_default(e);
            else if (in_scene && tag == "include")
                include(e);
            else if (in_scene && tag == "alias")
                add_alias(e);
            else if (tag == "ref")
                read_reference(e, object, plugin);
            else if (const std::optional<Category> category = category_of(tag))
                read_nested(e, *category, object, plugin, depth);
            else if (is_value_tag(tag))
                read_property(e, object, plugin);
            else
                unknown_tag(e, in_scene);
        }
        if (object->category == Category::texture) fold_uv_scale(*object);
    }

    [[noreturn]] void unknown_tag(const Element& e, bool in_scene) {
        std::vector<std::string> allowed = value_tags();
        for (const std::string& tag : object_tags()) allowed.push_back(tag);
        allowed.push_back("ref");
        if (in_scene) allowed.insert(allowed.end(), {"default", "include", "alias"});
        fail(e.at(),
             fmt::format("<{}> is not known here; allowed: {}", e.tag(), nearest_first(e.tag(), allowed)));
    }

    const PluginSchema& plugin_of(const Element& e, Category category, const Text& type) {
        const bool legacy = e.file->legacy;
        const PluginSchema* plugin = find_plugin(category, type.text);
        if (!plugin || ((plugin->flags & flag::legacy) && !legacy))
            fail(type.at, fmt::format("{} '{}' is not known; allowed: {}", name(category), type.text,
                                      nearest_first(type.text, plugin_names(category, legacy))));
        if (plugin->flags & flag::unsupported)
            fail(type.at, fmt::format("{} '{}' is not supported yet", name(category), type.text));
        if (plugin->flags & flag::ignored)
            note(fmt::format("{} '{}': only its depths, sizes and counts are read", name(category),
                             type.text));
        return *plugin;
    }

    void read_nested(const Element& e, Category category, const std::shared_ptr<Object>& parent,
                     const PluginSchema& parent_plugin, int depth) {
        e.allow({"type", "id", "name"});
        const Text type = e.text("type");
        const PluginSchema& plugin = plugin_of(e, category, type);
        const std::shared_ptr<Object> object = make_object(category, type.text, e.at(), e.file->legacy);
        if (e.has("id")) {
            const Text id = e.text("id");
            object->id = id.text;
            object->has_own_id = true;
            const auto [other, added] = by_id_.emplace(id.text, object);
            if (!added)
                fail(id.at, fmt::format("id '{}' exists already, at {}", id.text, other->second->at.where()));
        }
        read_children(e, object, plugin, depth + 1);
        const Text name_text = e.has("name") ? e.text("name") : Text{{}, e.at()};
        attach(parent, parent_plugin, name_text.text, object, e.at(), parent->nested.size(), e.file->legacy);
    }

    void read_reference(const Element& e, const std::shared_ptr<Object>& parent, const PluginSchema& plugin) {
        e.allow({"id", "name"});
        pending_.push_back({parent, &plugin, e.has("name") ? e.text("name").text : std::string(),
                            parent->nested.size(), e.text("id"), e.file->legacy});
        parent->nested.emplace_back(nullptr, e.at());
    }

    /// Gives `child` its place in the parent: as the parameter of that name, or among the unnamed children.
    /// `slot` is where it stands there; a reference has kept that place free.
    void attach(const std::shared_ptr<Object>& parent, const PluginSchema& plugin,
                const std::string& written_name, const std::shared_ptr<Object>& child, const Location& at,
                std::size_t slot, bool legacy) {
        const std::string key = legacy ? snake_case(written_name) : written_name;
        const Parameter* parameter = key.empty() ? nullptr : plugin.find(key);
        const bool fits = parameter && child->category == Category::texture &&
                          ((parameter->flags & flag::textured) || parameter->kind == ValueKind::texture_only);
        if (fits) {
            add_property(*parent, plugin, *parameter, ObjectPtr(child), at);
            return;
        }
        if (parameter)
            fail(at,
                 fmt::format("{} '{}': parameter '{}' must be {}, not {}", name(plugin.category), plugin.type,
                             parameter->name, expected_kinds(*parameter), name(child->category)));
        if (plugin.rule(child->category)) {
            // Children of a category with a rule may bear any name, as in Mitsuba.
            if (slot < parent->nested.size())
                parent->nested[slot] = {child, at};
            else
                parent->nested.emplace_back(child, at);
            return;
        }
        std::string message;
        if (!key.empty()) {
            message =
                fmt::format("{} '{}' has no parameter '{}'; allowed: {}", name(plugin.category), plugin.type,
                            written_name, nearest_first(written_name, parameter_names(plugin, legacy)));
        } else {
            std::vector<std::string> allowed;
            for (const ChildRule& rule : plugin.children) allowed.emplace_back(name(rule.category));
            message =
                fmt::format("{} '{}' takes no unnamed {}; allowed: {}", name(plugin.category), plugin.type,
                            name(child->category), nearest_first(name(child->category), allowed));
        }
        if (key.empty() || !legacy) fail(at, message);
        warn(at, message);
    }

    void add_property(Object& object, const PluginSchema& plugin, const Parameter& parameter, Value value,
                      const Location& at) {
        if (object.has(parameter.name))
            fail(at, fmt::format("parameter '{}' is given twice, first at {}", parameter.name,
                                 object.find(parameter.name)->at.where()));
        if (parameter.flags & flag::unsupported)
            fail(at, fmt::format("{} '{}': parameter '{}' is not supported yet", name(plugin.category),
                                 plugin.type, parameter.name));
        if (parameter.flags & flag::ignored)
            note_ignored(fmt::format("{} '{}'", name(plugin.category), plugin.type),
                         std::string(parameter.name));
        object.properties.push_back({std::string(parameter.name), std::move(value), at});
    }

    void read_property(const Element& e, const std::shared_ptr<Object>& object, const PluginSchema& plugin) {
        const Text written = e.text("name");
        const bool legacy = e.file->legacy;
        const std::string key = legacy ? snake_case(written.text) : written.text;
        const Parameter* parameter = plugin.find(key);
        if (legacy && object->category == Category::texture && read_uv_scale(e, *object, key)) return;
        if (!parameter || ((parameter->flags & flag::legacy) && !legacy)) {
            const std::string message =
                fmt::format("{} '{}' has no parameter '{}'; allowed: {}", name(plugin.category), plugin.type,
                            written.text, nearest_first(written.text, parameter_names(plugin, legacy)));
            if (!legacy) fail(written.at, message);
            // Its $names count as used all the same.
            if (e.has("value")) e.text("value");
            warn(written.at, message);
            return;
        }
        Value value = read_value(e, *parameter, plugin,
                                 [this](const Location& at, const std::string& text) { warn(at, text); });
        if (legacy) value = modern_value(key, std::move(value), e);
        if (parameter->kind == ValueKind::file) {
            const auto& file = std::get<std::string>(value);
            if (std::find(resources_.begin(), resources_.end(), file) == resources_.end())
                resources_.push_back(file);
        }
        const Location at = e.has("value") ? e.file->document.at(e.node, "value") : e.at();
        add_property(*object, plugin, *parameter, std::move(value), at);
    }

    /// Values that only the 0.x dialect has, as the nearest that Mitsuba 3 knows.
    Value modern_value(const std::string& key, Value value, const Element& e) {
        const auto* word = std::get_if<std::string>(&value);
        if (!word) return value;
        const Location at = e.file->document.at(e.node, "value");
        if (key == "distribution" && (*word == "phong" || *word == "as")) {
            warn(at, fmt::format("distribution '{}' is rendered as beckmann", *word));
            return std::string("beckmann");
        }
        if (key == "filter_type" && (*word == "trilinear" || *word == "ewa")) {
            note(fmt::format("texture filter '{}' is bilinear here: many samples per pixel do the rest",
                             *word));
            return std::string("bilinear");
        }
        return value;
    }

    /// 0.x: uscale, vscale, uoffset, voffset of any texture; true when `key` is one of them.
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
        for (const PendingRef& ref : pending_) {
            const std::shared_ptr<Object> target = target_of(ref.id);
            attach(ref.parent, *ref.parent_plugin, ref.name, target, ref.id.at, ref.nested_at, ref.legacy);
        }
        // A reference that became a parameter, or nothing, leaves its place free.
        for (const Made& made : objects_)
            std::erase_if(made.object->nested, [](const auto& child) { return child.first == nullptr; });
    }

    /// Adds what an object means without saying it, where that is not the default of its plugin in Mitsuba 3.
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

    /// What an emitter without BSDF scatters: nothing, in both dialects.
    ObjectPtr black_bsdf(const Location& at) {
        if (!black_bsdf_) {
            black_bsdf_ = make_object(Category::bsdf, "diffuse", at);
            black_bsdf_->id = "emitter-without-bsdf";
            black_bsdf_->properties.push_back({"reflectance", Spectrum(0.0f), at});
        }
        return black_bsdf_;
    }

    void check_cycles() {
        std::map<const Object*, int> state;  // 1: on the way down, 2: done
        for (const Made& made : objects_) descend(*made.object, made.object->at, state);
    }

    void descend(const Object& object, const Location& at, std::map<const Object*, int>& state) {
        int& mine = state[&object];
        if (mine == 2) return;
        if (mine == 1) fail(at, fmt::format("'{}' contains itself: the reference is cyclic", object.id));
        mine = 1;
        for (const auto& [child, place] : object.nested) descend(*child, place, state);
        for (const Property& property : object.properties)
            if (const auto* child = std::get_if<ObjectPtr>(&property.value))
                descend(**child, property.at, state);
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
    std::map<const Object*, std::array<double, 4>> uv_scales_;
    std::map<std::string, std::vector<std::string>> ignored_;  // parameters by plugin, for one note each
    std::set<std::string> open_files_, noted_;
    std::vector<std::string> resources_;
};

}  // namespace

SceneDescription read_scene(const std::filesystem::path& file, const Defines& defines) {
    return Reader(file, defines).take();
}

}  // namespace loom
