// The numerical half of the virtual machine: one kernel per elementwise operation, chosen once for the CPU.
//
// A register holds `lanes` floats per component, lanes being a multiple of kLanePad; a uniform register holds
// its value kLanePad times. So one kernel serves every mixture of uniform and varying operands: an operand's
// index mask is either all ones or kLanePad - 1. A uniform result is the same kernel over kLanePad lanes.
// There are no scalar tails, so a point's result cannot depend on its place in the batch or on the size of
// the batch.
#pragma once

#include <cstddef>
#include <cstdint>

#include "shading/ir.h"
#include "shading/rare_case.h"

namespace fr {

inline constexpr uint32_t kLanePad = 16;
inline constexpr uint32_t padLanes(size_t n) { return uint32_t((n + kLanePad - 1) / kLanePad * kLanePad); }

/// Where an operand's floats are. Component c of lane i: data[c * component + (i & indexMask)]. 64-byte
/// aligned.
struct Operand {
  float* data = nullptr;
  uint32_t component = 0;             // floats from one component (or array element's component) to the next
  uint32_t indexMask = kLanePad - 1;  // kLanePad - 1: uniform; ~0: varying
  float* comp(uint32_t c) const { return data + size_t(c) * component; }
  bool varying() const { return indexMask != kLanePad - 1; }
  float at(uint32_t lane, uint32_t c = 0) const { return comp(c)[lane & indexMask]; }
};

struct KernelCall {
  const Operand* arg = nullptr;
  uint32_t argCount = 0;
  uint32_t lanes = 0;             // kLanePad when the result is uniform
  const int32_t* mask = nullptr;  // masked operations: -1 active, 0 not; always a whole batch or one block
  const float* matrix = nullptr;  // transforms: 16 floats, row vectors
  uint32_t mode = 0;              // kernel-specific
};
using Kernel = void (*)(const KernelCall&);

/// Kernels that are no operation of their own.
enum class Helper : uint32_t {
  transformPoint,      // out3, in3; matrix, divides by w when the matrix is a projection
  transformVector,     // out3, in3
  transformNormal,     // out3, in3; matrix is the one that carries points
  ctransform,          // out3, in3; mode = from * 8 + to (ColorSpace)
  subTriple,           // out3, a3, b3
  maskAndNonZero,      // out mask, in mask, float: out = in & (f != 0)   (masks as float registers)
  maskAndZero,         // out mask, in mask, float: out = in & (f == 0)
  maskAndNot,          // out, a, b: a & ~b
  maskAnd,             // out, a, b
  maskOr,              // out, a, b
  maskCone,            // out mask, in mask, L3, axis3, angle: angle(L, axis) < angle
  maskDifferent,       // out mask, a3, b3: any component differs in bits
  maskNonBlack,        // out mask, in mask, color3: any component not 0
  negateMasked,        // out3, in3; mask
  assignTripleMasked,  // out3, in3; mask
  assignFloatMasked,   // out, in; mask
  sanitize,            // inout: NaN and infinities become 0
  kCount
};

enum class ColorSpace : uint32_t { kRgb, kHsv, kHsl, kXyz, kXyY, kYiq };

/// Differences between neighbours: out[i] = (x[hi[i]] - x[lo[i]]) * scale[i] * cell[i], for columns of
/// `lanes` floats, one for each component. A neighbour that is not active is replaced by the point itself;
/// what is left of a central difference is then twice as steep.
struct Difference {
  const float* x = nullptr;
  const uint16_t *lo = nullptr, *hi = nullptr;
  const float *scale = nullptr, *cell = nullptr;                        // cell may be nullptr: 1
  const int32_t* mask = nullptr;                                        // nullptr: all neighbours are active
  uint32_t lanes = 0, components = 1, component = 0, outComponent = 0;  // the last two: from one to the next
  float* out = nullptr;                                                 // other columns than x
};

/// A column of hashes: hashStep(base, site), then a step down to `counter` or `next` where there is one.
struct SeedHash {
  const uint64_t* base = nullptr;  // nullptr: `one` for all lanes
  uint64_t one = 0, site = 0, next = 0;
  bool hasNext = false;
  const uint32_t* counter = nullptr;
  uint32_t lanes = 0;
  uint64_t* out = nullptr;   // may be `base`
  uint32_t* high = nullptr;  // upper halves, where somebody wants them
};
/// Columns of sobolOwen2(index, seed).
struct SobolPairs {
  uint32_t index = 0, lanes = 0;
  const uint32_t* seed = nullptr;
  float *x = nullptr, *y = nullptr;
};
/// Surroundings of points, from their neighbours in u and v: [0] and [1], nullptr where there are none.
struct Footprints {
  uint32_t lanes = 0;
  Operand P, givenRadius, givenSpread;
  const uint16_t *lo[2] = {}, *hi[2] = {};
  const float *scale[2] = {}, *cell[2] = {};
  float *radius = nullptr, *spread = nullptr;
  float* inward = nullptr;  // three columns: a small step into the surface from the border of a grid
};
/// Rays of `lanes` points. Columns need not be aligned.
struct RayMaking {
  uint32_t lanes = 0;
  Operand from, direction;  // the second: from `from`, or the end point
  bool toPoint = false;
  bool segment = false;          // directions keep their length
  Operand unit;                  // unit directions
  const float* shift = nullptr;  // three columns: of the origins
  Operand P;                     // the points themselves; no data: there are none
  const float *radius = nullptr, *spread = nullptr, *inward = nullptr;  // Footprints, or nullptr
  uint32_t shiftComponent = 0, inwardComponent = 0;                     // from one column to the next
  const uint16_t *lo[2] = {}, *hi[2] = {};  // where spread grows with how directions turn
  const float *scale[2] = {}, *cell[2] = {};
  const int32_t* neighbourMask = nullptr;  // nullptr: all neighbours are active
  Operand cone, samples;  // half angles of cones that directions are chosen from; no data: none
  bool cosine = false;
  uint32_t sample = 0, many = 1;  // so many samples of every point, from this one on
  size_t next = 0;  // floats from the columns `to` and `pair` of one sample to those of the next
  const uint32_t* seed = nullptr;
  float *origin[3] = {}, *to[3] = {}, *rayRadius = nullptr, *raySpread = nullptr;
  float* pair[2] = {};           // nullptr: nobody wants to know
  int32_t* onSurface = nullptr;  // the ray starts at the point itself
};

struct KernelTable {
  Kernel op[size_t(Op::kCount)] = {};  // nullptr: the machine does it
  Kernel helper[size_t(Helper::kCount)] = {};
  /// Rare cases for code that is made at run time: `in` and `results` hold `lanes` floats of every value,
  /// results change where `where` is set. nullptr where no such code is made.
  void (*rare[size_t(RareCase::kCount)])(const float* in, float* results, const int32_t* where) = {};
  uint32_t lanes = 0;  // of one vector
  void (*difference)(const Difference& d) = nullptr;
  /// `factor` times the cross product of two differences of three components, to u.out.
  void (*crossOfDifferences)(const Difference& u, const Difference& v, float factor) = nullptr;
  void (*hashSeeds)(const SeedHash& s) = nullptr;
  void (*sobolPairs)(const SobolPairs& s) = nullptr;
  void (*footprints)(const Footprints& f) = nullptr;
  void (*makeRays)(const RayMaking& r) = nullptr;
  /// True when any lane of the mask is set.
  bool (*anyActive)(const int32_t* mask, uint32_t lanes) = nullptr;
  uint32_t (*countActive)(const int32_t* mask, uint32_t lanes) = nullptr;
  /// Counts them on the way.
  uint32_t (*copyMask)(int32_t* to, const int32_t* from, uint32_t lanes) = nullptr;
};

/// The table of the instruction set that base/isa.h picks. Thread-safe.
const KernelTable& kernels();
/// Of a given set (0 sse4, 1 avx2, 2 avx512); the caller has checked that the CPU has it.
const KernelTable& kernelsOf(int isa);

}  // namespace fr
