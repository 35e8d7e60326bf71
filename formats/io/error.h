#pragma once
#include <stdexcept>
#include <string>

namespace loom {

/// An unusable input: a file, a scene, an option. The message names the file and the location, and says what was
/// expected. A stage that throws it ends with exit code 2.
class InputError : public std::runtime_error {
  public:
    explicit InputError(const std::string& message) : std::runtime_error(message) {}
};

}  // namespace loom
