// What a thread is using right now, so that others do not free it (Michael, "Hazard pointers", 2004).
// Internal to tracer/.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>

namespace fr::tracer {

/// One thing at a time, for each thread of the process.
///
/// Protocol: a reader loads the pointer P from its place, stores P into its slot, and loads the place again;
/// only when that still says P may it use *P. Who takes P out of its place does so first, and frees *P only
/// after isHeld(P) was false once. SYNC: both of the reader's accesses and both of the freer's (the exchange
/// on the place, the load of the slot) are sequentially consistent: either the reader sees that P has gone,
/// or the freer sees the slot.
class alignas(64) HazardSlot {
 public:
  static constexpr size_t kMostThreads = 1024;

  /// This thread's slot; it is given back when the thread ends. Ends the program when there are too many
  /// threads.
  static HazardSlot& mine();
  static bool isHeld(const void* p);

  template <class T>
  const T* hold(const std::atomic<const T*>& place) {
    for (const T* p = place.load(std::memory_order_acquire);;) {
      if (!p) return nullptr;
      held_.store(p, std::memory_order_seq_cst);
      const T* again = place.load(std::memory_order_seq_cst);
      if (again == p) return p;
      p = again;
      if (!p) release();
    }
  }
  /// SYNC: release: what was read through the pointer happened before it is freed.
  void release() { held_.store(nullptr, std::memory_order_release); }

 private:
  friend struct HazardSlotOwner;
  static std::array<HazardSlot, kMostThreads>& all();

  std::atomic<const void*> held_{nullptr};
  std::atomic<bool> taken_{false};
};

}  // namespace fr::tracer
