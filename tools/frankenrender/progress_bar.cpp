#include "tools/frankenrender/progress_bar.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdio>

namespace fr::tools {

ProgressBar::ProgressBar(bool enabled, std::string title) : enabled_(enabled), title_(std::move(title)) {}

ProgressBar::~ProgressBar() {
  if (drawn_) std::fputs("\r\033[K", stderr);
}

void ProgressBar::update(double fraction, std::string_view rate) {
  if (!enabled_) return;
  std::lock_guard lock(mutex_);
  const auto now = Clock::now();
  if (now - last_ < std::chrono::milliseconds(100)) return;
  last_ = now;
  drawn_ = true;
  fraction = std::clamp(fraction, 0.0, 1.0);
  const double seconds = std::chrono::duration<double>(now - start_).count();
  const int width = 36, filled = int(fraction * width);
  std::string left = fraction > 0.01 ? fmt::format("{:.0f} s left", seconds / fraction - seconds) : "";
  if (!rate.empty() && !left.empty()) left += ", ";
  fmt::print(stderr, "\r\033[K{} [{}{}] {:3.0f} % {}{}", title_, std::string(size_t(filled), '#'),
             std::string(size_t(width - filled), '.'), fraction * 100, left, rate);
  std::fflush(stderr);
}

}  // namespace fr::tools
