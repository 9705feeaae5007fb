#include "reyes/bucket_worker.h"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "base/random.h"

namespace fr::reyes {
namespace {

using Clock = std::chrono::steady_clock;

class Timer {
 public:
  explicit Timer(double& sum) : sum_(sum), start_(Clock::now()) {}
  ~Timer() { sum_ += std::chrono::duration<double>(Clock::now() - start_).count(); }
  Timer(const Timer&) = delete;
  Timer& operator=(const Timer&) = delete;

 private:
  double& sum_;
  Clock::time_point start_;
};

/// Grids in flight and hidden tiles per thread while shaders can ask for rays: enough that the thread has
/// other work while a batch is traced.
constexpr size_t kTasksWithRays = 8, kPendingWithRays = 4;

/// Appends a plane of shaded values to `to`; what is not a number would spread through the filter, so it
/// becomes 0.
void copyValues(const float* from, const ShadedGrid& grid, std::vector<float>& to) {
  const size_t first = to.size();
  if (grid.stride.all()) {
    to.insert(to.end(), from, from + grid.points);
  } else {
    to.resize(first + grid.points);
    spreadShading(*grid.record, grid.stride, from, to.data() + first);
  }
  bool bad = false;
  for (size_t i = first; i < to.size(); ++i)
    if (!std::isfinite(to[i])) to[i] = 0, bad = true;
  if (bad)
    reportOnce("shaded value not finite",
               Error{RiError::kMath,
                     Severity::kWarning,
                     {},
                     "a surface shader computed colours that are not numbers or infinite; "
                     "they are drawn black"});
}

}  // namespace

BucketWorker::BucketWorker(FrameWork& work) : work_(work), hider_(*work.scene) {
  const bool rays = work.shading->canAskRays();
  mostTasks_ = rays ? kTasksWithRays : 1;
  mostPending_ = rays ? kPendingWithRays : 2;
}
BucketWorker::~BucketWorker() = default;

void BucketWorker::run() {
  for (;;) {
    const uint32_t seen = work_.events.load(std::memory_order_seq_cst);
    if (work_.broken.load(std::memory_order_relaxed)) break;
    const bool polled = pollTasks();
    const bool finished = finishTiles();
    if (startGrid() || polled || finished) continue;
    if (pending_.size() < mostPending_ && takeTile()) continue;
    if (!flying_.empty()) {
      waitForOracle();
      continue;
    }
    if (pending_.empty()) break;  // no tiles are left, or takeTile() would have found one
    const Timer timer(statistics_.otherWaitSeconds);
    work_.events.wait(seen, std::memory_order_seq_cst);
  }
  const HiderStatistics& h = hider_.statistics();
  const std::lock_guard lock(work_.mutex);
  FrameStatistics& s = work_.statistics;
  s.nodesCulledOutside += h.nodesCulledOutside, s.nodesCulledBucket += h.nodesCulledTile;
  s.nodesCulledHidden += h.nodesCulledHidden, s.nodesSplit += h.nodesSplit, s.nodesLost += h.nodesLost;
  s.gridsDrawn += h.gridsDrawn, s.gridsCulledHidden += h.gridsCulledHidden,
      s.gridsCulledBucket += h.gridsCulledTile;
  s.micropolygonsTested += h.micropolygonsTested, s.fragments += h.fragments;
  s.resolveSeconds += h.resolveSeconds, s.hideSeconds += h.drawSeconds;
  if (statistics_.buckets > 0)
    s.fewestSamples =
        s.buckets ? std::min(s.fewestSamples, statistics_.fewestSamples) : statistics_.fewestSamples;
  s.mostSamples = std::max(s.mostSamples, statistics_.mostSamples);
  s.pixels += statistics_.pixels, s.errors += statistics_.errors;
  s.buckets += statistics_.buckets, s.samples += statistics_.samples;
  s.gridsShaded += statistics_.gridsShaded, s.pointsShaded += statistics_.pointsShaded;
  s.pointsVisible += statistics_.pointsVisible;
  s.raysAsked += statistics_.raysAsked, s.rayBatches += statistics_.rayBatches;
  s.shadeSeconds += statistics_.shadeSeconds, s.oracleWaitSeconds += statistics_.oracleWaitSeconds;
  s.otherWaitSeconds += statistics_.otherWaitSeconds, s.compositeSeconds += statistics_.compositeSeconds;
  s.filterAndWriteSeconds += statistics_.filterAndWriteSeconds;
}

/// Takes the tiles that this thread hides next: several that lie side by side, fewer towards the end.
/// Neighbouring tiles see the same grids; if two threads always hid neighbours, they would wait for each
/// other to dice them.
bool BucketWorker::takeRun() {
  constexpr size_t kMostTiles = 8;
  const size_t all = work_.order.size(), given = std::min(work_.next.load(std::memory_order_relaxed), all);
  const size_t count = std::clamp<size_t>((all - given) / (8 * size_t(work_.threads)), 1, kMostTiles);
  nextOfRun_ = std::min(work_.next.fetch_add(count, std::memory_order_relaxed), all);
  runEnd_ = std::min(nextOfRun_ + count, all);
  tilesLeft_ = nextOfRun_ < runEnd_;
  return tilesLeft_;
}

bool BucketWorker::takeTile() {
  if (!tilesLeft_ || work_.stop.load(std::memory_order_relaxed)) return false;
  if (nextOfRun_ == runEnd_ && !takeRun()) return false;
  std::unique_ptr<Pending> p;
  if (idlePending_.empty())
    p = std::make_unique<Pending>();
  else
    p = std::move(idlePending_.back()), idlePending_.pop_back();
  const int tile = work_.order[nextOfRun_++];
  if (work_.adaptive)
    p->adaptive.begin(int(work_.film->tileRect(tile).area()), kFixedChannels + int(work_.outputs.size()),
                      *work_.adaptive);
  hideTile(*p, tile);
  pending_.push_back(std::move(p));
  return true;
}

void BucketWorker::hideTile(Pending& p, int tile) {
  hider_.hide(tile, work_.film->tileRect(tile), p.view, work_.adaptive ? p.adaptive.round() : SampleRound{});
  p.needed.clear(), p.nextToClaim = p.nextToFinish = 0;
  for (TileGrid& g : p.view.grids) {
    if (!g.seen || (g.traits.matte && g.traits.opaque)) continue;
    // The box of the whole grid, so that every tile that can see it is counted.
    g.shaded = work_.shaded->acquire(tile, g.node, work_.scene->cache->view(*g.record),
                                     work_.scene->space.bounds(g.record->bound));
    g.shaded->addSeen(g.seenTriangles);
    p.needed.push_back(g.shaded);
  }
}

bool BucketWorker::startGrid() {
  if (flying_.size() >= mostTasks_) return false;
  for (auto& p : pending_)
    while (p->nextToClaim < p->needed.size()) {
      ShadedGrid* grid = p->needed[p->nextToClaim++];
      if (!grid->claim()) continue;
      std::unique_ptr<GridTask> task;
      if (idleTasks_.empty())
        task = std::make_unique<GridTask>(*work_.shading);
      else
        task = std::move(idleTasks_.back()), idleTasks_.pop_back();
      task->grid = grid, task->query = nullptr;
      const cache::GridRecord& record = *grid->record;
      ShadePoints points;
      const bool meshlet = record.kind == cache::GridKind::kMeshlet;
      points.topology = meshlet ? ShadePoints::Topology::kMeshlet : ShadePoints::Topology::kGrid;
      const cache::GridView view = work_.scene->cache->view(record);
      grid->points = view.vertexCount();
      points.grid = &record;
      const cache::AttributeId attributes = work_.scene->cache->objectOf(grid->node).attributes;
      grid->stride =
          shadingStride(work_.scene->space.open(), view, work_.scene->traits[attributes].shadingArea);
      points.strideU = grid->stride.u, points.strideV = grid->stride.v;
      points.count = grid->stride.all() ? grid->points : points.gridPoints();
      task->points = points.count;
      points.gridSeed = hashStep(work_.options->seed, patchRank(work_.scene->cache->node(grid->node)));
      task->task.begin(points);
      advance(std::move(task));
      return true;
    }
  return false;
}

/// Runs a task until it is done or waits for rays.
void BucketWorker::advance(std::unique_ptr<GridTask> task) {
  for (;;) {
    ShadeTask::Status status;
    {
      const Timer timer(statistics_.shadeSeconds);
      status = task->task.run();
    }
    if (status == ShadeTask::Status::kDone) {
      finishGrid(*task);
      idleTasks_.push_back(std::move(task));
      return;
    }
    if (connectOracle()) {
      flying_.push_back(std::move(task));
      submit(*flying_.back());
      return;
    }
    task->task.missAll();
  }
}

/// Asks the task's rays if there is a free block. False: not yet.
bool BucketWorker::submit(GridTask& task) {
  RayQuery* q = oracle_->acquire();
  if (!q) return false;
  const Timer timer(statistics_.shadeSeconds);
  task.task.writeRays(*q);
  statistics_.raysAsked += q->count, ++statistics_.rayBatches;
  task.query = q;
  if (auto r = oracle_->submit(q); !r) oracleGone(std::move(r.error()));
  return true;
}

bool BucketWorker::pollTasks() {
  bool any = false;
  for (size_t i = 0; i < flying_.size();) {
    GridTask& task = *flying_[i];
    if (!oracle_) {
      // It went away: what flew comes down with misses.
      task.task.missAll();
    } else if (!task.query) {
      any |= submit(task);
      ++i;
      continue;
    } else if (oracle_->answered(task.query)) {
      task.task.readAnswers(*task.query);
      oracle_->release(task.query);
    } else {
      ++i;
      continue;
    }
    task.query = nullptr;
    any = true;
    std::unique_ptr<GridTask> landed = std::move(flying_[i]);
    flying_.erase(flying_.begin() + ptrdiff_t(i));
    advance(std::move(landed));
  }
  return any;
}

bool BucketWorker::connectOracle() {
  if (oracle_) return true;
  if (work_.oracleFailed.load(std::memory_order_relaxed)) return false;
  if (!work_.oracle) {
    reportOnce("no ray oracle", Error{RiError::kIncapable,
                                      Severity::kWarning,
                                      {},
                                      "shaders ask for rays but there is no ray oracle: all rays miss"});
    return false;
  }
  auto line = work_.oracle->connect();
  if (!line) {
    oracleGone(std::move(line.error()));
    return false;
  }
  oracle_ = std::move(*line);
  return true;
}

void BucketWorker::oracleGone(Error error) {
  oracle_.reset();
  if (!work_.oracleFailed.exchange(true))
    report(std::move(error).context("the ray oracle is gone, the remaining rays miss"));
}

void BucketWorker::waitForOracle() {
  const Timer timer(statistics_.oracleWaitSeconds);
  if (!oracle_) return;
  if (auto r = oracle_->wait(); !r) oracleGone(std::move(r.error()));
}

void BucketWorker::finishGrid(GridTask& task) {
  ShadedGrid& g = *task.grid;
  const cache::AttributeId attributes = work_.scene->cache->objectOf(g.node).attributes;
  g.color.reserve(3 * g.points);
  for (int c = 0; c < 3; ++c) copyValues(task.task.color(c), g, g.color);
  if (!work_.scene->traits[attributes].opaque)
    for (int c = 0; c < 3; ++c) copyValues(task.task.opacity(c), g, g.opacity);
  for (const OutputChannel& o : work_.outputs) {
    if (const float* values = task.task.output(o.variable, o.component)) {
      copyValues(values, g, g.outputs);
    } else {
      g.outputs.insert(g.outputs.end(), g.points, 0.0f);
      reportOnce(
          "no output " + o.variable,
          Error{RiError::kMissingData,
                Severity::kWarning,
                {},
                fmt::format("some surface shaders have no output variable \"{}\": 0 there", o.variable)});
    }
  }
  if (!work_.scene->traits[attributes].smooth && g.record->kind == cache::GridKind::kGrid &&
      !(g.record->flags & cache::kGridSprites))
    g.makeCells();
  ++statistics_.gridsShaded, statistics_.pointsShaded += task.points;
  g.publish();
  work_.signal();
}

bool BucketWorker::finishTiles() {
  bool any = false;
  for (size_t i = 0; i < pending_.size();) {
    Pending& p = *pending_[i];
    while (p.nextToFinish < p.needed.size() && p.needed[p.nextToFinish]->done()) ++p.nextToFinish;
    if (p.nextToFinish < p.needed.size()) {
      ++i;
      continue;
    }
    any = true;
    if (!finishRound(p)) {  // some pixels want more samples
      ++i;
      continue;
    }
    finishTile(p);
    idlePending_.push_back(std::move(pending_[i]));
    pending_.erase(pending_.begin() + ptrdiff_t(i));
  }
  return any;
}

/// Colours of the samples that the tile was hidden for. False: it is hidden again, for more.
bool BucketWorker::finishRound(Pending& tile) {
  {
    const Timer timer(statistics_.compositeSeconds);
    resolveTile(tile.view, work_.scene->space, int(work_.outputs.size()), work_.opacityThreshold,
                work_.midpointDepth, colors_);
    if (!work_.adaptive) return true;
    tile.adaptive.add(colors_);
  }
  if (tile.adaptive.done()) return true;
  hideTile(tile, tile.view.tile);
  return false;
}

void BucketWorker::finishTile(Pending& tile) {
  const int* counts = nullptr;
  if (work_.adaptive) {
    const Timer timer(statistics_.compositeSeconds);
    counts = tile.adaptive.gather(colors_);
    statistics_.errors += tile.adaptive.errors();
    const auto [fewest, most] = tile.adaptive.countRange();
    statistics_.fewestSamples = statistics_.buckets ? std::min(statistics_.fewestSamples, fewest) : fewest;
    statistics_.mostSamples = std::max(statistics_.mostSamples, most);
  }
  statistics_.pixels += uint64_t(work_.film->tileRect(tile.view.tile).area());
  statistics_.pointsVisible += work_.shaded->finishTile(tile.view.tile);
  const Timer timer(statistics_.filterAndWriteSeconds);
  std::vector<const float*> channels;
  for (const auto& c : colors_.channels) channels.push_back(c.data());
  const TileSamples samples{tile.view.samples.perPixel(), counts, colors_.x.data(), colors_.y.data(),
                            channels.data()};
  statistics_.samples += colors_.x.size(), ++statistics_.buckets;
  work_.film->addTile(tile.view.tile, samples, [this](FilmTile&& pixels) {
    if (work_.options->pixels) {
      const std::lock_guard lock(work_.mutex);
      work_.options->pixels(pixels);
    }
    if (work_.journal) work_.journal->add(pixels);
    if (work_.output) work_.output->addTile(pixels);
  });
  if (abortRequested()) work_.stop = true;
  const std::lock_guard lock(work_.mutex);
  ++work_.tilesDone;
  if (work_.options->progress) work_.options->progress(double(work_.tilesDone) / double(work_.order.size()));
}

}  // namespace fr::reyes
