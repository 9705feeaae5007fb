#include "scene_cache/trim.h"

#include <algorithm>
#include <cmath>

#include "ri/renderer.h"
#include "scene_cache/nurbs.h"

namespace fr::cache {
namespace {

constexpr size_t kBands = 256;
/// Edges, over all bands: a limit for what bad data can ask for.
constexpr size_t kMostEdges = size_t(1) << 24;
constexpr int kDeepest = 12;

struct Uv {
  double u, v;
};

Uv pointOf(const double* piece, int order, double t) {
  double h[3];
  bezierPiecePoint(piece, order, 3, t, h);
  return {h[0] / h[2], h[1] / h[2]};
}

/// Chords of one Bezier piece between t0 and t1, without its first point.
void flatten(const double* piece, int order, double t0, Uv a, double t1, Uv b, double tolerance, int depth,
             std::vector<Uv>& out) {
  const double dx = b.u - a.u, dy = b.v - a.v, length = std::sqrt(dx * dx + dy * dy);
  double off = 0;
  // At several places: a curve may cross its chord in the middle.
  for (const double f : {0.5, 0.27, 0.71}) {
    const Uv m = pointOf(piece, order, t0 + (t1 - t0) * f);
    const double ex = m.u - a.u, ey = m.v - a.v;
    const double along = length > 0 ? (ex * dx + ey * dy) / length : 0;
    const double across = length > 0 ? std::abs(ex * dy - ey * dx) / length : std::sqrt(ex * ex + ey * ey);
    off = std::max({off, across, along < 0 ? -along : 0.0, along > length ? along - length : 0.0});
  }
  // Cubic and higher: at least four chords before the samples are believed.
  if ((off <= tolerance && (order <= 3 || depth >= 2)) || depth >= kDeepest) {
    out.push_back(b);
    return;
  }
  const double middle = 0.5 * (t0 + t1);
  const Uv m = pointOf(piece, order, middle);
  flatten(piece, order, t0, a, middle, m, tolerance, depth + 1, out);
  flatten(piece, order, middle, m, t1, b, tolerance, depth + 1, out);
}

}  // namespace

TrimLoops flattenTrimCurves(const ri::TrimCurve& t, double size) {
  TrimLoops r;
  const double tolerance = size / 65536;
  std::vector<TrimEdge> all;
  size_t curve = 0, knot = 0, point = 0;
  for (size_t loop = 0; loop < t.ncurves.size(); ++loop) {
    std::vector<Uv> line;
    std::string problem;
    double widest = 0;
    for (int c = 0; c < t.ncurves[loop]; ++c, ++curve) {
      const size_t n = size_t(t.n[curve]), order = size_t(t.order[curve]);
      const std::span<const float> knots(t.knot.data() + knot, n + order);
      const size_t first = point;
      knot += n + order, point += n;
      if (!problem.empty()) continue;
      if (order > kMaxBezierOrder) problem = fmt::format("order {} of curve {}", order, curve);
      for (size_t i = 1; i < knots.size(); ++i)
        if (!(knots[i - 1] <= knots[i])) problem = fmt::format("the knots of curve {} decrease", curve);
      std::vector<double> values;
      for (size_t i = first; i < first + n; ++i) {
        values.insert(values.end(), {double(t.u[i]), double(t.v[i]), double(t.w[i])});
        if (!std::isfinite(t.u[i]) || !std::isfinite(t.v[i]) || !(t.w[i] > 0) || !std::isfinite(t.w[i]))
          problem =
              fmt::format("point {} of curve {} is not finite or has no positive weight", i - first, curve);
      }
      if (!problem.empty()) continue;
      const auto spans = nurbsSpans(knots, int(order), t.min[curve], t.max[curve]);
      if (spans.empty()) {
        problem = fmt::format("curve {} is empty between {} and {}", curve, t.min[curve], t.max[curve]);
        continue;
      }
      const auto pieces = bezierPieces(knots, int(order), spans, values.data(), 3, 3);
      const int raised = int(std::max<size_t>(order, 4));
      for (size_t s = 0; s < spans.size(); ++s) {
        const double* piece = pieces.data() + s * size_t(raised) * 3;
        const Uv a = pointOf(piece, raised, 0), b = pointOf(piece, raised, 1);
        if (line.empty()) {
          line.push_back(a);
        } else {
          const double gap = std::max(std::abs(a.u - line.back().u), std::abs(a.v - line.back().v));
          widest = std::max(widest, gap);
          if (gap > 0) line.push_back(a);
        }
        // Straight lines need no subdivision.
        if (order == 2) {
          line.push_back(b);
        } else {
          flatten(piece, raised, 0, a, 1, b, tolerance, 0, line);
        }
      }
    }
    if (problem.empty() && line.size() > 1) {
      widest = std::max(
          {widest, std::abs(line.front().u - line.back().u), std::abs(line.front().v - line.back().v)});
      if (widest > 1e-3 * size)
        r.problems.push_back(
            fmt::format("trim loop {} is open by {:.3g}; it is closed by a straight line", loop, widest));
      for (size_t i = 0; i < line.size(); ++i) {
        const Uv &a = line[i], &b = line[(i + 1) % line.size()];
        const TrimEdge e{float(a.u), float(a.v), float(b.u), float(b.v)};
        if (std::isfinite(e.u0) && std::isfinite(e.v0) && std::isfinite(e.u1) && std::isfinite(e.v1))
          all.push_back(e);
      }
    } else if (!problem.empty()) {
      r.problems.push_back(fmt::format("trim loop {} is left out: {}", loop, problem));
    }
  }
  if (all.empty()) return r;
  r.low = kInfinity, r.high = -kInfinity;
  for (const TrimEdge& e : all)
    r.low = std::min({r.low, e.v0, e.v1}), r.high = std::max({r.high, e.v0, e.v1});
  if (!(r.high > r.low)) return r;
  const auto bandOf = [&](float v) {
    const double x = (double(v) - double(r.low)) / (double(r.high) - double(r.low)) * double(kBands);
    return size_t(std::clamp(x, 0.0, double(kBands - 1)));
  };
  std::vector<uint32_t> counts(kBands + 1, 0);
  size_t total = 0;
  for (const TrimEdge& e : all) {
    for (size_t b = bandOf(std::min(e.v0, e.v1)); b <= bandOf(std::max(e.v0, e.v1)); ++b)
      ++counts[b + 1], ++total;
  }
  if (total > kMostEdges) {
    r.problems.push_back("too many trim curves; the surface is not trimmed");
    return r;
  }
  for (size_t b = 0; b < kBands; ++b) counts[b + 1] += counts[b];
  r.bands = counts;
  r.edges.resize(total);
  for (const TrimEdge& e : all) {
    for (size_t b = bandOf(std::min(e.v0, e.v1)); b <= bandOf(std::max(e.v0, e.v1)); ++b)
      r.edges[counts[b]++] = e;
  }
  return r;
}

size_t TrimTest::bandOf(double v) const {
  const size_t n = bands_.size() - 1;
  const double x = (v - double(low_)) / (double(high_) - double(low_)) * double(n);
  return x > 0 ? std::min(size_t(std::min(x, double(n))), n - 1) : 0;
}

std::span<const TrimEdge> TrimTest::band(size_t i) const {
  const uint32_t first = bands_[i], end = bands_[i + 1];
  if (first > end || end > edges_.size()) return {};  // damaged
  return edges_.subspan(first, end - first);
}

bool TrimTest::removed(double u, double v) const {
  if (!any()) return false;
  bool inside = false;
  if (v >= double(low_) && v <= double(high_)) {
    for (const TrimEdge& e : band(bandOf(v))) {
      const double v0 = double(e.v0), v1 = double(e.v1);
      if ((v0 <= v) == (v1 <= v)) continue;
      if (u < double(e.u0) + (v - v0) * (double(e.u1) - double(e.u0)) / (v1 - v0)) inside = !inside;
    }
  }
  return inside != outside_;
}

std::optional<bool> TrimTest::removed(double u0, double u1, double v0, double v1) const {
  if (!any()) return false;
  if (u1 < u0) std::swap(u0, u1);
  if (v1 < v0) std::swap(v0, v1);
  if (v1 >= double(low_) && v0 <= double(high_)) {
    for (size_t b = bandOf(v0); b <= bandOf(v1); ++b) {
      for (const TrimEdge& e : band(b)) {
        // Boxes; then the line against the four corners.
        const double a = double(std::min(e.u0, e.u1)), c = double(std::max(e.u0, e.u1));
        const double d = double(std::min(e.v0, e.v1)), f = double(std::max(e.v0, e.v1));
        if (c < u0 || a > u1 || f < v0 || d > v1) continue;
        const double dx = double(e.u1) - double(e.u0), dy = double(e.v1) - double(e.v0);
        int above = 0;
        for (const double u : {u0, u1}) {
          for (const double v : {v0, v1}) above += (u - double(e.u0)) * dy - (v - double(e.v0)) * dx > 0;
        }
        if (above == 0 || above == 4) continue;
        return std::nullopt;
      }
    }
  }
  return removed(0.5 * (u0 + u1), 0.5 * (v0 + v1));
}

PatchTrim patchTrim(const Skeleton& s, NodeId root) {
  PatchTrim t;
  const auto roots = s.rootPatches();
  if (root >= roots.size()) return t;
  const ObjectRecord& object = s.objects()[roots[root].object];
  if (object.type != PrimitiveType::kNurbs) return t;
  const auto* source = sourceRecord<NurbsSource>(s, object);
  if (!source || source->trimBands.count < 2 || source->spansU == 0) return t;
  const auto spanU = sourceArray<NurbsSpan>(s, source->spanU),
             spanV = sourceArray<NurbsSpan>(s, source->spanV);
  const uint32_t fu = roots[root].face % source->spansU, fv = roots[root].face / source->spansU;
  const auto bands = sourceArray<uint32_t>(s, source->trimBands);
  if (fu >= spanU.size() || fv >= spanV.size() || bands.size() < 2) return t;
  t.u0 = spanU[fu].low, t.uSize = spanU[fu].high - spanU[fu].low;
  t.v0 = spanV[fv].low, t.vSize = spanV[fv].high - spanV[fv].low;
  t.test = TrimTest(sourceArray<TrimEdge>(s, source->trimEdges), bands, source->trimLow, source->trimHigh,
                    source->trimOutside != 0);
  return t;
}

}  // namespace fr::cache
