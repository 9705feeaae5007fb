// Assignment, arithmetic, comparison and elementary mathematics.
#include <cstring>

#include "shading/kernel_loop.h"

namespace fr::FR_ISA {

void addArithmeticKernels(KernelTable& t);

namespace {
void addAssignments(KernelTable& t) {
  const auto slot = [&t](Op op) -> Kernel& { return t.op[size_t(op)]; };
  FR_KERNEL_CALL(slot(Op::assign_f), 2,
                 store(a[0], i, select(loadMask(k.mask, i), load(a[1], i), load(a[0], i))));
  FR_KERNEL_CALL(slot(Op::assign_t), 2, const VI m = loadMask(k.mask, i);
                 store3(a[0], i, select(m, load3(a[1], i), load3(a[0], i))));
  FR_KERNEL_CALL(slot(Op::assign_m), 2, const VI m = loadMask(k.mask, i); for (uint32_t c = 0; c < 16; ++c)
                     store(a[0], i, select(m, load(a[1], i, c), load(a[0], i, c)), c));
  FR_KERNEL(slot(Op::splat_t), 2, const V x = load(a[1], i); store3(a[0], i, {x, x, x}));
  FR_KERNEL(slot(Op::diagonal_m), 2, const V x = load(a[1], i);
            for (uint32_t c = 0; c < 16; ++c) store(a[0], i, c % 5 == 0 ? x : V{}, c));
  FR_KERNEL(slot(Op::make_t), 4, store3(a[0], i, {load(a[1], i), load(a[2], i), load(a[3], i)}));
  FR_KERNEL(slot(Op::make_m), 17, for (uint32_t c = 0; c < 16; ++c) store(a[0], i, load(a[1 + c], i), c));
  FR_KERNEL(slot(Op::average_t), 2, const V3 x = load3(a[1], i);
            store(a[0], i, (x.x + x.y + x.z) * 0.333333333f));
  FR_KERNEL(slot(Op::comp_t), 3, const V3 x = load3(a[1], i); const V c = load(a[2], i);
            store(a[0], i, select(c < 1.0f, x.x, select(c < 2.0f, x.y, x.z))));
  FR_KERNEL_CALL(slot(Op::setcomp_t), 3, const VI m = loadMask(k.mask, i); const V3 x = load3(a[0], i);
                 const V c = vfloor(load(a[1], i)); const V f = load(a[2], i);
                 store3(a[0], i,
                        {select(m & (c == 0.0f), f, x.x), select(m & (c == 1.0f), f, x.y),
                         select(m & (c == 2.0f), f, x.z)}));
  FR_KERNEL(slot(Op::comp_m), 4,
            const V e = clampTo(vfloor(load(a[2], i)), 0.0f, 3.0f) * 4.0f +
                        clampTo(vfloor(load(a[3], i)), 0.0f, 3.0f);
            V r = load(a[1], i, 0);
            for (uint32_t c = 1; c < 16; ++c) r = select(e == float(c), load(a[1], i, c), r);
            store(a[0], i, r));
  FR_KERNEL_CALL(
      slot(Op::setcomp_m), 4, const VI m = loadMask(k.mask, i); const V r = vfloor(load(a[1], i));
      const V q = vfloor(load(a[2], i)); const V f = load(a[3], i); for (uint32_t c = 0; c < 16; ++c)
          store(a[0], i, select(m & (r == float(c / 4)) & (q == float(c % 4)), f, load(a[0], i, c)), c));
  FR_KERNEL(slot(Op::select_f), 4,
            store(a[0], i, select(load(a[1], i) != 0.0f, load(a[2], i), load(a[3], i))));
  FR_KERNEL(slot(Op::select_t), 4,
            store3(a[0], i, select(load(a[1], i) != 0.0f, load3(a[2], i), load3(a[3], i))));
  FR_KERNEL(slot(Op::select_m), 4, const VI m = load(a[1], i) != 0.0f; for (uint32_t c = 0; c < 16; ++c)
                store(a[0], i, select(m, load(a[2], i, c), load(a[3], i, c)), c));
}

#define FR_COMPONENTS2(x, y, expression)                               \
  const V3 p = load3(a[1], i);                                         \
  const V3 q = load3(a[2], i);                                         \
  const auto g = [](V x, V y) FR_LANE_FUNCTION { return expression; }; \
  store3(a[0], i, {g(p.x, q.x), g(p.y, q.y), g(p.z, q.z)})

void addArithmetic(KernelTable& t) {
  const auto slot = [&t](Op op) -> Kernel& { return t.op[size_t(op)]; };
#define FR_BINARY(name, expression)                                                  \
  FR_KERNEL(slot(Op::name), 3, const V x = load(a[1], i); const V y = load(a[2], i); \
            store(a[0], i, expression))
#define FR_UNARY(name, expression) \
  FR_KERNEL(slot(Op::name), 2, const V x = load(a[1], i); store(a[0], i, expression))
  FR_BINARY(add_f, x + y);
  FR_BINARY(sub_f, x - y);
  FR_BINARY(mul_f, x * y);
  FR_BINARY(div_f, divide(x, y));
  FR_BINARY(eq_f, toFlag(x == y));
  FR_BINARY(ne_f, toFlag(x != y));
  FR_BINARY(lt_f, toFlag(x < y));
  FR_BINARY(le_f, toFlag(x <= y));
  FR_BINARY(gt_f, toFlag(x > y));
  FR_BINARY(ge_f, toFlag(x >= y));
  FR_BINARY(and_f, toFlag((x != 0.0f) & (y != 0.0f)));
  FR_BINARY(or_f, toFlag((x != 0.0f) | (y != 0.0f)));
  FR_UNARY(not_f, toFlag(x == 0.0f));
  FR_UNARY(neg_f, -x);
  FR_BINARY(min_f, vmin(x, y));
  FR_BINARY(max_f, vmax(x, y));
  FR_BINARY(mod, select(y == 0.0f, V{}, x - y * vfloor(divide(x, y))));
  FR_UNARY(abs, vabs(x));
  FR_UNARY(sign, select(x > 0.0f, splat(1.0f), select(x < 0.0f, splat(-1.0f), V{})));
  FR_UNARY(floor, vfloor(x));
  FR_UNARY(ceil, vceil(x));
  FR_UNARY(round, vround(x));
  FR_BINARY(step, select(y < x, V{}, splat(1.0f)));
  FR_KERNEL(slot(Op::clamp_f), 4, store(a[0], i, vmax(vmin(load(a[1], i), load(a[3], i)), load(a[2], i))));
  FR_KERNEL(slot(Op::mix_f), 4, const V m = load(a[3], i);
            store(a[0], i, load(a[1], i) * (1.0f - m) + load(a[2], i) * m));
  FR_KERNEL(slot(Op::smoothstep), 4, const V lo = load(a[1], i); const V hi = load(a[2], i);
            const V x = load(a[3], i); const V r = clampTo(divide(x - lo, hi - lo), 0.0f, 1.0f);
            store(a[0], i, select(lo < hi, r * r * (3.0f - 2.0f * r), select(x < lo, V{}, splat(1.0f)))));

  FR_KERNEL(slot(Op::add_t), 3, store3(a[0], i, add(load3(a[1], i), load3(a[2], i))));
  FR_KERNEL(slot(Op::sub_t), 3, store3(a[0], i, sub(load3(a[1], i), load3(a[2], i))));
  t.helper[size_t(Helper::subTriple)] = slot(Op::sub_t);
  FR_KERNEL(slot(Op::mul_t), 3, FR_COMPONENTS2(x, y, x * y));
  FR_KERNEL(slot(Op::div_t), 3, FR_COMPONENTS2(x, y, divide(x, y)));
  FR_KERNEL(slot(Op::mul_tf), 3, store3(a[0], i, scale(load3(a[1], i), load(a[2], i))));
  FR_KERNEL(slot(Op::div_tf), 3, const V3 x = load3(a[1], i); const V y = load(a[2], i);
            store3(a[0], i, {divide(x.x, y), divide(x.y, y), divide(x.z, y)}));
  FR_KERNEL(slot(Op::neg_t), 2, const V3 x = load3(a[1], i); store3(a[0], i, {-x.x, -x.y, -x.z}));
  FR_KERNEL(slot(Op::dot), 3, store(a[0], i, dot(load3(a[1], i), load3(a[2], i))));
  FR_KERNEL(slot(Op::cross), 3, store3(a[0], i, cross(load3(a[1], i), load3(a[2], i))));
  FR_KERNEL(slot(Op::eq_t), 3, const V3 x = load3(a[1], i); const V3 y = load3(a[2], i);
            store(a[0], i, toFlag((x.x == y.x) & (x.y == y.y) & (x.z == y.z))));
  FR_KERNEL(slot(Op::ne_t), 3, const V3 x = load3(a[1], i); const V3 y = load3(a[2], i);
            store(a[0], i, toFlag((x.x != y.x) | (x.y != y.y) | (x.z != y.z))));
  FR_KERNEL(slot(Op::mod_t), 3, FR_COMPONENTS2(x, y, select(y == 0.0f, V{}, x - y * vfloor(divide(x, y)))));
  FR_KERNEL(slot(Op::abs_t), 2, const V3 x = load3(a[1], i);
            store3(a[0], i, {vabs(x.x), vabs(x.y), vabs(x.z)}));
  FR_KERNEL(slot(Op::min_t), 3, FR_COMPONENTS2(x, y, vmin(x, y)));
  FR_KERNEL(slot(Op::max_t), 3, FR_COMPONENTS2(x, y, vmax(x, y)));
  FR_KERNEL(slot(Op::clamp_t), 4, const V3 x = load3(a[1], i); const V3 lo = load3(a[2], i);
            const V3 hi = load3(a[3], i);
            store3(a[0], i,
                   {vmax(vmin(x.x, hi.x), lo.x), vmax(vmin(x.y, hi.y), lo.y), vmax(vmin(x.z, hi.z), lo.z)}));
  FR_KERNEL(slot(Op::mix_t), 4, const V m = load(a[3], i);
            store3(a[0], i, add(scale(load3(a[1], i), 1.0f - m), scale(load3(a[2], i), m))));
  FR_KERNEL(
      slot(Op::mix_tt), 4, const V3 x = load3(a[1], i); const V3 y = load3(a[2], i);
      const V3 m = load3(a[3], i); store3(
          a[0], i,
          {x.x * (1.0f - m.x) + y.x * m.x, x.y * (1.0f - m.y) + y.y * m.y, x.z * (1.0f - m.z) + y.z * m.z}));
}

void addMathematics(KernelTable& t) {
  const auto slot = [&t](Op op) -> Kernel& { return t.op[size_t(op)]; };
  FR_UNARY(radians, x * 0.017453292519943296f);
  FR_UNARY(degrees, x * 57.29577951308232f);
  FR_UNARY(sin, vsin(x));
  FR_UNARY(cos, vcos(x));
  FR_KERNEL(slot(Op::tan), 2, V s; V c; sinCos(load(a[1], i), s, c); store(a[0], i, divide(s, c)));
  FR_UNARY(asin, vasin(x));
  FR_UNARY(acos, vacos(x));
  FR_UNARY(atan, vatan(x));
  FR_BINARY(atan2, vatan2(x, y));
  FR_BINARY(pow, vpow(x, y));
  FR_UNARY(exp, vexp(x));
  FR_UNARY(sqrt, vsqrt(x));
  FR_UNARY(inversesqrt, inverseSqrt(x));
  FR_UNARY(log, vlog(x));
  FR_BINARY(log2arg, select(x > 0.0f, divide(vlog(x), vlog(y)), splat(-1.0e38f)));
  FR_UNARY(erf, verf(x));
  FR_UNARY(erfc, verfc(x));
}

#ifndef FR_ISA_recorded
template <class C>
void addRare(KernelTable& t) {
  t.rare[size_t(C::kCase)] = [](const float* in, float* results, const int32_t* where) {
    V x[C::kInputs], r[C::kResults];
    std::memcpy(x, in, sizeof x);
    std::memcpy(r, results, sizeof r);
    rarelyBlend<C>(loadMask(where, 0), x, r);
    std::memcpy(results, r, sizeof r);
  };
}
#endif

#ifndef FR_ISA_recorded
FR_INLINE uint32_t total(VI lanes) {
  uint32_t n = 0;
  for (uint32_t k = 0; k < kLanes; ++k) n += uint32_t(lanes[k]);
  return n;
}
#endif
void addMasks(KernelTable& t) {
  const auto slot = [&t](Helper h) -> Kernel& { return t.helper[size_t(h)]; };
  FR_KERNEL(slot(Helper::maskAndNonZero), 3,
            store(a[0], i, fromBits(bits(load(a[1], i)) & (load(a[2], i) != 0.0f))));
  FR_KERNEL(slot(Helper::maskAndZero), 3,
            store(a[0], i, fromBits(bits(load(a[1], i)) & (load(a[2], i) == 0.0f))));
  FR_KERNEL(slot(Helper::maskAndNot), 3,
            store(a[0], i, fromBits(bits(load(a[1], i)) & ~bits(load(a[2], i)))));
  FR_KERNEL(slot(Helper::maskAnd), 3, store(a[0], i, fromBits(bits(load(a[1], i)) & bits(load(a[2], i)))));
  FR_KERNEL(slot(Helper::maskOr), 3, store(a[0], i, fromBits(bits(load(a[1], i)) | bits(load(a[2], i)))));
  // angle < limit without an arc cosine: cosines fall as angles grow. Limits beyond pi admit everything.
  FR_KERNEL(slot(Helper::maskCone), 5, const V3 l = normalize(load3(a[2], i));
            const V3 axis = normalize(load3(a[3], i)); const V angle = load(a[4], i);
            const VI in = (dot(l, axis) > vcos(clampTo(angle, 0.0f, 3.1415927f))) | (angle > 3.1415927f);
            store(a[0], i, fromBits(bits(load(a[1], i)) & in)));
  FR_KERNEL(slot(Helper::maskDifferent), 3, const V3 x = load3(a[1], i); const V3 y = load3(a[2], i);
            store(a[0], i,
                  fromBits((bits(x.x) != bits(y.x)) | (bits(x.y) != bits(y.y)) | (bits(x.z) != bits(y.z)))));
  FR_KERNEL(slot(Helper::maskNonBlack), 3, const V3 c = load3(a[2], i);
            store(a[0], i, fromBits(bits(load(a[1], i)) & ((c.x != 0.0f) | (c.y != 0.0f) | (c.z != 0.0f)))));
  FR_KERNEL_CALL(slot(Helper::negateMasked), 2, const V3 x = load3(a[1], i); const V3 o = load3(a[0], i);
                 store3(a[0], i, select(loadMask(k.mask, i), V3{-x.x, -x.y, -x.z}, o)));
  slot(Helper::assignTripleMasked) = t.op[size_t(Op::assign_t)];
  slot(Helper::assignFloatMasked) = t.op[size_t(Op::assign_f)];
  FR_KERNEL(slot(Helper::sanitize), 1, const V x = load(a[0], i);
            store(a[0], i, select(vabs(x) <= splat(kLargest), x, V{})));
#ifndef FR_ISA_recorded
  t.lanes = kLanes;
  addRare<DenormalLog>(t), addRare<LargeAngle>(t), addRare<ExtremeLength>(t), addRare<ExtremeNormalize>(t);
  addRare<Homogeneous>(t), addRare<LargeExp>(t), addRare<LargePow>(t);
  t.anyActive = [](const int32_t* mask, uint32_t lanes) {
    VI any{};
    for (uint32_t i = 0; i < lanes; i += kLanes) any |= loadMask(mask, i);
    return anyLane(any);
  };
  t.countActive = [](const int32_t* mask, uint32_t lanes) {
    VI sum{};
    for (uint32_t i = 0; i < lanes; i += kLanes) sum -= loadMask(mask, i);
    return total(sum);
  };
  t.copyMask = [](int32_t* to, const int32_t* from, uint32_t lanes) {
    VI sum{};
    for (uint32_t i = 0; i < lanes; i += kLanes) {
      VI m;
      std::memcpy(&m, from + i, sizeof m);
      *reinterpret_cast<VI*>(to + i) = m;
      sum -= m;
    }
    return total(sum);
  };
#endif
}
}  // namespace

void addArithmeticKernels(KernelTable& t) {
  addAssignments(t);
  addArithmetic(t);
  addMathematics(t);
  addMasks(t);
}

}  // namespace fr::FR_ISA
