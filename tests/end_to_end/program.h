// Runs the built programs as a user would, and reads the pictures they wrote.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <vector>

namespace fr::test {

struct Outcome {
  int exitCode = -1;  // -1: ended by a signal
  int signal = 0;
  std::string out, err;
};

/// Runs build/bin/<name>, or the program with that path, with `arguments` in `directory`. `whileRunning(pid)`
/// is called once, right after the start; `inChild` in the new process before the program, for limits and
/// mounts. `standardInput`: a file to read, else the test's own.
Outcome run(const std::string& name, const std::vector<std::string>& arguments,
            const std::filesystem::path& directory, const std::function<void(int)>& whileRunning = {},
            const std::map<std::string, std::string>& environment = {},
            const std::filesystem::path& standardInput = {}, const std::function<void()>& inChild = {});

/// A fresh directory under the system's temporary folder, removed at the end of the test.
class Workspace {
 public:
  Workspace();
  ~Workspace();
  const std::filesystem::path& path() const { return path_; }
  std::filesystem::path write(const std::string& file, const std::string& text) const;

 private:
  std::filesystem::path path_;
};

struct Picture {
  int width = 0, height = 0;
  std::map<std::string, std::vector<float>> channels;
  float at(const std::string& channel, int x, int y) const {
    return channels.at(channel).at(size_t(y) * size_t(width) + size_t(x));
  }
  bool operator==(const Picture&) const = default;
};
/// Reads all channels of an OpenEXR file as floats; fails the test and returns an empty picture if it cannot.
Picture readExr(const std::filesystem::path& file);
/// Root mean square difference over all channels; infinity when sizes or channels differ.
double rmse(const Picture& a, const Picture& b);
/// Largest absolute difference.
double worst(const Picture& a, const Picture& b);

/// Children of a process that are alive now.
std::vector<int> childrenOf(int pid);

}  // namespace fr::test
