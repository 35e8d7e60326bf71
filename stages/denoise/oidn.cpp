#include "stages/denoise/oidn.h"

#include <dlfcn.h>
#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <stdexcept>

#include "formats/io/error.h"

namespace loom::denoise {
namespace {

namespace fs = std::filesystem;

constexpr const char* library_name = "libOpenImageDenoise.so.2";

// The used part of the C interface, version 2.
using Device = struct OidnDevice*;
using Filter = struct OidnFilter*;
constexpr int device_cpu = 1, format_float3 = 3, error_none = 0;

/// Handle of a device or filter, released by the destructor.
template <class Handle>
using Owned = std::unique_ptr<std::remove_pointer_t<Handle>, void (*)(Handle)>;

}  // namespace

struct Oidn::Library {
    void* handle;
    Device (*new_device)(int type);
    void (*set_device_bool)(Device, const char* name, bool);
    void (*set_device_int)(Device, const char* name, int);
    int (*get_device_int)(Device, const char* name);
    int (*get_device_error)(Device, const char** message);
    void (*commit_device)(Device);
    void (*release_device)(Device);
    Filter (*new_filter)(Device, const char* type);
    void (*set_shared_filter_image)(Filter, const char* name, void*, int format, std::size_t width, std::size_t height,
                                    std::size_t byte_offset, std::size_t pixel_stride, std::size_t row_stride);
    void (*set_filter_bool)(Filter, const char* name, bool);
    void (*commit_filter)(Filter);
    void (*execute_filter)(Filter);
    void (*release_filter)(Filter);

    // Never closed: its thread pool ends with the process.
    explicit Library(const char* path) : handle(dlopen(path, RTLD_NOW | RTLD_LOCAL)) {
        if (!handle) throw std::runtime_error(dlerror());
        find(new_device, "oidnNewDevice");
        find(set_device_bool, "oidnSetDeviceBool");
        find(set_device_int, "oidnSetDeviceInt");
        find(get_device_int, "oidnGetDeviceInt");
        find(get_device_error, "oidnGetDeviceError");
        find(commit_device, "oidnCommitDevice");
        find(release_device, "oidnReleaseDevice");
        find(new_filter, "oidnNewFilter");
        find(set_shared_filter_image, "oidnSetSharedFilterImage");
        find(set_filter_bool, "oidnSetFilterBool");
        find(commit_filter, "oidnCommitFilter");
        find(execute_filter, "oidnExecuteFilter");
        find(release_filter, "oidnReleaseFilter");
        device(0);
    }

    /// Makes a device with `threads` threads (0: all).
    Owned<Device> device(int threads) const {
        Owned<Device> made(new_device(device_cpu), release_device);
        if (!made) check(nullptr);
        if (threads > 0) set_device_int(made.get(), "numThreads", threads);
        set_device_bool(made.get(), "setAffinity", false);
        commit_device(made.get());
        check(made.get());
        return made;
    }

    void check(Device device) const {
        const char* message = nullptr;
        if (get_device_error(device, &message) != error_none)
            throw std::runtime_error(fmt::format("Open Image Denoise: {}", message ? message : "unknown error"));
        if (!device) throw std::runtime_error("Open Image Denoise: no device");
    }

  private:
    template <class Function>
    void find(Function& function, const char* name) const {
        function = reinterpret_cast<Function>(dlsym(handle, name));
        if (!function) throw std::runtime_error(fmt::format("{} has no {}", library_name, name));
    }
};

std::optional<Oidn> Oidn::load(const std::string& path, std::string& missing) {
    const auto open = [](const fs::path& library) {
        Oidn oidn;
        oidn.library_ = std::make_shared<const Library>(library.c_str());
        return oidn;
    };
    // Resolve links: the library loads its other parts from its real folder.
    const auto in_folder = [](const fs::path& place) {
        return fs::canonical(fs::is_directory(place) ? place / library_name : place);
    };

    const char* variable = std::getenv("LOOM_OIDN");
    const std::string named = !path.empty() ? path : variable ? variable : "";
    if (!named.empty()) {
        try {
            return open(in_folder(named));
        } catch (const std::exception& failure) {
            throw InputError(fmt::format("{} {}: {}", path.empty() ? "LOOM_OIDN" : "--oidn", named, failure.what()));
        }
    }
    std::error_code none;
    const fs::path beside =
        fs::read_symlink("/proc/self/exe", none).parent_path().parent_path() / "oidn" / library_name;
    try {
        return open(fs::exists(beside, none) ? in_folder(beside) : fs::path(library_name));
    } catch (const std::exception& failure) {
        missing = failure.what();
        return std::nullopt;
    }
}

std::string Oidn::version() const {
    const auto device = library_->device(0);
    const auto part = [&](const char* name) { return library_->get_device_int(device.get(), name); };
    return fmt::format("{}.{}.{}", part("versionMajor"), part("versionMinor"), part("versionPatch"));
}

void Oidn::denoise(const Layers& layers, int threads, std::vector<float> (&color)[3]) const {
    const std::size_t n = layers.n_pixels();
    const auto interleaved = [n](const std::span<const float>(&channels)[3], float sign, float low, float high) {
        std::vector<float> triples(3 * n);
        for (std::size_t c = 0; c < 3; ++c)
            for (std::size_t i = 0; i < n; ++i) triples[3 * i + c] = std::clamp(sign * channels[c][i], low, high);
        return triples;
    };
    std::vector<float> albedo, normal;
    if (!layers.albedo[0].empty()) albedo = interleaved(layers.albedo, 1, 0, 1);
    if (!albedo.empty() && !layers.normal[0].empty()) normal = interleaved(layers.normal, 1, -1, 1);

    const Library& oidn = *library_;
    const auto device = oidn.device(threads);
    for (auto& channel : color) channel.assign(n, 0.0f);
    for (const float sign : {1.0f, -1.0f}) {
        std::vector<float> part = interleaved(layers.color, sign, 0, std::numeric_limits<float>::max());
        if (std::all_of(part.begin(), part.end(), [](float x) { return x == 0; })) continue;
        std::vector<float> clean(3 * n);
        const Owned<Filter> filter(oidn.new_filter(device.get(), "RT"), oidn.release_filter);
        const auto image = [&](const char* name, std::vector<float>& values) {
            if (values.empty()) return;
            oidn.set_shared_filter_image(filter.get(), name, values.data(), format_float3, layers.width, layers.height,
                                         0, 0, 0);
        };
        image("color", part);
        image("albedo", albedo);
        image("normal", normal);
        image("output", clean);
        oidn.set_filter_bool(filter.get(), "hdr", true);
        oidn.set_filter_bool(filter.get(), "cleanAux", false);
        oidn.commit_filter(filter.get());
        oidn.execute_filter(filter.get());
        oidn.check(device.get());
        for (std::size_t c = 0; c < 3; ++c)
            for (std::size_t i = 0; i < n; ++i) color[c][i] += sign * clean[3 * i + c];
    }
}

}  // namespace loom::denoise
