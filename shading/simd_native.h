// Vectors of kLanes floats as GCC's vector types: what simd.h is made of, in machine instructions.
#pragma once

#include <immintrin.h>

#include <cstdint>

#define FR_INLINE static inline __attribute__((always_inline))

namespace fr::FR_ISA {

#if defined(FR_ISA_avx512)
inline constexpr uint32_t kLanes = 16;
#elif defined(FR_ISA_avx2)
inline constexpr uint32_t kLanes = 8;
#else
inline constexpr uint32_t kLanes = 4;
#endif

typedef float V __attribute__((vector_size(kLanes * 4)));
typedef int32_t VI __attribute__((vector_size(kLanes * 4)));
typedef uint32_t VU __attribute__((vector_size(kLanes * 4)));

FR_INLINE V splat(float f) { return f - V{}; }
FR_INLINE VI splatInt(int32_t i) { return i - VI{}; }
FR_INLINE VU splatUint(uint32_t i) { return i - VU{}; }
FR_INLINE V select(VI m, V a, V b) { return m ? a : b; }
FR_INLINE VI bits(V v) { return (VI)v; }
FR_INLINE V fromBits(VI v) { return (V)v; }
FR_INLINE V vmin(V a, V b) { return a < b ? a : b; }
FR_INLINE V vmax(V a, V b) { return a > b ? a : b; }
FR_INLINE bool anyLane(VI m) {
#if defined(FR_ISA_avx512)
  return _mm512_test_epi32_mask((__m512i)m, (__m512i)m) != 0;
#elif defined(FR_ISA_avx2)
  return _mm256_testz_si256((__m256i)m, (__m256i)m) == 0;
#else
  return _mm_testz_si128((__m128i)m, (__m128i)m) == 0;
#endif
}
FR_INLINE V rawSqrt(V x) {
#if defined(FR_ISA_avx512)
  return (V)_mm512_maskz_sqrt_ps(0xffff, (__m512)x);
#elif defined(FR_ISA_avx2)
  return (V)_mm256_sqrt_ps((__m256)x);
#else
  return (V)_mm_sqrt_ps((__m128)x);
#endif
}
FR_INLINE V vfloor(V x) {
#if defined(FR_ISA_avx512)
  return (V)_mm512_maskz_roundscale_ps(0xffff, (__m512)x, _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC);
#elif defined(FR_ISA_avx2)
  return (V)_mm256_floor_ps((__m256)x);
#else
  return (V)_mm_floor_ps((__m128)x);
#endif
}
/// Truncates; out of range: INT_MIN.
FR_INLINE VI toInt(V x) {
#if defined(FR_ISA_avx512)
  return (VI)_mm512_maskz_cvttps_epi32(0xffff, (__m512)x);
#elif defined(FR_ISA_avx2)
  return (VI)_mm256_cvttps_epi32((__m256)x);
#else
  return (VI)_mm_cvttps_epi32((__m128)x);
#endif
}
FR_INLINE V toFloat(VI x) { return __builtin_convertvector(x, V); }

/// Where `where` holds, which is next to never, `C` computes `result` from `in`.
template <class C>
static __attribute__((noinline)) void rarelyBlend(VI where, const V* in, V* result) {
  V r[C::kResults];
  C::compute(in, r);
  for (int k = 0; k < C::kResults; ++k) result[k] = select(where, r[k], result[k]);
}
template <class C>
FR_INLINE void rarely(VI where, const V* in, V* result) {
  if (__builtin_expect(anyLane(where), 0)) rarelyBlend<C>(where, in, result);
}

}  // namespace fr::FR_ISA
