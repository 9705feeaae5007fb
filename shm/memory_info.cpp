#include "shm/memory_info.h"

#include <fcntl.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <optional>
#include <string>

#include "shm/file_descriptor.h"

namespace fr::shm {
namespace {

constexpr uint64_t kUnlimited = AvailableMemory::kUnlimited;

/// Whole text of a small file of the kernel's, at most 1 MB.
std::optional<std::string> readSmallFile(const std::string& path) {
  const FileDescriptor fd(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (!fd) return std::nullopt;
  std::string text;
  char buffer[4096];
  while (text.size() < (1u << 20)) {
    const ssize_t n = ::read(fd.get(), buffer, sizeof buffer);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return std::nullopt;
    if (n == 0) break;
    text.append(buffer, size_t(n));
  }
  return text;
}

std::string_view takeLine(std::string_view& text) {
  const size_t end = text.find('\n');
  const std::string_view line = text.substr(0, end);
  text.remove_prefix(end == std::string_view::npos ? text.size() : end + 1);
  return line;
}

std::optional<uint64_t> parseNumber(std::string_view text) {
  const size_t start = text.find_first_not_of(" \t\n");
  if (start == std::string_view::npos) return std::nullopt;
  text.remove_prefix(start);
  uint64_t v = 0;
  const auto [end, ec] = std::from_chars(text.data(), text.data() + text.size(), v);
  if (ec != std::errc()) return std::nullopt;
  return v;
}

/// The number after `key` at the start of a line ("Pss:   12 kB"), times `unit`.
std::optional<uint64_t> findValue(std::string_view text, std::string_view key, uint64_t unit) {
  while (!text.empty()) {
    const std::string_view line = takeLine(text);
    if (!line.starts_with(key)) continue;
    const std::optional<uint64_t> v = parseNumber(line.substr(key.size()));
    if (v && *v <= kUnlimited / unit) return *v * unit;
  }
  return std::nullopt;
}

std::string procPath(pid_t pid, const char* file) {
  return pid == 0 ? fmt::format("/proc/self/{}", file) : fmt::format("/proc/{}/{}", pid, file);
}

/// One level of a control group hierarchy.
void applyGroup(AvailableMemory& m, const std::string& folder, bool v2) {
  const auto limitText = readSmallFile(folder + (v2 ? "/memory.max" : "/memory.limit_in_bytes"));
  if (!limitText) return;
  const uint64_t limit = parseGroupLimit(*limitText);
  if (limit == kUnlimited) return;
  m.groupLimit = std::min(m.groupLimit, limit);
  const auto useText = readSmallFile(folder + (v2 ? "/memory.current" : "/memory.usage_in_bytes"));
  const uint64_t use = useText ? parseNumber(*useText).value_or(0) : 0;
  // File pages that the kernel can drop are counted as used by the group, but they do not stand in our way.
  const auto stat = readSmallFile(folder + "/memory.stat");
  const uint64_t reclaimable =
      stat ? findValue(*stat, v2 ? "inactive_file " : "total_inactive_file ", 1).value_or(0) : 0;
  const uint64_t held = use - std::min(use, reclaimable);
  m.groupFree = std::min(m.groupFree, limit - std::min(limit, held));
}

/// Our group and its parents, up to the root of the mount; inside a container only the root may be visible.
void applyGroups(AvailableMemory& m, const std::string& mount, std::string path, bool v2) {
  if (path.find("..") != std::string::npos) path.clear();
  while (!path.empty() && path != "/") {
    applyGroup(m, mount + path, v2);
    path.erase(path.rfind('/') == std::string::npos ? 0 : path.rfind('/'));
  }
  applyGroup(m, mount, v2);
}

}  // namespace

uint64_t parseMemAvailable(std::string_view meminfo) {
  return findValue(meminfo, "MemAvailable:", 1024).value_or(kUnlimited);
}

uint64_t parseGroupLimit(std::string_view text) {
  const std::optional<uint64_t> v = parseNumber(text);
  return !v || *v >= (1ull << 60) ? kUnlimited : *v;
}

uint64_t outOfMemoryKills() {
  const auto text = readSmallFile("/proc/vmstat");
  return text ? findValue(*text, "oom_kill ", 1).value_or(0) : 0;
}

Result<ProcessMemory> processMemory(pid_t pid) {
  const std::string path = procPath(pid, "smaps_rollup");
  const auto text = readSmallFile(path);
  if (!text || text->empty()) {
    return makeError(RiError::kSystem, "cannot read the memory use of process {} from {}: {}", pid, path,
                     text ? "empty" : std::strerror(errno));
  }
  auto value = [&](std::string_view key) { return findValue(*text, key, 1024).value_or(0); };
  ProcessMemory m;
  m.rss = value("Rss:");
  m.pss = value("Pss:");
  m.privateDirty = value("Private_Dirty:");
  m.privateBytes = value("Private_Clean:") + m.privateDirty;
  m.sharedBytes = value("Shared_Clean:") + value("Shared_Dirty:");
  m.swap = value("Swap:");
  return m;
}

AvailableMemory availableMemory() {
  AvailableMemory m;
  m.free = kUnlimited;
  m.physical = kUnlimited;
  if (const auto text = readSmallFile("/proc/meminfo")) {
    m.free = parseMemAvailable(*text);
    m.physical = findValue(*text, "MemTotal:", 1024).value_or(kUnlimited);
  }
  const auto groups = readSmallFile("/proc/self/cgroup");
  if (!groups) return m;
  // Lines are "id:controllers:path"; version 2 has id 0 and no controllers.
  std::string_view rest = *groups;
  while (!rest.empty()) {
    const std::string_view line = takeLine(rest);
    const size_t a = line.find(':');
    const size_t b = a == std::string_view::npos ? a : line.find(':', a + 1);
    if (b == std::string_view::npos) continue;
    const std::string controllers = fmt::format(",{},", line.substr(a + 1, b - a - 1));
    const std::string path(line.substr(b + 1));
    if (controllers == ",,") applyGroups(m, "/sys/fs/cgroup", path, true);
    if (controllers.find(",memory,") != std::string::npos)
      applyGroups(m, "/sys/fs/cgroup/memory", path, false);
  }
  return m;
}

Result<CpuTime> processCpuTime(pid_t pid) {
  const std::string path = procPath(pid, "stat");
  const auto text = readSmallFile(path);
  // The second field is the program's name in brackets; it may contain anything, brackets and blanks too.
  const size_t bracket = text ? text->rfind(')') : std::string::npos;
  if (bracket == std::string::npos) {
    return makeError(RiError::kSystem, "cannot read the processor time of process {}", pid);
  }
  std::string_view rest = std::string_view(*text).substr(bracket + 1);
  double ticks[2] = {};
  for (int field = 3; field <= 15; ++field) {
    const size_t start = rest.find_first_not_of(' ');
    if (start == std::string_view::npos) break;
    rest.remove_prefix(start);
    const size_t end = std::min(rest.find(' '), rest.size());
    if (field >= 14) ticks[field - 14] = double(parseNumber(rest.substr(0, end)).value_or(0));
    rest.remove_prefix(end);
  }
  const long perSecond = ::sysconf(_SC_CLK_TCK);
  const double tick = perSecond > 0 ? 1.0 / double(perSecond) : 0.01;
  return CpuTime{ticks[0] * tick, ticks[1] * tick};
}

}  // namespace fr::shm
