// A progress bar on a terminal line.
#pragma once

#include <chrono>
#include <mutex>
#include <string>
#include <string_view>

namespace fr::tools {

/// Thread-safe. Draws at most ten times a second on stderr; the destructor clears the line.
class ProgressBar {
 public:
  ProgressBar(bool enabled, std::string title);
  ~ProgressBar();
  /// fraction in [0,1]. `rate`: how fast it goes, in words.
  void update(double fraction, std::string_view rate = {});

 private:
  using Clock = std::chrono::steady_clock;
  bool enabled_, drawn_ = false;
  std::string title_;
  std::mutex mutex_;
  Clock::time_point start_ = Clock::now(), last_{};
};

}  // namespace fr::tools
