#include "scene_cache/nurbs.h"

#include <algorithm>
#include <cmath>

namespace fr::cache {

std::vector<NurbsSpan> nurbsSpans(std::span<const float> knots, int order, float min, float max) {
  std::vector<NurbsSpan> spans;
  const size_t p = size_t(order) - 1, n = knots.size() - size_t(order);
  const double low = double(min), high = double(max), range = high - low;
  for (size_t k = p; k < n; ++k) {
    const double a = double(knots[k]), b = double(knots[k + 1]);
    if (!(b > a)) continue;
    NurbsSpan s{};
    s.low = std::max(a, low), s.high = std::min(b, high);
    if (!(s.high > s.low)) continue;
    s.segment = uint32_t(k - p);
    s.segLow = float((s.low - a) / (b - a)), s.segHigh = float((s.high - a) / (b - a));
    s.unitLow = float((s.low - low) / range), s.unitHigh = float((s.high - low) / range);
    spans.push_back(s);
  }
  return spans;
}

namespace {

/// The blossom of one span: `arguments` are degree numbers. d: order x width scratch, holding the control
/// values.
void blossom(std::span<const float> knots, size_t p, size_t k, const double* arguments, size_t width,
             double* d) {
  for (size_t r = 1; r <= p; ++r) {
    const double x = arguments[r - 1];
    for (size_t i = p; i >= r; --i) {
      const double t0 = double(knots[i + k - p]), t1 = double(knots[i + 1 + k - r]);
      const double alpha = (x - t0) / (t1 - t0);  // the interval [k, k + 1] lies between: not 0
      for (size_t c = 0; c < width; ++c)
        d[i * width + c] = (1 - alpha) * d[(i - 1) * width + c] + alpha * d[i * width + c];
    }
  }
}

}  // namespace

std::vector<double> bezierPieces(std::span<const float> knots, int order, std::span<const NurbsSpan> spans,
                                 const double* values, size_t width, size_t stride) {
  const size_t p = size_t(order) - 1, out = size_t(std::max(order, 4));
  std::vector<double> pieces(spans.size() * out * width);
  std::vector<double> d(size_t(order) * width), arguments(p), raised(out * width);
  std::vector<double> piece(out * width);
  for (size_t s = 0; s < spans.size(); ++s) {
    const NurbsSpan& span = spans[s];
    const size_t k = span.segment + p;
    for (size_t j = 0; j <= p; ++j) {
      for (size_t i = 0; i <= p; ++i)
        std::copy_n(values + (span.segment + i) * stride, width, d.begin() + ptrdiff_t(i * width));
      for (size_t i = 0; i < p; ++i) arguments[i] = i < p - j ? span.low : span.high;
      blossom(knots, p, k, arguments.data(), width, d.data());
      std::copy_n(d.begin() + ptrdiff_t(p * width), width, piece.begin() + ptrdiff_t(j * width));
    }
    if (s > 0 && spans[s - 1].high == span.low) {
      const auto same = std::equal_range(knots.begin(), knots.end(), float(span.low));
      if (same.second - same.first < order) {
        const double* end = pieces.data() + (s * out - 1) * width;
        std::copy_n(end, width, piece.begin());
      }
    }
    // Raise the degree: the same curve with one more control point.
    for (size_t have = size_t(order); have < out; ++have) {
      for (size_t i = 0; i <= have; ++i) {
        const double a = double(i) / double(have);
        for (size_t c = 0; c < width; ++c)
          raised[i * width + c] = i == 0 ? piece[c]
                                  : i == have
                                      ? piece[(have - 1) * width + c]
                                      : a * piece[(i - 1) * width + c] + (1 - a) * piece[i * width + c];
      }
      std::copy_n(raised.begin(), (have + 1) * width, piece.begin());
    }
    std::copy_n(piece.begin(), out * width, pieces.begin() + ptrdiff_t(s * out * width));
  }
  return pieces;
}

void bezierPiecePoint(const double* points, int order, size_t width, double t, double* out) {
  double d[kMaxBezierOrder * 4];
  width = std::min<size_t>(width, 4);
  const int n = std::min(order, int(kMaxBezierOrder));
  std::copy_n(points, size_t(n) * width, d);
  for (int r = n - 1; r > 0; --r) {
    for (size_t i = 0; i < size_t(r) * width; ++i) d[i] = (1 - t) * d[i] + t * d[i + width];
  }
  std::copy_n(d, width, out);
}

}  // namespace fr::cache
