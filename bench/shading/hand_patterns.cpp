// Procedural patterns by hand: fBm, marble, brick.
#include "bench/shading/hand_simd.h"

namespace fr::FR_ISA {

void handFbm(const HandTask& t) {
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    const V3 P = scale(at(t.P, i), splat(t.frequency)), Os = at(t.Os, i);
    V p[3] = {P.x, P.y, P.z}, sum{};
    float a = 1;
    for (float k = 0; k < t.octaves; k += 1) {
      V n;
      noise<3, 1>(p, nullptr, &n);
      sum += a * (2.0f * n - 1.0f);
      a *= 0.5f;
      for (V& x : p) x *= 2.0f;
    }
    const V c = 0.5f + 0.5f * sum;
    put(t.Ci, i, scale(Os, c));
    put(t.Oi, i, Os);
  }
}

void handMarble(const HandTask& t) {
  const V3 ambient = scale(ambientLight(t), splat(t.Ka));
  const V exponent = splat(1.0f / t.roughness);
  static const float knots[6][3] = {{.1f, .1f, .2f},  {.2f, .2f, .35f}, {.35f, .35f, .5f},
                                    {.7f, .7f, .75f}, {.9f, .9f, .9f},  {1, 1, 1}};
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    const V3 P = at(t.P, i), Os = at(t.Os, i);
    V p[3] = {P.x * t.frequency, P.y * t.frequency, P.z * t.frequency}, sum{};
    float a = 1;
    for (float k = 0; k < t.octaves; k += 1) {
      V n;
      noise<3, 1>(p, nullptr, &n);
      sum += a * vabs(n - 0.5f);
      a *= 0.5f;
      for (V& x : p) x *= 2.0f;
    }
    // A Catmull-Rom spline over six knots: three segments.
    const V x = clampTo(0.5f + 0.5f * vsin(4.0f * P.x + 8.0f * sum), 0.0f, 1.0f) * 3.0f;
    const V segment = vmin(vfloor(x), splat(2.0f)), u = x - segment, u2 = u * u, u3 = u2 * u;
    const V w[4] = {0.5f * (-u3 + 2.0f * u2 - u), 0.5f * (3.0f * u3 - 5.0f * u2 + 2.0f),
                    0.5f * (-3.0f * u3 + 4.0f * u2 + u), 0.5f * (u3 - u2)};
    V3 color{};
    const VI first = segment < 1.0f, second = segment < 2.0f;
    for (int k = 0; k < 4; ++k) {
      const V3 knot =
          select(first, splat3(knots[k]), select(second, splat3(knots[k + 1]), splat3(knots[k + 2])));
      color = add(color, scale(knot, w[k]));
    }
    const V3 I = unit(at(t.I, i)), N = towards(unit(at(t.N, i)), I);
    V3 diffuse, specular;
    reflect<true, true>(t, P, N, negative(I), exponent, diffuse, specular);
    put(t.Oi, i, Os);
    put(t.Ci, i,
        mul(Os, add(mul(color, add(ambient, scale(diffuse, splat(t.Kd)))), scale(specular, splat(t.Ks)))));
  }
}

void handBrick(const HandTask& t) {
  const V3 ambient = scale(ambientLight(t), splat(t.Ka)), mortar = splat3(t.color);
  for (uint32_t i = 0; i < t.count; i += kLanes) {
    V x = at(t.s, i) * t.frequency;
    const V y = at(t.t, i) * (t.frequency * 2.0f);
    const V row = vfloor(y);
    x = select(row - 2.0f * vfloor(row * 0.5f) > 0.5f, x + 0.5f, x);
    const V column = vfloor(x);
    const V fx = x - column, fy = y - row;
    const V lo = splat(0.04f), hi = splat(0.08f);
    const V inside = smooth(lo, hi, fx) * (1.0f - smooth(1.0f - hi, 1.0f - lo, fx)) * smooth(lo, hi, fy) *
                     (1.0f - smooth(1.0f - hi, 1.0f - lo, fy));
    const V cell[2] = {column, row};
    V tint;
    cellNoise<2, 1>(cell, &tint);
    const V3 N = towards(unit(at(t.N, i)), at(t.I, i)), Os = at(t.Os, i);
    V3 diffuse, none;
    reflect<true, false>(t, at(t.P, i), N, V3{}, V{}, diffuse, none);
    const V3 base = mix(mortar, scale(at(t.Cs, i), 0.7f + 0.3f * tint), inside);
    put(t.Oi, i, Os);
    put(t.Ci, i, mul(mul(Os, base), add(ambient, scale(diffuse, splat(t.Kd)))));
  }
}

}  // namespace fr::FR_ISA
