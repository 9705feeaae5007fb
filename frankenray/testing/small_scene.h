// A scene whose answers are known, for the tests of both libraries, and running programs on it.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

namespace fr::test {

/// A folder of its own with "scene.rib"; removed at the end. World space, camera 100 away from its origin so
/// that cache space is another one:
///   a wall, z = 2, |x|, |y| <= 1: constant shader, color (1, 0.5, 0.25), opaque
///   a pane, z = 1, 4 <= x <= 6, |y| <= 1: opacity (0.25, 0.5, 0.75)
class SmallScene {
 public:
  SmallScene();
  ~SmallScene();
  SmallScene(const SmallScene&) = delete;
  const std::filesystem::path& folder() const { return folder_; }
  std::string rib() const { return (folder_ / "scene.rib").string(); }
  /// "/path/rendrib -rayserver /path/scene.rib"
  std::string command() const;

 private:
  std::filesystem::path folder_;
};

/// Path of the built rendrib.
std::string rendrib();

struct Outcome {
  int exitCode = -1;  // -1: ended by a signal
  std::string out, err;
  /// Lines of `out`.
  std::vector<std::string> lines() const;
};

/// Runs a program with text on its standard input. The variables RAYSERVER* are removed from its environment,
/// those of `environment` added. Its stdout and stderr are read to their ends, which come when it and all its
/// children have closed them.
Outcome runProgram(const std::vector<std::string>& words, const std::string& input,
                   const std::map<std::string, std::string>& environment,
                   const std::filesystem::path& folder);

/// Numbers of a line "1 2 3 | 4".
std::vector<double> numbers(const std::string& line);

}  // namespace fr::test
