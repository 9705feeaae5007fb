// Points and Curves.
#include <algorithm>
#include <cmath>

#include "scene_cache/add_primitive.h"
#include "scene_cache/bezier.h"
#include "scene_cache/morton.h"
#include "scene_cache/patch_basis.h"
#include "scene_cache/thin.h"

namespace fr::cache {
namespace {

struct Rated {
  DiceRate rate;
  float pixels;  // of a micropolygon's side
  float scale;   // object to cache space
};

Rated ratedFor(const Adding& a) {
  Rated r;
  r.rate = a.rate(PrimitiveType::kCurves);
  r.pixels = std::sqrt(std::clamp(a.writer.attributes(a.desc.attributes).shadingRate, 1e-4f, 1e6f));
  const double s = std::cbrt(std::abs(glm::determinant(DMat3(a.toCache[0]))));
  r.scale = std::isfinite(s) ? float(s) : 0.0f;
  return r;
}

/// Positions of all keys, three floats each.
Result<std::vector<std::vector<float>>> positionsOf(Adding& a) {
  std::vector<std::vector<float>> keys;
  for (size_t k = 0; k < a.keyCount(); ++k) {
    uint32_t components = 3;
    const ri::Param* p = positionParam(ri::paramsOf(a.key(k)), &components);
    if (!p) return a.error(RiError::kMissingData, "no positions (\"P\")");
    std::vector<float> values;
    if (components == 4) {
      for (size_t i = 0; i + 3 < p->floats.size(); i += 4) {
        for (size_t c = 0; c < 3; ++c) values.push_back(p->floats[i + c] / p->floats[i + 3]);
      }
    } else {
      values = p->floats;
    }
    values.resize(values.size() / 3 * 3);
    if (!keys.empty() && keys[0].size() != values.size())
      return a.error(RiError::kBadMotion, "keys with different numbers of positions");
    keys.push_back(std::move(values));
  }
  if (keys[0].size() / 3 >= kNone) return a.error(RiError::kLimit, "too many positions");
  return keys;
}

/// A float variable's numbers; empty when it is absent or of another kind.
std::span<const float> floatsOf(const ri::ParamList& params, std::string_view name) {
  const ri::Param* p = params.find(name);
  if (!p || p->declaration.type != ri::ValueType::kFloat || p->declaration.width() != 1) return {};
  return p->floats;
}

Vec3 pointAt(const Adding& a, const std::vector<std::vector<float>>& keys, size_t gridKey, size_t i) {
  const KeySpan k = findKeys(a.keyTimes(), uint32_t(keys.size()), a.gridTimes[gridKey]);
  const float *x = keys[k.a].data() + i * 3, *y = keys[k.b].data() + i * 3;
  DVec3 p(x[0], x[1], x[2]);
  if (k.weight != 0) p = p * (1 - k.weight) + DVec3(y[0], y[1], y[2]) * k.weight;
  return Vec3(transformPoint(a.toCache[gridKey], p));
}

/// Corners of the polygon that stands for a disk of this radius in pixels.
uint32_t sidesFor(float radius) {
  constexpr std::pair<float, uint32_t> kSteps[] = {{0.35f, 3}, {0.8f, 4}, {1.6f, 6},
                                                   {4, 10},    {10, 16},  {40, 32}};
  for (const auto& [limit, sides] : kSteps) {
    if (radius < limit) return sides;
  }
  return 64;
}

/// How many pieces of a curve stay this close to it, in micropolygons.
constexpr float kCurveTolerance = 0.15f;
/// Cells of a narrow ribbon: this many micropolygons of area, but no longer than kLongestCell. Hair is shaded
/// along its length, where nothing changes within a few pixels.
constexpr float kCellArea = 3;
constexpr float kLongestCell = 8;
constexpr float kMostSteps = 4096;
constexpr uint32_t kMostColumns = 1024;

/// Rows of cells that fit a meshlet when it is this many cells wide.
uint32_t rowsThatFit(uint32_t columns) {
  return std::min(uint32_t(kMaxMeshletVertices) / (columns + 1) - 1,
                  uint32_t(kMaxMeshletTriangles) / (2 * columns));
}

/// Pieces of curves are about so many micropolygons long.
constexpr float kLongPiece = 64;
/// Fewer vertices than these are not worth a meshlet of their own, however far they stand apart.
constexpr uint32_t kFewVertices = 40;

/// A box around curves of this radius, and what rounding may move them.
Box3f thickened(Box3f box, float radius) {
  box.grow(radius);
  const Vec3 size = glm::max(glm::abs(box.min), glm::abs(box.max));
  box.grow(4e-7f * std::max({size.x, size.y, size.z}));
  return box;
}

/// Extends a box by the part [from, to] of a segment: by its end points, or the control points of the part.
void extendByPart(const Vec3 b[4], bool cubic, float from, float to, Box3f& box) {
  if (!cubic) {
    box.extend(b[0] + from * (b[1] - b[0]));
    box.extend(b[0] + to * (b[1] - b[0]));
    return;
  }
  // The blossom of the curve.
  const auto blossom = [&](float r, float s, float t) {
    const auto between = [](const Vec3& x, const Vec3& y, float at) { return x + at * (y - x); };
    const Vec3 p0 = between(b[0], b[1], r), p1 = between(b[1], b[2], r), p2 = between(b[2], b[3], r);
    return between(between(p0, p1, s), between(p1, p2, s), t);
  };
  box.extend(blossom(from, from, from)), box.extend(blossom(from, from, to));
  box.extend(blossom(from, to, to)), box.extend(blossom(to, to, to));
}

}  // namespace

Result<void> addPoints(Adding& a) {
  auto positions = positionsOf(a);
  if (!positions) return std::move(positions).error();
  const auto& keys = *positions;
  const ri::ParamList& params = ri::paramsOf(a.key(0));
  const size_t count = keys[0].size() / 3;
  std::span<const float> widths = floatsOf(params, "width");
  if (widths.empty() || (widths.size() != 1 && widths.size() < count))
    widths = floatsOf(params, "constantwidth");
  const float one = 1;
  if (widths.empty()) widths = {&one, 1};
  const Rated rated = ratedFor(a);

  Box3f box;
  std::vector<uint32_t> order;
  order.reserve(count);
  std::vector<Vec3> places(count);
  size_t bad = 0;
  for (size_t i = 0; i < count; ++i) {
    bool finite = true;
    for (size_t t = 0; t < a.toCache.size(); ++t) finite = finite && isFinite(pointAt(a, keys, t, i));
    const float w = widths[widths.size() == 1 ? 0 : i];
    finite = finite && std::isfinite(w);
    if (!finite) {
      ++bad;
      continue;
    }
    if (w == 0) continue;
    places[i] = pointAt(a, keys, 0, i);
    box.extend(places[i]);
    order.push_back(uint32_t(i));
  }
  if (bad > 0) {
    if (bad == count) return a.error(RiError::kRange, "no point has a finite place and width; left out");
    a.warn(RiError::kRange,
           fmt::format("{} of {} points have no finite place or width; left out", bad, count));
  }
  if (order.empty()) return {};
  std::vector<std::pair<uint64_t, uint32_t>> codes;
  codes.reserve(order.size());
  for (const uint32_t i : order) codes.emplace_back(mortonCode(places[i], box), i);
  std::sort(codes.begin(), codes.end());
  for (size_t i = 0; i < codes.size(); ++i) order[i] = codes[i].second;
  codes = {};

  std::vector<PointCluster> clusters;
  std::vector<Box3f> bounds;
  const auto radiusOf = [&](uint32_t i) {
    return 0.5f * std::abs(widths[widths.size() == 1 ? 0 : i]) * rated.scale;
  };
  for (size_t first = 0; first < order.size();) {
    PointCluster c{first, 0, 3};
    Box3f bound;
    for (size_t i = first; i < order.size(); ++i) {
      const Vec3 p = places[order[i]];
      const float r = radiusOf(order[i]);
      const float pixels = rated.rate.segment(p, p + Vec3(r, 0, 0)) * rated.pixels;
      const uint32_t sides = std::max(c.sides, sidesFor(pixels));
      if ((c.count + 1) * sides > uint32_t(kMaxMeshletVertices) ||
          (c.count + 1) * (sides - 2) > uint32_t(kMaxMeshletTriangles))
        break;
      // What is far from the rest starts a cluster of its own: a cluster's box should be small.
      Box3f more = bound;
      for (size_t t = 0; t < a.toCache.size(); ++t) {
        const Vec3 q = pointAt(a, keys, t, order[i]), reach(r * equalAreaRadius(sides));
        more.extend(q - reach), more.extend(q + reach);
      }
      bound = more, c.sides = sides, ++c.count;
    }
    const Vec3 size = glm::max(glm::abs(bound.min), glm::abs(bound.max));
    bound.grow(4e-7f * std::max({size.x, size.y, size.z}));
    clusters.push_back(c), bounds.push_back(bound);
    first += c.count;
  }
  PointsSource s{};
  s.positions = a.positions(keys, 3);
  s.widths = a.writer.addArray<float>(widths);
  s.order = a.writer.addArray<uint32_t>(order);
  s.clusters = a.writer.addArray<PointCluster>(clusters);
  ObjectRecord o = a.object(PrimitiveType::kPoints, params);
  o.source = a.record(s);
  a.finish(o, bounds);
  return {};
}

Result<void> addCurves(Adding& a) {
  const auto& c = std::get<ri::Curves>(*a.desc.primitive);
  auto positions = positionsOf(a);
  if (!positions) return std::move(positions).error();
  const auto& keys = *positions;
  for (size_t k = 1; k < a.keyCount(); ++k) {
    if (std::get<ri::Curves>(a.key(k)).nverts != c.nverts)
      return a.error(RiError::kBadMotion, "keys of different shapes");
  }
  CurvesSource s{};
  s.cubic = c.cubic, s.periodic = c.periodic, s.step = uint32_t(std::max(1, a.desc.steps.v));
  for (int i = 0; i < 16; ++i) s.basis[i] = float(a.desc.vBasis[i / 4][i % 4]);
  const BezierConversion conversion = bezierConversion(s.basis);

  std::vector<CurveRecord> curves;
  curves.reserve(c.nverts.size());
  uint64_t vertex = 0, varying = 0;
  for (const int n : c.nverts) {
    CurveRecord r{uint32_t(vertex), uint32_t(n), uint32_t(varying), 0};
    const uint32_t count = uint32_t(n);
    r.segments = !c.cubic     ? (c.periodic ? count : count - 1)
                 : c.periodic ? count / s.step
                              : (count - 4) / s.step + 1;
    curves.push_back(r);
    vertex += count, varying += r.segments + (c.periodic ? 0u : 1u);
  }
  if (vertex > keys[0].size() / 3)
    return a.error(RiError::kConsistency,
                   fmt::format("{} positions, {} are needed", keys[0].size() / 3, vertex));

  const ri::ParamList& params = ri::paramsOf(a.key(0));
  std::span<const float> widths = floatsOf(params, "width");
  const ri::Param* widthParam = widths.empty() ? nullptr : params.find("width");
  if (widths.empty()) widths = floatsOf(params, "constantwidth");
  const float one = 1;
  if (widths.empty()) widths = {&one, 1};
  /// Widest that a curve gets; vertex values of a cubic basis may overshoot a little.
  const auto widest = [&](const CurveRecord& r, size_t index) {
    if (widths.size() == 1 || !widthParam) return std::abs(widths[0]);
    if (widthParam->declaration.storage == ri::StorageClass::kUniform)
      return std::abs(widths[std::min(index, widths.size() - 1)]);
    const bool isVertex = widthParam->declaration.storage == ri::StorageClass::kVertex;
    const size_t first = isVertex ? r.firstVertex : r.firstVarying;
    const size_t n = isVertex ? r.vertexCount : r.segments + (c.periodic ? 0u : 1u);
    float w = 0;
    for (size_t i = first; i < std::min(first + n, widths.size()); ++i) w = std::max(w, std::abs(widths[i]));
    return isVertex && c.cubic ? w * 1.5f : w;
  };

  // Control points of a segment: four of a Bezier curve, or two.
  const uint32_t controls = c.cubic ? 4 : 2;
  const auto segmentAt = [&](const CurveRecord& r, uint32_t segment, size_t t, Vec3 b[4]) {
    for (uint32_t k = 0; k < controls; ++k) b[k] = pointAt(a, keys, t, curveVertex(s, r, segment, k));
    if (!c.cubic) return;
    const Vec3 g[4] = {b[0], b[1], b[2], b[3]};
    for (int k = 0; k < 4; ++k) {
      DVec3 sum(0);
      for (int j = 0; j < 4; ++j) sum += conversion.m[k][j] * DVec3(g[j]);
      b[k] = Vec3(sum / conversion.denominator);
    }
  };

  const Rated rated = ratedFor(a);
  struct Planned {
    uint64_t code = 0;
    uint32_t curve = 0;
    Box3f bound;
    float radius = 0, length = 0;  // length: micropolygons
    uint16_t steps = 1;
    uint32_t columns = 1;
  };
  std::vector<Planned> planned;
  planned.reserve(curves.size());
  size_t bad = 0;
  Box3f all;
  for (uint32_t i = 0; i < curves.size(); ++i) {
    const CurveRecord& r = curves[i];
    Planned p;
    p.curve = i;
    const float width = widest(r, i);
    bool finite = std::isfinite(width);
    float steps = 1, across = 0;
    const float radius = 0.5f * width * rated.scale;
    for (size_t t = 0; t < a.toCache.size() && finite; ++t) {
      for (uint32_t segment = 0; segment < r.segments && finite; ++segment) {
        Vec3 b[4];
        const uint32_t n = controls;
        segmentAt(r, segment, t, b);
        for (uint32_t k = 0; k < n; ++k) p.bound.extend(b[k]), finite = finite && isFinite(b[k]);
        if (t > 0) continue;
        across = std::max(across, rated.rate.segment(b[0], b[0] + Vec3(2 * radius, 0, 0)));
        across = std::max(across, rated.rate.segment(b[n - 1], b[n - 1] + Vec3(2 * radius, 0, 0)));
        float length = 0, bend = 0;
        for (uint32_t k = 0; k + 1 < n; ++k) length += rated.rate.segment(b[k], b[k + 1]);
        p.length += length;
        for (uint32_t k = 1; k + 1 < n; ++k)
          bend = std::max(bend, rated.rate.segment(b[k], b[k] + (b[k - 1] - 2.0f * b[k] + b[k + 1])));
        // A cubic's chord is off by at most 6 / 8 of the second difference of its control points, over n^2.
        const float flatness = rated.rate.flatness;
        const float tolerance = flatness > 0 ? std::min(flatness, kCurveTolerance) : kCurveTolerance;
        const float longest = std::clamp(kCellArea / std::max(across, 1e-6f), 1.0f, kLongestCell);
        steps = std::max({steps, std::sqrt(0.75f * bend / tolerance), length / longest});
      }
    }
    finite = finite && isFinite(p.bound.min) && isFinite(p.bound.max);
    if (!finite) {
      ++bad;
      continue;
    }
    if (radius == 0) continue;
    p.radius = radius;
    p.bound = thickened(p.bound, radius);
    p.steps = uint16_t(std::clamp(std::ceil(steps), 1.0f, kMostSteps));
    p.columns = uint32_t(std::clamp(std::ceil(across), 1.0f, float(kMostColumns)));
    all.extend(p.bound);
    planned.push_back(p);
  }
  if (bad > 0) {
    if (bad == curves.size())
      return a.error(RiError::kRange, "no curve has finite places and widths; left out");
    a.warn(RiError::kRange,
           fmt::format("{} of {} curves have no finite places or widths; left out", bad, curves.size()));
  }
  if (planned.empty()) return {};
  for (Planned& p : planned) p.code = mortonCode(p.bound.center(), all);
  std::sort(planned.begin(), planned.end(), [](const Planned& x, const Planned& y) {
    return std::pair(x.code, x.curve) < std::pair(y.code, y.curve);
  });

  // Box of a piece: around the control points of each part of a segment that it shows.
  const auto boundOf = [&](const Planned& p, const CurvePiece& piece) {
    const CurveRecord& r = curves[p.curve];
    const uint32_t end = piece.firstRow + piece.rows;
    Box3f box;
    for (uint32_t segment = piece.firstRow / p.steps; segment * p.steps < end; ++segment) {
      const auto at = [&](uint32_t row) {
        const uint32_t from = segment * p.steps;
        return row <= from ? 0.0f : std::min(1.0f, float(row - from) / float(p.steps));
      };
      for (size_t t = 0; t < a.toCache.size(); ++t) {
        Vec3 b[4];
        segmentAt(r, segment, t, b);
        extendByPart(b, c.cubic, at(piece.firstRow), at(end), box);
      }
    }
    return thickened(box, p.radius);
  };

  std::vector<CurvePiece> pieces;
  std::vector<CurveCluster> clusters;
  std::vector<Box3f> bounds;
  for (const Planned& p : planned) {
    const uint32_t strips = (p.columns + 14) / 15;
    const uint64_t rows = uint64_t(curves[p.curve].segments) * p.steps;
    if (rows >= uint64_t(1) << 31) return a.error(RiError::kLimit, "a curve of too many segments");
    // Long curves are cut: whoever looks for what may be seen in some place should not find all of them.
    const auto parts =
        uint64_t(std::clamp(double(p.length / kLongPiece), 1.0, std::max(1.0, double(rows) / 8)));
    const auto mostRows = uint32_t((rows + parts - 1) / parts);
    for (uint32_t strip = 0; strip < strips; ++strip) {
      const uint32_t firstColumn = strip * p.columns / strips,
                     columns = (strip + 1) * p.columns / strips - firstColumn;
      for (uint64_t row = 0; row < rows;) {
        CurvePiece piece{};
        piece.curve = p.curve, piece.steps = p.steps;
        piece.firstRow = uint32_t(row);
        piece.columns = uint16_t(columns), piece.firstColumn = uint16_t(firstColumn);
        piece.allColumns = uint16_t(p.columns);
        piece.rows = uint16_t(std::min<uint64_t>(rows - row, std::min(mostRows, rowsThatFit(columns))));
        const Box3f bound = boundOf(p, piece);
        const uint32_t vertices = (piece.rows + 1u) * (columns + 1), triangles = 2u * piece.rows * columns;
        const auto isFull = [&] {
          const CurveCluster& last = clusters.back();
          if (last.vertexCount + vertices > uint32_t(kMaxMeshletVertices) ||
              last.triangleCount + triangles > uint32_t(kMaxMeshletTriangles))
            return true;
          if (last.vertexCount < kFewVertices) return false;
          Box3f both = bounds.back();
          both.extend(bound);
          return rated.rate.segment(both.min, both.max) > 1.5f * kLongPiece;
        };
        if (clusters.empty() || isFull()) {
          clusters.push_back({pieces.size(), 0, 0, 0});
          bounds.emplace_back();
        }
        CurveCluster& cluster = clusters.back();
        piece.firstVertex = cluster.vertexCount, piece.firstTriangle = cluster.triangleCount;
        cluster.vertexCount = uint16_t(cluster.vertexCount + vertices);
        cluster.triangleCount = uint16_t(cluster.triangleCount + triangles);
        ++cluster.pieceCount;
        bounds.back().extend(bound);
        pieces.push_back(piece);
        row += piece.rows;
      }
    }
  }
  if (clusters.size() >= kNone) return a.error(RiError::kLimit, "too many curves");
  s.positions = a.positions(keys, 3);
  s.curves = a.writer.addArray<CurveRecord>(curves);
  s.pieces = a.writer.addArray<CurvePiece>(pieces);
  s.clusters = a.writer.addArray<CurveCluster>(clusters);
  ObjectRecord o = a.object(PrimitiveType::kCurves, params);
  o.source = a.record(s);
  a.finish(o, bounds);
  return {};
}

}  // namespace fr::cache
