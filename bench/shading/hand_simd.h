// What the hand-written shaders share: columns, lights, differences between neighbours. Once per instruction
// set.
#pragma once

#include "base/sobol_pair.h"
#include "bench/shading/hand.h"
#include "shading/noise.h"
#include "shading/simd.h"

namespace fr::FR_ISA {

using bench::HandLight;
using bench::HandRays;
using bench::HandTask;

typedef float LooseV __attribute__((vector_size(kLanes * 4), aligned(4)));
FR_INLINE V at(const float* column, uint32_t i) { return *reinterpret_cast<const V*>(column + i); }
FR_INLINE V atLoose(const float* column, uint32_t i) {
  return (V) * reinterpret_cast<const LooseV*>(column + i);
}
FR_INLINE V3 at(const float* const column[3], uint32_t i) {
  return {at(column[0], i), at(column[1], i), at(column[2], i)};
}
FR_INLINE void put(float* column, uint32_t i, V v) { *reinterpret_cast<V*>(column + i) = v; }
FR_INLINE void putLoose(float* column, uint32_t i, V v) {
  *reinterpret_cast<LooseV*>(column + i) = (LooseV)v;
}
FR_INLINE void put(float* const column[3], uint32_t i, V3 v) {
  put(column[0], i, v.x), put(column[1], i, v.y), put(column[2], i, v.z);
}
FR_INLINE V3 splat3(const float c[3]) { return {splat(c[0]), splat(c[1]), splat(c[2])}; }
FR_INLINE V3 mul(V3 a, V3 b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }
FR_INLINE V3 negative(V3 a) { return {-a.x, -a.y, -a.z}; }
FR_INLINE V3 mix(V3 a, V3 b, V t) { return add(scale(a, 1.0f - t), scale(b, t)); }
FR_INLINE V smooth(V lo, V hi, V x) {
  const V r = clampTo((x - lo) / (hi - lo), 0.0f, 1.0f);
  return r * r * (3.0f - 2.0f * r);
}
/// Not for vectors whose squares over- or underflow.
FR_INLINE V3 unit(V3 a) {
  const V d = dot(a, a);
  const V inv = 1.0f / rawSqrt(d);
  return scale(a, select(d > 0.0f, inv, V{}));
}
FR_INLINE V3 towards(V3 n, V3 in) { return select(dot(in, n) > 0.0f, negative(n), n); }

/// Direction to the light (any length) and colour at P.
FR_INLINE void shine(const HandLight& l, V3 P, V3& toLight, V3& Cl) {
  if (l.kind == HandLight::kDistant) {
    toLight = negative(splat3(l.axis));
    Cl = splat3(l.color);
    return;
  }
  toLight = sub(splat3(l.from), P);
  const V d2 = dot(toLight, toLight);
  V strength = 1.0f / d2;
  if (l.kind == HandLight::kSpot) {
    const V c = -dot(toLight, splat3(l.axis)) / rawSqrt(d2);
    const V s =
        vpow(vmax(c, V{}), splat(l.beam)) * strength * smooth(splat(l.cosOuter), splat(l.cosInner), c);
    strength = select(c > l.cosOuter, s, V{});
  }
  Cl = scale(splat3(l.color), strength);
}

FR_INLINE uint64_t mixed(uint64_t x) {
  x ^= x >> 33, x *= 0xff51afd7ed558ccdull;
  x ^= x >> 33, x *= 0xc4ceb9fe1a85ec53ull;
  return x ^ (x >> 33);
}
/// Point `index` of a scrambled Sobol sequence, its first two dimensions.
FR_INLINE void sobolPair(uint32_t index, VU seed, V& u, V& v) {
  VU x, y;
  sobolOwenPair(
      splatUint(index), seed, [](VU n) __attribute__((always_inline)) { return noiseHash(n); }, x, y);
  u = toFloat((VI)(x >> 8)) * 0x1p-24f;
  v = toFloat((VI)(y >> 8)) * 0x1p-24f;
}

FR_INLINE V3 ambientLight(const HandTask& t) {
  V3 sum{};
  for (uint32_t k = 0; k < t.lightCount; ++k)
    if (t.lights[k].kind == HandLight::kAmbient) sum = add(sum, splat3(t.lights[k].color));
  return sum;
}
/// Lambert's and Blinn's sums over all lights in one go.
template <bool kDiffuse, bool kSpecular>
FR_INLINE void reflect(const HandTask& t, V3 P, V3 N, V3 V_, V exponent, V3& diffuse, V3& specular) {
  diffuse = specular = V3{};
  for (uint32_t k = 0; k < t.lightCount; ++k) {
    const HandLight& l = t.lights[k];
    if (l.kind == HandLight::kAmbient) continue;
    V3 L, Cl;
    shine(l, P, L, Cl);
    const V d = dot(L, N);
    const VI front = d > 0.0f;
    if (!anyLane(front)) continue;
    const V inv = 1.0f / rawSqrt(dot(L, L));
    if (kDiffuse) diffuse = add(diffuse, scale(Cl, select(front, d * inv, V{})));
    if (kSpecular) {
      const V3 h = unit(add(scale(L, inv), V_));
      specular = add(specular, scale(Cl, select(front, vpow(vmax(dot(N, h), V{}), exponent), V{})));
    }
  }
}

/// Changes of a column from cell to cell, along rows and across them: central inside, one-sided at the
/// borders.
inline void cellChanges(const HandTask& t, const float* x, float* du, float* dv) {
  const uint32_t w = t.row, n = t.count;
  for (uint32_t i = 0; i < n; i += kLanes) {
    put(du, i, w > 1 ? (atLoose(x, i + 1) - atLoose(x - 1, i)) * 0.5f : V{});
    put(dv, i, V{});
  }
  if (w > 1)
    for (uint32_t i = 0; i < n; i += w) {
      du[i] = x[i + 1] - x[i];
      du[i + w - 1] = x[i + w - 1] - x[i + w - 2];
    }
  if (t.rows < 2) return;
  for (uint32_t i = w; i < n - w; i += kLanes)
    putLoose(dv, i, (atLoose(x, i + w) - atLoose(x - w, i)) * 0.5f);
  for (uint32_t i = 0; i < w; ++i) {
    dv[i] = x[i + w] - x[i];
    dv[n - w + i] = x[n - w + i] - x[n - 2 * w + i];
  }
}

}  // namespace fr::FR_ISA
