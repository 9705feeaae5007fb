#include "tracer/shm_oracle.h"

#include <algorithm>
#include <array>

#include "oracle/query_fields.h"
#include "shm/channel.h"
#include "tracer/inproc_oracle.h"
#include "tracer/tracer_process.h"

namespace fr::tracer {

namespace {

/// A block that was in flight when so many tracers died is taken for the reason of their deaths. Blocks are
/// asked again oldest first, so one that is merely unlucky has been answered long before.
constexpr int kMostDeathsOfABlock = 16;

}  // namespace

struct ShmOracleService::State {
  TracerProcess process;
  State(cache::SceneCache& c, Options o) : process(c, std::move(o)) {}
};

/// One line. Blocks live in the channel; before there is one, and after the last tracer died, in a private
/// block that can be filled but not submitted.
///
/// When a tracer dies, the caller's blocks stay where they are, in the old channel's memory; what was in
/// flight is copied into blocks of the next tracer's channel, and its answers back. No tracer can have
/// changed a question: they map questions read-only.
class ShmOracle : public RayOracle {
 public:
  explicit ShmOracle(std::shared_ptr<ShmOracleService::State> state) : state_(std::move(state)) {}

  /// Through the channel's mailbox: one line there and back.
  Result<SingleAnswer> ask(const SingleRayMail& ray) override {
    if (ray.ray.kind > uint32_t(RayKind::kFullTrace))
      return makeError(RiError::kRange, "{} is no kind of ray", ray.ray.kind);
    const RayKind kind = RayKind(ray.ray.kind);
    for (int deaths = 0;;) {
      open();
      if (error_) return *error_;
      std::array<std::byte, shm::kMailBytes> bytes;
      const Result<uint32_t> n = channel_->call(singleRayBytes(ray), bytes);
      if (n) {
        noteAnswer();
        SingleAnswer answer;
        if (!readSingleAnswer(std::span(bytes).first(*n), kind, answer))
          return makeError(RiError::kConsistency, "the ray tracer's answer to a single ray has {} bytes", *n);
        return answer;
      }
      if (!channel_->error()) return n.error();
      if (Result<void> r = recover(n.error()); !r) return std::move(r).error();
      if (++deaths >= kMostDeathsOfABlock) return fail(tooManyDeaths());
    }
  }

  RayQuery* acquire() override {
    open();
    if (!error_ && channel_->error()) (void)recover(*channel_->error());
    if (error_) {
      if (!orphan_) orphan_ = std::make_unique<RayQuery>();
      return orphan_.get();
    }
    const auto slot =
        std::find_if(slots_.begin(), slots_.end(), [](const Slot& s) { return s.state == SlotState::kFree; });
    if (slot == slots_.end() || !takeBlock(*slot)) return nullptr;
    slot->query = slot->shared;
    slot->query->terms = RayTerms{};
    slot->home = channel_;
    slot->state = SlotState::kFilling;
    return slot->query;
  }

  Result<void> submit(RayQuery* q) override {
    if (error_) return *error_;
    Slot* s = find(q);
    if (!s || s->state != SlotState::kFilling)
      return makeError(RiError::kBadHandle, "a block of rays was submitted that was not acquired");
    s->count = std::min(q->count, kMaxRays);
    s->kind = q->kind;
    s->order = nextOrder_++;
    s->deaths = 0;
    s->state = SlotState::kSubmitted;
    if (Result<void> r = send(*s); !r) return recover(r.error());
    return {};
  }

  bool answered(const RayQuery* q) const override {
    Slot* s = find(q);
    if (!s) return false;
    if (s->state == SlotState::kSubmitted && !error_) {
      switch (channel_->poll(s->block)) {
        case shm::BlockStatus::kDone:
          if (s->shared != s->query) copyAnswers(*s->shared, *s->query, s->count);
          s->state = SlotState::kAnswered;
          noteAnswer();
          break;
        case shm::BlockStatus::kFailed:  // the server would not have it: nothing was hit
          makeMisses(*s);
          s->state = SlotState::kAnswered;
          break;
        default:  // in flight; a broken channel is for wait() to mend
          break;
      }
    }
    return s->state == SlotState::kAnswered;
  }

  Result<void> wait() override {
    for (;;) {
      if (error_) return *error_;
      // answered() may have found it broken. First: a caller that leaves an answered block alone would come
      // back and back.
      if (channel_ && channel_->error())
        if (Result<void> again = recover(*channel_->error()); !again) return again;
      std::array<uint32_t, kBlocksPerLine> pending;
      size_t n = 0;
      for (const Slot& s : slots_) {
        if (s.state == SlotState::kAnswered) return {};
        if (s.state == SlotState::kSubmitted) pending[n++] = s.block;
      }
      if (n == 0) return makeError(RiError::kIllState, "waiting for rays, but none were submitted");
      Result<uint32_t> r = channel_->waitAny(std::span(pending.data(), n));
      if (r) return {};
      if (Result<void> again = recover(r.error()); !again) return again;
    }
  }

  void release(RayQuery* q) override {
    Slot* s = find(q);
    if (!s || s->state == SlotState::kSubmitted) return;  // the server's
    if (s->block != kNoBlock) channel_->release(s->block);
    s->state = SlotState::kFree;
    s->query = s->shared = nullptr;
    s->block = kNoBlock;
    s->home.reset();
  }

 private:
  static constexpr uint32_t kNoBlock = ~0u;
  enum class SlotState : uint8_t { kFree, kFilling, kSubmitted, kAnswered };
  struct Slot {
    RayQuery* query = nullptr;                 // what the caller sees
    std::shared_ptr<shm::ClientChannel> home;  // whose memory that is
    RayQuery* shared = nullptr;                // the block in the present channel: mostly the same
    uint32_t block = kNoBlock;                 // its index
    SlotState state = SlotState::kFree;
    RayKind kind{};
    uint32_t count = 0;
    int deaths = 0;      // tracers that died since it was submitted
    uint64_t order = 0;  // of submission
  };

  void open() {
    if (channel_ || error_) return;
    auto line = state_->process.open();
    if (line)
      channel_ = std::move(line->channel), life_ = line->life;
    else
      error_ = std::move(line).error();
  }

  /// Gives the slot a block of the present channel.
  bool takeBlock(Slot& s) {
    const std::optional<uint32_t> index = channel_->acquire();
    if (!index) return false;
    const std::span<std::byte> bytes = channel_->data(*index);
    if (bytes.size() < sizeof(RayQuery)) return false;
    s.block = *index;
    s.shared = reinterpret_cast<RayQuery*>(bytes.data());
    return true;
  }

  /// Puts a submitted slot into the ring. Errors: the channel's.
  Result<void> send(Slot& s) {
    if (s.block == kNoBlock) {
      // As many blocks as slots, so there is one.
      if (!takeBlock(s))
        return channel_->error() ? *channel_->error() : makeError(RiError::kBug, "no block for a question");
      copyQuestion(*s.query, *s.shared);
    }
    return channel_->submit(s.block);
  }

  /// The channel broke: brings everything that is in flight to the next tracer. Errors: for good.
  Result<void> recover(Error why) {
    std::vector<Slot*> flying;
    for (Slot& s : slots_)
      if (s.state == SlotState::kSubmitted) flying.push_back(&s);
    std::sort(flying.begin(), flying.end(), [](const Slot* a, const Slot* b) { return a->order < b->order; });
    for (;;) {
      // What the dead one had finished counts.
      std::erase_if(flying, [&](Slot* s) { return answered(s->query); });
      for (Slot* s : flying)
        if (++s->deaths >= kMostDeathsOfABlock) return fail(tooManyDeaths());
      auto line = state_->process.openAfter(life_, why);
      if (!line) return fail(std::move(line).error());
      channel_ = std::move(line->channel), life_ = line->life;
      noted_ = false;
      for (Slot& s : slots_) s.block = kNoBlock, s.shared = nullptr;
      Result<void> sent;
      for (Slot* s : flying)
        if (sent = send(*s); !sent) break;
      if (sent) return {};
      why = std::move(sent).error();
    }
  }

  Slot* find(const RayQuery* q) const {
    for (Slot& s : slots_)
      if (q && s.query == q) return &s;
    return nullptr;
  }
  void noteAnswer() const {
    if (!noted_) state_->process.noteAnswer(life_), noted_ = true;
  }
  Error fail(Error e) {
    error_ = std::move(e);
    return *error_;
  }
  static Error tooManyDeaths() {
    return makeError(RiError::kSystem, "{} ray tracer processes died over the same questions",
                     kMostDeathsOfABlock);
  }
  static void makeMisses(Slot& s) {
    RayQuery& q = *s.query;
    const float value = s.kind == RayKind::kVisibility ? 1.0f : 0.0f;
    for (uint32_t i = 0; i < s.count; ++i) {
      q.hitDistance[i] = s.kind == RayKind::kHitTest ? kNoHit : kNoHitFullTrace;
      q.missDepth[i] = 0;
      q.hitNode[i] = cache::kNone;
      for (int c = 0; c < 3; ++c)
        q.color[c][i] = value, q.hitP[c][i] = q.hitN[c][i] = q.missP[c][i] = q.missR[c][i] = 0;
    }
  }

  std::shared_ptr<ShmOracleService::State> state_;
  std::shared_ptr<shm::ClientChannel> channel_;
  uint64_t life_ = 0;                               // of the tracer at its other end
  mutable std::array<Slot, kBlocksPerLine> slots_;  // mutable: answered() notes what it finds
  mutable bool noted_ = false;                      // that this tracer answers
  uint64_t nextOrder_ = 0;
  std::optional<Error> error_;
  std::unique_ptr<RayQuery> orphan_;
};

ShmOracleService::ShmOracleService(cache::SceneCache& cache, Options options)
    : state_(std::make_shared<State>(cache, std::move(options))) {}

ShmOracleService::~ShmOracleService() = default;

Result<std::unique_ptr<RayOracle>> ShmOracleService::connect() {
  return std::unique_ptr<RayOracle>(std::make_unique<ShmOracle>(state_));
}

std::optional<TracerStatistics> ShmOracleService::statistics() { return state_->process.statistics(); }
int ShmOracleService::processId() const { return state_->process.processId(); }
uint64_t ShmOracleService::restarts() const { return state_->process.restarts(); }

}  // namespace fr::tracer
