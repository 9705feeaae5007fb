#include "tracer/pipe_oracle.h"

#include <algorithm>
#include <mutex>

#include "oracle/ray_client.h"
#include "tracer/node_address.h"
#include "tracer/ray_server.h"

namespace fr::tracer {

struct PipeOracleService::State {
  const cache::SceneCache& cache;
  const Options options;
  mutable std::mutex mutex;  // all below
  std::unique_ptr<RayClient> client;
  std::optional<Error> failed;  // for good
  bool sameScene = false;
  DVec3 shift{0};  // from our cache space to the server's

  State(const cache::SceneCache& c, Options o) : cache(c), options(std::move(o)) {}

  Result<std::unique_ptr<RayOracle>> openLine() {
    std::lock_guard lock(mutex);
    if (failed) return *failed;
    if (!client) {
      RayClientOptions o;
      o.name = "frankenrender";
      o.pipe = true;
      o.startsAreRoots = true;
      o.blocksPerLine = options.blocksPerLine;
      auto started = RayClient::start(options.command, o);
      if (!started) {
        failed = std::move(started).error();
        return *failed;
      }
      client = std::move(started).value();
      compareScenes();
    }
    return client->connect();
  }

  /// REQUIRES mutex, client.
  void compareScenes() {
    const RaySceneInfo& theirs = client->scene();
    sameScene = theirs.scene == sceneHash(cache);
    if (sameScene) return;
    shift =
        cache.skeleton().header().cacheOrigin - DVec3(theirs.origin[0], theirs.origin[1], theirs.origin[2]);
    if (client->transport() == RayTransport::kPipe1998)
      reportWarning(
          RiError::kNone,
          "the ray server '{}' speaks the protocol of 1998 only: one ray at a time, and its rays do not "
          "know which surface they leave",
          options.command[0]);
    else
      reportWarning(
          RiError::kNone,
          "the ray server '{}' has loaded another scene than this frame: its answers may differ, and its "
          "rays do not know which surface they leave",
          options.command[0]);
  }
};

/// One line. Before there is a server, and after it is gone, blocks can be filled but not submitted.
class PipeOracle : public RayOracle {
 public:
  explicit PipeOracle(std::shared_ptr<PipeOracleService::State> state) : state_(std::move(state)) {}

  RayQuery* acquire() override {
    if (!line_ && !error_) {
      auto opened = state_->openLine();
      if (opened)
        line_ = std::move(opened).value();
      else
        error_ = std::move(opened).error();
    }
    if (error_) {
      if (!orphan_) orphan_ = std::make_unique<RayQuery>();
      return orphan_.get();
    }
    return line_->acquire();
  }

  Result<void> submit(RayQuery* q) override {
    if (error_) return *error_;
    const uint32_t n = std::min(q->count, kMaxRays);
    if (state_->sameScene) {
      for (uint32_t i = 0; i < n; ++i) {
        if (q->node[i] == cache::kNone) continue;
        const NodeAddress a = addressOf(state_->cache, q->node[i]);
        q->node[i] = a.root, q->cell[i] = a.place;
      }
    } else {
      for (uint32_t i = 0; i < n; ++i) {
        q->node[i] = cache::kNone;
        for (int c = 0; c < 3; ++c) {
          q->normal[c][i] = 0;
          q->origin[c][i] = float(double(q->origin[c][i]) + state_->shift[c]);
        }
      }
      shifted_.push_back(q);
    }
    return keep(line_->submit(q));
  }

  bool answered(const RayQuery* q) const override {
    if (!line_ || !line_->answered(q)) return false;
    if (state_->sameScene || state_->shift == DVec3(0)) return true;
    // Points come back from the server's space, once.
    for (auto at = shifted_.begin(); at != shifted_.end(); ++at) {
      if (*at != q) continue;
      shifted_.erase(at);
      RayQuery& block = *const_cast<RayQuery*>(q);
      for (uint32_t i = 0; i < std::min(q->count, kMaxRays); ++i)
        for (int c = 0; c < 3; ++c) {
          block.hitP[c][i] = float(double(q->hitP[c][i]) - state_->shift[c]);
          block.missP[c][i] = float(double(q->missP[c][i]) - state_->shift[c]);
        }
      break;
    }
    return true;
  }

  Result<void> wait() override {
    if (error_) return *error_;
    if (!line_) return makeError(RiError::kIllState, "waiting for rays, but none were submitted");
    return keep(line_->wait());
  }

  void release(RayQuery* q) override {
    if (line_) line_->release(q);
  }

 private:
  Result<void> keep(Result<void> r) {
    if (!r && r.error().code == RiError::kSystem) error_ = r.error();
    return r;
  }

  std::shared_ptr<PipeOracleService::State> state_;
  std::unique_ptr<RayOracle> line_;
  std::optional<Error> error_;
  std::unique_ptr<RayQuery> orphan_;
  mutable std::vector<const RayQuery*> shifted_;  // submitted, answers not looked at yet
};

PipeOracleService::PipeOracleService(const cache::SceneCache& cache, Options options)
    : state_(std::make_shared<State>(cache, std::move(options))) {}
PipeOracleService::~PipeOracleService() = default;

Result<std::unique_ptr<RayOracle>> PipeOracleService::connect() {
  return std::unique_ptr<RayOracle>(std::make_unique<PipeOracle>(state_));
}

std::optional<TracerStatistics> PipeOracleService::statistics() {
  std::lock_guard lock(state_->mutex);
  if (!state_->client) return {};
  auto n = state_->client->numbers();
  if (!n) return {};
  TracerStatistics s;
  for (uint32_t k = 0; k < 4; ++k) {
    s.rays[k] = n->counter[uint32_t(Counter::kTrace) + k];
    s.nestedRays[k] = n->counter[uint32_t(Counter::kNestedTrace) + k];
  }
  s.intersections = (*n)[Counter::kIntersections], s.rejected = (*n)[Counter::kRejected];
  s.hitsShaded = (*n)[Counter::kHitsShaded], s.pointsShaded = (*n)[Counter::kPointsShaded];
  s.batches = (*n)[Counter::kBlocks] + (*n)[Counter::kSingles] + (*n)[Counter::kPipeQueries];
  s.grids = (*n)[Gauge::kGridsUsed], s.gridsDiced = (*n)[Gauge::kGridsDiced];
  s.embreeBytes = s.embreePeakBytes = (*n)[Gauge::kTreeBytes], s.recordBytes = (*n)[Gauge::kRecordBytes];
  s.answerSeconds = double((*n)[Counter::kBusyNanoseconds]) * 1e-9;
  return s;
}

int PipeOracleService::processId() const {
  std::lock_guard lock(state_->mutex);
  return state_->client && state_->client->alive() ? state_->client->processId() : 0;
}

}  // namespace fr::tracer
