// Dicing: which nodes split, and where the vertices of those that do not split lie.
//
// Border vertices follow one rule that both sides of a border obey without knowing each other. Each border
// line has a root interval: the dyadic interval of the line when a split created it, or the whole root edge.
// canon(I) is uniform, 2^ceil(log2(metric(I))) segments, when that is at most 16, else both halves of I
// canonically. A border vertex that is not a vertex of canon(root interval) collapses onto the next lower one
// that is.
#pragma once

#include <vector>

#include "scene_cache/cache.h"
#include "scene_cache/dice_metric.h"
#include "scene_cache/surface.h"

namespace fr::cache {

/// Deepest split in either direction: parameters of grid vertices stay exact in float (2^-24).
inline constexpr int kMaxSplitDepth = 20;

/// Dyadic rectangle and borders of a node; what the dicer needs of a PatchNode.
struct NodeRect {
  uint32_t iu = 0, iv = 0;
  uint8_t du = 0, dv = 0;
  uint8_t edgeRootDepth[4] = {};
};
inline NodeRect rectOf(const PatchNode& n) {
  return {n.iu,
          n.iv,
          n.du,
          n.dv,
          {n.edgeRootDepth[0], n.edgeRootDepth[1], n.edgeRootDepth[2], n.edgeRootDepth[3]}};
}

/// Borders of the root patch that another patch evaluates.
struct RootBorders {
  struct Piece {
    const Surface* surface = nullptr;  // nullptr: the patch itself
    uint8_t edge = 0;                  // of the owner
    bool reversed = false;
  };
  Piece edge[4];
  Piece corner[4];
};

struct DicePlan {
  enum class Kind : uint8_t { kGrid, kSplitU, kSplitV } kind = Kind::kGrid;
  uint8_t log2Nu = 0, log2Nv = 0;
  /// Borders v0, u1, v1, u0: only every 2^edgeShift-th grid vertex of the line is kept.
  uint8_t edgeShift[4] = {};
};

/// Decides for one node. `path`: from the root node to the node itself.
DicePlan planNode(const Surface& surface, const RootBorders& borders, const DiceRate& rate,
                  const NodeRect& node);

/// Children of a split node.
void splitRect(const NodeRect& node, bool inV, NodeRect children[2]);

/// Parameters of the grid's columns and rows, and those of a vertex after collapsing.
struct GridParameters {
  float u[kMaxGridSide + 1], v[kMaxGridSide + 1];
};
GridParameters gridParameters(const NodeRect& node, int log2Nu, int log2Nv);
/// (u, v) of vertex (i, j) as shown: collapsed along the borders.
void collapsedParameters(const NodeRect& node, int log2Nu, int log2Nv, const uint8_t edgeShift[4], int i,
                         int j, float* u, float* v);

/// Positions of a planned grid, xyz interleaved. `surface` and `borders` may be those of another time than
/// the plan's; `planSurface`, `planBorders` are those that the plan was made with (collapsed ends of lines
/// ask for other lines' plans).
void dicePositions(const Surface& surface, const RootBorders& borders, const Surface& planSurface,
                   const RootBorders& planBorders, const DiceRate& rate, std::span<const NodeRect> path,
                   const DicePlan& plan, float* xyz, size_t rowStride);
/// The same of those vertices alone that depend on the rate: corners, borders that collapse or are another
/// patch's. The others must be in place.
void diceBorders(const Surface& surface, const RootBorders& borders, const Surface& planSurface,
                 const RootBorders& planBorders, const DiceRate& rate, std::span<const NodeRect> path,
                 const DicePlan& plan, float* xyz, size_t rowStride);

/// Estimated distance of the level-0 cells from the true surface: deviation index 0.
float estimateTrueDeviation(const Surface& surface, const GridParameters& g, const float* xyz, int nu, int nv,
                            size_t rowStride);

}  // namespace fr::cache
