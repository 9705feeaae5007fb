#include "shading/machine.h"

namespace fr {

void gridStencil(DerivativeStencil& s, uint32_t nu, uint32_t nv, uint32_t lanes, float du, float dv) {
  s.resize(lanes);
  const uint32_t row = nu + 1;
  for (uint32_t i = 0; i < lanes; ++i) s.uLo[i] = s.uHi[i] = s.vLo[i] = s.vHi[i] = uint16_t(i);
  const float inverseU = du != 0 ? 1 / du : 0, inverseV = dv != 0 ? 1 / dv : 0;
  for (uint32_t y = 0; y <= nv; ++y)
    for (uint32_t x = 0; x <= nu; ++x) {
      const uint32_t i = y * row + x;
      const uint32_t x0 = x > 0 ? x - 1 : x, x1 = x < nu ? x + 1 : x, y0 = y > 0 ? y - 1 : y,
                     y1 = y < nv ? y + 1 : y;
      s.uLo[i] = uint16_t(y * row + x0), s.uHi[i] = uint16_t(y * row + x1);
      s.vLo[i] = uint16_t(y0 * row + x), s.vHi[i] = uint16_t(y1 * row + x);
      s.uScale[i] = x1 > x0 ? inverseU / float(x1 - x0) : 0;
      s.vScale[i] = y1 > y0 ? inverseV / float(y1 - y0) : 0;
      s.uCell[i] = du, s.vCell[i] = dv;
    }
}

void meshletStencil(DerivativeStencil& s, uint32_t vertices, uint32_t triangles, const uint8_t* indices,
                    uint32_t lanes) {
  s.resize(lanes);
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
  for (uint32_t i = 0; i < 3 * period; ++i) {
    const uint32_t p = i % period;
    s.uLo[i] = s.vLo[i] = uint16_t(p);
    s.uHi[i] = uint16_t(period + p), s.vHi[i] = uint16_t(2 * period + p);
    s.uScale[i] = du[p] != 0 ? 1 / du[p] : 0, s.vScale[i] = dv[p] != 0 ? 1 / dv[p] : 0;
    s.uCell[i] = du[p], s.vCell[i] = dv[p];
  }
}

}  // namespace fr
