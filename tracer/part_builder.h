// From gathered grids to an Embree scene. Internal to tracer/.
#pragma once

#include <vector>

#include "tracer/entry_store.h"
#include "tracer/grid_gather.h"
#include "tracer/traced_part.h"

namespace fr::tracer {

/// A scene without geometry, with the flags that all of ours have.
RTCScene newRayScene(RTCDevice device);

/// As what Embree gets grids that do not move: its own grids take 16 bytes a cell; quadrilaterals a hundred,
/// but rays less time.
enum class CellType { kGrids, kQuads };

/// Fills `part`, whose scene is not committed yet: more may be attached to it. Grid i gets the entry
/// firstEntry + i; what building adds to the grids' records (where their primitives are) stands in
/// grids[i].entry afterwards. Grids that are `open` get their vertices of stride 1 along all borders that no
/// other grid of the part shows, so that parts of one surface meet at every stride. Adds to `counts`. Runs on
/// the calling TBB arena.
void buildPart(RTCDevice device, const cache::SceneCache& cache, std::vector<GatheredGrid>& grids,
               uint32_t firstEntry, TracedPart& part, RaySceneStatistics& counts,
               CellType type = CellType::kGrids);

}  // namespace fr::tracer
