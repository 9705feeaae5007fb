#include "tracer/border_stitch.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <atomic>
#include <compare>

#define XXH_INLINE_ALL
#include <xxhash.h>

namespace fr::tracer {
namespace {

enum Edge { kV0, kU1, kV1, kU0 };

/// A vertex by its column and row at stride 1.
struct Place {
  int i, j;
};

const float* vertexAt(const BorderedGrid& g, const Place& p) {
  return g.vertices + 3 * (size_t(p.j) * g.rowStride + size_t(p.i));
}

/// Numbers that are equal as positions are equal as bits.
struct Position {
  float x, y, z;
  explicit Position(const float* p) : x(p[0] + 0.0f), y(p[1] + 0.0f), z(p[2] + 0.0f) {}
  auto operator<=>(const Position&) const = default;
};

/// Where border `edge` has its vertex number k of stride 1.
Place placeOn(const BorderedGrid& g, int edge, int k) {
  const int nu = g.cellsU << g.level, nv = g.cellsV << g.level;
  switch (edge) {
    case kV0:
      return {k, 0};
    case kU1:
      return {nu, k};
    case kV1:
      return {k, nv};
    default:
      return {0, k};
  }
}

int segmentsOf(const BorderedGrid& g, int edge) { return edge == kV0 || edge == kV1 ? g.cellsU : g.cellsV; }

/// A piece of a border, from vertex `from` to `to` of stride 1, by its end points in either order; 0 when it
/// has no length.
uint64_t segmentHash(const BorderedGrid& g, int edge, int from, int to) {
  const Position a(vertexAt(g, placeOn(g, edge, from))), b(vertexAt(g, placeOn(g, edge, to)));
  if (a == b) return 0;
  struct {
    Position low, high;
    uint32_t kind;
  } key{a < b ? a : b, a < b ? b : a, g.kind};
  static_assert(sizeof(key) == 28);
  return XXH3_64bits(&key, sizeof(key));
}
uint64_t coarseHash(const BorderedGrid& g, int edge, int segment) {
  return segmentHash(g, edge, segment << g.level, (segment + 1) << g.level);
}

/// By border, a bit for each vertex of stride 1 that is to be shown, beside those of the coarse stride.
struct Refined {
  uint32_t vertices[4] = {};
  bool any() const { return (vertices[0] | vertices[1] | vertices[2] | vertices[3]) != 0; }
};

uint32_t verticesInside(int from, int to) { return (1u << to) - (2u << from); }

class CellStitcher {
 public:
  CellStitcher(const BorderedGrid& grid, uint32_t index, const Refined& refined, std::vector<StitchQuad>& out)
      : g_(grid), index_(index), refined_(refined), out_(out), step_(1 << grid.level) {}

  void cell(int cu, int cv) {
    count_ = 0;
    const int i = cu * step_, j = cv * step_;
    side(cv == 0 ? refined_.vertices[kV0] : 0, i, {i, j}, 1, 0);
    side(cu == g_.cellsU - 1 ? refined_.vertices[kU1] : 0, j, {i + step_, j}, 0, 1);
    side(cv == g_.cellsV - 1 ? refined_.vertices[kV1] : 0, i + step_, {i + step_, j + step_}, -1, 0);
    side(cu == 0 ? refined_.vertices[kU0] : 0, j + step_, {i, j + step_}, 0, -1);
    if (count_ == 4) return add(outline_[0], outline_[1], outline_[2], outline_[3]);
    // The middle vertex sees all of the outline. Two triangles that share an edge make a quadrilateral.
    const Place middle{i + step_ / 2, j + step_ / 2};
    for (int k = 0; k < count_; k += 2) {
      const Place &a = outline_[k], &b = outline_[k + 1], &c = outline_[(k + 2) % count_];
      k + 1 < count_ ? add(a, b, c, middle) : add(a, outline_[0], middle, middle);
    }
  }

 private:
  /// The vertices of a side but for its end: the corner, and which of those after it are `shown`. The corner
  /// is number `first` of the border.
  void side(uint32_t shown, int first, const Place& from, int di, int dj) {
    for (int k = 0; k < step_; ++k)
      if (k == 0 || (shown >> (first + (di + dj) * k) & 1))
        outline_[count_++] = {from.i + k * di, from.j + k * dj};
  }

  /// Triangles abd and cdb.
  void add(const Place& a, const Place& b, const Place& c, const Place& d) {
    const Position pa(vertexAt(g_, a)), pb(vertexAt(g_, b)), pc(vertexAt(g_, c)), pd(vertexAt(g_, d));
    const bool first = pa != pb && pb != pd && pa != pd, second = pc != pd && pd != pb && pc != pb;
    if (!first && !second) return;  // collapsed
    out_.push_back({index_,
                    {uint8_t(a.i), uint8_t(b.i), uint8_t(c.i), uint8_t(d.i)},
                    {uint8_t(a.j), uint8_t(b.j), uint8_t(c.j), uint8_t(d.j)}});
  }

  const BorderedGrid& g_;
  uint32_t index_;
  const Refined& refined_;
  std::vector<StitchQuad>& out_;
  int step_;
  int count_ = 0;
  Place outline_[64];  // four sides of at most 16
};

void stitch(BorderedGrid& g, uint32_t index, const Refined& refined, std::vector<StitchQuad>& out) {
  int u0 = refined.vertices[kU0] != 0, u1 = g.cellsU - (refined.vertices[kU1] != 0);
  int v0 = refined.vertices[kV0] != 0, v1 = g.cellsV - (refined.vertices[kV1] != 0);
  if (u0 >= u1 || v0 >= v1) u0 = u1 = v0 = v1 = 0;
  g.inner[0] = uint8_t(u0), g.inner[1] = uint8_t(u1), g.inner[2] = uint8_t(v0), g.inner[3] = uint8_t(v1);
  CellStitcher stitcher(g, index, refined, out);
  for (int cv = 0; cv < g.cellsV; ++cv)
    for (int cu = 0; cu < g.cellsU; ++cu)
      if (cu < u0 || cu >= u1 || cv < v0 || cv >= v1) stitcher.cell(cu, cv);
}

}  // namespace

std::vector<StitchQuad> stitchBorders(std::span<BorderedGrid> grids) {
  bool anyCoarse = false;
  std::vector<size_t> firstOf(grids.size() + 1, 0);
  for (size_t n = 0; n < grids.size(); ++n) {
    BorderedGrid& g = grids[n];
    g.inner[0] = g.inner[2] = 0, g.inner[1] = g.cellsU, g.inner[3] = g.cellsV;
    anyCoarse |= g.vertices && g.level > 0;
    firstOf[n + 1] = firstOf[n] + (g.vertices ? 2 * (size_t(g.cellsU) + g.cellsV) : 0);
  }
  if (!anyCoarse) return {};

  using Range = tbb::blocked_range<size_t>;
  const auto forEachSegment = [](const BorderedGrid& g, auto&& visit) {
    for (int edge = 0; edge < 4; ++edge)
      for (int k = 0; k < segmentsOf(g, edge); ++k) visit(edge, k);
  };

  // All segments by their hash. One that stands there once has no equal.
  std::vector<uint64_t> shown(firstOf.back());
  tbb::parallel_for(Range(0, grids.size(), 256), [&](const Range& range) {
    for (size_t n = range.begin(); n != range.end(); ++n) {
      uint64_t* to = shown.data() + firstOf[n];
      if (grids[n].vertices)
        forEachSegment(grids[n], [&](int edge, int k) { *to++ = coarseHash(grids[n], edge, k); });
    }
  });
  tbb::parallel_sort(shown.begin(), shown.end());
  const auto isAlone = [&](uint64_t hash) {
    const auto at = std::lower_bound(shown.begin(), shown.end(), hash);
    return hash != 0 && (shown.end() - at < 2 || at[1] != hash);
  };
  const auto isShown = [&](uint64_t hash) {
    return hash != 0 && std::binary_search(shown.begin(), shown.end(), hash);
  };

  // A segment that somebody shows in pieces is cut where that one cuts it; whoever shows the pieces stays as
  // he is. (Borders are halved and halved again, so of two segments that overlap one holds the other.)
  const auto hasPieces = [&](const BorderedGrid& g, int edge, int from, int to, uint64_t hash) {
    for (int step = (to - from) / 2; step > 0; step /= 2)
      for (int k = from; k < to; k += step)
        if (const uint64_t piece = segmentHash(g, edge, k, k + step); piece != hash && isShown(piece))
          return true;
    return false;
  };
  // Returns the vertices to show inside of a segment; appends the pieces that others show.
  const auto cut = [&](const BorderedGrid& g, int edge, int from, int to, std::vector<uint64_t>& met,
                       auto&& self) -> uint32_t {
    const uint64_t hash = segmentHash(g, edge, from, to);
    if (hash == 0 || !hasPieces(g, edge, from, to, hash)) return 0;
    const int middle = (from + to) / 2;
    uint32_t shownVertices = 1u << middle;
    for (const auto& [begin, end] : {std::pair(from, middle), std::pair(middle, to)}) {
      const uint64_t half = segmentHash(g, edge, begin, end);
      if (half != hash && isShown(half))
        met.push_back(half);
      else if (g.open && half != 0 && !hasPieces(g, edge, begin, end, half))
        shownVertices |= verticesInside(begin, end);  // the other side of this half is elsewhere
      else
        shownVertices |= self(g, edge, begin, end, met, self);
    }
    return shownVertices;
  };
  constexpr size_t kPart = 256;
  const size_t partCount = (grids.size() + kPart - 1) / kPart;
  const auto forEachCoarseGrid = [&](size_t part, auto&& visit) {
    for (size_t n = part * kPart; n < std::min(grids.size(), (part + 1) * kPart); ++n)
      if (grids[n].vertices && grids[n].level > 0) visit(n);
  };
  std::vector<Refined> refined(grids.size());
  std::vector<std::vector<uint64_t>> metParts(partCount);
  std::atomic<bool> anyOpen{false};
  tbb::parallel_for(size_t(0), partCount, [&](size_t part) {
    forEachCoarseGrid(part, [&](size_t n) {
      const BorderedGrid& g = grids[n];
      if (g.open) anyOpen = true;
      forEachSegment(g, [&](int edge, int k) {
        if (isAlone(coarseHash(g, edge, k)))
          refined[n].vertices[edge] |= cut(g, edge, k << g.level, (k + 1) << g.level, metParts[part], cut);
      });
    });
  });
  if (anyOpen) {
    // What nobody here shows, whole, in pieces or as a piece, may be shown elsewhere in any way.
    std::vector<uint64_t> met;
    for (const auto& p : metParts) met.insert(met.end(), p.begin(), p.end());
    tbb::parallel_sort(met.begin(), met.end());
    tbb::parallel_for(size_t(0), partCount, [&](size_t part) {
      forEachCoarseGrid(part, [&](size_t n) {
        const BorderedGrid& g = grids[n];
        if (!g.open) return;
        forEachSegment(g, [&](int edge, int k) {
          const uint64_t hash = coarseHash(g, edge, k);
          const uint32_t inside = verticesInside(k << g.level, (k + 1) << g.level);
          if (isAlone(hash) && !(refined[n].vertices[edge] & inside) &&
              !std::binary_search(met.begin(), met.end(), hash))
            refined[n].vertices[edge] |= inside;
        });
      });
    });
  }
  std::vector<std::vector<StitchQuad>> parts(partCount);
  tbb::parallel_for(size_t(0), partCount, [&](size_t part) {
    forEachCoarseGrid(part, [&](size_t n) {
      if (refined[n].any()) stitch(grids[n], uint32_t(n), refined[n], parts[part]);
    });
  });
  std::vector<StitchQuad> all;
  for (const auto& p : parts) all.insert(all.end(), p.begin(), p.end());
  return all;
}

}  // namespace fr::tracer
