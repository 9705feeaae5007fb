// A memory file that only grows and whose mapping never moves.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>

#include "base/error.h"

namespace fr::cache {

/// Anonymous shared memory, reserved in address space once and backed as it grows. Memory is really allocated
/// before it is handed out: exhaustion is an Error, never a SIGBUS. Not thread-safe.
class AppendSegment {
 public:
  static Result<AppendSegment> create(const char* name);
  AppendSegment(AppendSegment&& o) noexcept { *this = std::move(o); }
  AppendSegment& operator=(AppendSegment&& o) noexcept;
  ~AppendSegment();

  /// Makes [0, bytes) usable. Amortised: grows by an eighth at least.
  Result<void> reserve(uint64_t bytes);
  std::byte* data() { return base_; }
  const std::byte* data() const { return base_; }
  /// Cuts the file to `bytes`, forbids any later change (seals) and gives the descriptor away.
  Result<int> seal(uint64_t bytes);

 private:
  AppendSegment() = default;
  int fd_ = -1;
  std::byte* base_ = nullptr;
  uint64_t reservedAddresses_ = 0;
  uint64_t allocated_ = 0;
};

}  // namespace fr::cache
