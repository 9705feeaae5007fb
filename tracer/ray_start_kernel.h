// Rays that leave one surface, eight at a time: what AnswerThread::startRay() and RayScene::leave() do of
// those that need no second look, to the same bits. Internal to tracer/.
#pragma once

#include <cstdint>

namespace fr::tracer {

inline constexpr uint32_t kRaysAtOnce = 8;

/// Columns of a batch of rays, as asked or as they are traced. Whoever asks may be writing: what is read is
/// read once.
struct AskedColumns {
  const float* origin[3];
  const float* direction[3];
  const float* normal[3];
};
struct StartedColumns {
  float* origin[3];
  float* direction[3];
};

/// What the surface that they leave does to them.
struct LeavingRays {
  float lift = 0;          // Departure::lift
  float grazing = -1;      // rays with smaller cosines to the normal need a second look
  bool onSurface = false;  // false: it is none, and origins stay
};

/// Starts rays [first, first + kRaysAtOnce). Returns which of them are right, as bits; what is written of the
/// others is not to be used.
using StartRays = uint32_t (*)(const AskedColumns& asked, uint32_t first, const LeavingRays& leaving,
                               const StartedColumns& started);
/// Turns rays [first, first + kRaysAtOnce) to directions within rounding of theirs (2^-20), as different from
/// them for every ray as their last bits are. Lengths change by no more.
using NudgeRays = void (*)(const StartedColumns& started, uint32_t first);
struct RayStartKernels {
  StartRays startRays;
  NudgeRays nudgeRays;
};
/// For this machine.
RayStartKernels rayStartKernels();

#define FR_RAY_START_KERNELS(isa)                                                           \
  namespace isa {                                                                           \
  uint32_t startRays(const AskedColumns& asked, uint32_t first, const LeavingRays& leaving, \
                     const StartedColumns& started);                                        \
  void nudgeRays(const StartedColumns& started, uint32_t first);                            \
  }
FR_RAY_START_KERNELS(sse4)
FR_RAY_START_KERNELS(avx2)
FR_RAY_START_KERNELS(avx512)
#undef FR_RAY_START_KERNELS

}  // namespace fr::tracer
