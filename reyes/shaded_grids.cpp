#include "reyes/shaded_grids.h"

#include <algorithm>
#include <cmath>

namespace fr::reyes {

void ShadedGrid::makeCells() {
  const size_t nu = record->nu, nv = record->nv, row = nu + 1;
  cells.resize(nu * nv);
  for (size_t c = 0; c < 3; ++c) {
    const float* const from = color.data() + c * points;
    const float* const through = opacity.empty() ? nullptr : opacity.data() + c * points;
    // In the order in which a hit's weights are added up elsewhere, so that both give the same bits.
    const auto mean = [row](const float* p) {
      return 0.25f * p[0] + 0.25f * p[1] + 0.25f * p[row] + 0.25f * p[row + 1];
    };
    for (size_t j = 0; j < nv; ++j)
      for (size_t i = 0; i < nu; ++i) {
        Cell& cell = cells[j * nu + i];
        cell.color[c] = mean(from + j * row + i);
        cell.opacity[c] = through ? std::clamp(mean(through + j * row + i), 0.0f, 1.0f) : 1.0f;
      }
  }
}

size_t ShadedGrid::visiblePoints() const {
  if (!done()) return 0;
  TriangleSet triangles;
  for (size_t i = 0; i < seen.size(); ++i) triangles.setWord(i, seen[i].load(std::memory_order_relaxed));
  return reyes::visiblePoints(*record, stride, triangles, indices);
}

ShadedGrids::ShadedGrids(const Film& film) : film_(film), tiles_(size_t(film.tileCount())) {}
ShadedGrids::~ShadedGrids() = default;

ShadedGrid* ShadedGrids::acquire(int tile, cache::NodeId node, const cache::GridView& view,
                                 const RasterBounds& bounds) {
  Shard& shard = shardOf(node);
  const std::lock_guard lock(shard.mutex);
  std::unique_ptr<ShadedGrid>& entry = shard.grids[node];
  if (entry) return entry.get();
  entry = std::make_unique<ShadedGrid>();
  ShadedGrid* grid = entry.get();
  grid->node = node, grid->record = view.record, grid->indices = view.indices;
  const size_t now = count_.fetch_add(1, std::memory_order_relaxed) + 1;
  for (size_t old = peak_.load(std::memory_order_relaxed);
       old < now && !peak_.compare_exchange_weak(old, now);) {
  }

  const PixelRect& s = film_.sampledRect();
  const auto at = [&](float v, int origin, int count) {
    return int(std::clamp(std::floor((v - float(origin)) / float(film_.tileSize())), 0.0f, float(count - 1)));
  };
  // One count for us while we register, so that a tile that finishes meanwhile does not free the grid.
  grid->tilesLeft = 1;
  const int x0 = at(bounds.x0, s.x0, film_.tilesX()), x1 = at(bounds.x1, s.x0, film_.tilesX());
  const int y0 = at(bounds.y0, s.y0, film_.tilesY()), y1 = at(bounds.y1, s.y0, film_.tilesY());
  for (int y = y0; y <= y1; ++y)
    for (int x = x0; x <= x1; ++x) {
      Tile& t = tiles_[size_t(y * film_.tilesX() + x)];
      const std::lock_guard tileLock(t.mutex);
      if (t.finished) continue;
      t.grids.push_back(grid);
      ++grid->tilesLeft;
    }
  // The asking tile is unfinished and registered: the count cannot reach 0 here. Its rounding is covered by
  // this:
  FR_CHECK(!tiles_[size_t(tile)].finished);
  FR_CHECK(grid->tilesLeft.fetch_sub(1) > 1);
  return grid;
}

size_t ShadedGrids::finishTile(int tile) {
  std::vector<ShadedGrid*> grids;
  {
    Tile& t = tiles_[size_t(tile)];
    const std::lock_guard lock(t.mutex);
    t.finished = true;
    grids.swap(t.grids);
  }
  size_t visible = 0;
  for (ShadedGrid* grid : grids) {
    if (grid->tilesLeft.fetch_sub(1, std::memory_order_acq_rel) != 1) continue;
    visible += grid->visiblePoints();
    count_.fetch_sub(1, std::memory_order_relaxed);
    Shard& shard = shardOf(grid->node);
    const std::lock_guard lock(shard.mutex);
    shard.grids.erase(grid->node);
  }
  return visible;
}

}  // namespace fr::reyes
