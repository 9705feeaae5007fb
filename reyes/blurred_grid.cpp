#include "reyes/blurred_grid.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace fr::reyes {
namespace {

/// Keys at which both a grid of `grid` and a camera of `camera` keys have theirs.
int commonKeys(int grid, int camera) {
  const int a = std::max(1, grid - 1), b = std::max(1, camera - 1);
  const int all = std::lcm(a, b) + 1;
  return all <= kMaxBlurKeys ? all : std::max(grid, camera);
}

struct ClipPoint {
  double x, y, w, z;  // raster position times w
};

/// Pixels to steps. What is cut at the near plane may reach far beyond the raster, where it need not be
/// exact.
double toSteps(double pixels, int origin) {
  return std::rint(pixels * kSubpixels) - double(origin) * kSubpixels;
}

}  // namespace

BlurFaces BlurredGrid::faces(const ShutterSpace& space, const PixelRect& tile) const {
  BlurFaces f;
  f.xw = xw.data(), f.yw = yw.data(), f.z = z.data();
  f.vertexCount = vertexCount, f.keys = keys;
  f.perspective = space.open().perspective();
  f.lens = space.open().lens();
  f.originX = tile.x0, f.originY = tile.y0;
  f.skip = state.data();
  return f;
}

void projectBlurred(const ShutterSpace& space, const float* positions, int positionKeys, size_t keyStride,
                    int columns, int rows, size_t rowStride, BlurredGrid& out) {
  const RasterSpace& open = space.open();
  const int keys =
      positionKeys < 2 && !space.moves() ? 1 : commonKeys(positionKeys, int(space.keys().size()));
  const size_t n = size_t(columns) * size_t(rows);
  out.keys = keys, out.vertexCount = n;
  for (auto* v : {&out.xw, &out.yw, &out.z}) v->resize(n * size_t(keys));
  for (auto* v : {&out.x0, &out.y0}) v->assign(n, kInfinity);
  for (auto* v : {&out.x1, &out.y1}) v->assign(n, -kInfinity);
  out.state.assign(n, kVertexDrawn);
  float nearest = kInfinity;
  for (int key = 0; key < keys; ++key) {
    const float time = keys > 1 ? float(key) / float(keys - 1) : 0;
    float weight = 0;
    const int a = positionKeys > 1 ? blurKey(positionKeys, time, &weight) : 0;
    const float* from = positions + size_t(a) * keyStride;
    const float* to = positionKeys > 1 ? from + keyStride : from;
    size_t i = 0;
    for (int row = 0; row < rows; ++row)
      for (int column = 0; column < columns; ++column, ++i) {
        const size_t at = (size_t(row) * rowStride + size_t(column)) * 3;
        const Vec3 p0(from[at], from[at + 1], from[at + 2]), p1(to[at], to[at + 1], to[at + 2]);
        const Vec4 h = space.homogeneous(weight > 0 ? p0 + weight * (p1 - p0) : p0, time);
        const size_t k = size_t(key) * n + i;
        out.xw[k] = h.x, out.yw[k] = h.y, out.z[k] = h.w;
        if (!std::isfinite(h.x) || !std::isfinite(h.y) || !std::isfinite(h.w)) {
          out.state[i] = kVertexInvalid;
          continue;
        }
        if (h.w < open.near()) {
          out.state[i] |= kVertexClipped;
          continue;
        }
        const float x = h.x / h.z, y = h.y / h.z, depthKey = open.key(h.w);
        const float shiftX = std::abs(open.lens().x(1, depthKey)),
                    shiftY = std::abs(open.lens().y(1, depthKey));
        out.x0[i] = std::min(out.x0[i], x - shiftX), out.x1[i] = std::max(out.x1[i], x + shiftX);
        out.y0[i] = std::min(out.y0[i], y - shiftY), out.y1[i] = std::max(out.y1[i], y + shiftY);
        nearest = std::min(nearest, depthKey);
      }
  }
  out.anyClipped = false;
  bool unbounded = false;
  RasterBounds b{kInfinity, kInfinity, -kInfinity, -kInfinity, 0, false};
  for (size_t i = 0; i < n; ++i) {
    if (out.state[i] & kVertexInvalid) {
      out.anyClipped = true;
      continue;
    }
    if (!(out.x0[i] > -kGuardBand && out.x1[i] < kGuardBand && out.y0[i] > -kGuardBand &&
          out.y1[i] < kGuardBand))
      out.state[i] |= kVertexClipped;
    unbounded |= out.state[i] != kVertexDrawn;
    b.x0 = std::min(b.x0, out.x0[i]), b.x1 = std::max(b.x1, out.x1[i]);
    b.y0 = std::min(b.y0, out.y0[i]), b.y1 = std::max(b.y1, out.y1[i]);
  }
  out.anyClipped |= unbounded;
  if (unbounded) {
    out.bounds = {-kInfinity, -kInfinity, kInfinity, kInfinity, -kInfinity, false};
    return;
  }
  b.key = nearest - 2e-6f * std::abs(nearest);
  b.outside = b.x0 > b.x1;
  out.bounds = b;
}

PixelBox clippedTriangleBox(const BlurFaces& f, float nearDepth, const uint32_t v[3], int columns, int rows) {
  // What moves straight from one key to the next stays within the hull of both triangles. Before the near
  // plane, the hull ends at the plane: its corners there lie between any two of the six that it separates.
  const double near = nearDepth;
  double low[2] = {HUGE_VAL, HUGE_VAL}, high[2] = {-HUGE_VAL, -HUGE_VAL};
  const size_t segments = f.keys > 1 ? size_t(f.keys - 1) : 1;
  for (size_t k = 0; k < segments; ++k)
    for (int side = -1; side <= 1; side += 2) {  // ends of the lens
      double position[2][6], z[6];
      int n = 0;
      for (size_t key = k; key <= k + (f.keys > 1 ? 1 : 0); ++key)
        for (int i = 0; i < 3; ++i, ++n) {
          const size_t at = key * f.vertexCount + v[i];
          z[n] = double(f.z[at]);
          const double w = f.perspective ? z[n] : 1.0;
          const double x1 = f.perspective ? -double(f.lens.x1) : double(f.lens.x1) * z[n];
          const double y1 = f.perspective ? -double(f.lens.y1) : double(f.lens.y1) * z[n];
          position[0][n] = double(f.xw[at]) + side * (double(f.lens.x0) * w + x1);
          position[1][n] = double(f.yw[at]) + side * (double(f.lens.y0) * w + y1);
        }
      const auto extend = [&](int axis, double p, double depth) {
        const double raster = f.perspective ? p / depth : p;
        low[axis] = std::min(low[axis], raster), high[axis] = std::max(high[axis], raster);
      };
      for (int axis = 0; axis < 2; ++axis)
        for (int a = 0; a < n; ++a) {
          if (z[a] >= near) extend(axis, position[axis][a], z[a]);
          for (int b = a + 1; b < n; ++b) {
            if ((z[a] >= near) == (z[b] >= near)) continue;
            const double t = (z[a] - near) / (z[a] - z[b]);
            extend(axis, position[axis][a] + t * (position[axis][b] - position[axis][a]), near);
          }
        }
    }
  if (!(low[0] <= high[0] && low[1] <= high[1])) return {0, 0, -1, -1};
  const auto pixel = [](double at, int origin, int count) {
    return int(std::clamp(std::floor(at - origin), -1.0, double(count)));
  };
  // Positions are rounded to steps, and by their size.
  const auto slack = [](double at) { return 2.0 / kSubpixels + 1e-6 * std::abs(at); };
  return {std::max(0, pixel(low[0] - slack(low[0]), f.originX, columns)),
          std::max(0, pixel(low[1] - slack(low[1]), f.originY, rows)),
          std::min(columns - 1, pixel(high[0] + slack(high[0]), f.originX, columns)),
          std::min(rows - 1, pixel(high[1] + slack(high[1]), f.originY, rows))};
}

bool seesClippedTriangle(const BlurFaces& f, float nearDepth, const uint32_t v[3], int32_t px, int32_t py,
                         float time, float lensX, float lensY, float* key) {
  ClipPoint a[5], b[5];
  float weight = 0;
  const size_t k = f.keys > 1 ? size_t(blurKey(f.keys, time, &weight)) : 0;
  for (int i = 0; i < 3; ++i) {
    const size_t from = k * f.vertexCount + v[i], to = f.keys > 1 ? from + f.vertexCount : from;
    const auto blend = [&](const float* values) {
      return double(values[from] + weight * (values[to] - values[from]));
    };
    const double z = blend(f.z), w = f.perspective ? z : 1.0;
    // The lens' shift times w: in perspective (s0 + s1 * -1/z) z.
    const double x1 = f.perspective ? -double(f.lens.x1) : double(f.lens.x1) * z;
    const double y1 = f.perspective ? -double(f.lens.y1) : double(f.lens.y1) * z;
    a[i] = {blend(f.xw) + double(lensX) * (double(f.lens.x0) * w + x1),
            blend(f.yw) + double(lensY) * (double(f.lens.y0) * w + y1), w, z};
  }
  // Cut at the near plane: at most four corners are left.
  int n = 0;
  const double near = nearDepth;
  for (int i = 0; i < 3; ++i) {
    const ClipPoint &p = a[i], &q = a[(i + 1) % 3];
    const double dp = p.z - near, dq = q.z - near;
    if (dp >= 0) b[n++] = p;
    if ((dp >= 0) == (dq >= 0)) continue;
    const bool swap = dq >= 0;  // in one order, so that neighbours get the same bits
    const ClipPoint &in = swap ? q : p, &out = swap ? p : q;
    const double t = (in.z - near) / (in.z - out.z);
    b[n++] = {in.x + t * (out.x - in.x), in.y + t * (out.y - in.y), in.w + t * (out.w - in.w), near};
  }
  for (int i = 2; i < n; ++i) {
    const ClipPoint* corner[3] = {&b[0], &b[i - 1], &b[i]};
    double x[3], y[3], depth[3];
    for (int c = 0; c < 3; ++c) {
      x[c] = toSteps(corner[c]->x / corner[c]->w, f.originX);
      y[c] = toSteps(corner[c]->y / corner[c]->w, f.originY);
      depth[c] = f.perspective ? -1 / corner[c]->z : corner[c]->z;
    }
    double area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0]);
    if (area == 0 || (area < 0 ? f.cullSign < 0 : f.cullSign > 0)) continue;
    if (area < 0) std::swap(x[1], x[2]), std::swap(y[1], y[2]), std::swap(depth[1], depth[2]), area = -area;
    bool inside = true;
    double w[3];
    for (int e = 0; e < 3; ++e) {
      const double dx = x[(e + 1) % 3] - x[e], dy = y[(e + 1) % 3] - y[e];
      w[e] = dx * (py - y[e]) - dy * (px - x[e]);
      const bool owns = dy > 0 || (dy == 0 && dx < 0);
      inside = inside && w[e] >= (owns ? 0 : 1);
    }
    if (!inside) continue;
    *key = float(depth[0] + (w[2] * (depth[1] - depth[0]) + w[0] * (depth[2] - depth[0])) / area);
    return true;
  }
  return false;
}

}  // namespace fr::reyes
