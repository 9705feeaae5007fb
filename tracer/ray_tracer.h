// Answers batches of ray questions: what both transports and the ray server call.
//
// A RayTracer belongs to one process and one scene cache; it builds the ray scene at the first question. Each
// thread that answers has an AnswerThread of its own, which holds all memory that answering needs: nothing is
// allocated per ray or per batch once the deepest level has been reached.
//
// Every answer is a function of its ray alone: not of the batch, the thread, or the transport.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <vector>

#include "base/error.h"
#include "oracle/ray_query.h"
#include "oracle/server_counters.h"
#include "oracle/single_ray.h"
#include "shading/shading_system.h"
#include "tracer/ray_scene.h"

namespace fr::tracer {

class RayTracer;

struct RayTracerOptions {
  RaySceneOptions scene;
  /// Deepest ray level that is traced; negative: Option "render" "max_raylevel" of the scene (default 4).
  int maxRayLevel = -1;
  /// Called once, when the ray scene has been built (at the first question), by the thread that built it.
  std::function<void(const RayTracer&)> onBuilt;
};

/// Counts of one process. Plain numbers with a fixed layout: they travel between processes.
struct TracerStatistics {
  uint64_t rays[4] = {};        // asked by clients, by RayKind
  uint64_t nestedRays[4] = {};  // asked by shaders at hits
  uint64_t intersections = 0;   // walks through the tree
  uint64_t rejected = 0;        // rays that made no sense (NaN, zero direction)
  uint64_t hitsShaded = 0;
  uint64_t batches = 0;
  uint64_t grids = 0, meshlets = 0, quads = 0, triangles = 0;
  uint64_t clusters = 0, clustersDiced = 0, treesBuilt = 0, treesFreed = 0;
  uint64_t embreeBytes = 0, embreePeakBytes = 0, recordBytes = 0;
  uint64_t gridsDiced = 0, micropolygonsDiced = 0;
  uint64_t pointsShaded = 0, shadersLoaded = 0;
  double resolveSeconds = 0, buildSeconds = 0, answerSeconds = 0;

  TracerStatistics& operator+=(const TracerStatistics& o);
};

class RayTracer {
 public:
  /// Both must outlive the tracer. Shaders must have been loaded (ShadingSystem::loadShaders(kForTracer)).
  RayTracer(cache::SceneCache& cache, ShadingSystem& shading, RayTracerOptions options);
  ~RayTracer();

  /// Builds the ray scene if nobody has. Thread-safe; the others wait. The first error is reported once, and
  /// stays.
  Result<void> prepare();
  /// The scene, or nullptr before prepare() or after its failure.
  const RayScene* scene() const { return ready_.load(std::memory_order_acquire); }

  /// Gives about so many bytes of acceleration structures back, if there are some that rays can do without
  /// for now; returns how many. Thread-safe.
  uint64_t giveBack(uint64_t bytes) {
    const RayScene* s = scene();
    return s ? s->giveBack(bytes) : 0;
  }

  cache::SceneCache& cache() const { return cache_; }
  ShadingSystem& shading() const { return shading_; }
  int maxRayLevel() const { return maxRayLevel_; }
  /// Of everything so far; thread-safe (numbers of running threads may lag).
  TracerStatistics statistics() const;

 private:
  friend class AnswerThread;
  cache::SceneCache& cache_;
  ShadingSystem& shading_;
  RayTracerOptions options_;
  int maxRayLevel_;
  std::once_flag once_;
  std::unique_ptr<RayScene> scene_;
  std::atomic<const RayScene*> ready_{nullptr};
  std::optional<Error> error_;
  mutable std::mutex mutex_;
  TracerStatistics counted_;  // under mutex_
};

/// One thread's workplace. Not thread-safe.
class AnswerThread {
 public:
  /// `row`: also counts here, for those who watch (nullptr: nobody does).
  explicit AnswerThread(RayTracer& tracer, CounterRow* row = nullptr);
  ~AnswerThread();

  /// Answers a block in place. Nothing in it is trusted, and it may change while it is read: every input is
  /// read once. Rays that make no sense are misses.
  void answer(RayQuery& query);
  /// Answers one ray: the same bits as in a block. False when its kind is none; any other field may hold
  /// anything. Its time is not counted in TracerStatistics::answerSeconds: clocks cost as much as rays.
  /// Call publishCounts() when nobody waits any more.
  bool answerOne(const SingleRayMail& mail, SingleAnswer& answer);
  /// Adds what answerOne() has counted to RayTracer::statistics(). (The row has it already.)
  void publishCounts();

 private:
  struct Level;
  struct AskedRay;
  struct PathRay;
  Level& level(size_t depth);
  void answerAt(RayQuery& query, size_t depth);
  void readTerms(const RayTerms& terms, Level& at);
  float chanceOf(const AskedRay& asked) const;
  static AskedRay askedRay(const RayQuery& query, uint32_t k);
  void fillRay(Ray& ray, const AskedRay& asked, uint32_t mask, const Level& at) const;
  bool startRay(Ray& ray, const AskedRay& asked, uint32_t mask, const Level& at);
  void startPath(PathRay& path, const AskedRay& asked, uint32_t mask, const Level& at);
  void readRays(const RayQuery& query, uint32_t first, Level& at, uint32_t mask);
  void answerWhether(RayQuery& query, uint32_t count, uint32_t mask, const Level& at);
  void answerHitTests(RayQuery& query, uint32_t count, const Level& at);
  void runAt(RayKind kind, Level& at, size_t depth);
  void orderPaths(const Level& at, uint32_t* order) const;
  void runVisibility(Level& at, size_t depth);
  void runTrace(Level& at, size_t depth);
  void writeExtras(const Level& at, RayQuery& query, uint32_t first);
  void writeAnswers(RayKind kind, const Level& at, bool full, RayQuery& query, uint32_t first);
  void countInRow();
  /// What shading a hit is for.
  enum class Purpose { kRadiance, kOpacity, kValues };
  uint32_t volumeKey(const PathRay& path) const;
  void shadeHits(Level& at, size_t depth, Purpose purpose);
  void shadeGroup(Level& at, size_t depth, size_t first, size_t end, Purpose purpose);
  void shadeMisses(Level& at, size_t depth);
  void shadePoints(Level& at, size_t depth, size_t first, size_t n, ShadePoints& points, Purpose purpose);
  Color attributeOpacity(const Hit& hit);
  cache::NodeId hitNode(const Hit& hit) const;
  void hitPoint(const Ray& ray, const Hit& hit, Vec3& P, Vec3& N);

  RayTracer& tracer_;
  std::vector<std::unique_ptr<Level>> levels_;
  TracerStatistics counts_;
  CounterRow* row_;
};

}  // namespace fr::tracer
