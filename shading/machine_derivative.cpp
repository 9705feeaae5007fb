// Derivatives: differences between neighbours of the batch, and what is made of them.
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "shading/machine.h"

namespace fr {

namespace {
enum class StepFilter { kBox, kTriangle, kGaussian, kCatmullRom };
StepFilter stepFilterOf(std::string_view name) {
  if (name == "triangle") return StepFilter::kTriangle;
  if (name == "gaussian") return StepFilter::kGaussian;
  if (name == "catmull-rom") return StepFilter::kCatmullRom;
  return StepFilter::kBox;
}
/// The filter's integral up to x, in units of its width: 0 to 1. Supports are 1, 2, 2 and 4 wide.
float stepIntegral(StepFilter filter, float x) {
  const float a = std::fabs(x);
  float half = 0;  // from 0 to a
  switch (filter) {
    case StepFilter::kBox:
      return std::clamp(x + 0.5f, 0.0f, 1.0f);
    case StepFilter::kTriangle:
      half = a < 1 ? a - 0.5f * a * a : 0.5f;
      break;
    case StepFilter::kGaussian:  // exp(-2 x^2) within 1 of the middle, as RiGaussianFilter
      half = a < 1 ? 0.5f * std::erf(1.41421356f * a) / 0.954499736f : 0.5f;
      break;
    case StepFilter::kCatmullRom:
      if (a < 1)
        half = a * (1 + a * a * (0.375f * a - 0.833333333f));
      else if (a < 2)
        half = a * (2 + a * (-2 + a * (0.833333333f - 0.125f * a))) - 0.166666667f;
      else
        half = 0.5f;
      break;
  }
  return x < 0 ? 0.5f - half : 0.5f + half;
}
}  // namespace

/// The change of x from neighbour to neighbour along u (or v). Neighbours that are not active have no defined
/// value: the difference is then one-sided, or 0.
Difference Machine::differenceOf(const Frame& f, const Operand& x, bool alongV) const {
  const DerivativeStencil& d = *batch_.stencil;
  Difference q;
  q.x = x.data, q.component = x.component;
  q.lo = (alongV ? d.vLo : d.uLo).data(), q.hi = (alongV ? d.vHi : d.uHi).data();
  q.scale = (alongV ? d.vScale : d.uScale).data();
  const bool whole = f.activeCount >= d.used;
  q.mask = whole ? nullptr : f.mask;
  q.lanes = f.lanes();
  return q;
}

/// Per unit of u, or with `perCell` from one cell to the next.
void Machine::difference(const Frame& f, const Operand& x, uint32_t components, bool alongV, bool perCell,
                         const Operand& out) const {
  const DerivativeStencil* const d = batch_.stencil;
  if (!d || !x.varying()) {
    for (uint32_t c = 0; c < components; ++c) std::fill_n(out.comp(c), f.lanes(), 0.0f);
    return;
  }
  Difference q = differenceOf(f, x, alongV);
  q.cell = perCell ? (alongV ? d->vCell : d->uCell).data() : nullptr;
  q.components = components;
  q.out = out.data, q.outComponent = out.component;
  kernels().difference(q);
}

/// Where a side of a surface has shrunk to a point (the pole of a sphere) nothing changes along it: the
/// normal there is that of the next point that has one.
void Machine::fillFromNeighbours(const Frame& f, const DerivativeStencil& d, const Operand& normal) {
  const auto isZero = [&](uint32_t i) {
    return normal.at(i, 0) == 0 && normal.at(i, 1) == 0 && normal.at(i, 2) == 0;
  };
  // Mostly there is none, and looking for it takes a few instructions a vector.
  uint32_t any = 0;
  const float *const x = normal.comp(0), *const y = normal.comp(1), *const z = normal.comp(2);
  for (uint32_t i = 0; i < d.used; ++i) {
    const auto bits = [i](const float* v) { return std::bit_cast<uint32_t>(v[i]); };
    any |= (bits(x) | bits(y) | bits(z)) << 1 ? 0u : 1u;  // signs aside
  }
  for (uint32_t i = 0; any && i < d.used; ++i) {
    if (f.mask[i] == 0 || !isZero(i)) continue;
    for (const uint16_t j : {d.vHi[i], d.vLo[i], d.uHi[i], d.uLo[i]}) {
      if (f.mask[j] == 0 || isZero(j)) continue;
      for (uint32_t c = 0; c < 3; ++c) normal.comp(c)[i] = normal.at(j, c);
      break;
    }
  }
}

/// Du(), Dv() and calculatenormal() for all points, to other columns than those of x.
void Machine::derivative(const Frame& f, Op op, const Operand& x, uint32_t components,
                         const Operand& out) const {
  if (op != Op::calculatenormal)
    return difference(f, x, components, op == Op::dv_f || op == Op::dv_t, false, out);
  if (!batch_.stencil || !x.varying()) {
    for (uint32_t c = 0; c < 3; ++c) std::fill_n(out.comp(c), f.lanes(), 0.0f * batch_.orientation);
    return;
  }
  Difference alongU = differenceOf(f, x, false);
  alongU.out = out.data, alongU.outComponent = out.component;
  kernels().crossOfDifferences(alongU, differenceOf(f, x, true), batch_.orientation);
  fillFromNeighbours(f, *batch_.stencil, out);
}

/// The columns of a run, and the differences that it reads behind them.
float* const* Machine::columnsWithDifferences(Frame& f, const NativeCode::Run& run) {
  columnsWithLights(f);
  const uint32_t n = f.lanes();
  const auto componentsOf = [](Op op) { return op == Op::du_f || op == Op::dv_f ? 1u : 3u; };
  const uint32_t count = run.differences.back().column + componentsOf(run.differences.back().op);
  differences_.reserve(size_t(n) * count);
  if (columns_.size() < run.firstDifference + count) columns_.resize(run.firstDifference + count);
  for (uint32_t c = 0; c < count; ++c)
    columns_[run.firstDifference + c] = differences_.data() + size_t(c) * n;
  for (const RunDifference& d : run.differences)
    derivative(f, d.op, f.symbol(d.symbol), componentsOf(d.op),
               {columns_[run.firstDifference + d.column], n, ~0u});
  return columns_.data();
}

void Machine::derivativeOp(Frame& f, const Step& s) {
  const Operand* a = f.args(s);
  const uint32_t n = f.lanes();
  const DerivativeStencil* const d = batch_.stencil;
  // The result may be an operand's own register, and neighbours are still to be read: results are collected
  // aside.
  const Operand& result = a[0];
  scratch_.reserve(size_t(n) * 12);
  const auto column = [&](uint32_t c) { return scratch_.data() + size_t(c) * n; };
  const auto kernel = [&](Op op, std::initializer_list<Operand> args) {
    KernelCall c;
    c.arg = args.begin(), c.argCount = uint32_t(args.size()), c.lanes = n, c.mask = f.mask;
    kernels().op[size_t(op)](c);
  };
  const uint32_t components = slTypeFloats(f.exe().program().symbols[symbolOf(f, s, 0)].type);
  const Operand first{column(0), n, ~0u}, second{column(3), n, ~0u}, third{column(6), n, ~0u};
  switch (s.op) {
    case Op::du_f:
    case Op::du_t:
    case Op::dv_f:
    case Op::dv_t:
    case Op::calculatenormal: {
      const bool aside = !result.varying() || (result.data == a[1].data);
      derivative(f, s.op, a[1], components, aside ? first : result);
      if (!aside) return;
      break;
    }
    case Op::deriv_f:
    case Op::deriv_t:
      for (const bool alongV : {false, true}) {
        const Operand& sum = alongV ? second : first;
        difference(f, a[2], 1, alongV, false, third);
        difference(f, a[1], components, alongV, false, sum);
        for (uint32_t c = 0; c < components; ++c) {
          const Operand part{sum.comp(c), n, ~0u};
          kernel(Op::div_f, {part, part, third});
        }
      }
      for (uint32_t c = 0; c < components; ++c) {
        const Operand x{first.comp(c), n, ~0u}, y{second.comp(c), n, ~0u};
        kernel(Op::add_f, {x, x, y});
      }
      break;
    case Op::area:
      if (!d || !a[1].varying()) {
        std::fill_n(first.data, n, 0.0f);
        break;
      }
      {
        Difference alongU = differenceOf(f, a[1], false);
        alongU.out = third.data, alongU.outComponent = third.component;
        kernels().crossOfDifferences(alongU, differenceOf(f, a[1], true), 1.0f);
      }
      kernel(Op::length, {first, third});
      for (uint32_t i = 0; i < n; ++i) first.data[i] *= std::fabs(d->uCell[i] * d->vCell[i]);
      break;
    default:
      return filterStep(f, s);
  }
  for (uint32_t c = 0; c < components; ++c)
    std::memcpy(result.comp(c), first.comp(c), (result.varying() ? n : kLanePad) * sizeof(float));
}

void Machine::filterStep(Frame& f, const Step& s) {
  const Operand* a = f.args(s);
  const bool two = s.op == Op::filterstep_2;
  const uint32_t n = f.lanes(), fixed = two ? 4 : 3;
  const Operand* const width = option(f, s, fixed, "width");
  const StepFilter filter = stepFilterOf(optionString(f, s, fixed, "filter"));
  const uint32_t lanes = a[0].varying() ? n : kLanePad;
  scratch_.reserve(size_t(n) * 12);
  float *const du = scratch_.data(), *const dv = du + n, *const out = dv + n;
  if (!two)
    difference(f, a[2], 1, false, true, {du, n, ~0u}), difference(f, a[2], 1, true, true, {dv, n, ~0u});
  for (uint32_t i = 0; i < lanes; ++i) {
    float w = two ? std::fabs(a[3].at(i) - a[2].at(i)) : std::fabs(du[i]) + std::fabs(dv[i]);
    const float x = two ? 0.5f * (a[3].at(i) + a[2].at(i)) : a[2].at(i);
    if (width && width->data) w *= width->at(i);
    const float edge = a[1].at(i);
    out[i] = w > 1e-12f ? stepIntegral(filter, (x - edge) / w) : x < edge ? 0.0f : 1.0f;
  }
  std::memcpy(a[0].data, out, lanes * sizeof(float));
}

}  // namespace fr
