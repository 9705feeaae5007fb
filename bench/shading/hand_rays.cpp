// Surfaces that ask rays, by hand: directions, footprints and seeds in one pass, then the answers.
#include "bench/shading/hand_simd.h"

namespace fr::FR_ISA {

namespace {
constexpr uint32_t kStride = 1056;

/// Half the larger side of each point's cell.
void cellRadius(const HandTask& t, float* radius, float* work) {
  for (uint32_t c = 0; c < 3; ++c) cellChanges(t, t.P[c], work + c * kStride, work + (3 + c) * kStride);
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    V du{}, dv{};
    for (uint32_t c = 0; c < 3; ++c) {
      const V a = at(work + c * kStride, i), b = at(work + (3 + c) * kStride, i);
      du += a * a, dv += b * b;
    }
    put(radius, i, 0.5f * rawSqrt(vmax(du, dv)));
  }
}
/// Rays along the unit directions from P, with the spread that neighbouring directions have.
void ask(const HandTask& t, float* const direction[3], uint64_t site) {
  float* const work = t.scratch + 16 + 8 * kStride;
  HandRays& r = *t.rays;
  r.count = t.count;
  cellRadius(t, r.radius, work);
  for (uint32_t c = 0; c < 3; ++c) cellChanges(t, direction[c], work + c * kStride, work + (3 + c) * kStride);
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    V du{}, dv{};
    for (uint32_t c = 0; c < 3; ++c) {
      const V a = at(work + c * kStride, i), b = at(work + (3 + c) * kStride, i);
      du += a * a, dv += b * b;
    }
    put(r.spread, i, vmin(0.5f * rawSqrt(vmax(du, dv)), splat(1)));
    put(r.origin, i, at(t.P, i));
    put(r.direction, i, at(direction, i));
  }
  for (uint32_t i = 0; i < t.count; ++i) {
    r.seed[i] = mixed((t.seed[i] ^ site) * 0x9e3779b97f4a7c15ull);
    r.lane[i] = i;
  }
  t.ask(r);
}
/// What came back, with the sky where rays left the scene.
FR_INLINE V3 arrived(const HandTask& t, uint32_t i) {
  const HandRays& r = *t.rays;
  const V depth = at(r.missDepth, i);
  const V3 sky = scale(splat3(t.color), select(depth > 0.0f, 1.0f / depth, V{}));
  return add(at(r.color, i), sky);
}
}  // namespace

namespace {
/// Surfaces that reflect what is around them: one ray a point, then light loops and `mix` of their sums.
/// mix(i, Cs, ambient, diffuse, specular) is the colour before Os; ambient and specular are weighted already.
template <bool kDiffuse, class Mix>
FR_INLINE void reflecting(const HandTask& t, const Mix& mix) {
  float* const at0 = t.scratch + 16;
  float* const R[3] = {at0, at0 + kStride, at0 + 2 * kStride};
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    const V3 I = unit(at(t.I, i)), N = towards(unit(at(t.N, i)), I);
    put(R, i, sub(I, scale(N, 2.0f * dot(I, N))));
  }
  ask(t, R, 1);
  const V3 ambient = scale(ambientLight(t), splat(t.Ka));
  const V exponent = splat(1.0f / t.roughness);
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    const V3 I = unit(at(t.I, i)), N = towards(unit(at(t.N, i)), I), Os = at(t.Os, i);
    V3 diffuse, specular;
    reflect<kDiffuse, true>(t, at(t.P, i), N, negative(I), exponent, diffuse, specular);
    put(t.Oi, i, Os);
    put(t.Ci, i, mul(Os, mix(i, at(t.Cs, i), ambient, diffuse, scale(specular, splat(t.Ks)))));
  }
}
}  // namespace

void handMirror(const HandTask& t) {
  reflecting<false>(
      t, [&](uint32_t i, V3 Cs, V3 ambient, V3, V3 specular) __attribute__((always_inline)) {
        return mul(Cs, add(add(ambient, specular), scale(arrived(t, i), splat(t.Kr))));
      });
}

void handShiny(const HandTask& t) {
  reflecting<true>(
      t, [&](uint32_t i, V3 Cs, V3 ambient, V3 diffuse, V3 specular) __attribute__((always_inline)) {
        const V3 coat = add(specular, scale(arrived(t, i), splat(t.Kr)));
        return add(mul(Cs, add(ambient, scale(diffuse, splat(t.Kd)))), mul(splat3(t.specularColor), coat));
      });
}

void handShinyMetal(const HandTask& t) {
  reflecting<false>(
      t, [&](uint32_t i, V3 Cs, V3 ambient, V3, V3 specular) __attribute__((always_inline)) {
        return mul(Cs, add(add(ambient, specular), scale(at(t.rays->color, i), splat(t.Kr))));
      });
}

void handGlass(const HandTask& t) {
  float* const at0 = t.scratch + 16;
  float* const R[3] = {at0, at0 + kStride, at0 + 2 * kStride};
  float* const T[3] = {at0 + 3 * kStride, at0 + 4 * kStride, at0 + 5 * kStride};
  float *const kr = at0 + 6 * kStride, *const through = at0 + 16 * kStride;
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    const V3 I = unit(at(t.I, i)), Nn = unit(at(t.N, i)), N = towards(Nn, I);
    const V eta = select(dot(I, Nn) < 0.0f, splat(1.0f / t.ior), splat(t.ior));
    const V c = -dot(I, N), g2 = 1.0f / (eta * eta) - 1.0f + c * c, g = vsqrt(g2);
    const V q = (g - c) / (g + c), h = (c * (g + c) - 1.0f) / (c * (g - c) + 1.0f);
    put(kr, i, select(g2 < 0.0f, splat(1), clampTo(0.5f * q * q * (1.0f + h * h), 0.0f, 1.0f)));
    put(R, i, add(I, scale(N, 2.0f * c)));
    const V k = 1.0f - eta * eta * (1.0f - c * c), f = vsqrt(k) - eta * c;
    put(T, i, select(k < 0.0f, V3{}, sub(scale(I, eta), scale(N, f))));
  }
  ask(t, T, 1);
  float* const color[3] = {through, through + kStride, through + 2 * kStride};
  for (uint32_t i = 0; i < t.count; i += kLanes) put(color, i, arrived(t, i));
  ask(t, R, 2);
  const V exponent = splat(1.0f / t.roughness);
  const V3 ambient = scale(ambientLight(t), splat(t.Ka));
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    const V3 I = unit(at(t.I, i)), N = towards(unit(at(t.N, i)), I), Os = at(t.Os, i);
    const V back = at(kr, i) * t.Kr, front = (1.0f - at(kr, i)) * t.Kt;
    V3 diffuse, specular;
    reflect<true, true>(t, at(t.P, i), N, negative(I), exponent, diffuse, specular);
    V3 sum = mul(at(t.Cs, i), add(ambient, scale(diffuse, splat(t.Kd))));
    sum = add(sum, scale(specular, splat(t.Ks)));
    sum = add(sum, scale(arrived(t, i), select(back > 1e-3f, back, V{})));
    sum = add(sum, scale(at(color, i), select(front > 1e-3f, front, V{})));
    put(t.Oi, i, Os);
    put(t.Ci, i, mul(Os, sum));
  }
}

void handOccluded(const HandTask& t) {
  float* const at0 = t.scratch + 16;
  float *const hidden = at0 + 15 * kStride, *const radius = at0 + 14 * kStride;
  const uint32_t samples = uint32_t(t.samples);
  HandRays& r = *t.rays;
  cellRadius(t, radius, at0);
  const float share = 1.0f / rawSqrt(splat(float(samples)))[0];
  for (uint32_t i = 0; i < t.count; i += kLanes) put(hidden, i, V{});
  for (uint32_t k = 0; k < samples; ++k) {
    for (uint32_t i = 0; i < t.count; i += kLanes) {
      const V3 N = unit(towards(at(t.N, i), at(t.I, i)));
      VU seed;
      for (uint32_t j = 0; j < kLanes; ++j) {
        const uint64_t h = mixed(t.seed[i + j] * 0x9e3779b97f4a7c15ull + k);
        r.seed[i + j] = h;
        seed[j] = uint32_t(h >> 32);
      }
      V u, v;
      sobolPair(k, seed, u, v);
      const V rho = rawSqrt(u), z = vsqrt(1.0f - u);
      V s, c;
      sinCos(v * 6.2831853f, s, c);
      const V sign = copySign(splat(1), N.z), a = -1.0f / (sign + N.z), b = N.x * N.y * a;
      const V3 x = {1.0f + sign * N.x * N.x * a, sign * b, -sign * N.x};
      const V3 w = {b, sign + N.y * N.y * a, -N.y};
      put(r.direction, i, add(add(scale(x, rho * c), scale(w, rho * s)), scale(N, z)));
      put(r.origin, i, at(t.P, i));
      put(r.radius, i, at(radius, i));
      put(r.spread, i, splat(share));
    }
    for (uint32_t i = 0; i < t.count; ++i) r.lane[i] = i;
    r.count = t.count;
    t.ask(r);
    for (uint32_t i = 0; i < t.count; i += kLanes)
      put(hidden, i, at(hidden, i) + toFlag(at(r.hitDistance, i) < 1e30f));
  }
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    const V open = t.Ka * (1.0f - at(hidden, i) * (1.0f / float(samples)));
    const V3 Os = at(t.Os, i);
    put(t.Oi, i, Os);
    put(t.Ci, i, scale(mul(Os, at(t.Cs, i)), open));
  }
}

}  // namespace fr::FR_ISA
