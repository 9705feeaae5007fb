// Vectors that record what is done to them: what simd.h is made of when kernels are turned into graphs.
//
// The operators of simd_native.h's vector types, appending to the graph that is being built on this thread.
#pragma once

#include <cstdint>

#include "shading/value_graph.h"

#define FR_INLINE static inline __attribute__((unused))

namespace fr::FR_ISA {

inline constexpr uint32_t kLanes = 1;

/// The graph that is being built on this thread; see RecordingScope.
ValueGraph& graph();

struct VI;
struct VU;
struct V {
  NodeIndex node = 0;  // 0.0
  V() = default;
  explicit V(NodeIndex n) : node(n) {}
};
struct VI {
  NodeIndex node = 0;
  VI() = default;
  explicit VI(NodeIndex n) : node(n) {}
  explicit VI(VU u);
};
struct VU {
  NodeIndex node = 0;
  VU() = default;
  explicit VU(NodeIndex n) : node(n) {}
  explicit VU(VI i) : node(i.node) {}
};
inline VI::VI(VU u) : node(u.node) {}

FR_INLINE V splat(float f) { return V(graph().constant(f)); }
FR_INLINE VI splatInt(int32_t i) { return VI(graph().constant(uint32_t(i))); }
FR_INLINE VU splatUint(uint32_t i) { return VU(graph().constant(i)); }

#define FR_FLOAT_OPERATOR(sign, op)                                                               \
  FR_INLINE V operator sign(V a, V b) { return V(graph().binary(VectorOp::op, a.node, b.node)); } \
  FR_INLINE V operator sign(V a, float b) { return a sign splat(b); }                             \
  FR_INLINE V operator sign(float a, V b) { return splat(a) sign b; }                             \
  FR_INLINE V& operator sign##=(V& a, V b) { return a = a sign b; }                               \
  FR_INLINE V& operator sign##=(V& a, float b) { return a = a sign splat(b); }
FR_FLOAT_OPERATOR(+, kAdd)
FR_FLOAT_OPERATOR(-, kSub)
FR_FLOAT_OPERATOR(*, kMul)
FR_FLOAT_OPERATOR(/, kDiv)
#undef FR_FLOAT_OPERATOR
FR_INLINE V operator-(V a) {
  return V(graph().binary(VectorOp::kXor, a.node, graph().constant(0x80000000u)));
}

FR_INLINE VI compare(Compare c, V a, V b) {
  return VI(graph().binary(VectorOp::kCompare, a.node, b.node, uint32_t(c)));
}
#define FR_COMPARISON(sign, ...)                                       \
  FR_INLINE VI operator sign(V a, V b) { return __VA_ARGS__; }         \
  FR_INLINE VI operator sign(V a, float b) { return a sign splat(b); } \
  FR_INLINE VI operator sign(float a, V b) { return splat(a) sign b; }
FR_COMPARISON(==, compare(Compare::kEqual, a, b))
FR_COMPARISON(!=, compare(Compare::kNotEqual, a, b))
FR_COMPARISON(<, compare(Compare::kLess, a, b))
FR_COMPARISON(<=, compare(Compare::kLessEqual, a, b))
FR_COMPARISON(>, compare(Compare::kLess, b, a))
FR_COMPARISON(>=, compare(Compare::kLessEqual, b, a))
#undef FR_COMPARISON

#define FR_INTEGER_OPERATOR(type, scalar, splatted, sign, op)                   \
  FR_INLINE type operator sign(type a, type b) {                                \
    return type(graph().binary(VectorOp::op, a.node, b.node));                  \
  }                                                                             \
  FR_INLINE type operator sign(type a, scalar b) { return a sign splatted(b); } \
  FR_INLINE type& operator sign##=(type& a, type b) { return a = a sign b; }    \
  FR_INLINE type& operator sign##=(type& a, scalar b) { return a = a sign splatted(b); }
FR_INTEGER_OPERATOR(VI, int32_t, splatInt, +, kAddInt)
FR_INTEGER_OPERATOR(VI, int32_t, splatInt, -, kSubInt)
FR_INTEGER_OPERATOR(VI, int32_t, splatInt, &, kAnd)
FR_INTEGER_OPERATOR(VI, int32_t, splatInt, |, kOr)
FR_INTEGER_OPERATOR(VI, int32_t, splatInt, ^, kXor)
FR_INTEGER_OPERATOR(VU, uint32_t, splatUint, +, kAddInt)
FR_INTEGER_OPERATOR(VU, uint32_t, splatUint, *, kMulInt)
FR_INTEGER_OPERATOR(VU, uint32_t, splatUint, &, kAnd)
FR_INTEGER_OPERATOR(VU, uint32_t, splatUint, |, kOr)
FR_INTEGER_OPERATOR(VU, uint32_t, splatUint, ^, kXor)
#undef FR_INTEGER_OPERATOR
FR_INLINE VI operator~(VI a) { return a ^ -1; }
FR_INLINE VI operator<<(VI a, int32_t n) {
  return VI(graph().unary(VectorOp::kShiftLeft, a.node, uint32_t(n)));
}
FR_INLINE VI operator>>(VI a, int32_t n) {
  return VI(graph().unary(VectorOp::kShiftRightSigned, a.node, uint32_t(n)));
}
FR_INLINE VU operator<<(VU a, uint32_t n) { return VU(graph().unary(VectorOp::kShiftLeft, a.node, n)); }
FR_INLINE VU operator>>(VU a, uint32_t n) { return VU(graph().unary(VectorOp::kShiftRight, a.node, n)); }
FR_INLINE VI equalInt(NodeIndex a, NodeIndex b) { return VI(graph().binary(VectorOp::kEqualInt, a, b)); }
FR_INLINE VI operator==(VI a, int32_t b) { return equalInt(a.node, splatInt(b).node); }
FR_INLINE VI operator!=(VI a, int32_t b) { return ~(a == b); }
FR_INLINE VI operator!=(VI a, VI b) { return ~equalInt(a.node, b.node); }
FR_INLINE VI operator==(VU a, uint32_t b) { return equalInt(a.node, splatUint(b).node); }
FR_INLINE VI operator<(VI a, int32_t b) {
  return VI(graph().binary(VectorOp::kGreaterInt, splatInt(b).node, a.node));
}
/// Below 2^31 on both sides.
FR_INLINE VI operator<=(VU a, uint32_t b) { return VI(a) < int32_t(b + 1); }

FR_INLINE V select(VI m, V a, V b) { return V(graph().select(m.node, a.node, b.node)); }
FR_INLINE VI bits(V v) { return VI(v.node); }
FR_INLINE V fromBits(VI v) { return V(v.node); }
FR_INLINE V vmin(V a, V b) { return V(graph().binary(VectorOp::kMin, a.node, b.node)); }
FR_INLINE V vmax(V a, V b) { return V(graph().binary(VectorOp::kMax, a.node, b.node)); }
FR_INLINE V rawSqrt(V x) { return V(graph().unary(VectorOp::kSqrt, x.node)); }
FR_INLINE V vfloor(V x) { return V(graph().unary(VectorOp::kFloor, x.node)); }
FR_INLINE VI toInt(V x) { return VI(graph().unary(VectorOp::kToInt, x.node)); }
FR_INLINE V toFloat(VI x) { return V(graph().unary(VectorOp::kToFloat, x.node)); }

template <class C>
FR_INLINE void rarely(VI where, const V* in, V* result) {
  NodeIndex inputs[kMostRareValues], results[kMostRareValues];
  for (int k = 0; k < C::kInputs; ++k) inputs[k] = in[k].node;
  for (int k = 0; k < C::kResults; ++k) results[k] = result[k].node;
  graph().rare(C::kCase, where.node, inputs, C::kInputs, results, C::kResults);
  for (int k = 0; k < C::kResults; ++k) result[k] = V(results[k]);
}

}  // namespace fr::FR_ISA
