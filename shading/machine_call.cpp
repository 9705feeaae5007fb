// Operations without a kernel that need no suspension: arrays, random numbers, splines, transformations.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/error.h"
#include "base/random.h"
#include "shading/machine.h"

namespace fr {

void Machine::setFloat(const Frame& f, const Operand& out, float value) {
  if (!out.varying()) {
    std::fill_n(out.data, kLanePad, value);
    return;
  }
  for (uint32_t i = 0; i < f.lanes(); ++i) out.data[i] = f.mask[i] ? value : out.data[i];
}

void Machine::call(Frame& f, const Step& s) {
  const Operand* a = f.args(s);
  const uint32_t flags = opInfo(s.op).flags;
  switch (s.op) {
    case Op::nop:
      return;
    case Op::assign_s:
    case Op::assign_a:
    case Op::load_f:
    case Op::load_t:
    case Op::load_m:
    case Op::load_s:
    case Op::store_f:
    case Op::store_t:
    case Op::store_m:
    case Op::store_s:
      return arrayOp(f, s);
    case Op::random_f:
    case Op::random_t:
      return randomOp(f, s);
    case Op::spline_f:
    case Op::spline_t:
    case Op::spline_fa:
    case Op::spline_ta:
      return splineOp(f, s);
    case Op::du_f:
    case Op::du_t:
    case Op::dv_f:
    case Op::dv_t:
    case Op::deriv_f:
    case Op::deriv_t:
    case Op::area:
    case Op::calculatenormal:
    case Op::filterstep:
    case Op::filterstep_2:
      return derivativeOp(f, s);
    case Op::transform_p:
    case Op::transform_v:
    case Op::transform_n:
    case Op::space_m:
    case Op::depth:
    case Op::ctransform:
      return transformOp(f, s);
    case Op::dso_call:
      return shadeopCall(f, s);
    case Op::raylevel:
      return setFloat(f, a[0], float(batch_.level));
    case Op::isshadowray:
      return setFloat(f, a[0], batch_.shadowRay ? 1.0f : 0.0f);
    case Op::isindirectray:
      return setFloat(
          f, a[0],
          batch_.level > 0 && !batch_.shadowRay && batch_.rayClass == RayClass::kDiffuse ? 1.0f : 0.0f);
    case Op::raylabel:
      f.strings(symbolOf(f, s, 0))[0] = batch_.rayLabel;
      return;
    case Op::msg_surface:
    case Op::msg_displacement:
    case Op::msg_atmosphere:
    case Op::msg_lightsource:
    case Op::msg_incident:
    case Op::msg_opposite:
    case Op::get_attribute:
    case Op::get_option:
    case Op::get_rendererinfo:
    case Op::get_rayinfo:
    case Op::get_variable:
      return message(f, s);
    case Op::isoutput:
      return setFloat(f, a[0], host_.isDisplayed(text(f, s, 1)) ? 1.0f : 0.0f);
    case Op::eq_s:
    case Op::ne_s:
    case Op::select_s:
    case Op::concat:
    case Op::format:
    case Op::strlen:
    case Op::substr:
    case Op::match:
    case Op::printf:
    case Op::shadername:
    case Op::shadername_s:
      return stringOp(f, s);
    default:
      break;
  }
  if (flags & kOpTexture) return textureOp(f, s);
  reportOnce(
      std::string("shading.op.") + opInfo(s.op).name,
      makeError(RiError::kUnimplemented, "shader operation \"{}\" is not available", opInfo(s.op).name));
}

void Machine::arrayOp(Frame& f, const Step& s) {
  const Operand* a = f.args(s);
  const ShaderProgram& p = f.exe().program();
  const auto outOfBounds = [&] {
    reportOnce("shading.index." + p.name,
               Error{RiError::kRange,
                     Severity::kWarning,
                     {},
                     fmt::format("shader \"{}\": array index out of bounds", p.name)});
  };
  if (s.op == Op::assign_s) {
    f.strings(symbolOf(f, s, 0))[0] = f.strings(symbolOf(f, s, 1))[0];
    return;
  }
  if (s.op == Op::assign_a) {
    const Symbol& to = p.symbols[symbolOf(f, s, 0)];
    const Symbol& from = p.symbols[symbolOf(f, s, 1)];
    if (to.type == SlType::kString) {
      for (uint32_t k = 0; k < std::min(to.arrayLength, from.arrayLength); ++k)
        f.strings(symbolOf(f, s, 0))[k] = f.strings(symbolOf(f, s, 1))[k];
      return;
    }
    KernelCall c;
    c.lanes = a[0].varying() ? f.lanes() : kLanePad;
    alignas(64) int32_t all[kLanePad];
    std::fill_n(all, kLanePad, -1);
    c.mask = a[0].varying() ? f.mask : all;
    for (uint32_t k = 0; k < std::min(to.floats(), from.floats()); ++k) {
      const Operand pair[] = {{a[0].comp(k), a[0].component, a[0].indexMask},
                              {a[1].comp(k), a[1].component, a[1].indexMask}};
      c.arg = pair, c.argCount = 2;
      kernels().op[size_t(Op::assign_f)](c);
    }
    return;
  }
  const bool load = s.op == Op::load_f || s.op == Op::load_t || s.op == Op::load_m || s.op == Op::load_s;
  const uint32_t arraySymbol = symbolOf(f, s, load ? 1 : 0);
  const Operand& index = a[load ? 2 : 1];
  const int64_t length = std::max(1u, p.symbols[arraySymbol].arrayLength);
  const uint32_t size = slTypeFloats(p.symbols[arraySymbol].type);
  const auto element = [&](uint32_t lane, bool& inside) {
    const float x = std::floor(index.at(lane));
    inside = x >= 0.0f && x < float(length);
    return inside ? int64_t(x) : x >= 0.0f ? length - 1 : 0;
  };
  bool inside = true;
  if (size == 0) {  // strings
    uint32_t lane = 0;
    if (index.varying())
      while (lane + 1 < f.lanes() && !f.mask[lane]) ++lane;
    const int64_t e = element(lane, inside);
    if (!inside) outOfBounds();
    if (load)
      f.strings(symbolOf(f, s, 0))[0] = f.strings(arraySymbol)[e];
    else if (inside)
      f.strings(arraySymbol)[e] = f.strings(symbolOf(f, s, 2))[0];
    return;
  }
  const Operand& array = a[load ? 1 : 0];
  const Operand& value = load ? a[0] : a[2];
  const uint32_t n = (load ? value : array).varying() ? f.lanes() : kLanePad;
  bool allInside = true;
  for (uint32_t i = 0; i < n; ++i) {
    const bool active = n == kLanePad && !(load ? value : array).varying() ? true : f.mask[i] != 0;
    const int64_t e = element(i, inside);
    if (active) allInside = allInside && inside;
    if (load) {
      for (uint32_t c = 0; c < size; ++c)
        value.comp(c)[i & value.indexMask] = array.at(i, uint32_t(e) * size + c);
    } else if (active && inside) {
      for (uint32_t c = 0; c < size; ++c)
        array.comp(uint32_t(e) * size + c)[i & array.indexMask] = value.at(i, c);
    }
  }
  if (!allInside) outOfBounds();
}

void Machine::randomOp(Frame& f, const Step& s) {
  const Operand& out = f.args(s)[0];
  const uint32_t components = s.op == Op::random_t ? 3 : 1;
  const uint64_t site = hashStep(f.instance().id, f.pc);
  uint32_t* const count = f.counter(s.counter);
  if (!out.varying()) {
    uint64_t h = hashStep(hashStep(batch_.batchSeed, site), count[0]++);
    for (uint32_t c = 0; c < components; ++c) {
      std::fill_n(out.comp(c), kLanePad, toUnitFloat64(h));
      h = mix64(h + 0x9e3779b97f4a7c15ull);
    }
    return;
  }
  const uint32_t n = f.lanes();
  scratch_.reserve(size_t(n) * 3);
  SeedHash seeds;
  seeds.base = batch_.seed, seeds.one = batch_.batchSeed, seeds.site = site, seeds.counter = count;
  seeds.lanes = n, seeds.out = reinterpret_cast<uint64_t*>(scratch_.data());
  seeds.high = reinterpret_cast<uint32_t*>(scratch_.data() + size_t(n) * 2);
  kernels().hashSeeds(seeds);
  for (uint32_t i = 0; i < n; ++i) count[i] += uint32_t(-f.mask[i]);
  for (uint32_t i = 0; i < n; ++i) out.data[i] = float(int32_t(seeds.high[i] >> 8)) * 0x1p-24f;
  for (uint32_t c = 1; c < components; ++c)
    for (uint32_t i = 0; i < n; ++i) {
      seeds.out[i] = mix64(seeds.out[i] + 0x9e3779b97f4a7c15ull);
      out.comp(c)[i] = toUnitFloat64(seeds.out[i]);
    }
}

namespace {
enum class Basis { kCatmullRom, kBezier, kBSpline, kHermite, kLinear };
Basis basisOf(std::string_view name) {
  if (name == "bezier") return Basis::kBezier;
  if (name == "bspline" || name == "b-spline") return Basis::kBSpline;
  if (name == "hermite") return Basis::kHermite;
  if (name == "linear") return Basis::kLinear;
  return Basis::kCatmullRom;
}
/// Weights of the four knots at t in [0,1] of a segment.
void weights(Basis b, float t, float w[4]) {
  const float u = 1 - t, t2 = t * t, t3 = t2 * t;
  switch (b) {
    case Basis::kCatmullRom:
      w[0] = 0.5f * (-t3 + 2 * t2 - t), w[1] = 0.5f * (3 * t3 - 5 * t2 + 2);
      w[2] = 0.5f * (-3 * t3 + 4 * t2 + t), w[3] = 0.5f * (t3 - t2);
      break;
    case Basis::kBezier:
      w[0] = u * u * u, w[1] = 3 * t * u * u, w[2] = 3 * t2 * u, w[3] = t3;
      break;
    case Basis::kBSpline:
      w[0] = u * u * u / 6, w[1] = (3 * t3 - 6 * t2 + 4) / 6;
      w[2] = (-3 * t3 + 3 * t2 + 3 * t + 1) / 6, w[3] = t3 / 6;
      break;
    case Basis::kHermite:  // point, tangent, point, tangent
      w[0] = 2 * t3 - 3 * t2 + 1, w[1] = t3 - 2 * t2 + t, w[2] = -2 * t3 + 3 * t2, w[3] = t3 - t2;
      break;
    case Basis::kLinear:
      w[0] = 0, w[1] = u, w[2] = t, w[3] = 0;
      break;
  }
}
}  // namespace

void Machine::splineOp(Frame& f, const Step& s) {
  const Operand* a = f.args(s);
  const bool array = s.op == Op::spline_fa || s.op == Op::spline_ta;
  const uint32_t components = s.op == Op::spline_t || s.op == Op::spline_ta ? 3 : 1;
  const uint32_t knots =
      array ? std::max(1u, f.exe().program().symbols[symbolOf(f, s, 3)].arrayLength) : s.argCount - 3u;
  std::string_view name = text(f, s, 1);
  const bool solve = name.substr(0, 5) == "solve";
  if (solve) name.remove_prefix(5);
  const Basis basis = basisOf(name);
  const uint32_t step = basis == Basis::kBezier ? 3 : basis == Basis::kHermite ? 2 : 1;
  const Operand& out = a[0];
  const Operand& x = a[2];
  const uint32_t n = out.varying() ? f.lanes() : kLanePad;
  const auto knot = [&](uint32_t k, uint32_t lane, uint32_t c) {
    return array ? a[3].at(lane, k * components + c) : a[3 + k].at(lane, c);
  };
  if (knots < 4) {
    reportOnce("shading.spline." + f.exe().program().name,
               Error{RiError::kConsistency,
                     Severity::kWarning,
                     {},
                     fmt::format("shader \"{}\": spline() needs four knots", f.exe().program().name)});
    for (uint32_t c = 0; c < components; ++c)
      for (uint32_t i = 0; i < n; ++i) out.comp(c)[i] = knot(0, i, c);
    return;
  }
  const uint32_t segments = (knots - 4) / step + 1;
  const auto evaluate = [&](float at, uint32_t lane, uint32_t c) {
    const float scaled = (at > 0.0f ? std::min(at, 1.0f) : 0.0f) * float(segments);
    const uint32_t segment = std::min(uint32_t(scaled), segments - 1);
    float w[4];
    weights(basis, scaled - float(segment), w);
    const uint32_t k = segment * step;
    return w[0] * knot(k, lane, c) + w[1] * knot(k + 1, lane, c) + w[2] * knot(k + 2, lane, c) +
           w[3] * knot(k + 3, lane, c);
  };
  for (uint32_t i = 0; i < n; ++i) {
    if (out.varying() && !f.mask[i]) continue;
    if (solve) {
      // The parameter where a monotone spline has the value: bisection.
      const float value = x.at(i);
      float lo = 0, hi = 1;
      const bool rising = evaluate(1, i, 0) >= evaluate(0, i, 0);
      for (int k = 0; k < 24; ++k) {
        const float mid = 0.5f * (lo + hi);
        ((evaluate(mid, i, 0) < value) == rising ? lo : hi) = mid;
      }
      for (uint32_t c = 0; c < components; ++c) out.comp(c)[i] = 0.5f * (lo + hi);
    } else {
      for (uint32_t c = 0; c < components; ++c) out.comp(c)[i] = evaluate(x.at(i), i, c);
    }
  }
}

bool Machine::space(const Frame& f, std::string_view name, uint32_t object, DMat4& toCurrent) const {
  toCurrent = DMat4(1.0);
  if (name == "current" || name.empty()) return true;
  if (name == "shader") {
    toCurrent = f.instance().toCurrent;
    return true;
  }
  if (name == "object" && object != kNoIndex) return host_.objectToCurrent(object, toCurrent);
  if (host_.spaceToCurrent(name, toCurrent)) return true;
  reportOnce("shading.space." + std::string(name),
             Error{RiError::kBadToken,
                   Severity::kWarning,
                   {},
                   fmt::format("shader \"{}\": there is no coordinate system \"{}\"; current space is used",
                               f.exe().program().name, name)});
  return false;
}

namespace {
int colorSpace(std::string_view name) {
  if (name == "rgb" || name == "current") return int(ColorSpace::kRgb);
  if (name == "hsv") return int(ColorSpace::kHsv);
  if (name == "hsl") return int(ColorSpace::kHsl);
  if (name == "xyz" || name == "XYZ") return int(ColorSpace::kXyz);
  if (name == "xyY") return int(ColorSpace::kXyY);
  if (name == "YIQ" || name == "yiq") return int(ColorSpace::kYiq);
  return -1;
}
}  // namespace

void Machine::transformOp(Frame& f, const Step& s) {
  const Operand* a = f.args(s);
  const Operand& out = a[0];
  const uint32_t lanes = out.varying() ? f.lanes() : kLanePad;
  KernelCall c;
  c.lanes = lanes;
  if (s.op == Op::ctransform) {
    int from = colorSpace(text(f, s, 1)), to = colorSpace(text(f, s, 2));
    if (from < 0 || to < 0) {
      reportOnce("shading.colorspace." + std::string(text(f, s, from < 0 ? 1 : 2)),
                 Error{RiError::kBadToken,
                       Severity::kWarning,
                       {},
                       fmt::format("shader \"{}\": there is no color space \"{}\"", f.exe().program().name,
                                   text(f, s, from < 0 ? 1 : 2))});
      from = to = 0;
    }
    const Operand pair[] = {out, a[3]};
    c.arg = pair, c.argCount = 2, c.mode = uint32_t(from * 8 + to);
    kernels().helper[size_t(Helper::ctransform)](c);
    return;
  }
  if (s.op == Op::depth) {
    // Current space is camera space.
    const Vec2 clip = host_.clipping();
    const float range = clip.y - clip.x;
    const float* const z = a[1].comp(2);
    if (!(range > 0) || !a[1].varying())
      std::fill_n(out.data, lanes, range > 0 ? (z[0] - clip.x) / range : 0.0f);
    else
      for (uint32_t i = 0; i < lanes; ++i) out.data[i] = (z[i] - clip.x) / range;
    return;
  }
  const std::string_view from = text(f, s, 1), to = text(f, s, 2);
  const bool perObject = (from == "object" || to == "object") && batch_.object && batch_.objects.size() > 1;
  const auto matrixFor = [&](uint32_t object, float m[16]) {
    DMat4 x, y;
    space(f, from, object, x);
    space(f, to, object, y);
    const DMat4 full = glm::inverse(y) * x;
    for (int k = 0; k < 16; ++k) m[k] = float((&full[0][0])[k]);
    // Exactly affine unless it projects: the last column decides whether w is divided out.
    if (std::fabs(m[3]) < 1e-12f && std::fabs(m[7]) < 1e-12f && std::fabs(m[11]) < 1e-12f &&
        std::fabs(m[15] - 1.0f) < 1e-6f)
      m[3] = m[7] = m[11] = 0.0f, m[15] = 1.0f;
    for (int k = 0; k < 16; ++k)
      if (!std::isfinite(m[k])) m[k] = k % 5 == 0 ? 1.0f : 0.0f;
  };
  alignas(64) float m[16];
  const uint32_t objects = perObject && out.varying() ? uint32_t(batch_.objects.size()) : 1;
  for (uint32_t o = 0; o < objects; ++o) {
    matrixFor(batch_.objects.empty() ? kNoIndex : batch_.objects[o], m);
    if (s.op == Op::space_m) {
      for (uint32_t k = 0; k < 16; ++k)
        for (uint32_t i = 0; i < lanes; ++i)
          if (objects == 1 || batch_.object[i] == o) out.comp(k)[i] = m[k];
      continue;
    }
    const Helper h = s.op == Op::transform_p   ? Helper::transformPoint
                     : s.op == Op::transform_v ? Helper::transformVector
                                               : Helper::transformNormal;
    c.matrix = m;
    c.argCount = 2;
    if (objects == 1) {
      const Operand pair[] = {out, a[3]};
      c.arg = pair;
      kernels().helper[size_t(h)](c);
    } else {
      scratch_.reserve(size_t(lanes) * 8);
      const Operand moved{scratch_.data(), lanes, ~0u};
      // The result may be the operand's own register: keep the operand until the last object is done.
      const Operand kept{scratch_.data() + 3 * lanes, lanes, ~0u};
      if (o == 0)
        for (uint32_t k = 0; k < 3; ++k)
          for (uint32_t i = 0; i < lanes; ++i) kept.comp(k)[i] = a[3].at(i, k);
      const Operand pair[] = {moved, kept};
      c.arg = pair;
      kernels().helper[size_t(h)](c);
      for (uint32_t k = 0; k < 3; ++k)
        for (uint32_t i = 0; i < lanes; ++i)
          if (batch_.object[i] == o) out.comp(k)[i] = moved.comp(k)[i];
    }
  }
}

}  // namespace fr
