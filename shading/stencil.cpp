#include <cmath>

#include "shading/machine.h"

namespace fr {

void gridStencil(DerivativeStencil& s, uint32_t nu, uint32_t nv, uint32_t lanes, float du, float dv,
                 const float* u, const float* v) {
  s.resize(lanes);
  const uint32_t row = nu + 1;
  s.used = row * (nv + 1);
  for (uint32_t i = 0; i < lanes; ++i) s.uLo[i] = s.uHi[i] = s.vLo[i] = s.vHi[i] = uint16_t(i);
  // Neighbours in [0, n] of x, `stride` lanes apart, and one over their distance in the parameter. Where
  // vertices of a border stand on one another the next ones are taken.
  const auto pick = [](uint32_t i, uint32_t x, uint32_t n, uint32_t stride, float cell,
                       const float* parameter, uint16_t& lo, uint16_t& hi) {
    uint32_t a = x > 0 ? x - 1 : x, b = x < n ? x + 1 : x;
    const auto lane = [&](uint32_t k) { return i + k * stride - x * stride; };
    const auto step = [&] {
      return parameter ? parameter[lane(b)] - parameter[lane(a)] : float(b - a) * cell;
    };
    while (std::fabs(step()) < 0.5f * std::fabs(cell) && (a > 0 || b < n)) {
      if (b < n) ++b;
      if (a > 0) --a;
    }
    lo = uint16_t(lane(a)), hi = uint16_t(lane(b));
    const float d = step();
    return d != 0 && std::isfinite(1 / d) ? 1 / d : 0.0f;
  };
  for (uint32_t y = 0; y <= nv; ++y)
    for (uint32_t x = 0; x <= nu; ++x) {
      const uint32_t i = y * row + x;
      s.uScale[i] = pick(i, x, nu, 1, du, u, s.uLo[i], s.uHi[i]);
      s.vScale[i] = pick(i, y, nv, row, dv, v, s.vLo[i], s.vHi[i]);
      s.uCell[i] = du, s.vCell[i] = dv;
    }
}

void meshletStencil(DerivativeStencil& s, uint32_t vertices, uint32_t triangles, const uint8_t* indices,
                    uint32_t lanes) {
  s.resize(lanes);
  s.used = vertices;
  for (uint32_t i = 0; i < lanes; ++i) {
    s.uLo[i] = s.uHi[i] = s.vLo[i] = s.vHi[i] = uint16_t(i);
    s.uCell[i] = s.vCell[i] = 1;
  }
  for (uint32_t t = 0; t < triangles; ++t)
    for (uint32_t k = 0; k < 3; ++k) {
      const uint32_t i = indices[3 * t + k], a = indices[3 * t + (k + 1) % 3],
                     b = indices[3 * t + (k + 2) % 3];
      if (i >= vertices || a >= vertices || b >= vertices || s.uScale[i] != 0) continue;
      s.uHi[i] = uint16_t(a), s.vHi[i] = uint16_t(b);
      s.uScale[i] = s.vScale[i] = 1;
    }
}

void tripleStencil(DerivativeStencil& s, uint32_t period, const float* du, const float* dv) {
  s.resize(3 * period);
  s.used = 3 * period;
  for (uint32_t i = 0; i < 3 * period; ++i) {
    const uint32_t p = i % period;
    s.uLo[i] = s.vLo[i] = uint16_t(p);
    s.uHi[i] = uint16_t(period + p), s.vHi[i] = uint16_t(2 * period + p);
    s.uScale[i] = du[p] != 0 ? 1 / du[p] : 0, s.vScale[i] = dv[p] != 0 ? 1 / dv[p] : 0;
    s.uCell[i] = du[p], s.vCell[i] = dv[p];
  }
}

}  // namespace fr
