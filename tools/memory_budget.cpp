#include "tools/memory_budget.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>

#include "shm/scratch_file.h"

namespace fr::tools {

std::optional<uint64_t> parseMemorySize(std::string_view text) {
  double number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (error != std::errc() || !(number > 0) || !std::isfinite(number)) return std::nullopt;
  std::string unit;
  for (const char* c = end; c != text.data() + text.size(); ++c)
    unit += char(std::tolower(static_cast<unsigned char>(*c)));
  if (unit.size() > 1 && unit.ends_with("ib")) unit.resize(unit.size() - 2);
  if (unit.size() > 1 && unit.ends_with("b")) unit.pop_back();
  constexpr std::string_view kUnits = "kmgt";
  if (unit == "b") unit.clear();
  if (!unit.empty()) {
    const size_t power = unit.size() == 1 ? kUnits.find(unit[0]) : std::string_view::npos;
    if (power == std::string_view::npos) return std::nullopt;
    number *= std::pow(1024.0, double(power + 1));
  }
  if (number < 1048576 || number > 1e18) return std::nullopt;
  return uint64_t(number);
}

ScratchPlace::ScratchPlace(const MemoryOptions& options) {
  if (options.budget > 0 || !options.scratch.empty()) folder_ = shm::scratchFolder(options.scratch);
}

uint32_t textureKilobytes(const MemoryOptions& options) {
  return uint32_t(std::min<uint64_t>(options.budget / 8 / 1024, 1u << 30));
}

Result<std::unique_ptr<shm::Pager>> holdBudget(const MemoryOptions& options, cache::SceneCache& cache,
                                               std::function<pid_t()> peer,
                                               std::function<uint64_t(uint64_t)> giveBack) {
  if (options.budget == 0) return std::unique_ptr<shm::Pager>();
  shm::PagerOptions pager;
  pager.budget = options.budget;
  pager.peer = std::move(peer);
  pager.giveBack = std::move(giveBack);
  auto started = shm::Pager::start(std::move(pager), cache.pagedRanges());
  if (started) cache.setPager(started->get());
  return started;
}

}  // namespace fr::tools
