// NuPatch.
#include <algorithm>
#include <cmath>

#include "ri/renderer.h"
#include "scene_cache/add_primitive.h"
#include "scene_cache/nurbs.h"
#include "scene_cache/trim.h"

namespace fr::cache {
namespace {

/// A net of control values to Bezier patches: out[face][j][i][c].
std::vector<float> bezierNet(const ri::NuPatch& p, std::span<const NurbsSpan> us,
                             std::span<const NurbsSpan> vs, std::span<const float> values, size_t width) {
  const size_t nu = size_t(p.nu), nv = size_t(p.nv);
  const size_t ou = size_t(std::max(p.uOrder, 4)), ov = size_t(std::max(p.vOrder, 4));
  const size_t columns = us.size() * ou;
  std::vector<double> in(nu * width);
  std::vector<double> rows(nv * columns * width);
  for (size_t j = 0; j < nv; ++j) {
    for (size_t i = 0; i < nu * width; ++i) in[i] = double(values[j * nu * width + i]);
    const auto row = bezierPieces(p.uKnot, p.uOrder, us, in.data(), width, width);
    std::copy(row.begin(), row.end(), rows.begin() + ptrdiff_t(j * columns * width));
  }
  std::vector<float> out(vs.size() * us.size() * ou * ov * width);
  for (size_t k = 0; k < columns; ++k) {
    const auto column = bezierPieces(p.vKnot, p.vOrder, vs, rows.data() + k * width, width, columns * width);
    for (size_t j = 0; j < vs.size() * ov; ++j) {
      const size_t face = j / ov * us.size() + k / ou;
      const size_t at = (face * ou * ov + j % ov * ou + k % ou) * width;
      for (size_t c = 0; c < width; ++c) out[at + c] = float(column[j * width + c]);
    }
  }
  // A seam that closes but for rounding closes exactly.
  const auto seam = [&](size_t lines, auto&& placeOf) {
    float size = 0, off = 0;
    for (size_t i = 0; i < lines; ++i) {
      for (size_t c = 0; c < width; ++c) {
        const float a = out[placeOf(i, false) * width + c], b = out[placeOf(i, true) * width + c];
        size = std::max({size, std::abs(a), std::abs(b)}), off = std::max(off, std::abs(a - b));
      }
    }
    if (!(off <= 4e-6f * size)) return;
    for (size_t i = 0; i < lines; ++i)
      std::copy_n(out.begin() + ptrdiff_t(placeOf(i, false) * width), width,
                  out.begin() + ptrdiff_t(placeOf(i, true) * width));
  };
  seam(vs.size() * ov, [&](size_t j, bool end) {
    const size_t face = j / ov * us.size() + (end ? us.size() - 1 : 0);
    return face * ou * ov + j % ov * ou + (end ? ou - 1 : 0);
  });
  seam(columns, [&](size_t k, bool end) {
    const size_t face = (end ? vs.size() - 1 : 0) * us.size() + k / ou;
    return face * ou * ov + (end ? ov - 1 : 0) * ou + k % ou;
  });
  return out;
}

}  // namespace

Result<void> addNuPatch(Adding& a) {
  const auto& p = std::get<ri::NuPatch>(*a.desc.primitive);
  for (const auto& [name, order, knots] : {std::tuple("u", p.uOrder, &p.uKnot), {"v", p.vOrder, &p.vKnot}}) {
    if (order < 2) return a.error(RiError::kRange, fmt::format("{}order {} makes no surface", name, order));
    if (order > int(kMaxBezierOrder))
      return a.error(RiError::kLimit, fmt::format("{}order {} is above {}", name, order, kMaxBezierOrder));
    if (firstNonFinite(*knots) >= 0)
      return a.error(RiError::kRange,
                     fmt::format("a {} knot is not finite; the primitive is left out", name));
  }
  NurbsSource s{};
  const auto us = nurbsSpans(p.uKnot, p.uOrder, p.uMin, p.uMax),
             vs = nurbsSpans(p.vKnot, p.vOrder, p.vMin, p.vMax);
  if (us.empty() || vs.empty())
    return a.error(RiError::kRange, "all knot intervals are empty; the primitive is left out");
  const uint64_t faces = uint64_t(us.size()) * vs.size();
  s.orderU = uint32_t(std::max(p.uOrder, 4)), s.orderV = uint32_t(std::max(p.vOrder, 4));
  if (faces * s.orderU * s.orderV >= uint64_t(1) << 31) return a.error(RiError::kLimit, "too many spans");
  s.spansU = uint32_t(us.size()), s.spansV = uint32_t(vs.size());
  s.segmentsU = uint32_t(p.nu - p.uOrder + 1), s.segmentsV = uint32_t(p.nv - p.vOrder + 1);

  const uint64_t count = uint64_t(p.nu) * unsigned(p.nv);
  uint32_t components = 3;
  std::vector<std::vector<float>> keys;
  for (size_t k = 0; k < a.keyCount(); ++k) {
    const auto& at = std::get<ri::NuPatch>(a.key(k));
    const ri::Param* param = positionParam(at.params, &components);
    if (!param) return a.error(RiError::kMissingData, "no positions (\"P\" or \"Pw\")");
    if (at.nu != p.nu || at.nv != p.nv || at.uOrder != p.uOrder || at.vOrder != p.vOrder ||
        param->floats.size() < count * components)
      return a.error(RiError::kBadMotion, "keys of different shapes");
    const std::span<const float> values(param->floats.data(), count * components);
    if (const ptrdiff_t bad = firstNonFinite(values); bad >= 0)
      return a.error(RiError::kRange,
                     fmt::format("position {} is not finite; the primitive is left out", bad / components));
    if (components == 4) {
      for (uint64_t i = 0; i < count; ++i) {
        if (!(values[i * 4 + 3] > 0))
          return a.error(RiError::kRange,
                         fmt::format("weight {} of position {} is not positive; the primitive is left out",
                                     values[i * 4 + 3], i));
      }
    }
    keys.push_back(bezierNet(p, us, vs, values, components));
    if (keys.back().size() != keys[0].size()) return a.error(RiError::kBadMotion, "keys of different shapes");
  }
  s.positions = a.positions(keys, components);
  s.spanU = a.writer.addArray<NurbsSpan>(us, 8), s.spanV = a.writer.addArray<NurbsSpan>(vs, 8);

  if (a.desc.trimCurve && !a.desc.trimCurve->ncurves.empty()) {
    const TrimLoops loops = flattenTrimCurves(
        *a.desc.trimCurve, std::max(double(p.uMax) - double(p.uMin), double(p.vMax) - double(p.vMin)));
    for (const std::string& problem : loops.problems) a.warn(RiError::kRange, problem);
    if (!loops.edges.empty()) {
      s.trimEdges = a.writer.addArray<TrimEdge>(loops.edges);
      s.trimBands = a.writer.addArray<uint32_t>(loops.bands);
      s.trimLow = loops.low, s.trimHigh = loops.high;
      s.trimOutside = a.desc.trimOutside ? 1 : 0;
    }
  }

  std::vector<Box3f> bounds(faces);
  const size_t perFace = size_t(s.orderU) * s.orderV;
  std::vector<double> points(perFace * components);
  for (size_t face = 0; face < faces; ++face) {
    for (size_t t = 0; t < a.toCache.size(); ++t) {
      const KeySpan k = findKeys(a.keyTimes(), uint32_t(keys.size()), a.gridTimes[t]);
      for (size_t i = 0; i < points.size(); ++i) {
        const double x = double(keys[k.a][face * points.size() + i]),
                     y = double(keys[k.b][face * points.size() + i]);
        points[i] = k.weight == 0 ? x : x * (1 - k.weight) + y * k.weight;
      }
      Surface surface;
      surface.setBezier(points.data(), s.orderU, s.orderV, int(components), a.toCache[t]);
      if (!surface.finite())
        return a.error(RiError::kRange, "the transformed primitive is not finite; it is left out");
      bounds[face].extend(surface.bound());
    }
  }

  // Vertex variables take the same way as the positions.
  ri::ParamList params = ri::paramsOf(a.key(0));
  for (ri::Param& v : params.params()) {
    if (v.declaration.storage != ri::StorageClass::kVertex || v.name == "P" || v.name == "Pw") continue;
    const size_t width = v.declaration.width();
    if (v.floats.empty() || v.floats.size() < count * width) continue;
    v.floats = bezierNet(p, us, vs, v.floats, width);
  }
  ObjectRecord o = a.object(PrimitiveType::kNurbs, params);
  o.source = a.record(s);
  a.finish(o, bounds);
  return {};
}

}  // namespace fr::cache
