#include "tracer/ray_tracer.h"

#include <algorithm>

namespace fr::tracer {

using namespace cache;

namespace {

/// Levels beyond this are not worth the memory of their workplaces.
constexpr int kDeepestLevel = 64;

bool alwaysOpaque(const SceneCache& cache, const ShadingSystem& shading, ObjectId id) {
  const ObjectRecord& o = cache.skeleton().objects()[id];
  const AttributeRecord& a = cache.skeleton().attributes()[o.attributes];
  switch (a.castsShadows) {
    case CastsShadows::kOpaque:
      return true;
    case CastsShadows::kShade:
      return shading.isOpaque(o.attributes);
    case CastsShadows::kOs:
      return a.opacity.x >= 1 && a.opacity.y >= 1 && a.opacity.z >= 1 &&
             !cache.skeleton().find(o.primvars, "Os");
    default:
      return false;
  }
}

}  // namespace

TracerStatistics& TracerStatistics::operator+=(const TracerStatistics& o) {
  for (int k = 0; k < 4; ++k) rays[k] += o.rays[k], nestedRays[k] += o.nestedRays[k];
  intersections += o.intersections, rejected += o.rejected, hitsShaded += o.hitsShaded, batches += o.batches;
  clusters += o.clusters, clustersDiced += o.clustersDiced;
  treesBuilt += o.treesBuilt, treesFreed += o.treesFreed;
  grids += o.grids, meshlets += o.meshlets, quads += o.quads, triangles += o.triangles;
  embreeBytes += o.embreeBytes, embreePeakBytes += o.embreePeakBytes, recordBytes += o.recordBytes;
  gridsDiced += o.gridsDiced, micropolygonsDiced += o.micropolygonsDiced;
  pointsShaded += o.pointsShaded, shadersLoaded += o.shadersLoaded;
  resolveSeconds += o.resolveSeconds, buildSeconds += o.buildSeconds, answerSeconds += o.answerSeconds;
  return *this;
}

RayTracer::RayTracer(SceneCache& cache, ShadingSystem& shading, RayTracerOptions options)
    : cache_(cache), shading_(shading), options_(options) {
  maxRayLevel_ = options.maxRayLevel >= 0 ? options.maxRayLevel : cache.skeleton().options().maxRayLevel;
  maxRayLevel_ = std::clamp(maxRayLevel_, 0, kDeepestLevel);
}

RayTracer::~RayTracer() = default;

Result<void> RayTracer::prepare() {
  std::call_once(once_, [&] {
    auto built = RayScene::build(
        cache_, [&](ObjectId id) { return alwaysOpaque(cache_, shading_, id); }, options_.scene);
    if (built) {
      scene_ = std::move(built).value();
      ready_.store(scene_.get(), std::memory_order_release);
      if (options_.onBuilt) options_.onBuilt(*this);
    } else {
      error_ = std::move(built).error();
      report(*error_);
    }
  });
  if (error_) return *error_;
  return {};
}

TracerStatistics RayTracer::statistics() const {
  TracerStatistics s;
  {
    std::lock_guard lock(mutex_);
    s = counted_;
  }
  if (const RayScene* built = scene()) {
    const RaySceneStatistics r = built->statistics();
    s.grids = r.grids, s.meshlets = r.meshlets, s.quads = r.quads, s.triangles = r.triangles;
    s.clusters = r.clusters, s.clustersDiced = r.clustersDiced;
    s.treesBuilt = r.treesBuilt, s.treesFreed = r.treesFreed;
    s.embreeBytes = r.embreeBytes, s.embreePeakBytes = r.peakBytes, s.recordBytes = r.recordBytes;
    s.resolveSeconds = r.resolveSeconds, s.buildSeconds = r.buildSeconds;
  }
  const CacheStatistics c = cache_.statistics();
  s.gridsDiced = c.gridsDiced, s.micropolygonsDiced = c.micropolygonsDiced;
  const ShadingStatistics h = shading_.statistics();
  s.pointsShaded = h.pointsShaded, s.shadersLoaded = h.shadersLoaded;
  return s;
}

}  // namespace fr::tracer
