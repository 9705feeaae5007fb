#include "shading/area_light.h"

#include <algorithm>
#include <cmath>

#include "scene_cache/primitive_source.h"

namespace fr {

using namespace cache;

namespace {

constexpr float kTau = 6.2831853f;

/// First element of an ascending run that lies above x, and where x stands between it and the one before.
template <class T>
uint32_t pick(const T* ends, uint32_t count, double x, float& rest) {
  const T* at = std::upper_bound(ends, ends + count, T(x), [](T a, T b) { return a < b; });
  if (at == ends + count) --at;
  const double low = at == ends ? 0.0 : double(at[-1]);
  const double width = double(*at) - low;
  rest = width > 0 ? std::clamp(float((x - low) / width), 0.0f, 0x1.fffffep-1f) : 0.5f;
  return uint32_t(at - ends);
}

Vec3 unitOrZero(const Vec3& v) {
  const float length = glm::length(v);
  return length > 0 && std::isfinite(length) ? v / length : Vec3(0);
}

/// Two directions perpendicular to the unit vector n and each other (Duff et al. 2017, JCGT 6(1)).
void basis(const Vec3& n, Vec3& x, Vec3& y) {
  const float sign = std::copysign(1.0f, n.z);
  const float a = -1.0f / (sign + n.z), b = n.x * n.y * a;
  x = {1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x};
  y = {b, sign + n.y * n.y * a, -n.y};
}

}  // namespace

AreaLight::AreaLight(SceneCache& scene, const SceneHost& host, ShaderId light)
    : scene_(scene), host_(host), light_(light) {}

bool AreaLight::ready() const {
  std::call_once(once_, [this] { const_cast<AreaLight*>(this)->build(); });
  return isBall_ || !cells_.empty();
}

void AreaLight::build() {
  const Skeleton& skeleton = scene_.skeleton();
  std::vector<const ObjectRecord*> objects;
  for (const ObjectRecord& o : skeleton.objects())
    if (o.attributes < skeleton.attributes().size() &&
        skeleton.attributes()[o.attributes].areaLight == light_ + 1)
      objects.push_back(&o);
  if (objects.size() == 1 && asBall(*objects[0], ball_)) {
    isBall_ = true;
    area_ = 2.0 * double(kTau) * double(ball_.radius) * double(ball_.radius);
  }
  for (const ObjectRecord* o : objects) {
    const bool reversed = skeleton.attributes()[o->attributes].flags & kReverseInCacheSpace;
    for (uint32_t p = 0; p < o->patchCount; ++p) {
      std::vector<NodeId> todo{o->firstPatch + p};
      while (!todo.empty()) {
        const ResolvedNode r = scene_.resolve(todo.back());
        todo.pop_back();
        if (r.state == NodeState::kSplit) todo.push_back(r.children[1]), todo.push_back(r.children[0]);
        if (r.state == NodeState::kGrid && r.grid) addGrid(*r.grid, reversed);
      }
    }
  }
  if (!isBall_ && !patches_.empty()) area_ = patches_.back().end;
}

/// A whole, round, unmoved sphere.
bool AreaLight::asBall(const ObjectRecord& object, Ball& ball) const {
  const Skeleton& skeleton = scene_.skeleton();
  if (object.type != PrimitiveType::kSphere || object.keyCount != 1 || object.patchCount == 0 ||
      (skeleton.attributes()[object.attributes].displacement != kNone ||
       skeleton.attributes()[object.attributes].deformation != 0))
    return false;
  const DMat3 linear(host_.transformToCurrent(object.transform));
  const double scale = glm::length(linear[0]);
  for (int c = 0; c < 3; ++c)
    if (std::fabs(glm::length(linear[c]) - scale) > 1e-4 * scale ||
        std::fabs(glm::dot(linear[c], linear[(c + 1) % 3])) > 1e-4 * scale * scale)
      return false;
  // Its ends and its middle, by what it looks like: a cut sphere has other ones.
  Vec3 P[5], N[5];
  const float u[5] = {0.0f, 0.0f, 0.0f, 0.5f, 1.0f}, v[5] = {0.0f, 1.0f, 0.5f, 0.5f, 0.5f};
  const uint32_t cell[5] = {kNone, kNone, kNone, kNone, kNone};
  const Mat4 toCurrent(host_.cacheToCurrent());
  const Mat3 normalToCurrent(normalMatrix(host_.cacheToCurrent()));
  if (object.patchCount > 1) return false;
  for (int i = 0; i < 5; ++i) {
    SurfaceOut out;
    for (int c = 0; c < 3; ++c) out.P[c] = &P[i][c], out.N[c] = &N[i][c];
    scene_.evaluateSurface(object.firstPatch, 1, &cell[i], &u[i], &v[i], out);
    P[i] = transformPoint(toCurrent, P[i]), N[i] = unitOrZero(normalToCurrent * N[i]);
  }
  ball.center = (P[0] + P[1]) * 0.5f;
  ball.radius = glm::length(P[0] - P[1]) * 0.5f;
  const float close = 1e-3f * ball.radius;
  if (!(ball.radius > 0) || !std::isfinite(ball.radius) || glm::length(P[2] - P[4]) > close) return false;
  // Opposite points of the equator, a radius from the middle.
  if (glm::length((P[2] + P[3]) * 0.5f - ball.center) > close ||
      std::fabs(glm::length(P[2] - ball.center) - ball.radius) > close)
    return false;
  ball.inward = glm::dot(N[2], P[2] - ball.center) < 0;
  return true;
}

void AreaLight::addGrid(const GridRecord& grid, bool reversed) {
  if (grid.flags & kGridAbsent) return;
  const GridView view = scene_.view(grid);
  const Mat4 toCurrent(host_.cacheToCurrent());
  const Mat3 normalToCurrent(normalMatrix(host_.cacheToCurrent()));
  const auto vertex = [&](size_t at) { return view.vertex(at); };
  Patch patch{uint32_t(cells_.size()), uint32_t(rowEnds_.size()), 0, 0, 0};
  const auto add = [&](Vec3 a, Vec3 b, Vec3 c, Vec3 d) {
    Cell cell;
    const Vec3 n = glm::cross(d - a, c - b);
    cell.normal = unitOrZero(normalToCurrent * (reversed ? -n : n));
    cell.corner[0] = transformPoint(toCurrent, a), cell.corner[1] = transformPoint(toCurrent, b);
    cell.corner[2] = transformPoint(toCurrent, c), cell.corner[3] = transformPoint(toCurrent, d);
    cell.area =
        0.5f * (glm::length(glm::cross(cell.corner[1] - cell.corner[0], cell.corner[2] - cell.corner[0])) +
                glm::length(glm::cross(cell.corner[1] - cell.corner[3], cell.corner[2] - cell.corner[3])));
    if (!std::isfinite(cell.area)) cell.area = 0;
    cells_.push_back(cell);
  };
  if (grid.kind == GridKind::kMeshlet) {
    for (uint32_t t = 0; t < grid.nv; ++t) {
      const uint8_t* i = view.indices + 3 * t;
      if (std::max({i[0], i[1], i[2]}) >= grid.nu) continue;
      const Vec3 a = vertex(i[0]), b = vertex(i[1]), c = vertex(i[2]);
      add(a, b, c, c);
      cells_.back().normal =
          unitOrZero(normalToCurrent * (glm::cross(b - a, c - a) * (reversed ? -1.0f : 1.0f)));
    }
    patch.columns = uint32_t(cells_.size()) - patch.firstCell, patch.rows = 1;
  } else {
    for (uint32_t j = 0; j < grid.nv; ++j)
      for (uint32_t i = 0; i < grid.nu; ++i) {
        const size_t at = size_t(j) * grid.rowStride + i;
        add(vertex(at), vertex(at + 1), vertex(at + grid.rowStride), vertex(at + grid.rowStride + 1));
      }
    patch.columns = grid.nu, patch.rows = grid.nv;
  }
  finishPatch(patch);
}

void AreaLight::finishPatch(Patch p) {
  double all = 0;
  cellEnds_.resize(cells_.size());
  for (uint32_t j = 0; j < p.rows; ++j) {
    double row = 0;
    for (uint32_t i = 0; i < p.columns; ++i) {
      const uint32_t k = p.firstCell + j * p.columns + i;
      row += double(cells_[k].area);
      cellEnds_[k] = float(row);
    }
    all += row;
    rowEnds_.push_back(float(all));
  }
  p.end = (patches_.empty() ? 0.0 : patches_.back().end) + all;
  if (all > 0) {
    patches_.push_back(p);
  } else {
    cells_.resize(p.firstCell), cellEnds_.resize(p.firstCell), rowEnds_.resize(p.firstRow);
  }
}

/// The first number chooses the patch and the column, the second the row: for a light of one patch,
/// stratified numbers are stratified points.
void AreaLight::sampleCells(const Vec2& xi, Vec3& P, Vec3& N) const {
  float x = xi.x, y = xi.y;
  const double wanted = double(x) * patches_.back().end;
  const auto at = std::upper_bound(patches_.begin(), patches_.end(), wanted,
                                   [](double a, const Patch& p) { return a < p.end; });
  const Patch& p = at == patches_.end() ? patches_.back() : *at;
  const double low = &p == patches_.data() ? 0.0 : (&p)[-1].end;
  x = std::clamp(float((wanted - low) / (p.end - low)), 0.0f, 0x1.fffffep-1f);
  const float* rows = rowEnds_.data() + p.firstRow;
  const uint32_t row = pick(rows, p.rows, double(y) * double(rows[p.rows - 1]), y);
  const float* columns = cellEnds_.data() + p.firstCell + size_t(row) * p.columns;
  const uint32_t column = pick(columns, p.columns, double(x) * double(columns[p.columns - 1]), x);
  const Cell& cell = cells_[p.firstCell + size_t(row) * p.columns + column];
  N = cell.normal;
  const Vec3 *a = &cell.corner[0], *b = &cell.corner[1], *c = &cell.corner[2];
  const float first = 0.5f * glm::length(glm::cross(*b - *a, *c - *a));
  const float share = cell.area > 0 ? std::min(1.0f, first / cell.area) : 1.0f;
  if (x < share) {
    x /= share;
  } else {
    x = (x - share) / std::max(1e-12f, 1.0f - share);
    a = &cell.corner[3], std::swap(b, c);
  }
  const float s = std::sqrt(std::clamp(x, 0.0f, 1.0f));
  P = *a * (1.0f - s) + *b * (s * (1.0f - y)) + *c * (s * y);
}

/// False: the point is not outside.
bool AreaLight::sampleBall(const Vec3& from, const Vec2& xi, Vec3& P, Vec3& N, float& factor) const {
  const Vec3 off = ball_.center - from;
  const float r = ball_.radius, d = glm::length(off);
  if (!(d > 1.0001f * r) || !std::isfinite(d)) return false;
  const float sine2 = r * r / (d * d), cosine = std::sqrt(1.0f - sine2);
  const float height = sine2 / (1.0f + cosine);  // 1 - cosine, without cancellation
  const float drop = xi.x * height, z = 1.0f - drop;
  const float rho2 = drop * (2.0f - drop);  // 1 - z^2
  const Vec3 axis = off / d;
  Vec3 x, y;
  basis(axis, x, y);
  const float rho = std::sqrt(rho2), phi = kTau * xi.y;
  const float t = d * z - std::sqrt(std::max(0.0f, r * r - d * d * rho2));
  P = from + (x * (rho * std::cos(phi)) + y * (rho * std::sin(phi)) + axis * z) * t;
  N = (P - ball_.center) / r;
  factor = ball_.inward ? 0.0f : t * t * kTau * height / float(area_);
  if (ball_.inward) N = -N;
  return true;
}

void AreaLight::sample(const EmitterQuery& q) const {
  for (uint32_t i = 0; i < q.lanes; ++i) {
    if (!q.mask[i]) continue;
    const Vec3 from(q.Ps.at(i, 0), q.Ps.at(i, 1), q.Ps.at(i, 2));
    Vec3 P(0), N(0);
    float factor = 0;
    if (!(isBall_ && sampleBall(from, q.xi[i], P, N, factor)) && !cells_.empty()) {
      sampleCells(q.xi[i], P, N);
      factor = std::max(0.0f, glm::dot(unitOrZero(from - P), N));
    }
    for (uint32_t c = 0; c < 3; ++c) q.P.comp(c)[i] = P[int(c)], q.N.comp(c)[i] = N[int(c)];
    q.factor[i] = factor;
  }
}

}  // namespace fr
