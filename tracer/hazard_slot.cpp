#include "tracer/hazard_slot.h"

#include "base/error.h"

namespace fr::tracer {

std::array<HazardSlot, HazardSlot::kMostThreads>& HazardSlot::all() {
  static std::array<HazardSlot, kMostThreads> slots;
  return slots;
}

struct HazardSlotOwner {
  HazardSlot* slot = nullptr;
  HazardSlotOwner() {
    for (HazardSlot& s : HazardSlot::all())
      if (!s.taken_.load(std::memory_order_relaxed) && !s.taken_.exchange(true, std::memory_order_acq_rel)) {
        slot = &s;
        return;
      }
    FR_CHECK(false);
  }
  ~HazardSlotOwner() {
    slot->release();
    slot->taken_.store(false, std::memory_order_release);
  }
};

HazardSlot& HazardSlot::mine() {
  static thread_local HazardSlotOwner owner;
  return *owner.slot;
}

bool HazardSlot::isHeld(const void* p) {
  for (const HazardSlot& s : all())
    if (s.held_.load(std::memory_order_seq_cst) == p) return true;
  return false;
}

}  // namespace fr::tracer
