// A hard limit of memory for processes: a control group of Linux, version 1 or 2, where one can be made (by
// root, where the memory controller is there and groups may be made).
#pragma once

#include <unistd.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>

namespace fr::test {

class MemoryGroup {
 public:
  /// Whoever is in it and takes more than `bytes`, pages of files included, has pages taken away, or is
  /// killed. nullptr: none can be made here.
  static std::unique_ptr<MemoryGroup> make(uint64_t bytes) {
    const std::string name = "frankenrender-test-" + std::to_string(::getpid());
    const std::filesystem::path root = "/sys/fs/cgroup";
    for (const auto& [parent, limit] :
         {std::pair(root / "memory", "memory.limit_in_bytes"), std::pair(root, "memory.max")}) {
      std::error_code error;
      if (!std::filesystem::create_directory(parent / name, error) || error) continue;
      std::unique_ptr<MemoryGroup> group(new MemoryGroup(parent / name));
      if (std::filesystem::exists(group->path_ / limit) && write(group->path_ / limit, std::to_string(bytes)))
        return group;
    }
    return nullptr;
  }
  MemoryGroup(const MemoryGroup&) = delete;
  MemoryGroup& operator=(const MemoryGroup&) = delete;
  ~MemoryGroup() {
    std::error_code error;
    std::filesystem::remove(path_, error);
  }

  bool add(int pid) const { return write(path_ / "cgroup.procs", std::to_string(pid)); }

 private:
  explicit MemoryGroup(std::filesystem::path path) : path_(std::move(path)) {}
  static bool write(const std::filesystem::path& path, const std::string& text) {
    std::ofstream file(path);
    file << text;
    file.flush();
    return file.good();
  }
  std::filesystem::path path_;
};

}  // namespace fr::test
