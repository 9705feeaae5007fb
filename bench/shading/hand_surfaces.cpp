// The standard surfaces without rays, by hand.
#include "bench/shading/hand_simd.h"

namespace fr::FR_ISA {

void handConstant(const HandTask& t) {
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    const V3 Os = at(t.Os, i);
    put(t.Oi, i, Os);
    put(t.Ci, i, mul(Os, at(t.Cs, i)));
  }
}

void handNull(const HandTask& t) {
  for (uint32_t i = 0; i < t.count; i += kLanes) put(t.Ci, i, V3{});
}

void handDefaultSurface(const HandTask& t) {
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    const V3 N = at(t.N, i), I = at(t.I, i), Os = at(t.Os, i);
    const V d = dot(N, I) / rawSqrt(dot(N, N) * dot(I, I));
    put(t.Oi, i, Os);
    put(t.Ci, i, scale(mul(Os, at(t.Cs, i)), t.Ka + t.Kd * d * d));
  }
}

void handMatte(const HandTask& t) {
  const V3 ambient = scale(ambientLight(t), splat(t.Ka));
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    const V3 N = towards(unit(at(t.N, i)), at(t.I, i)), Os = at(t.Os, i);
    V3 diffuse, none;
    reflect<true, false>(t, at(t.P, i), N, V3{}, V{}, diffuse, none);
    put(t.Oi, i, Os);
    put(t.Ci, i, mul(mul(Os, at(t.Cs, i)), add(ambient, scale(diffuse, splat(t.Kd)))));
  }
}

void handMatteByArea(const HandTask& t) {
  constexpr uint32_t stride = 1056;
  float* const at0 = t.scratch + 16;
  const auto column = [&](uint32_t c) { return at0 + c * stride; };
  float *const pair[2] = {column(0), column(1)}, *const factor = column(2);
  float *const P[3] = {column(3), column(4), column(5)}, *const N[3] = {column(6), column(7), column(8)};
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    VU seed;
    for (uint32_t j = 0; j < kLanes; ++j) {
      const uint64_t h = mixed(t.seed[i + j] * 0x9e3779b97f4a7c15ull + 1);
      seed[j] = uint32_t(mixed(h * 0x9e3779b97f4a7c15ull + 2) >> 32);
    }
    V u, v;
    sobolPair(0, seed, u, v);
    put(pair[0], i, u), put(pair[1], i, v);
  }
  t.emitters(t, pair, P, N, factor);
  const V3 color = splat3(t.lights[0].color);
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    const V3 n = towards(unit(at(t.N, i)), at(t.I, i)), Os = at(t.Os, i), toLight = sub(at(P, i), at(t.P, i));
    const V d = dot(toLight, n), d2 = dot(toLight, toLight);
    const VI lit = (d > 0.0f) & (dot(toLight, at(N, i)) < 0.0f);
    const V cosine = select(lit, d / rawSqrt(d2), V{});
    const V3 diffuse = scale(color, cosine * at(factor, i) / d2);
    put(t.Oi, i, Os);
    put(t.Ci, i, mul(mul(Os, at(t.Cs, i)), scale(diffuse, splat(t.Kd))));
  }
}

void handMetal(const HandTask& t) {
  const V3 ambient = scale(ambientLight(t), splat(t.Ka));
  const V exponent = splat(1.0f / t.roughness);
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    const V3 I = unit(at(t.I, i)), N = towards(unit(at(t.N, i)), I), Os = at(t.Os, i);
    V3 none, specular;
    reflect<false, true>(t, at(t.P, i), N, negative(I), exponent, none, specular);
    put(t.Oi, i, Os);
    put(t.Ci, i, mul(mul(Os, at(t.Cs, i)), add(ambient, scale(specular, splat(t.Ks)))));
  }
}

namespace {
/// `paint`: columns of a colour that multiplies Cs, or nullptr.
FR_INLINE void plastic(const HandTask& t, const float* const* paint) {
  const V3 ambient = scale(ambientLight(t), splat(t.Ka)), shine = scale(splat3(t.specularColor), splat(t.Ks));
  const V exponent = splat(1.0f / t.roughness);
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    const V3 I = unit(at(t.I, i)), N = towards(unit(at(t.N, i)), I), Os = at(t.Os, i);
    V3 diffuse, specular;
    reflect<true, true>(t, at(t.P, i), N, negative(I), exponent, diffuse, specular);
    V3 base = at(t.Cs, i);
    if (paint) base = mul(base, at(paint, i));
    put(t.Oi, i, Os);
    put(t.Ci, i, mul(Os, add(mul(base, add(ambient, scale(diffuse, splat(t.Kd)))), mul(shine, specular))));
  }
}
}  // namespace

void handPlastic(const HandTask& t) { plastic(t, nullptr); }

void handPaintedPlastic(const HandTask& t) {
  constexpr uint32_t stride = 1056;
  float* const at0 = t.scratch + 16;
  float* change[4] = {at0, at0 + stride, at0 + 2 * stride, at0 + 3 * stride};
  float* const color[3] = {at0 + 4 * stride, at0 + 5 * stride, at0 + 6 * stride};
  cellChanges(t, t.s, change[0], change[2]);
  cellChanges(t, t.t, change[1], change[3]);
  t.texture(t, change, color);
  plastic(t, color);
}

void handTexture(const HandTask& t) {
  constexpr uint32_t stride = 1056;
  float* const at0 = t.scratch + 16;
  float* change[4] = {at0, at0 + stride, at0 + 2 * stride, at0 + 3 * stride};
  cellChanges(t, t.s, change[0], change[2]);
  cellChanges(t, t.t, change[1], change[3]);
  t.texture(t, change, t.Ci);
  for (uint32_t i = 0; i < t.count; i += kLanes) put(t.Oi, i, at(t.Os, i));
}

void handChecker(const HandTask& t) {
  constexpr uint32_t stride = 1056;
  float* const at0 = t.scratch + 16;
  float* change[4] = {at0, at0 + stride, at0 + 2 * stride, at0 + 3 * stride};
  cellChanges(t, t.s, change[0], change[2]);
  cellChanges(t, t.t, change[1], change[3]);
  const V3 ambient = scale(ambientLight(t), splat(t.Ka)), dark = splat3(t.color);
  const auto wave = [](V x) __attribute__((always_inline)) {
    return vabs(x - 2.0f * vfloor(x * 0.5f) - 1.0f);
  };
  const auto filtered = [&](V x, V w) __attribute__((always_inline)) {
    return (wave(x + w * 0.5f) - wave(x - w * 0.5f)) / w;
  };
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    const V ws = vmax((vabs(at(change[0], i)) + vabs(at(change[2], i))) * t.frequency, splat(1e-6f));
    const V wt = vmax((vabs(at(change[1], i)) + vabs(at(change[3], i))) * t.frequency, splat(1e-6f));
    const V board =
        0.5f - 0.5f * filtered(at(t.s, i) * t.frequency, ws) * filtered(at(t.t, i) * t.frequency, wt);
    const V3 N = towards(unit(at(t.N, i)), at(t.I, i)), Os = at(t.Os, i);
    V3 diffuse, none;
    reflect<true, false>(t, at(t.P, i), N, V3{}, V{}, diffuse, none);
    put(t.Oi, i, Os);
    put(t.Ci, i, mul(mul(Os, mix(at(t.Cs, i), dark, board)), add(ambient, scale(diffuse, splat(t.Kd)))));
  }
}

void handBumpy(const HandTask& t) {
  // The displacement without a texture moves nothing, but the normals are those of the grid.
  constexpr uint32_t stride = 1056;
  float* const at0 = t.scratch + 16;
  float *du[3], *dv[3];
  for (uint32_t c = 0; c < 3; ++c) {
    du[c] = at0 + c * stride, dv[c] = at0 + (3 + c) * stride;
    cellChanges(t, t.P[c], du[c], dv[c]);
  }
  const V cells = splat(float(t.row > 1 ? t.row - 1 : 1) * float(t.rows > 1 ? t.rows - 1 : 1));
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    put(t.outP, i, add(at(t.P, i), scale(unit(at(t.N, i)), V{})));
    put(t.outN, i, scale(cross(at(du, i), at(dv, i)), cells));
  }
}

}  // namespace fr::FR_ISA
