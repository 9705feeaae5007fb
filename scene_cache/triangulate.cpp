#include "scene_cache/triangulate.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace fr::cache {
namespace {

struct Flat {
  double x, y;
};
double cross(const Flat& o, const Flat& a, const Flat& b) {
  return (a.x - o.x) * (b.y - o.y) - (a.y - o.y) * (b.x - o.x);
}
bool same(const Flat& a, const Flat& b) { return a.x == b.x && a.y == b.y; }

/// Inside or on the border of the counterclockwise triangle a b c.
bool inside(const Flat& p, const Flat& a, const Flat& b, const Flat& c) {
  return cross(a, b, p) >= 0 && cross(b, c, p) >= 0 && cross(c, a, p) >= 0;
}

double area(const std::vector<Flat>& p, std::span<const uint32_t> loop) {
  double sum = 0;
  for (size_t i = 0; i < loop.size(); ++i) {
    const Flat& a = p[loop[i]];
    const Flat& b = p[loop[(i + 1) % loop.size()]];
    sum += a.x * b.y - a.y * b.x;
  }
  return sum;
}

/// Joins a hole to the outer loop by a bridge from its rightmost vertex to one that it can see.
void joinHole(const std::vector<Flat>& p, std::vector<uint32_t>& outer, std::span<const uint32_t> hole) {
  size_t start = 0;
  for (size_t i = 1; i < hole.size(); ++i) {
    if (p[hole[i]].x > p[hole[start]].x) start = i;
  }
  const Flat m = p[hole[start]];
  // The nearest edge that a ray to the right meets; of its ends the right one.
  double nearest = std::numeric_limits<double>::infinity();
  size_t bridge = outer.size();
  for (size_t i = 0; i < outer.size(); ++i) {
    const size_t next = (i + 1) % outer.size();
    const Flat &a = p[outer[i]], &b = p[outer[next]];
    if ((a.y > m.y) == (b.y > m.y) && a.y != m.y && b.y != m.y) continue;
    const double x = a.y == b.y ? std::max(a.x, b.x) : a.x + (m.y - a.y) / (b.y - a.y) * (b.x - a.x);
    if (x >= m.x && x < nearest) nearest = x, bridge = a.x > b.x ? i : next;
  }
  if (bridge == outer.size()) {
    // The hole lies outside: join it anywhere.
    bridge = 0;
  } else {
    // A vertex inside the triangle (m, hit, bridge) would block the bridge: take the one nearest to the ray's
    // direction.
    const Flat hit{nearest, m.y}, q = p[outer[bridge]];
    double best = std::numeric_limits<double>::infinity();
    const bool up = q.y > m.y;
    for (size_t i = 0; i < outer.size(); ++i) {
      const Flat& r = p[outer[i]];
      if (same(r, q) || r.x < m.x) continue;
      const bool in = up ? inside(r, m, hit, q) : inside(r, m, q, hit);
      if (!in) continue;
      const double dx = r.x - m.x, dy = std::abs(r.y - m.y);
      const double slope = dx > 0 ? dy / dx : (dy > 0 ? 1e300 : 0);
      if (slope < best) best = slope, bridge = i;
    }
  }
  std::vector<uint32_t> joined;
  joined.reserve(outer.size() + hole.size() + 2);
  joined.insert(joined.end(), outer.begin(), outer.begin() + ptrdiff_t(bridge) + 1);
  for (size_t i = 0; i <= hole.size(); ++i) joined.push_back(hole[(start + i) % hole.size()]);
  joined.insert(joined.end(), outer.begin() + ptrdiff_t(bridge), outer.end());
  outer = std::move(joined);
}

}  // namespace

DVec3 newellNormal(std::span<const DVec3> loop) {
  DVec3 n(0);
  // Around the first point, so that a small face far from the origin keeps its digits.
  for (size_t i = 1; i + 1 < loop.size(); ++i) n += glm::cross(loop[i] - loop[0], loop[i + 1] - loop[0]);
  return n;
}

std::vector<uint32_t> triangulate(std::span<const DVec3> points, std::span<const uint32_t> loopSizes) {
  std::vector<uint32_t> result;
  if (loopSizes.empty() || points.size() < 3) return result;
  const size_t outerSize = std::min<size_t>(loopSizes[0], points.size());
  const DVec3 n = newellNormal(points.first(outerSize));
  // Onto the plane's best axes, counterclockwise.
  const DVec3 size = glm::abs(n);
  const int axis = size.x > size.y ? (size.x > size.z ? 0 : 2) : (size.y > size.z ? 1 : 2);
  const int ax = (axis + 1) % 3, ay = (axis + 2) % 3;
  const double flip = n[axis] < 0 ? -1 : 1;
  std::vector<Flat> p(points.size());
  for (size_t i = 0; i < points.size(); ++i)
    p[i] = {points[i][ax] - points[0][ax], flip * (points[i][ay] - points[0][ay])};

  std::vector<uint32_t> loop(outerSize);
  std::iota(loop.begin(), loop.end(), 0u);
  std::vector<std::vector<uint32_t>> holes;
  size_t first = outerSize;
  for (size_t k = 1; k < loopSizes.size() && first < points.size(); ++k) {
    std::vector<uint32_t> h(std::min<size_t>(loopSizes[k], points.size() - first));
    std::iota(h.begin(), h.end(), uint32_t(first));
    first += h.size();
    if (h.empty()) continue;
    if (area(p, h) > 0) std::reverse(h.begin(), h.end());  // holes run the other way
    holes.push_back(std::move(h));
  }
  const auto rightmost = [&p](const std::vector<uint32_t>& h) {
    double x = -std::numeric_limits<double>::infinity();
    for (const uint32_t i : h) x = std::max(x, p[i].x);
    return x;
  };
  std::sort(holes.begin(), holes.end(),
            [&](const auto& a, const auto& b) { return rightmost(a) > rightmost(b); });
  for (const auto& h : holes) joinHole(p, loop, h);

  // Ears from a ring; only reflex vertices can lie in an ear.
  const size_t count = loop.size();
  if (count < 3) return result;
  std::vector<uint32_t> next(count), last(count);
  for (size_t i = 0; i < count; ++i)
    next[i] = uint32_t((i + 1) % count), last[i] = uint32_t((i + count - 1) % count);
  const auto at = [&](uint32_t i) -> const Flat& { return p[loop[i]]; };
  const auto turn = [&](uint32_t i) { return cross(at(last[i]), at(i), at(next[i])); };
  std::vector<uint32_t> reflex;
  for (uint32_t i = 0; i < count; ++i) {
    if (turn(i) <= 0) reflex.push_back(i);
  }
  const auto isEar = [&](uint32_t i) {
    if (turn(i) <= 0) return false;
    const Flat &a = at(last[i]), &b = at(i), &c = at(next[i]);
    for (const uint32_t r : reflex) {
      if (r == last[i] || r == i || r == next[i]) continue;
      const Flat& q = at(r);
      if (same(q, a) || same(q, b) || same(q, c)) continue;
      if (inside(q, a, b, c)) return false;
    }
    return true;
  };
  result.reserve((count - 2) * 3);
  uint32_t i = 0;
  size_t left = count, failures = 0;
  while (left > 3) {
    // After a round without an ear the loop crosses itself or has no area: cut anything.
    if (failures <= left && !isEar(i)) {
      i = next[i], ++failures;
      continue;
    }
    result.insert(result.end(), {loop[last[i]], loop[i], loop[next[i]]});
    next[last[i]] = next[i], last[next[i]] = last[i];
    std::erase_if(reflex,
                  [&](uint32_t r) { return r == i || ((r == last[i] || r == next[i]) && turn(r) > 0); });
    if (failures > left)
      failures = left;  // one cut, then look for ears again for a step
    else
      failures = 0;
    i = next[next[i]];
    --left;
  }
  result.insert(result.end(), {loop[last[i]], loop[i], loop[next[i]]});
  return result;
}

}  // namespace fr::cache
