#include "scene_cache/dicer.h"

#include <algorithm>
#include <cmath>

namespace fr::cache {
namespace {

float dyadic(uint64_t numerator, int depth) { return float(double(numerator) * std::ldexp(1.0, -depth)); }

/// A line u = const or v = const of a root patch, or the border of another patch that stands for it.
struct Line {
  const Surface* surface = nullptr;
  bool alongU = true;  // v is fixed
  float fixed = 0;
  bool reversed = false;

  void points(const float* t, size_t n, float* const P[3]) const {
    float r[kMetricSteps + 1];
    if (reversed) {
      for (size_t i = 0; i < n; ++i) r[i] = 1 - t[i];
      t = r;
    }
    if (alongU) {
      surface->row(fixed, n, t, P);
    } else {
      surface->column(fixed, n, t, P);
    }
  }
  Vec3 point(float t) const {
    if (reversed) t = 1 - t;
    return alongU ? surface->point(t, fixed) : surface->point(fixed, t);
  }
  float metric(const DiceRate& rate, uint32_t index, int depth) const {
    float t[kMetricSteps + 1], x[kMetricSteps + 1], y[kMetricSteps + 1], z[kMetricSteps + 1];
    for (int i = 0; i <= kMetricSteps; ++i)
      t[i] = dyadic(uint64_t(index) * kMetricSteps + unsigned(i), depth + 3);
    float* const P[3] = {x, y, z};
    points(t, kMetricSteps + 1, P);
    return rate.curve(x, y, z);
  }
};

/// Border lines of the root patch: v = 0, u = 1, v = 1, u = 0.
Line edgeLine(const Surface& own, const RootBorders& borders, int edge) {
  const RootBorders::Piece& p = borders.edge[edge];
  const int e = p.surface ? p.edge : edge;
  Line l;
  l.surface = p.surface ? p.surface : &own;
  l.alongU = e == 0 || e == 2;
  l.fixed = e == 1 || e == 2 ? 1.0f : 0.0f;
  l.reversed = p.surface && p.reversed;
  return l;
}
Vec3 rootCorner(const Surface& own, const RootBorders& borders, int corner) {
  const RootBorders::Piece& p = borders.corner[corner];
  const int c = p.surface ? p.edge : corner;
  return (p.surface ? p.surface : &own)
      ->point(c == 1 || c == 2 ? 1.0f : 0.0f, c == 2 || c == 3 ? 1.0f : 0.0f);
}

/// One of a node's four border lines with its root interval.
struct BorderLine {
  Line line;
  bool alongU;          // in the patch's own parameters
  uint32_t fixedIndex;  // fixed parameter = fixedIndex / 2^fixedDepth
  int fixedDepth;
  int rootDepth;
};
BorderLine borderLine(const Surface& surface, const RootBorders& borders, const NodeRect& n, int edge) {
  BorderLine b;
  b.alongU = edge == 0 || edge == 2;
  const bool high = edge == 1 || edge == 2;
  b.fixedDepth = b.alongU ? n.dv : n.du;
  b.fixedIndex = (b.alongU ? n.iv : n.iu) + (high ? 1u : 0u);
  b.rootDepth = n.edgeRootDepth[edge];
  const bool onRootBorder = b.fixedIndex == (high ? 1u << b.fixedDepth : 0u);
  if (onRootBorder) {
    b.line = edgeLine(surface, borders, edge);
  } else {
    b.line.surface = &surface;
    b.line.alongU = b.alongU;
    b.line.fixed = dyadic(b.fixedIndex, b.fixedDepth);
  }
  return b;
}

/// Spacing of canon(root interval) inside the interval `index` / 2^depth: vertices at multiples of 2^-result.
/// Above depth + kMaxGridLog2 when that interval would have to be halved.
int canonicalDepth(const BorderLine& b, const DiceRate& rate, uint32_t index, int depth) {
  for (int e = std::min(b.rootDepth, depth);; ++e) {
    const int n = rate.log2Segments(b.line.metric(rate, index >> (depth - e), e));
    if (n <= kMaxGridLog2 || e >= kMaxSplitDepth) return e + std::min(n, kMaxGridLog2);
    if (e == depth) return depth + n;
  }
}

class PositionRule {
 public:
  PositionRule(const Surface& surface, const RootBorders& borders, const Surface& planSurface,
               const RootBorders& planBorders, const DiceRate& rate, std::span<const NodeRect> path)
      : surface_(surface),
        borders_(borders),
        planSurface_(planSurface),
        planBorders_(planBorders),
        rate_(rate),
        path_(path) {}

  /// Position of the kept vertex at t = index / 2^depth of border `edge` of path_[level]; t lies in the root
  /// interval.
  Vec3 kept(size_t level, int edge, uint64_t index, int depth) const {
    const NodeRect& n = path_[level];
    const BorderLine b = borderLine(surface_, borders_, n, edge);
    const float t = dyadic(index, depth);
    const uint64_t rootSize = depth >= b.rootDepth ? uint64_t(1) << (depth - b.rootDepth) : 0;
    const bool atEnd = rootSize == 0 || index % rootSize == 0;
    const uint32_t one = 1u << b.fixedDepth;
    const bool lineOnRoot = b.fixedIndex == 0 || b.fixedIndex == one;
    const bool endOnRoot = index == 0 || index == uint64_t(1) << depth;
    if (atEnd && lineOnRoot && endOnRoot) {
      const bool tHigh = index != 0, fHigh = b.fixedIndex != 0;
      const bool uHigh = b.alongU ? tHigh : fHigh, vHigh = b.alongU ? fHigh : tHigh;
      return rootCorner(surface_, borders_, vHigh ? (uHigh ? 2 : 3) : (uHigh ? 1 : 0));
    }
    if (atEnd && !lineOnRoot) {
      // The line ends on an older one, which decides. Its creator is the ancestor that it halves.
      for (size_t k = level; k-- > 0;) {
        const NodeRect& a = path_[k];
        const int across = b.alongU ? a.dv : a.du, along = b.alongU ? a.du : a.dv;
        const uint32_t acrossIndex = b.alongU ? a.iv : a.iu, alongIndex = b.alongU ? a.iu : a.iv;
        if (across >= b.fixedDepth || along != b.rootDepth) continue;
        // Middle of the ancestor, reduced to the depth of the line.
        const uint64_t middle = (uint64_t(acrossIndex) * 2 + 1) << (b.fixedDepth - across - 1);
        if (middle != b.fixedIndex) continue;
        const uint64_t low = uint64_t(alongIndex) << (depth - along);
        const bool high = index != low;
        const int older = b.alongU ? (high ? 1 : 3) : (high ? 2 : 0);
        return onLine(k, older, b.fixedIndex, b.fixedDepth);
      }
    }
    return b.line.point(t);
  }

  /// The vertex that shows at t of a border line: the next kept one.
  Vec3 onLine(size_t level, int edge, uint64_t index, int depth) const {
    const NodeRect& n = path_[level];
    const BorderLine b = borderLine(planSurface_, planBorders_, n, edge);
    // Where in the line: the interval of depth `own` that holds t (the lower one of two).
    const uint64_t last = (uint64_t(1) << depth) - 1;
    const uint64_t inside = std::min(index, last);
    // At the high end of the root interval the vertex is kept in any case.
    if (depth <= b.rootDepth || index % (uint64_t(1) << (depth - b.rootDepth)) == 0)
      return kept(level, edge, index, depth);
    const int spacing = canonicalSpacing(b, inside, depth);
    uint64_t shown = index;
    if (spacing < depth) {
      const int shift = depth - spacing;
      shown = (index >> shift) << shift;
    }
    return kept(level, edge, shown, depth);
  }

 private:
  /// As canonicalDepth, descending as far as needed around one parameter.
  int canonicalSpacing(const BorderLine& b, uint64_t index, int depth) const {
    for (int e = b.rootDepth;; ++e) {
      if (e > depth) return depth;  // finer than asked for: kept
      const int n = rate_.log2Segments(b.line.metric(rate_, uint32_t(index >> (depth - e)), e));
      if (n <= kMaxGridLog2 || e >= kMaxSplitDepth) return e + std::min(n, kMaxGridLog2);
    }
  }

  const Surface& surface_;
  const RootBorders& borders_;
  const Surface& planSurface_;
  const RootBorders& planBorders_;
  const DiceRate& rate_;
  std::span<const NodeRect> path_;
};

float distanceOf(const Vec3& a) { return std::sqrt(glm::dot(a, a)); }

}  // namespace

void splitRect(const NodeRect& n, bool inV, NodeRect c[2]) {
  c[0] = c[1] = n;
  if (inV) {
    for (int k = 0; k < 2; ++k) c[k].dv = uint8_t(n.dv + 1), c[k].iv = n.iv * 2 + unsigned(k);
    c[0].edgeRootDepth[2] = c[1].edgeRootDepth[0] = n.du;
  } else {
    for (int k = 0; k < 2; ++k) c[k].du = uint8_t(n.du + 1), c[k].iu = n.iu * 2 + unsigned(k);
    c[0].edgeRootDepth[1] = c[1].edgeRootDepth[3] = n.dv;
  }
}

DicePlan planNode(const Surface& surface, const RootBorders& borders, const DiceRate& rate,
                  const NodeRect& n) {
  constexpr int kSide = kMetricSteps + 1;
  float x[kSide * kSide], y[kSide * kSide], z[kSide * kSide];
  float u[kSide], v[kSide];
  for (int i = 0; i < kSide; ++i) {
    u[i] = dyadic(uint64_t(n.iu) * kMetricSteps + unsigned(i), n.du + 3);
    v[i] = dyadic(uint64_t(n.iv) * kMetricSteps + unsigned(i), n.dv + 3);
  }
  float xyz[kSide * kSide * 3];
  surface.grid(kMetricSteps, u, kMetricSteps, v, xyz, kSide);
  for (int k = 0; k < kSide * kSide; ++k) x[k] = xyz[3 * k], y[k] = xyz[3 * k + 1], z[k] = xyz[3 * k + 2];
  float metricU = 0, metricV = 0;
  for (int k = 0; k < kSide; ++k) {
    metricU = std::max(metricU, rate.curve(x + k * kSide, y + k * kSide, z + k * kSide));
    metricV = std::max(metricV, rate.curve(x + k, y + k, z + k, kSide));
  }
  int log2u = rate.log2Segments(metricU), log2v = rate.log2Segments(metricV);
  const bool canU = n.du < kMaxSplitDepth, canV = n.dv < kMaxSplitDepth;
  DicePlan plan;
  // Where the larger metric asks for a split, borders make no difference.
  if (log2u > kMaxGridLog2 && canU && metricU >= metricV) {
    plan.kind = DicePlan::Kind::kSplitU;
    return plan;
  }
  if (log2v > kMaxGridLog2 && canV && metricV > metricU) {
    plan.kind = DicePlan::Kind::kSplitV;
    return plan;
  }
  int spacing[4];
  for (int e = 0; e < 4; ++e) {
    const BorderLine b = borderLine(surface, borders, n, e);
    spacing[e] = b.alongU ? canonicalDepth(b, rate, n.iu, n.du) : canonicalDepth(b, rate, n.iv, n.dv);
    int& log2 = b.alongU ? log2u : log2v;
    log2 = std::max(log2, spacing[e] - (b.alongU ? n.du : n.dv));
  }
  const bool wantU = log2u > kMaxGridLog2 && canU, wantV = log2v > kMaxGridLog2 && canV;
  if (wantU || wantV) {
    plan.kind = wantU && (!wantV || metricU >= metricV) ? DicePlan::Kind::kSplitU : DicePlan::Kind::kSplitV;
    return plan;
  }
  plan.log2Nu = uint8_t(std::min(log2u, kMaxGridLog2));
  plan.log2Nv = uint8_t(std::min(log2v, kMaxGridLog2));
  for (int e = 0; e < 4; ++e) {
    const int fine = e == 0 || e == 2 ? n.du + plan.log2Nu : n.dv + plan.log2Nv;
    plan.edgeShift[e] = uint8_t(std::max(0, fine - spacing[e]));
  }
  return plan;
}

GridParameters gridParameters(const NodeRect& n, int log2Nu, int log2Nv) {
  GridParameters g;
  for (int i = 0; i <= 1 << log2Nu; ++i)
    g.u[i] = dyadic((uint64_t(n.iu) << log2Nu) + unsigned(i), n.du + log2Nu);
  for (int j = 0; j <= 1 << log2Nv; ++j)
    g.v[j] = dyadic((uint64_t(n.iv) << log2Nv) + unsigned(j), n.dv + log2Nv);
  return g;
}

void collapsedParameters(const NodeRect& n, int log2Nu, int log2Nv, const uint8_t shift[4], int i, int j,
                         float* u, float* v) {
  uint64_t a = (uint64_t(n.iu) << log2Nu) + unsigned(i), b = (uint64_t(n.iv) << log2Nv) + unsigned(j);
  const int nu = 1 << log2Nu, nv = 1 << log2Nv;
  const int su = std::min(32, int(j == 0 ? shift[0] : j == nv ? shift[2] : 0));
  const int sv = std::min(32, int(i == nu ? shift[1] : i == 0 ? shift[3] : 0));
  // At the line's own end nothing collapses: it is a multiple of every spacing.
  a = (a >> su) << su, b = (b >> sv) << sv;
  *u = dyadic(a, n.du + log2Nu), *v = dyadic(b, n.dv + log2Nv);
}

void dicePositions(const Surface& surface, const RootBorders& borders, const Surface& planSurface,
                   const RootBorders& planBorders, const DiceRate& rate, std::span<const NodeRect> path,
                   const DicePlan& plan, float* xyz, size_t rowStride) {
  const NodeRect& n = path.back();
  const int nu = 1 << plan.log2Nu, nv = 1 << plan.log2Nv;
  const GridParameters g = gridParameters(n, plan.log2Nu, plan.log2Nv);
  surface.grid(nu, g.u, nv, g.v, xyz, rowStride);
  diceBorders(surface, borders, planSurface, planBorders, rate, path, plan, xyz, rowStride);
}

void diceBorders(const Surface& surface, const RootBorders& borders, const Surface& planSurface,
                 const RootBorders& planBorders, const DiceRate& rate, std::span<const NodeRect> path,
                 const DicePlan& plan, float* xyz, size_t rowStride) {
  const NodeRect& n = path.back();
  const int nu = 1 << plan.log2Nu, nv = 1 << plan.log2Nv;
  const PositionRule rule(surface, borders, planSurface, planBorders, rate, path);
  const size_t level = path.size() - 1;
  const auto put = [&](int i, int j, const Vec3& p) {
    float* out = xyz + (size_t(j) * rowStride + size_t(i)) * 3;
    out[0] = p.x, out[1] = p.y, out[2] = p.z;
  };
  for (int e = 0; e < 4; ++e) {
    const bool alongU = e == 0 || e == 2;
    const int count = alongU ? nu : nv, log2 = alongU ? plan.log2Nu : plan.log2Nv;
    const int depth = (alongU ? n.du : n.dv) + log2;
    const uint64_t first = uint64_t(alongU ? n.iu : n.iv) << log2;
    const BorderLine b = borderLine(surface, borders, n, e);
    const bool foreign = b.line.surface != &surface;
    const int shift = std::min(32, int(plan.edgeShift[e]));
    Vec3 shown(0);
    uint64_t shownIndex = ~uint64_t(0);
    for (int k = 1; k < count; ++k) {
      const uint64_t index = first + unsigned(k), keptIndex = (index >> shift) << shift;
      if (keptIndex == index && !foreign) continue;
      if (keptIndex != shownIndex) shown = rule.kept(level, e, keptIndex, depth), shownIndex = keptIndex;
      put(alongU ? k : e == 1 ? nu : 0, alongU ? (e == 2 ? nv : 0) : k, shown);
    }
  }
  // Corners: the border whose root interval they lie inside of decides; at the end of both, the root patch's
  // corner.
  for (int c = 0; c < 4; ++c) {
    const int i = c == 1 || c == 2 ? nu : 0, j = c >= 2 ? nv : 0;
    const uint64_t a = (uint64_t(n.iu) << plan.log2Nu) + unsigned(i),
                   b = (uint64_t(n.iv) << plan.log2Nv) + unsigned(j);
    const int da = n.du + plan.log2Nu, db = n.dv + plan.log2Nv;
    const int edgeU = c >= 2 ? 2 : 0, edgeV = i ? 1 : 3;
    const int rootU = n.edgeRootDepth[edgeU], rootV = n.edgeRootDepth[edgeV];
    const bool insideU = a % (uint64_t(1) << (da - rootU)) != 0,
               insideV = b % (uint64_t(1) << (db - rootV)) != 0;
    const uint32_t endU = 1u << n.du, endV = 1u << n.dv;
    const bool uBorder = (n.iu + (i ? 1u : 0u)) % endU == 0, vBorder = (n.iv + (j ? 1u : 0u)) % endV == 0;
    if (insideU) {
      put(i, j, rule.onLine(level, edgeU, a, da));
    } else if (insideV) {
      put(i, j, rule.onLine(level, edgeV, b, db));
    } else if (uBorder && vBorder) {
      put(i, j, rootCorner(surface, borders, c));
    } else {
      put(i, j, rule.kept(level, uBorder ? edgeV : edgeU, uBorder ? b : a, uBorder ? db : da));
    }
  }
}

float estimateTrueDeviation(const Surface& surface, const GridParameters& g, const float* xyz, int nu, int nv,
                            size_t rowStride) {
  const auto at = [&](int i, int j) {
    const float* p = xyz + (size_t(j) * rowStride + size_t(i)) * 3;
    return Vec3(p[0], p[1], p[2]);
  };
  float worst = 0;
  const int su = std::max(1, nu / 4), sv = std::max(1, nv / 4);
  for (int j = sv / 2; j < nv; j += sv) {
    float u[kMaxGridSide], x[kMaxGridSide], y[kMaxGridSide], z[kMaxGridSide];
    size_t n = 0;
    for (int i = su / 2; i < nu; i += su) u[n++] = 0.5f * (g.u[i] + g.u[i + 1]);
    float* const P[3] = {x, y, z};
    surface.row(0.5f * (g.v[j] + g.v[j + 1]), n, u, P);
    size_t k = 0;
    for (int i = su / 2; i < nu; i += su, ++k) {
      const Vec3 a = at(i, j), b = at(i + 1, j), c = at(i, j + 1), d = at(i + 1, j + 1);
      const Vec3 center = ((a + d) + (b + c)) * 0.25f;
      const Vec3 t = (a + d) - (b + c);
      worst = std::max(worst, distanceOf(Vec3(x[k], y[k], z[k]) - center) + 0.25f * distanceOf(t));
    }
  }
  return worst;
}

}  // namespace fr::cache
