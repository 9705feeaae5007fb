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

Result<MemoryBudget> MemoryBudget::hold(const MemoryOptions& options) {
  MemoryBudget b;
  if (options.budget > 0 || !options.scratch.empty()) b.folder_ = shm::scratchFolder(options.scratch);
  if (options.budget > 0) {
    auto pager = shm::Pager::start(options.budget);
    if (!pager) return std::move(pager).error();
    b.pager_ = *std::move(pager);
  }
  return b;
}

BudgetOfJob::BudgetOfJob(const MemoryBudget& budget, shm::PagerHooks hooks) : pager_(budget.pager()) {
  if (!pager_) return;
  pager_->setHooks(std::move(hooks));
}

BudgetOfJob::~BudgetOfJob() {
  if (!pager_) return;
  pager_->setHooks({});
}

uint32_t textureKilobytes(const MemoryOptions& options) {
  return uint32_t(std::min<uint64_t>(options.budget / 8 / 1024, 1u << 30));
}

}  // namespace fr::tools
