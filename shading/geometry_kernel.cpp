// Vectors, matrices, transformations and colours.
#include "shading/kernel_loop.h"

namespace fr::FR_ISA {

void addGeometryKernels(KernelTable& t);

namespace {
struct M4 {
  V e[16];
};
FR_INLINE M4 loadMatrix(const Operand& a, uint32_t i) {
  M4 m;
  for (uint32_t c = 0; c < 16; ++c) m.e[c] = load(a, i, c);
  return m;
}
FR_INLINE M4 loadMatrix(const float* f) {
  M4 m;
  for (uint32_t c = 0; c < 16; ++c) m.e[c] = splat(f[c]);
  return m;
}
FR_INLINE void storeMatrix(const Operand& a, uint32_t i, const M4& m) {
  for (uint32_t c = 0; c < 16; ++c) store(a, i, m.e[c], c);
}
FR_INLINE M4 multiply(const M4& a, const M4& b) {
  M4 r;
  for (int y = 0; y < 4; ++y)
    for (int x = 0; x < 4; ++x)
      r.e[y * 4 + x] = a.e[y * 4] * b.e[x] + a.e[y * 4 + 1] * b.e[4 + x] + a.e[y * 4 + 2] * b.e[8 + x] +
                       a.e[y * 4 + 3] * b.e[12 + x];
  return r;
}
/// Cofactors by 2x2 minors; returns the determinant.
FR_INLINE V adjugate(const M4& m, M4& r) {
  const V* a = m.e;
  const V s0 = a[0] * a[5] - a[4] * a[1], s1 = a[0] * a[6] - a[4] * a[2], s2 = a[0] * a[7] - a[4] * a[3];
  const V s3 = a[1] * a[6] - a[5] * a[2], s4 = a[1] * a[7] - a[5] * a[3], s5 = a[2] * a[7] - a[6] * a[3];
  const V c5 = a[10] * a[15] - a[14] * a[11], c4 = a[9] * a[15] - a[13] * a[11],
          c3 = a[9] * a[14] - a[13] * a[10];
  const V c2 = a[8] * a[15] - a[12] * a[11], c1 = a[8] * a[14] - a[12] * a[10],
          c0 = a[8] * a[13] - a[12] * a[9];
  r.e[0] = a[5] * c5 - a[6] * c4 + a[7] * c3;
  r.e[1] = -a[1] * c5 + a[2] * c4 - a[3] * c3;
  r.e[2] = a[13] * s5 - a[14] * s4 + a[15] * s3;
  r.e[3] = -a[9] * s5 + a[10] * s4 - a[11] * s3;
  r.e[4] = -a[4] * c5 + a[6] * c2 - a[7] * c1;
  r.e[5] = a[0] * c5 - a[2] * c2 + a[3] * c1;
  r.e[6] = -a[12] * s5 + a[14] * s2 - a[15] * s1;
  r.e[7] = a[8] * s5 - a[10] * s2 + a[11] * s1;
  r.e[8] = a[4] * c4 - a[5] * c2 + a[7] * c0;
  r.e[9] = -a[0] * c4 + a[1] * c2 - a[3] * c0;
  r.e[10] = a[12] * s4 - a[13] * s2 + a[15] * s0;
  r.e[11] = -a[8] * s4 + a[9] * s2 - a[11] * s0;
  r.e[12] = -a[4] * c3 + a[5] * c1 - a[6] * c0;
  r.e[13] = a[0] * c3 - a[1] * c1 + a[2] * c0;
  r.e[14] = -a[12] * s3 + a[13] * s1 - a[14] * s0;
  r.e[15] = a[8] * s3 - a[9] * s1 + a[10] * s0;
  return s0 * c5 - s1 * c4 + s2 * c3 + s3 * c2 - s4 * c1 + s5 * c0;
}
/// Singular: identity.
FR_INLINE M4 inverse(const M4& m) {
  M4 r;
  const V det = adjugate(m, r);
  const V inv = divide(splat(1.0f), det);
  for (int c = 0; c < 16; ++c) r.e[c] = select(det == 0.0f, splat(c % 5 == 0 ? 1.0f : 0.0f), r.e[c] * inv);
  return r;
}
FR_INLINE V3 transformPoint(const M4& m, V3 p) {
  const V* e = m.e;
  const V in[4] = {p.x * e[0] + p.y * e[4] + p.z * e[8] + e[12], p.x * e[1] + p.y * e[5] + p.z * e[9] + e[13],
                   p.x * e[2] + p.y * e[6] + p.z * e[10] + e[14],
                   p.x * e[3] + p.y * e[7] + p.z * e[11] + e[15]};
  V r[3] = {in[0], in[1], in[2]};
  rarely<Homogeneous>(in[3] != 1.0f, in, r);
  return {r[0], r[1], r[2]};
}
FR_INLINE V3 transformVector(const M4& m, V3 p) {
  const V* e = m.e;
  return {p.x * e[0] + p.y * e[4] + p.z * e[8], p.x * e[1] + p.y * e[5] + p.z * e[9],
          p.x * e[2] + p.y * e[6] + p.z * e[10]};
}
FR_INLINE V3 transformNormal(const M4& m, V3 p) {
  const V3 a = {m.e[0], m.e[1], m.e[2]}, b = {m.e[4], m.e[5], m.e[6]}, c = {m.e[8], m.e[9], m.e[10]};
  const V3 bc = cross(b, c), ca = cross(c, a), ab = cross(a, b);
  const V det = dot(a, bc);
  const V inv = select(det == 0.0f, splat(1.0f), divide(splat(1.0f), det));
  return {(p.x * bc.x + p.y * ca.x + p.z * ab.x) * inv, (p.x * bc.y + p.y * ca.y + p.z * ab.y) * inv,
          (p.x * bc.z + p.y * ca.z + p.z * ab.z) * inv};
}
/// Rows of the rotation about a unit axis.
FR_INLINE V3 rotateAbout(V3 p, V angle, V3 axis) {
  V s, c;
  sinCos(angle, s, c);
  const V d = dot(axis, p) * (1.0f - c);
  const V3 x = cross(axis, p);
  return {p.x * c + x.x * s + axis.x * d, p.y * c + x.y * s + axis.y * d, p.z * c + x.z * s + axis.z * d};
}
FR_INLINE V3 refracted(V3 in, V3 n, V eta) {
  const V d = dot(in, n);
  const V k = 1.0f - eta * eta * (1.0f - d * d);
  const V f = eta * d + vsqrt(k);
  const V3 r = {eta * in.x - f * n.x, eta * in.y - f * n.y, eta * in.z - f * n.z};
  return select(k < 0.0f, V3{}, r);
}
FR_INLINE V3 reflected(V3 in, V3 n) {
  const V d = 2.0f * dot(in, n);
  return {in.x - d * n.x, in.y - d * n.y, in.z - d * n.z};
}

void addVectors(KernelTable& t) {
  const auto slot = [&t](Op op) -> Kernel& { return t.op[size_t(op)]; };
  FR_KERNEL(slot(Op::length), 2, store(a[0], i, length(load3(a[1], i))));
  FR_KERNEL(slot(Op::distance), 3, store(a[0], i, length(sub(load3(a[1], i), load3(a[2], i)))));
  FR_KERNEL(slot(Op::normalize), 2, store3(a[0], i, normalize(load3(a[1], i))));
  FR_KERNEL(slot(Op::ptlined), 4, const V3 p = load3(a[1], i); const V3 d = sub(load3(a[2], i), p);
            const V3 q = sub(load3(a[3], i), p);
            const V f = clampTo(divide(dot(q, d), dot(d, d)), 0.0f, 1.0f);
            store(a[0], i, length(sub(q, scale(d, f)))));
  FR_KERNEL(slot(Op::rotate_t), 5, const V3 p0 = load3(a[3], i);
            const V3 axis = normalize(sub(load3(a[4], i), p0));
            store3(a[0], i, add(p0, rotateAbout(sub(load3(a[1], i), p0), load(a[2], i), axis))));
  FR_KERNEL(slot(Op::faceforward), 4, const V3 n = load3(a[1], i);
            const VI flip = dot(load3(a[2], i), load3(a[3], i)) > 0.0f;
            store3(a[0], i, select(flip, V3{-n.x, -n.y, -n.z}, n)));
  FR_KERNEL(slot(Op::reflect), 3, store3(a[0], i, reflected(load3(a[1], i), load3(a[2], i))));
  FR_KERNEL(slot(Op::refract), 4, store3(a[0], i, refracted(load3(a[1], i), load3(a[2], i), load(a[3], i))));
  FR_KERNEL(slot(Op::fresnel), 7, const V3 in = load3(a[4], i); const V3 n = load3(a[5], i);
            const V eta = load(a[6], i); const V c = -dot(in, n);
            const V g2 = divide(splat(1.0f), eta * eta) - 1.0f + c * c; const V g = vsqrt(g2);
            const V q = divide(g - c, g + c); const V h = divide(c * (g + c) - 1.0f, c * (g - c) + 1.0f);
            const V f = clampTo(0.5f * q * q * (1.0f + h * h), 0.0f, 1.0f); const VI total = g2 < 0.0f;
            store(a[0], i, select(total, splat(1.0f), f));
            store(a[1], i, select(total, V{}, (1.0f - f) * eta * eta)); store3(a[2], i, reflected(in, n));
            store3(a[3], i, refracted(in, n, eta)));
}

void addMatrices(KernelTable& t) {
  const auto slot = [&t](Op op) -> Kernel& { return t.op[size_t(op)]; };
  FR_KERNEL(slot(Op::mul_m), 3, storeMatrix(a[0], i, multiply(loadMatrix(a[1], i), loadMatrix(a[2], i))));
  FR_KERNEL(slot(Op::div_m), 3,
            storeMatrix(a[0], i, multiply(loadMatrix(a[1], i), inverse(loadMatrix(a[2], i)))));
  FR_KERNEL(slot(Op::inverse_m), 2, storeMatrix(a[0], i, inverse(loadMatrix(a[1], i))));
  FR_KERNEL(slot(Op::determinant), 2, M4 r; store(a[0], i, adjugate(loadMatrix(a[1], i), r)));
  FR_KERNEL(slot(Op::eq_m), 3, VI same = splatInt(-1);
            for (uint32_t c = 0; c < 16; ++c) same &= load(a[1], i, c) == load(a[2], i, c);
            store(a[0], i, toFlag(same)));
  FR_KERNEL(slot(Op::ne_m), 3, VI same = splatInt(-1);
            for (uint32_t c = 0; c < 16; ++c) same &= load(a[1], i, c) == load(a[2], i, c);
            store(a[0], i, toFlag(~same)));
  FR_KERNEL(
      slot(Op::translate_m), 3, M4 m = loadMatrix(a[1], i); const V3 d = load3(a[2], i);
      for (uint32_t c = 0; c < 4; ++c) m.e[12 + c] += d.x * m.e[c] + d.y * m.e[4 + c] + d.z * m.e[8 + c];
      storeMatrix(a[0], i, m));
  FR_KERNEL(slot(Op::scale_m), 3, M4 m = loadMatrix(a[1], i); const V3 d = load3(a[2], i);
            for (uint32_t c = 0; c < 4; ++c) m.e[c] *= d.x, m.e[4 + c] *= d.y, m.e[8 + c] *= d.z;
            storeMatrix(a[0], i, m));
  FR_KERNEL(slot(Op::rotate_m), 4, const M4 m = loadMatrix(a[1], i); const V angle = load(a[2], i);
            const V3 axis = normalize(load3(a[3], i)); const V one = splat(1.0f); M4 r{};
            const V3 x = rotateAbout({one, V{}, V{}}, angle, axis);
            const V3 y = rotateAbout({V{}, one, V{}}, angle, axis);
            const V3 z = rotateAbout({V{}, V{}, one}, angle, axis);
            r.e[0] = x.x, r.e[1] = x.y, r.e[2] = x.z, r.e[4] = y.x, r.e[5] = y.y, r.e[6] = y.z, r.e[8] = z.x,
            r.e[9] = z.y, r.e[10] = z.z, r.e[15] = one;
            storeMatrix(a[0], i, multiply(r, m)));
  FR_KERNEL(slot(Op::transform_pm), 3, store3(a[0], i, transformPoint(loadMatrix(a[1], i), load3(a[2], i))));
  FR_KERNEL(slot(Op::transform_vm), 3, store3(a[0], i, transformVector(loadMatrix(a[1], i), load3(a[2], i))));
  FR_KERNEL(slot(Op::transform_nm), 3, store3(a[0], i, transformNormal(loadMatrix(a[1], i), load3(a[2], i))));
  const auto helper = [&t](Helper h) -> Kernel& { return t.helper[size_t(h)]; };
  FR_KERNEL_CALL(helper(Helper::transformPoint), 2,
                 store3(a[0], i, transformPoint(loadMatrix(k.matrix), load3(a[1], i))));
  FR_KERNEL_CALL(helper(Helper::transformVector), 2,
                 store3(a[0], i, transformVector(loadMatrix(k.matrix), load3(a[1], i))));
  FR_KERNEL_CALL(helper(Helper::transformNormal), 2,
                 store3(a[0], i, transformNormal(loadMatrix(k.matrix), load3(a[1], i))));
}

FR_INLINE V3 byMatrix(V3 c, const float (&m)[9]) {
  return {c.x * m[0] + c.y * m[1] + c.z * m[2], c.x * m[3] + c.y * m[4] + c.z * m[5],
          c.x * m[6] + c.y * m[7] + c.z * m[8]};
}
// NTSC YIQ; CIE XYZ of Rec. 709 primaries with D65 white.
constexpr float kToYiq[9] = {0.299f,     0.587f,    0.114f,     0.595716f, -0.274453f,
                             -0.321263f, 0.211456f, -0.522591f, 0.311135f};
constexpr float kFromYiq[9] = {1.0f,        0.9562957f, 0.6210244f,  1.0f,      -0.2721221f,
                               -0.6473806f, 1.0f,       -1.1069890f, 1.7046150f};
constexpr float kToXyz[9] = {0.4124564f, 0.3575761f, 0.1804375f, 0.2126729f, 0.7151522f,
                             0.0721750f, 0.0193339f, 0.1191920f, 0.9503041f};
constexpr float kFromXyz[9] = {3.2404542f, -1.5371385f, -0.4985314f, -0.9692660f, 1.8760108f,
                               0.0415560f, 0.0556434f,  -0.2040259f, 1.0572252f};

/// Hue of an rgb colour, 0..1, from its largest component and the range.
FR_INLINE V hueOf(V3 c, V largest, V range) {
  const V r = divide(c.y - c.z, range), g = divide(c.z - c.x, range) + 2.0f,
          b = divide(c.x - c.y, range) + 4.0f;
  const V h = select(c.x == largest, r, select(c.y == largest, g, b)) * 0.166666667f;
  return select(range == 0.0f, V{}, select(h < 0.0f, h + 1.0f, h));
}
/// Fully saturated, fully bright colour of a hue.
FR_INLINE V3 ofHue(V h) {
  const V x = (h - vfloor(h)) * 6.0f;
  return {clampTo(vabs(x - 3.0f) - 1.0f, 0.0f, 1.0f), clampTo(2.0f - vabs(x - 2.0f), 0.0f, 1.0f),
          clampTo(2.0f - vabs(x - 4.0f), 0.0f, 1.0f)};
}
FR_INLINE V3 toRgb(V3 c, uint32_t space) {
  switch (ColorSpace(space)) {
    case ColorSpace::kHsv: {
      const V3 h = ofHue(c.x);
      const V s = c.y, v = c.z;
      return {v * (1.0f - s + h.x * s), v * (1.0f - s + h.y * s), v * (1.0f - s + h.z * s)};
    }
    case ColorSpace::kHsl: {
      const V3 h = ofHue(c.x);
      const V q = c.y * (1.0f - vabs(2.0f * c.z - 1.0f));
      return {c.z + q * (h.x - 0.5f), c.z + q * (h.y - 0.5f), c.z + q * (h.z - 0.5f)};
    }
    case ColorSpace::kXyz:
      return byMatrix(c, kFromXyz);
    case ColorSpace::kXyY:
      return byMatrix({divide(c.x * c.z, c.y), c.z, divide((1.0f - c.x - c.y) * c.z, c.y)}, kFromXyz);
    case ColorSpace::kYiq:
      return byMatrix(c, kFromYiq);
    case ColorSpace::kRgb:
      break;
  }
  return c;
}
FR_INLINE V3 fromRgb(V3 c, uint32_t space) {
  const V hi = vmax(c.x, vmax(c.y, c.z)), lo = vmin(c.x, vmin(c.y, c.z));
  const V range = hi - lo;
  switch (ColorSpace(space)) {
    case ColorSpace::kHsv:
      return {hueOf(c, hi, range), divide(range, hi), hi};
    case ColorSpace::kHsl: {
      const V l = (hi + lo) * 0.5f;
      return {hueOf(c, hi, range), divide(range, 1.0f - vabs(2.0f * l - 1.0f)), l};
    }
    case ColorSpace::kXyz:
      return byMatrix(c, kToXyz);
    case ColorSpace::kXyY: {
      const V3 x = byMatrix(c, kToXyz);
      const V sum = x.x + x.y + x.z;
      return {divide(x.x, sum), divide(x.y, sum), x.y};
    }
    case ColorSpace::kYiq:
      return byMatrix(c, kToYiq);
    case ColorSpace::kRgb:
      break;
  }
  return c;
}
}  // namespace

void addGeometryKernels(KernelTable& t) {
  addVectors(t);
  addMatrices(t);
  FR_KERNEL_CALL(t.helper[size_t(Helper::ctransform)], 2,
                 store3(a[0], i, fromRgb(toRgb(load3(a[1], i), k.mode / 8), k.mode % 8)));
}

}  // namespace fr::FR_ISA
