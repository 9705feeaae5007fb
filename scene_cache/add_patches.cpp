// Quadrics, Patch and PatchMesh.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <optional>

#include "scene_cache/add_primitive.h"
#include "scene_cache/patch_basis.h"
#include "scene_cache/quadric.h"

namespace fr::cache {
namespace {

std::optional<Quadric> quadricOf(const ri::Primitive& primitive) {
  return std::visit(
      [](const auto& p) -> std::optional<Quadric> {
        using T = std::decay_t<decltype(p)>;
        if constexpr (std::is_same_v<T, ri::Sphere>) {
          return Quadric{PrimitiveType::kSphere, {p.radius, p.zmin, p.zmax, p.thetaMax}};
        } else if constexpr (std::is_same_v<T, ri::Cone>) {
          return Quadric{PrimitiveType::kCone, {p.height, p.radius, p.thetaMax}};
        } else if constexpr (std::is_same_v<T, ri::Cylinder>) {
          return Quadric{PrimitiveType::kCylinder, {p.radius, p.zmin, p.zmax, p.thetaMax}};
        } else if constexpr (std::is_same_v<T, ri::Hyperboloid>) {
          return Quadric{PrimitiveType::kHyperboloid,
                         {p.p1[0], p.p1[1], p.p1[2], p.p2[0], p.p2[1], p.p2[2], p.thetaMax}};
        } else if constexpr (std::is_same_v<T, ri::Paraboloid>) {
          return Quadric{PrimitiveType::kParaboloid, {p.rmax, p.zmin, p.zmax, p.thetaMax}};
        } else if constexpr (std::is_same_v<T, ri::Disk>) {
          return Quadric{PrimitiveType::kDisk, {p.height, p.radius, p.thetaMax}};
        } else if constexpr (std::is_same_v<T, ri::Torus>) {
          return Quadric{PrimitiveType::kTorus,
                         {p.majorRadius, p.minorRadius, p.phiMin, p.phiMax, p.thetaMax}};
        } else {
          return std::nullopt;
        }
      },
      primitive);
}

Quadric blend(const Quadric& a, const Quadric& b, double t) {
  Quadric q = a;
  if (t == 0) return q;
  for (int i = 0; i < 8; ++i) q.p[i] = a.p[i] * (1 - t) + b.p[i] * t;
  return q;
}

void basisFloats(const DMat4& m, float out[16]) {
  for (int i = 0; i < 16; ++i) out[i] = float(m[i / 4][i % 4]);
}

/// x and y of a height field's geometry values: those that give x = u, y = v over the whole mesh.
std::vector<double> heightFieldAbscissae(uint32_t count, uint32_t patches, uint32_t step, bool cubic,
                                         const BezierConversion& c, bool* ok) {
  std::vector<double> x(count);
  for (uint32_t i = 0; i < count; ++i) {
    if (!cubic) {
      x[i] = double(i) / std::max(1u, patches);
      continue;
    }
    const uint32_t patch = std::min(i / std::max(1u, step), patches - 1);
    const uint32_t local = std::min(i - patch * step, 3u);
    double b[4], g[4];
    for (int k = 0; k < 4; ++k) b[k] = (double(patch) + k / 3.0) / patches;
    if (!geometryFromBezier(c, b, g)) *ok = false;
    x[i] = *ok ? g[local] : 0;
  }
  return x;
}

}  // namespace

namespace {

/// Turns beyond the first lie on it, and a million of them would be a million spheres. True when one was cut.
bool clampSweeps(std::vector<Quadric>& keys) {
  bool cut = false;
  const auto clamp = [&cut](double& angle, double from) {
    const double allowed = std::clamp(angle, from - 360, from + 360);
    cut = cut || allowed != angle;
    angle = allowed;
  };
  for (Quadric& q : keys) {
    clamp(q.p[quadricParameterCount(q.type) - 1], 0);
    if (q.type == PrimitiveType::kTorus) clamp(q.p[3], q.p[2]);
  }
  return cut;
}

}  // namespace

Result<void> addQuadric(Adding& a) {
  std::vector<Quadric> keys;
  for (size_t k = 0; k < a.keyCount(); ++k) keys.push_back(*quadricOf(a.key(k)));
  QuadricSource source{};
  source.keyCount = uint32_t(keys.size());
  std::vector<double> params;
  for (const Quadric& q : keys) {
    for (const double x : q.p) {
      if (!std::isfinite(x))
        return a.error(RiError::kRange, "a dimension is not a finite number; the primitive is left out");
    }
  }
  if (clampSweeps(keys)) a.warn(RiError::kRange, "an angle is more than a full turn; a full turn is drawn");
  for (const Quadric& q : keys) params.insert(params.end(), q.p, q.p + 8);
  Box3f box;
  for (size_t i = 0; i < a.toCache.size(); ++i) {
    const KeySpan k = findKeys(a.keyTimes(), uint32_t(keys.size()), a.gridTimes[i]);
    Surface s;
    s.setQuadric(blend(keys[k.a], keys[k.b], k.weight), a.toCache[i]);
    if (!s.finite())
      return a.error(RiError::kRange, "the transformed primitive is not finite; it is left out");
    box.extend(s.bound());
  }
  source.params = a.writer.addArray<double>(params, 16);
  if (keys.size() > 1) source.times = a.writer.addArray<float>(a.keyTimes());
  ObjectRecord o = a.object(keys[0].type, ri::paramsOf(a.key(0)));
  o.source = a.record(source);
  a.finish(o, std::span(&box, 1));
  return {};
}

Result<void> addPatches(Adding& a) {
  PatchMeshSource s{};
  bool cubic = false;
  if (const auto* p = std::get_if<ri::Patch>(a.desc.primitive)) {
    cubic = p->bicubic;
    s.nu = s.nv = cubic ? 4 : 2;
    s.patchesU = s.patchesV = s.stepU = s.stepV = 1;
  } else {
    const auto& m = std::get<ri::PatchMesh>(*a.desc.primitive);
    cubic = m.bicubic;
    s.nu = uint32_t(m.nu), s.nv = uint32_t(m.nv);
    s.separate = m.separate;
    s.stepU = cubic ? uint32_t(a.desc.steps.u) : 1, s.stepV = cubic ? uint32_t(a.desc.steps.v) : 1;
    s.wrapU = m.uPeriodic, s.wrapV = m.vPeriodic;
    const auto patches = [cubic](uint32_t n, uint32_t step, bool wrap) -> uint32_t {
      if (step == 0) return 0;
      if (!cubic) return wrap ? n : n - 1;
      return wrap ? n / step : n < 4 ? 0 : (n - 4) / step + 1;
    };
    s.patchesU = patches(s.nu, s.stepU, m.uPeriodic), s.patchesV = patches(s.nv, s.stepV, m.vPeriodic);
    if (m.separate) {
      s.stepU = s.stepV = cubic ? 4 : 2;
      s.patchesU = s.nu / s.stepU, s.patchesV = s.nv / s.stepV;
    }
  }
  if (s.patchesU == 0 || s.patchesV == 0 || uint64_t(s.patchesU) * s.patchesV >= kNone) {
    return a.error(RiError::kConsistency, fmt::format("{} x {} values make no patch", s.nu, s.nv));
  }
  basisFloats(a.desc.uBasis, s.basisU), basisFloats(a.desc.vBasis, s.basisV);
  const BezierConversion cu = bezierConversion(s.basisU), cv = bezierConversion(s.basisV);

  const uint64_t count = uint64_t(s.nu) * s.nv;
  uint32_t components = 3;
  std::vector<std::vector<float>> keys;
  for (size_t k = 0; k < a.keyCount(); ++k) {
    const ri::ParamList& params = ri::paramsOf(a.key(k));
    std::vector<float> values;
    if (const ri::Param* p = positionParam(params, &components)) {
      values = p->floats;
    } else if (const ri::Param* z = params.find("Pz")) {
      if (z->floats.size() < count) {
        return a.error(RiError::kConsistency,
                       fmt::format("\"Pz\" has {} values, {} are needed", z->floats.size(), count));
      }
      bool ok = true;
      const auto x = heightFieldAbscissae(s.nu, s.patchesU, s.stepU, cubic, cu, &ok);
      const auto y = heightFieldAbscissae(s.nv, s.patchesV, s.stepV, cubic, cv, &ok);
      if (!ok) return a.error(RiError::kIncapable, "a height field needs an invertible basis");
      s.heightField = 1;
      for (uint64_t i = 0; i < count; ++i) {
        values.insert(values.end(), {float(x[i % s.nu]), float(y[i / s.nu]), z->floats[i]});
      }
    } else {
      return a.error(RiError::kMissingData, "no positions (\"P\", \"Pw\" or \"Pz\")");
    }
    if (values.size() < count * components) {
      return a.error(RiError::kConsistency,
                     fmt::format("{} positions, {} are needed", values.size() / components, count));
    }
    values.resize(count * components);
    if (const ptrdiff_t bad = firstNonFinite(values); bad >= 0) {
      return a.error(RiError::kRange,
                     fmt::format("position {} is not finite; the primitive is left out", bad / components));
    }
    if (components == 4) {
      for (uint64_t i = 0; i < count; ++i) {
        if (!(values[i * 4 + 3] > 0)) {
          return a.error(RiError::kRange,
                         fmt::format("weight {} of position {} is not positive; the primitive is left out",
                                     values[i * 4 + 3], i));
        }
      }
    }
    if (!keys.empty() && keys[0].size() != values.size()) {
      return a.error(RiError::kBadMotion, "keys with different numbers of positions");
    }
    keys.push_back(std::move(values));
  }
  s.positions = a.positions(keys, components);

  const uint32_t patchCount = s.patchesU * s.patchesV;
  std::vector<Box3f> bounds(patchCount);
  const uint32_t side = cubic ? 4 : 2;
  for (uint32_t face = 0; face < patchCount; ++face) {
    const uint32_t pu = face % s.patchesU, pv = face / s.patchesU;
    for (size_t t = 0; t < a.toCache.size(); ++t) {
      const KeySpan k = findKeys(a.keyTimes(), uint32_t(keys.size()), a.gridTimes[t]);
      double points[16 * 4];
      for (uint32_t j = 0; j < side; ++j) {
        for (uint32_t i = 0; i < side; ++i) {
          const uint64_t at =
              (uint64_t(pv) * s.stepV + j) % s.nv * s.nu + (uint64_t(pu) * s.stepU + i) % s.nu;
          for (uint32_t c = 0; c < components; ++c) {
            const double x = keys[k.a][at * components + c], y = keys[k.b][at * components + c];
            points[(j * side + i) * components + c] = k.weight == 0 ? x : x * (1 - k.weight) + y * k.weight;
          }
        }
      }
      Surface surface;
      if (cubic) {
        convertToBezier(cu, cv, int(components), points);
        surface.setBicubic(points, int(components), a.toCache[t]);
      } else {
        surface.setBilinear(points, int(components), a.toCache[t]);
      }
      if (!surface.finite())
        return a.error(RiError::kRange, "the transformed primitive is not finite; it is left out");
      bounds[face].extend(surface.bound());
    }
  }
  ObjectRecord o = a.object(cubic ? PrimitiveType::kBicubicPatches : PrimitiveType::kBilinearPatches,
                            ri::paramsOf(a.key(0)));
  o.source = a.record(s);
  a.finish(o, bounds);
  return {};
}

}  // namespace fr::cache
