// Volumes and imagers by hand.
#include "bench/shading/hand_simd.h"

namespace fr::FR_ISA {

void handFog(const HandTask& t) {
  const V3 background = splat3(t.color), one = {splat(1), splat(1), splat(1)};
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    const V3 I = at(t.I, i);
    const V d = 1.0f - vexp(-rawSqrt(dot(I, I)) / t.distance);
    put(t.Ci, i, mix(at(t.Ci, i), background, d));
    put(t.Oi, i, mix(at(t.Oi, i), one, d));
  }
}

void handDepthcue(const HandTask& t) {
  const V3 background = splat3(t.color), one = {splat(1), splat(1), splat(1)};
  const float scale_ = 1.0f / (t.farClip - t.nearClip);
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    const V d = clampTo((at(t.P[2], i) - t.nearClip) * scale_, 0.0f, 1.0f);
    put(t.Ci, i, mix(at(t.Ci, i), background, d));
    put(t.Oi, i, mix(at(t.Oi, i), one, d));
  }
}

void handSmoke(const HandTask& t) {
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    const V3 I = at(t.I, i), origin = sub(at(t.P, i), I);
    const V distance = rawSqrt(dot(I, I));
    const V steps = clampTo(vceil(distance / t.stepSize), 1.0f, 64.0f);
    const V ds = distance / steps, inv = 1.0f / steps;
    V random;
    for (uint32_t k = 0; k < kLanes; ++k) {
      // Of the point, the call and how often this point was there.
      const uint64_t h = mixed(t.seed[i + k] * 0x9e3779b97f4a7c15ull + 1);
      random[k] = float(uint32_t(mixed(h * 0x9e3779b97f4a7c15ull + t.calls[i + k]) >> 40)) * 0x1p-24f;
    }
    V3 lit{};
    V through = splat(1);
    const V stop = 1.0f - vexp(-t.density * ds);
    V k{};
    for (;; k += 1.0f) {
      const VI live = k < steps;
      if (!anyLane(live)) break;
      const V3 here = add(origin, scale(I, (k + random) * inv));
      V3 arriving{};
      for (uint32_t l = 0; l < t.lightCount; ++l) {
        if (t.lights[l].kind == HandLight::kAmbient) continue;
        V3 L, Cl;
        shine(t.lights[l], here, L, Cl);
        arriving = add(arriving, Cl);
      }
      lit = add(lit, scale(arriving, select(live, through * stop, V{})));
      through = select(live, through * (1.0f - stop), through);
    }
    put(t.Ci, i, add(lit, scale(at(t.Ci, i), through)));
    const V3 Oi = at(t.Oi, i);
    put(t.Oi, i,
        {1.0f - through * (1.0f - Oi.x), 1.0f - through * (1.0f - Oi.y), 1.0f - through * (1.0f - Oi.z)});
  }
}

void handBackground(const HandTask& t) {
  const V3 color = splat3(t.color), one = {splat(1), splat(1), splat(1)};
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    put(t.Ci, i, add(at(t.Ci, i), scale(color, 1.0f - at(t.alpha, i))));
    put(t.Oi, i, one);
    put(t.alpha, i, one.x);
  }
}

void handClampToAlpha(const HandTask& t) {
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    const V3 c = at(t.Ci, i), o = at(t.Oi, i);
    put(t.Ci, i, {vmin(vmax(c.x, V{}), o.x), vmin(vmax(c.y, V{}), o.y), vmin(vmax(c.z, V{}), o.z)});
  }
}

}  // namespace fr::FR_ISA
