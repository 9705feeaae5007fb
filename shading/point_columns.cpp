#include "shading/point_columns.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/random.h"
#include "scene_cache/packed_normal.h"

namespace fr {

namespace {
constexpr uint32_t kMaxRowPoints = 1024;
Vec3 at3(const Operand& o, uint32_t i) { return {o.at(i, 0), o.at(i, 1), o.at(i, 2)}; }
void set3(const Operand& o, uint32_t i, const Vec3& v) {
  for (int c = 0; c < 3; ++c) o.comp(uint32_t(c))[i] = v[c];
}
}  // namespace

/// Calls f(node, first, n) for every run of points on one node.
template <class F>
void PointColumns::eachRun(F&& f) {
  for (uint32_t i = 0; i < count_;) {
    uint32_t j = i + 1;
    while (j < count_ && nodes_[j] == nodes_[i]) ++j;
    f(nodes_[i], i, j - i);
    i = j;
  }
}

void PointColumns::reset(uint32_t points, uint32_t lanes, const ShadeSetup& setup) {
  setup_ = &setup;
  count_ = points;
  lanes_ = lanes;
  memory_.reserve(size_t(lanes) * kColumns);
  std::memset(memory_.data(), 0, size_t(lanes) * kColumns * sizeof(float));
  mask_.reserve(lanes);
  std::memset(mask_.data(), 0, lanes * sizeof(float));
  auto* mask = reinterpret_cast<int32_t*>(mask_.data());
  for (uint32_t base = 0; base < lanes; base += padLanes(points)) std::fill_n(mask + base, points, -1);
  nodes_.resize(lanes), cells_.resize(lanes), patchU_.resize(lanes), patchV_.resize(lanes),
      seeds_.resize(lanes);
  batch_ = Batch{};
  batch_.lanes = lanes;
  batch_.points = batch_.asking = points;
  batch_.copyPeriod = lanes > padLanes(points) ? padLanes(points) : 0;
  batch_.mask = mask;
  batch_.attributes = setup.attributes;
  batch_.maxDiffuseDepth = setup.maxDiffuseDepth, batch_.maxSpecularDepth = setup.maxSpecularDepth;
  batch_.specularThreshold = system_.specularThreshold;
  const cache::AttributeRecord& a = system_.scene.skeleton().attributes()[setup.attributes];
  batch_.orientation = a.flags & cache::kReverseOrientation ? -1.0f : 1.0f;
  const auto bind = [&](GlobalId g, uint32_t c) { batch_.globals[size_t(g)] = operand(c); };
  bind(GlobalId::k_P, kP), bind(GlobalId::k_N, kN), bind(GlobalId::k_Ng, kNg), bind(GlobalId::k_Ns, kN);
  bind(GlobalId::k_dPdu, kDPdu), bind(GlobalId::k_dPdv, kDPdv), bind(GlobalId::k_I, kI);
  bind(GlobalId::k_Cs, kCs), bind(GlobalId::k_Os, kOs), bind(GlobalId::k_Ci, kCi), bind(GlobalId::k_Oi, kOi);
  bind(GlobalId::k_u, kU), bind(GlobalId::k_v, kV), bind(GlobalId::k_s, kS), bind(GlobalId::k_t, kT);
  bind(GlobalId::k_du, kDu), bind(GlobalId::k_dv, kDv);
  const cache::CameraRecord& camera = system_.scene.skeleton().camera();
  const float uniform[] = {3.0f, camera.shutter[0], camera.shutter[1] - camera.shutter[0],
                           system_.prmanSpecular};
  const GlobalId ids[] = {GlobalId::k_ncomps, GlobalId::k_time, GlobalId::k_dtime,
                          GlobalId::k___prmanspecular};
  uniforms_.reserve(4 * kLanePad);
  for (uint32_t i = 0; i < 4; ++i) {
    std::fill_n(uniforms_.data() + i * kLanePad, kLanePad, uniform[i]);
    batch_.globals[size_t(ids[i])] = Operand{uniforms_.data() + i * kLanePad, kLanePad, kLanePad - 1};
  }
}

void PointColumns::toCurrent(uint32_t c, bool normal) {
  KernelCall call;
  const Operand pair[] = {operand(c), operand(c)};
  call.arg = pair, call.argCount = 2, call.lanes = lanes_;
  call.matrix = &system_.cacheToCurrent[0][0];
  const Helper h = c == kP  ? Helper::transformPoint
                   : normal ? Helper::transformNormal
                            : Helper::transformVector;
  kernels().helper[size_t(h)](call);
}

/// dPdu, dPdv and Ng from neighbouring points: displaced grids and meshlets.
void PointColumns::differencesFromStencil(bool normals, float orientation) {
  const Operand P = operand(kP);
  for (uint32_t i = 0; i < count_; ++i) {
    const Vec3 du = (at3(P, stencil_.uHi[i]) - at3(P, stencil_.uLo[i])) * stencil_.uScale[i];
    const Vec3 dv = (at3(P, stencil_.vHi[i]) - at3(P, stencil_.vLo[i])) * stencil_.vScale[i];
    set3(operand(kDPdu), i, du), set3(operand(kDPdv), i, dv);
    if (!normals) continue;
    const Vec3 n = glm::cross(du, dv) * orientation;
    const float length = glm::length(n);
    set3(operand(kNg), i, length > 0 && std::isfinite(length) ? n / length : at3(operand(kN), i));
  }
}

bool PointColumns::subtracted() const {
  return (system_.scene.skeleton().attributes()[setup_->attributes].flags & cache::kSubtracted) != 0;
}

void PointColumns::turnOver() {
  batch_.orientation = -batch_.orientation;
  for (uint32_t c : {kN, kNg})
    for (uint32_t i = 0; i < 3 * lanes_; ++i) column(c)[i] = -column(c)[i];
}

void PointColumns::describeRays(const ShadePoints& points) {
  batch_.level = points.level;
  batch_.shadowRay = points.shadowRay;
  batch_.rayClass = points.rayClass;
  batch_.diffuseDepth = points.diffuseDepth, batch_.shadowDepth = points.shadowDepth;
  batch_.rayLabel = points.label;
}

void PointColumns::fillVolume(const ShadePoints& points, const ShadeSetup& setup) {
  const uint32_t n = uint32_t(std::min(points.count, kMaxShadePoints));
  reset(n, padLanes(n), setup);
  describeRays(points);
  const Mat3 rotate(system_.cacheToCurrent);
  const float scale = std::cbrt(std::fabs(glm::determinant(rotate)));
  const float far = scale > 0 ? system_.host.sceneDiameter() / scale : 0.0f;
  distance_.assign(lanes_, 0.0f);
  for (uint32_t i = 0; i < n; ++i) {
    nodes_[i] = cells_[i] = cache::kNone;
    patchU_[i] = patchV_[i] = 0;
    seeds_[i] = points.seed ? points.seed[i] : 0;
    const Vec3 d(points.direction[0][i], points.direction[1][i], points.direction[2][i]);
    const Vec3 o(points.origin[0][i], points.origin[1][i], points.origin[2][i]);
    // A ray that leaves the scene ends where nothing more can be.
    const float start = points.segmentStart ? points.segmentStart[i] : 0.0f;
    const float t = points.distance && points.distance[i] < 1e29f ? points.distance[i] : start + far;
    distance_[i] = t;
    set3(operand(kP), i, transformPoint(system_.cacheToCurrent, o + d * t));
    const Vec3 I = rotate * (d * t);
    const float length = glm::length(I);
    set3(operand(kI), i, I);
    const Vec3 N = length > 0 ? I / -length : Vec3(0, 0, -1);
    set3(operand(kN), i, N), set3(operand(kNg), i, N);
    const float radius = points.radius ? points.radius[i] : 0.0f;
    column(kRadius)[i] = std::isfinite(radius) ? radius : 0.0f;
    column(kSpread)[i] = points.spread && std::isfinite(points.spread[i]) ? points.spread[i] : 0.0f;
  }
  for (uint32_t i = n; i < lanes_; ++i) nodes_[i] = cells_[i] = cache::kNone;
  batch_.footprint = operand(kRadius), batch_.spread = operand(kSpread);
  const cache::AttributeRecord& a = system_.scene.skeleton().attributes()[setup.attributes];
  for (uint32_t c = 0; c < 3; ++c) {
    std::fill_n(column(kCs + c), lanes_, a.color[int(c)]);
    std::fill_n(column(kOs + c), lanes_, a.opacity[int(c)]);
  }
  batch_.seed = seeds_.data();
  object_.assign(lanes_, 0);
  objects_.assign(1, cache::kNone);
  batch_.object = object_.data();
  batch_.objects = objects_;
}

const float* PointColumns::primvar(std::string_view name, uint32_t component) const {
  const cache::Skeleton& skeleton = system_.scene.skeleton();
  for (auto& p : primvar_) p.assign(lanes_, 0.0f);
  bool any = false;
  const uint32_t period = padLanes(count_);
  for (uint32_t i = 0; i < lanes_; ++i) {
    if (i % period >= count_) continue;
    const cache::ObjectRecord& object = system_.scene.objectOf(nodes_[i]);
    const cache::ParamRecord* r = skeleton.find(object.primvars, name);
    if (!r || r->arrayLength > 1) continue;
    const bool scalar = r->type == cache::ParamType::kFloat;
    const bool geometric = r->type == cache::ParamType::kPoint || r->type == cache::ParamType::kVector ||
                           r->type == cache::ParamType::kNormal;
    if (!scalar && !geometric && r->type != cache::ParamType::kColor) continue;
    float* const out[3] = {&primvar_[0][i], &primvar_[1][i], &primvar_[2][i]};
    if (!system_.scene.evaluatePrimvar(nodes_[i], *r, 1, &cells_[i], &patchU_[i], &patchV_[i], out)) continue;
    any |= component < (scalar ? 1u : 3u);
    if (!geometric) continue;
    const DMat4 M = system_.host.transformToCurrent(object.transform);
    const DVec3 v(*out[0], *out[1], *out[2]);
    const DVec3 w = r->type == cache::ParamType::kPoint    ? transformPoint(M, v)
                    : r->type == cache::ParamType::kVector ? transformVector(M, v)
                                                           : normalMatrix(M) * v;
    for (int c = 0; c < 3; ++c) *out[c] = float(w[c]);
  }
  return any ? primvar_[component % 3].data() : nullptr;
}

/// Addresses of the vertices that are shaded, of a grid or a meshlet.
void PointColumns::vertexAddresses(const ShadePoints& points) {
  const cache::GridRecord& grid = *points.grid;
  if (points.strideU == 1 && points.strideV == 1) {
    system_.scene.vertexParameters(grid, cells_.data(), patchU_.data(), patchV_.data());
    return;
  }
  const size_t all = system_.scene.view(grid).vertexCount();
  gridCells_.resize(all), gridU_.resize(all), gridV_.resize(all);
  system_.scene.vertexParameters(grid, gridCells_.data(), gridU_.data(), gridV_.data());
  for (uint32_t i = 0; i < count_; ++i) {
    const size_t from = points.vertexOf(i);
    cells_[i] = gridCells_[from], patchU_[i] = gridU_[from], patchV_[i] = gridV_[from];
  }
}

void PointColumns::fill(const ShadePoints& points, const ShadeSetup& setup) {
  const bool hits = points.topology == ShadePoints::Topology::kHits;
  const bool strided = !hits && (points.strideU > 1 || points.strideV > 1);
  const uint32_t n = uint32_t(std::min(hits      ? points.count
                                       : strided ? points.gridPoints()
                                                 : system_.scene.view(*points.grid).vertexCount(),
                                       kMaxShadePoints));
  const uint32_t period = padLanes(n);
  const bool triple = hits && setup.usesDerivatives;
  reset(n, triple ? 3 * period : period, setup);
  describeRays(points);
  const cache::SceneCache& scene = system_.scene;
  const bool perspective = system_.host.perspective();
  const uint64_t parameterBits = globalBit(GlobalId::k_u) | globalBit(GlobalId::k_v) |
                                 globalBit(GlobalId::k_s) | globalBit(GlobalId::k_t) |
                                 globalBit(GlobalId::k_du) | globalBit(GlobalId::k_dv) |
                                 globalBit(GlobalId::k_dPdu) | globalBit(GlobalId::k_dPdv);
  const bool needParameters =
      setup.usesDerivatives || (setup.readsGlobals & parameterBits) || setup.canAskRays || points.valuesOnly;
  const auto surfaceOut = [&](uint32_t first, bool position, bool normal, bool tangents) {
    cache::SurfaceOut out;
    for (uint32_t c = 0; c < 3; ++c) {
      if (position) out.P[c] = column(kP + c) + first;
      if (normal) out.N[c] = column(kN + c) + first;
      if (!tangents) continue;
      out.Ng[c] = column(kNg + c) + first;
      out.dPdu[c] = column(kDPdu + c) + first, out.dPdv[c] = column(kDPdv + c) + first;
    }
    return out;
  };
  if (!hits) {
    const cache::GridRecord& grid = *points.grid;
    const cache::GridView view = scene.view(grid);
    const bool meshlet = grid.kind == cache::GridKind::kMeshlet, sprites = grid.flags & cache::kGridSprites;
    const cache::PrimitiveType type = scene.objectOf(grid.node).type;
    const bool thin = type == cache::PrimitiveType::kPoints || type == cache::PrimitiveType::kCurves;
    vertexAddresses(points);
    std::fill_n(nodes_.begin(), n, grid.node);
    const uint32_t nu = meshlet ? 0 : grid.nu / points.strideU, nv = meshlet ? 0 : grid.nv / points.strideV;
    const uint32_t row = meshlet ? kMaxRowPoints : nu + 1u;
    for (uint32_t i = 0; i < n; ++i) {
      const size_t vertex = meshlet ? i : points.vertexOf(i);
      const size_t at = meshlet ? i : vertex / (grid.nu + 1u) * grid.rowStride + vertex % (grid.nu + 1u);
      const Vec3 P = view.vertex(at);
      for (uint32_t c = 0; c < 3; ++c) {
        column(kP + c)[i] = P[int(c)];
      }
      if (view.normals) {
        const Vec3 N = cache::unpackNormal(view.normals[vertex]);
        for (uint32_t c = 0; c < 3; ++c) column(kN + c)[i] = N[int(c)];
      }
      seeds_[i] = hashStep(points.gridSeed, vertex);
    }
    const bool displaced = view.normals != nullptr || setup.displaced;
    const bool faceted = meshlet && !thin;  // derivatives along the sides of triangles
    if (!view.normals || !displaced)
      scene.evaluateSurface(grid.node, n, cells_.data(), patchU_.data(), patchV_.data(),
                            surfaceOut(0, sprites, !view.normals, !displaced && !faceted));
    toCurrent(kP, false), toCurrent(kN, true);
    if (needParameters)
      scene.evaluateParameters(grid.node, n, cells_.data(), patchU_.data(), patchV_.data(), column(kU),
                               column(kV), column(kS), column(kT));
    float du = 1, dv = 1, scaleU = 1, scaleV = 1;
    if (meshlet) {
      meshletStencil(stencil_, n, sprites ? 0 : grid.nv, view.indices, lanes_);
    } else {
      // Over the widest row and column: those of a border may be collapsed.
      const auto span = [](const float* p, uint32_t cells, uint32_t step, uint32_t lines, uint32_t lineStep) {
        float widest = 0;
        for (uint32_t line : {0u, lines / 2, lines}) {
          const float w = p[line * lineStep + cells * step] - p[line * lineStep];
          if (std::fabs(w) > std::fabs(widest)) widest = w;
        }
        return widest / float(std::max(1u, cells));
      };
      const float patchDu = span(patchU_.data(), nu, 1, nv, row);
      const float patchDv = span(patchV_.data(), nv, row, nu, 1);
      du = needParameters ? span(column(kU), nu, 1, nv, row) : patchDu;
      dv = needParameters ? span(column(kV), nv, row, nu, 1) : patchDv;
      if (du == 0 || !std::isfinite(du)) du = patchDu != 0 ? patchDu : 1;
      if (dv == 0 || !std::isfinite(dv)) dv = patchDv != 0 ? patchDv : 1;
      scaleU = patchDu / du, scaleV = patchDv / dv;  // dPdu is per unit of the patch's own u
      gridStencil(stencil_, nu, nv, lanes_, du, dv, needParameters ? column(kU) : nullptr,
                  needParameters ? column(kV) : nullptr);
    }
    std::fill_n(column(kDu), lanes_, du), std::fill_n(column(kDv), lanes_, dv);
    if (displaced || faceted) {
      differencesFromStencil(true, batch_.orientation);
    } else {
      toCurrent(kNg, true), toCurrent(kDPdu, false), toCurrent(kDPdv, false);
      for (uint32_t c = 0; c < 3; ++c)
        for (uint32_t i = 0; i < n; ++i) column(kDPdu + c)[i] *= scaleU, column(kDPdv + c)[i] *= scaleV;
    }
    for (uint32_t i = 0; i < n; ++i) {
      const Vec3 P = at3(operand(kP), i);
      set3(operand(kI), i, perspective ? P : Vec3(0, 0, 1));
    }
    if (setup.canAskRays) {
      for (uint32_t i = 0; i < n; ++i) {
        const Vec3 a = at3(operand(kDPdu), i) * du, b = at3(operand(kDPdv), i) * dv;
        // A curve's v runs along all of it: its width says how large a cell is.
        const float square = thin ? glm::dot(a, a) : std::max(glm::dot(a, a), glm::dot(b, b));
        const float radius = 0.5f * std::sqrt(square);
        column(kRadius)[i] = radius;
        const float distance = glm::length(at3(operand(kP), i));
        column(kSpread)[i] = perspective && distance > 0 ? std::min(1.0f, radius / distance) : 0.0f;
      }
      batch_.footprint = operand(kRadius), batch_.spread = operand(kSpread);
    }
    batch_.batchSeed = points.gridSeed;
  } else {
    for (uint32_t i = 0; i < n; ++i) {
      nodes_[i] = points.node[i];
      cells_[i] = points.cell ? points.cell[i] : cache::kNone;
      patchU_[i] = points.u[i], patchV_[i] = points.v[i];
      seeds_[i] = points.seed ? points.seed[i] : 0;
    }
    eachRun([&](cache::NodeId node, uint32_t first, uint32_t m) {
      // P where the ray met the diced surface; the rest as on grids, so that both renderers shade alike.
      scene.evaluateDiced(node, m, &cells_[first], &patchU_[first], &patchV_[first],
                          surfaceOut(first, true, true, setup.displaced));
      if (!setup.displaced)
        scene.evaluateSurface(node, m, &cells_[first], &patchU_[first], &patchV_[first],
                              surfaceOut(first, false, false, true));
      if (needParameters)
        scene.evaluateParameters(node, m, &cells_[first], &patchU_[first], &patchV_[first],
                                 column(kU) + first, column(kV) + first, column(kS) + first,
                                 column(kT) + first);
    });
    for (uint32_t i = 0; i < n; ++i) {
      const float radius = points.radius ? points.radius[i] : 0.0f;
      column(kRadius)[i] = std::isfinite(radius) ? radius : 0.0f;
      column(kSpread)[i] = points.spread && std::isfinite(points.spread[i]) ? points.spread[i] : 0.0f;
    }
    if (triple) {
      // Two more points a hit, one footprint away in u and in v.
      for (uint32_t i = 0; i < n; ++i) {
        const Vec3 du3 = at3(operand(kDPdu), i), dv3 = at3(operand(kDPdv), i);
        const auto step = [&](const Vec3& d, float at) {
          const float length = glm::length(d);
          float s = length > 0 ? 2.0f * column(kRadius)[i] / length : 0.0f;
          s = std::isfinite(s) ? std::clamp(s, 1e-4f, 0.25f) : 1e-4f;
          return at + s <= 1.0f ? s : -s;
        };
        const float su = step(du3, patchU_[i]), sv = step(dv3, patchV_[i]);
        for (uint32_t k : {1u, 2u}) {
          const uint32_t j = k * period + i;
          nodes_[j] = nodes_[i], cells_[j] = cells_[i], seeds_[j] = seeds_[i];
          patchU_[j] = patchU_[i] + (k == 1 ? su : 0.0f), patchV_[j] = patchV_[i] + (k == 2 ? sv : 0.0f);
          column(kRadius)[j] = column(kRadius)[i], column(kSpread)[j] = column(kSpread)[i];
          set3(operand(kP), j, at3(operand(kP), i) + (k == 1 ? du3 * su : dv3 * sv));
          set3(operand(kN), j, at3(operand(kN), i)), set3(operand(kNg), j, at3(operand(kNg), i));
          set3(operand(kDPdu), j, du3), set3(operand(kDPdv), j, dv3);
        }
      }
      for (uint32_t k : {1u, 2u})
        eachRun([&](cache::NodeId node, uint32_t first, uint32_t m) {
          const uint32_t at = k * period + first;
          if (!setup.displaced)
            scene.evaluateSurface(node, m, &cells_[at], &patchU_[at], &patchV_[at],
                                  surfaceOut(at, false, true, false));
          scene.evaluateParameters(node, m, &cells_[at], &patchU_[at], &patchV_[at], column(kU) + at,
                                   column(kV) + at, column(kS) + at, column(kT) + at);
        });
    }
    for (uint32_t c : {kP, kN, kNg, kDPdu, kDPdv}) toCurrent(c, c == kN || c == kNg);
    // Steps in the shader's own u and v, which dPdu and dPdv are then per unit of.
    for (uint32_t i = 0; i < n; ++i) {
      float du = 1, dv = 1;
      if (triple) {
        const float patchDu = patchU_[period + i] - patchU_[i],
                    patchDv = patchV_[2 * period + i] - patchV_[i];
        du = column(kU)[period + i] - column(kU)[i], dv = column(kV)[2 * period + i] - column(kV)[i];
        if (du == 0 || !std::isfinite(du)) du = patchDu;
        if (dv == 0 || !std::isfinite(dv)) dv = patchDv;
        for (uint32_t k = 0; k < 3; ++k)
          for (uint32_t c = 0; c < 3; ++c) {
            column(kDPdu + c)[k * period + i] *= patchDu / du;
            column(kDPdv + c)[k * period + i] *= patchDv / dv;
          }
      } else {
        const float lu = glm::length(at3(operand(kDPdu), i)), lv = glm::length(at3(operand(kDPdv), i));
        du = lu > 0 ? 2 * column(kRadius)[i] / lu : 0, dv = lv > 0 ? 2 * column(kRadius)[i] / lv : 0;
      }
      for (uint32_t k = 0; k < (triple ? 3u : 1u); ++k)
        column(kDu)[k * period + i] = du, column(kDv)[k * period + i] = dv;
    }
    if (triple) tripleStencil(stencil_, period, column(kDu), column(kDv));
    const Mat3 rotate(system_.cacheToCurrent);
    distance_.assign(lanes_, 0.0f);
    for (uint32_t i = 0; i < n; ++i) {
      distance_[i] = points.distance ? points.distance[i] : 1.0f;
      const Vec3 d(points.direction[0][i], points.direction[1][i], points.direction[2][i]);
      const float t = points.distance ? points.distance[i] : 1.0f;
      const Vec3 I = rotate * (d * t);
      set3(operand(kI), i, I);
      for (uint32_t k = 1; triple && k < 3; ++k)
        set3(operand(kI), k * period + i, I + at3(operand(kP), k * period + i) - at3(operand(kP), i));
    }
    batch_.footprint = operand(kRadius), batch_.spread = operand(kSpread);
    if (!triple) batch_.stencil = nullptr;
  }
  if (!hits || triple) batch_.stencil = &stencil_;
  finish(setup);
  primvars(setup.surfaceOverrides, *setup.surface, overrides_);
  batch_.overrides = overrides_.list;
}

std::span<const Batch::Override> PointColumns::displacementOverrides(const ShadeSetup& setup) {
  if (!setup.displacement) return {};
  primvars(setup.displacementOverrides, *setup.displacement, displacementOverrides_);
  return displacementOverrides_.list;
}

Batch PointColumns::beforeDisplacement(const ShadeSetup& setup) {
  Batch b = batch_;
  b.raysAllowed = false;
  b.overrides = displacementOverrides(setup);
  undisplaced_.reserve(size_t(lanes_) * 15);
  std::memset(undisplaced_.data(), 0, size_t(lanes_) * 15 * sizeof(float));
  uint32_t next = 0;
  const auto column = [&](GlobalId g) {
    const Operand o{undisplaced_.data() + size_t(next) * lanes_, lanes_, ~0u};
    next += 3;
    return b.globals[size_t(g)] = o;
  };
  const Operand P = column(GlobalId::k_P), N = column(GlobalId::k_N), Ng = column(GlobalId::k_Ng),
                dPdu = column(GlobalId::k_dPdu), dPdv = column(GlobalId::k_dPdv);
  b.globals[size_t(GlobalId::k_Ns)] = N;
  for (uint32_t offset = 0; offset < lanes_; offset += padLanes(count_))
    eachRun([&](cache::NodeId node, uint32_t first, uint32_t m) {
      const uint32_t at = offset + first;
      cache::SurfaceOut out;
      for (uint32_t c = 0; c < 3; ++c) {
        out.P[c] = P.comp(c) + at, out.N[c] = N.comp(c) + at, out.Ng[c] = Ng.comp(c) + at;
        out.dPdu[c] = dPdu.comp(c) + at, out.dPdv[c] = dPdv.comp(c) + at;
      }
      system_.scene.evaluateSurface(node, m, &cells_[at], &patchU_[at], &patchV_[at], out);
    });
  const auto toCurrent = [&](const Operand& o, Helper h) {
    KernelCall call;
    const Operand pair[] = {o, o};
    call.arg = pair, call.argCount = 2, call.lanes = lanes_;
    call.matrix = &system_.cacheToCurrent[0][0];
    kernels().helper[size_t(h)](call);
  };
  toCurrent(P, Helper::transformPoint);
  toCurrent(N, Helper::transformNormal), toCurrent(Ng, Helper::transformNormal);
  toCurrent(dPdu, Helper::transformVector), toCurrent(dPdv, Helper::transformVector);
  // Per unit of the shader's own u and v, as du and dv are.
  if (const DerivativeStencil* s = b.stencil)
    for (uint32_t i = 0; i < lanes_; ++i) {
      set3(dPdu, i, (at3(P, s->uHi[i]) - at3(P, s->uLo[i])) * s->uScale[i]);
      set3(dPdv, i, (at3(P, s->vHi[i]) - at3(P, s->vLo[i])) * s->vScale[i]);
    }
  return b;
}

/// Colours, seeds and objects.
void PointColumns::finish(const ShadeSetup& setup) {
  const cache::Skeleton& skeleton = system_.scene.skeleton();
  const cache::AttributeRecord& a = skeleton.attributes()[setup.attributes];
  for (uint32_t c = 0; c < 3; ++c) {
    std::fill_n(column(kCs + c), lanes_, a.color[int(c)]);
    std::fill_n(column(kOs + c), lanes_, a.opacity[int(c)]);
  }
  const auto color = [&](const char* name, uint32_t base) {
    for (uint32_t offset = 0; offset < lanes_; offset += padLanes(count_))
      eachRun([&](cache::NodeId node, uint32_t first, uint32_t m) {
        const cache::ParamRecord* p = skeleton.find(system_.scene.objectOf(node).primvars, name);
        if (!p || p->type != cache::ParamType::kColor) return;
        const uint32_t at = offset + first;
        float* const out[3] = {column(base) + at, column(base + 1) + at, column(base + 2) + at};
        system_.scene.evaluatePrimvar(node, *p, m, &cells_[at], &patchU_[at], &patchV_[at], out);
      });
  };
  if (setup.colorPrimvar) color("Cs", kCs);
  if (setup.opacityPrimvar) color("Os", kOs);
  for (uint32_t c = 0; c < 3; ++c) std::memcpy(column(kOi + c), column(kOs + c), lanes_ * sizeof(float));
  batch_.seed = seeds_.data();
  objectTable();
}

void PointColumns::objectTable() {
  object_.assign(lanes_, 0);
  objects_.clear();
  const cache::ObjectRecord* const table = system_.scene.skeleton().objects().data();
  eachRun([&](cache::NodeId node, uint32_t first, uint32_t m) {
    const uint32_t id = uint32_t(&system_.scene.objectOf(node) - table);
    size_t k = 0;
    if (setup_->usesObjectSpace || objects_.empty()) {
      k = size_t(std::find(objects_.begin(), objects_.end(), id) - objects_.begin());
      if (k == objects_.size()) objects_.push_back(id);
    }
    for (uint32_t offset = 0; offset < lanes_; offset += padLanes(count_))
      std::fill_n(object_.begin() + offset + first, m, uint16_t(k));
  });
  batch_.object = object_.data();
  batch_.objects = objects_;
  batch_.variables = this;
}

void PointColumns::primvars(const std::vector<ShadeSetup::PrimvarParameter>& parameters,
                            const ShaderInstance& shader, Overrides& to) {
  to.list.clear();
  size_t columns = 0;
  const ShaderProgram& p = shader.program();
  for (const auto& x : parameters) columns += p.symbols[p.parameters[x.parameter].symbol].floats();
  to.memory.reserve(columns * lanes_ + 1);
  float* at = to.memory.data();
  const cache::Skeleton& skeleton = system_.scene.skeleton();
  std::vector<float*> out;
  for (const auto& x : parameters) {
    const Symbol& symbol = p.symbols[p.parameters[x.parameter].symbol];
    const uint32_t components = symbol.floats();
    const Operand o{at, lanes_, ~0u};
    at += size_t(components) * lanes_;
    const ShaderValue& value = shader.values[x.parameter];
    for (uint32_t c = 0; c < components; ++c) std::fill_n(o.comp(c), lanes_, value.floats[c]);
    for (uint32_t offset = 0; offset < lanes_; offset += padLanes(count_))
      eachRun([&](cache::NodeId node, uint32_t first, uint32_t m) {
        const cache::ObjectRecord& object = system_.scene.objectOf(node);
        const cache::ParamRecord* r = skeleton.find(object.primvars, x.name);
        if (!r) return;
        const bool triple = r->type == cache::ParamType::kColor || r->type == cache::ParamType::kPoint ||
                            r->type == cache::ParamType::kVector || r->type == cache::ParamType::kNormal;
        const uint32_t size = (triple                                 ? 3
                               : r->type == cache::ParamType::kFloat  ? 1
                               : r->type == cache::ParamType::kMatrix ? 16
                                                                      : 0) *
                              std::max(1u, r->arrayLength);
        if (size != components) return;
        const uint32_t first2 = offset + first;
        out.resize(components);
        for (uint32_t c = 0; c < components; ++c) out[c] = o.comp(c) + first2;
        if (!system_.scene.evaluatePrimvar(node, *r, m, &cells_[first2], &patchU_[first2], &patchV_[first2],
                                           out.data()))
          return;
        if (!triple || r->type == cache::ParamType::kColor) return;
        const DMat4 M = system_.host.transformToCurrent(object.transform);
        const Mat4 M4(M);
        const Mat3 linear = r->type == cache::ParamType::kNormal ? Mat3(normalMatrix(M)) : Mat3(M4);
        for (uint32_t e = 0; e + 2 < components; e += 3)
          for (uint32_t i = first2; i < first2 + m; ++i) {
            Vec3 v(o.comp(e)[i], o.comp(e + 1)[i], o.comp(e + 2)[i]);
            v = r->type == cache::ParamType::kPoint ? transformPoint(M4, v) : linear * v;
            for (uint32_t c = 0; c < 3; ++c) o.comp(e + c)[i] = v[int(c)];
          }
      });
    to.list.push_back({x.parameter, o});
  }
}

void PointColumns::fillForDicing(const ShadeSetup& setup, cache::NodeId node, size_t n, const uint32_t* cell,
                                 const float* u, const float* v, int gridNu, int gridNv, float* const P[3],
                                 float* const N[3]) {
  const bool grid = gridNu > 0 && gridNv > 0 && size_t(gridNu + 1) * size_t(gridNv + 1) == n;
  const uint32_t count = uint32_t(n), period = padLanes(n);
  const bool triple = !grid;
  reset(count, triple ? 3 * period : period, setup);
  const cache::SceneCache& scene = system_.scene;
  for (uint32_t i = 0; i < count; ++i) {
    nodes_[i] = node;
    cells_[i] = cell ? cell[i] : cache::kNone;
    patchU_[i] = u[i], patchV_[i] = v[i];
    // The address, not the batch: a shared border vertex gets the same random numbers in both grids.
    uint32_t bitsU, bitsV;
    std::memcpy(&bitsU, &u[i], 4), std::memcpy(&bitsV, &v[i], 4);
    seeds_[i] = hashStep(hashStep(hashStep(0xd15b1ace, scene.node(node).root), uint64_t(bitsU) << 32 | bitsV),
                         cells_[i]);
    for (uint32_t c = 0; c < 3; ++c) column(kP + c)[i] = P[c][i], column(kN + c)[i] = N[c][i];
  }
  cache::SurfaceOut out;
  for (uint32_t c = 0; c < 3; ++c)
    out.Ng[c] = column(kNg + c), out.dPdu[c] = column(kDPdu + c), out.dPdv[c] = column(kDPdv + c);
  scene.evaluateSurface(node, n, cells_.data(), patchU_.data(), patchV_.data(), out);
  float du = 1e-3f, dv = 1e-3f;
  if (grid) {
    du = (u[gridNu] - u[0]) / float(gridNu);
    dv = (v[size_t(gridNv) * size_t(gridNu + 1)] - v[0]) / float(gridNv);
    gridStencil(stencil_, uint32_t(gridNu), uint32_t(gridNv), lanes_, du, dv, u, v);
    std::fill_n(column(kDu), lanes_, du), std::fill_n(column(kDv), lanes_, dv);
  } else {
    for (uint32_t i = 0; i < count; ++i) {
      for (uint32_t k : {1u, 2u}) {
        const uint32_t j = k * period + i;
        nodes_[j] = node, cells_[j] = cells_[i], seeds_[j] = seeds_[i];
        const float su = u[i] + du <= 1 ? du : -du, sv = v[i] + dv <= 1 ? dv : -dv;
        patchU_[j] = u[i] + (k == 1 ? su : 0), patchV_[j] = v[i] + (k == 2 ? sv : 0);
        for (uint32_t m = 0; m < 3; ++m) column(kDu)[m * period + i] = su, column(kDv)[m * period + i] = sv;
      }
    }
    for (uint32_t k : {1u, 2u}) {
      cache::SurfaceOut aux;
      for (uint32_t c = 0; c < 3; ++c) {
        aux.P[c] = column(kP + c) + k * period, aux.N[c] = column(kN + c) + k * period;
        aux.Ng[c] = column(kNg + c) + k * period;
        aux.dPdu[c] = column(kDPdu + c) + k * period, aux.dPdv[c] = column(kDPdv + c) + k * period;
      }
      scene.evaluateSurface(node, n, &cells_[k * period], &patchU_[k * period], &patchV_[k * period], aux);
    }
    tripleStencil(stencil_, period, column(kDu), column(kDv));
  }
  for (uint32_t offset = 0; offset < lanes_; offset += period)
    scene.evaluateParameters(node, n, &cells_[offset], &patchU_[offset], &patchV_[offset],
                             column(kU) + offset, column(kV) + offset, column(kS) + offset,
                             column(kT) + offset);
  for (uint32_t c : {kP, kN, kNg, kDPdu, kDPdv}) toCurrent(c, c == kN || c == kNg);
  const bool perspective = system_.host.perspective();
  for (uint32_t i = 0; i < lanes_; ++i)
    set3(operand(kI), i, perspective ? at3(operand(kP), i) : Vec3(0, 0, 1));
  batch_.stencil = &stencil_;
  batch_.raysAllowed = false;
  finish(setup);
  batch_.overrides = displacementOverrides(setup);
}

}  // namespace fr
