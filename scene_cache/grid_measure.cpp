// By rows, each coordinate in an array of its own: loops that compilers turn into vector instructions.
#include "scene_cache/grid_measure.h"

#include <algorithm>
#include <cmath>

namespace fr::cache {
namespace {

constexpr int kSide = kMaxGridSide + 1;
/// Rows of vertices of all rows of cells at stride 2, which has the most.
constexpr int kMostRows = kMaxGridSide / 2 * 3;

/// Squared distance from a point to a triangle (Ericson, "Real-Time Collision Detection", 5.1.5).
float squareToTriangle(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
  const auto square = [](const Vec3& v) { return glm::dot(v, v); };
  const auto toSegment = [&](const Vec3& s, const Vec3& e) {
    const Vec3 d = e - s;
    const float length = square(d);
    const float t = length > 0 ? std::clamp(glm::dot(p - s, d) / length, 0.0f, 1.0f) : 0.0f;
    return square(p - s - d * t);
  };
  const Vec3 ab = b - a, ac = c - a, n = glm::cross(ab, ac);
  const float area = square(n);
  if (area > 0) {
    const Vec3 ap = p - a;
    const float v = glm::dot(glm::cross(ap, ac), n), w = glm::dot(glm::cross(ab, ap), n);
    if (v >= 0 && w >= 0 && v + w <= area) {
      const float d = glm::dot(ap, n);
      return d * d / area;
    }
  }
  return std::min({toSegment(a, b), toSegment(b, c), toSegment(c, a)});
}

/// A grid's coordinates, row after row.
struct Columns {
  float x[kSide][kSide], y[kSide][kSide], z[kSide][kSide];
  Vec3 at(int i, int j) const { return {x[j][i], y[j][i], z[j][i]}; }
};

/// One row of a coarser surface: values between every k-th column, drawn from rows of the fine one.
struct CoarseRow {
  float left[kSide], right[kSide];
  /// Weight fv between rows `low` and `high`.
  void set(const float* low, const float* high, float fv, int nu, int k) {
    const float w = 1 - fv;
    for (int i = 0; i < nu; i += k) {
      const float a = low[i] * w + high[i] * fv, b = low[i + k] * w + high[i + k] * fv;
      for (int x = 0; x < k; ++x) left[i + x] = a, right[i + x] = b;
    }
    left[nu] = right[nu] = low[nu] * w + high[nu] * fv;
  }
};

}  // namespace

void measureGrid(const float* xyz, int nu, int nv, size_t rowStride, int levels, float deviation[kLevels],
                 float* cellSize, Box3f* bound) {
  Columns p;
  for (int j = 0; j <= nv; ++j) {
    const float* row = xyz + size_t(j) * rowStride * 3;
    for (int i = 0; i <= nu; ++i)
      p.x[j][i] = row[3 * i], p.y[j][i] = row[3 * i + 1], p.z[j][i] = row[3 * i + 2];
  }
  for (int j = 0; j <= nv; ++j)
    for (int i = 0; i <= nu; ++i) bound->extend(p.at(i, j));
  float longest = 0;
  for (int j = 0; j < nv; ++j) {
    float square[kSide];
    for (int i = 0; i < nu; ++i) {
      const float dx = p.x[j + 1][i + 1] - p.x[j][i], dy = p.y[j + 1][i + 1] - p.y[j][i],
                  dz = p.z[j + 1][i + 1] - p.z[j][i];
      const float ex = p.x[j][i + 1] - p.x[j + 1][i], ey = p.y[j][i + 1] - p.y[j + 1][i],
                  ez = p.z[j][i + 1] - p.z[j + 1][i];
      const float d = dx * dx + dy * dy + dz * dz, e = ex * ex + ey * ey + ez * ez;
      square[i] = d > e ? d : e;
    }
    for (int i = 0; i < nu; ++i) longest = std::max(longest, square[i]);
  }
  *cellSize = std::max(*cellSize, std::sqrt(longest));
  // Nothing smaller can be told from the rounding of coordinates.
  const Vec3 size = glm::max(glm::abs(bound->min), glm::abs(bound->max));
  const float rounding = 0x1p-24f * std::max({size.x, size.y, size.z});
  for (int level = 1; level < levels; ++level) {
    const int k = 1 << level;
    const float step = 1.0f / float(k);
    float along[kSide];
    for (int i = 0; i <= nu; ++i) along[i] = float(i & (k - 1)) * step;
    // How far vertices are from bilinear cells; a row of cells has k + 1 rows of vertices.
    float square[kMostRows][kSide], twist[kSide][kSide];
    int rows = 0;
    for (int j = 0; j < nv; j += k) {
      // A cell is traced as two triangles, at most a quarter of its twist from the bilinear cell.
      for (int i = 0; i < nu; i += k) {
        const Vec3 t = (p.at(i, j) + p.at(i + k, j + k)) - (p.at(i + k, j) + p.at(i, j + k));
        const float quarter = 0.25f * std::sqrt(glm::dot(t, t));
        for (int x = 0; x < k; ++x) twist[j][i + x] = quarter;
      }
      twist[j][nu] = twist[j][nu - 1];
      for (int y = 0; y <= k; ++y, ++rows) {
        const float fv = float(y) * step;
        CoarseRow x, yy, z;
        x.set(p.x[j], p.x[j + k], fv, nu, k), yy.set(p.y[j], p.y[j + k], fv, nu, k);
        z.set(p.z[j], p.z[j + k], fv, nu, k);
        for (int i = 0; i <= nu; ++i) {
          const float w = 1 - along[i];
          const float ex = p.x[j + y][i] - (x.left[i] * w + x.right[i] * along[i]);
          const float ey = p.y[j + y][i] - (yy.left[i] * w + yy.right[i] * along[i]);
          const float ez = p.z[j + y][i] - (z.left[i] * w + z.right[i] * along[i]);
          square[rows][i] = ex * ex + ey * ey + ez * ez;
        }
      }
    }
    // Collapsed border vertices slide along the surface, which is no deviation: the exact distance decides.
    // From the triangle where the vertex should be; the other one is looked at only if that is too far.
    float worst = rounding;
    const auto look = [&](int row, int i) {
      const int y = row % (k + 1), j = row / (k + 1) * k, first = std::min(i & ~(k - 1), nu - k);
      const Vec3 a = p.at(first, j), b = p.at(first + k, j), c = p.at(first, j + k),
                 d = p.at(first + k, j + k);
      const Vec3 at = p.at(i, j + y);
      const bool lower = i - first + y <= k;
      const float own = lower ? squareToTriangle(at, a, b, c) : squareToTriangle(at, d, c, b);
      if (own <= worst * worst) return;
      const float other = lower ? squareToTriangle(at, d, c, b) : squareToTriangle(at, a, b, c);
      worst = std::max(worst, std::sqrt(std::min(own, other)));
    };
    // The vertex that seems farthest first: few others can then be farther.
    float most[kMostRows] = {};
    for (int row = 0; row < rows; ++row)
      for (int i = 0; i <= nu; ++i) most[row] = square[row][i] > most[row] ? square[row][i] : most[row];
    const int mostRow = int(std::max_element(most, most + rows) - most);
    const int mostColumn = int(std::max_element(square[mostRow], square[mostRow] + nu + 1) - square[mostRow]);
    look(mostRow, mostColumn);
    for (int row = 0; row < rows; ++row) {
      const float* const mayTwist = twist[row / (k + 1) * k];
      for (int i = 0; i <= nu; ++i) {
        const float enough = std::max(0.0f, worst - mayTwist[i]);
        if (square[row][i] > enough * enough) look(row, i);
      }
    }
    deviation[level] = std::max(deviation[level], worst);
  }
}

}  // namespace fr::cache
