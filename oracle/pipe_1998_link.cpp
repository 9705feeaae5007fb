// A RayClient to a server that speaks only what BMRT's spoke: one ray at a time, world-space floats.
#include <atomic>
#include <mutex>

#include "oracle/client_link.h"
#include "oracle/pipe_codec.h"
#include "oracle/pipe_io.h"

namespace fr {
namespace {

class Link1998 : public RayClient::Link {
 public:
  Link1998(PipeEnds ends, const RayClientOptions& options) : options_(options), ends_(std::move(ends)) {}
  ~Link1998() override {
    ends_.toServer.reset();
    ends_.child.wait(shm::ChildProcess::kGrace);
  }

  RayTransport transport() const override { return RayTransport::kPipe1998; }
  Result<std::unique_ptr<RayOracle>> connect() override;
  Result<RayServerNumbers> numbers() override {
    return makeError(RiError::kIncapable, "a ray server of 1998 keeps no statistics");
  }
  bool alive() const override { return !gone_.load(std::memory_order_relaxed); }
  int processId() const override { return int(ends_.child.pid()); }

  /// One ray; fulltrace is two.
  Result<SingleAnswer> ask(const SingleRayMail& m) {
    std::lock_guard lock(mutex_);
    const RayKind kind = RayKind(m.ray.kind);
    if (kind != RayKind::kFullTrace) return askOne(kind, m.ray);
    auto geometry = askOne(RayKind::kHitTest, m.ray);
    if (!geometry) return geometry;
    SingleAnswer a = *geometry;
    if (a.hitDistance < kNoHitFullTrace) {
      auto color = askOne(RayKind::kTrace, m.ray);
      if (!color) return color;
      for (int c = 0; c < 3; ++c) a.color[c] = color->color[c];
    } else {
      a.hitDistance = kNoHitFullTrace;
      a.missDepth = 1;
      for (int c = 0; c < 3; ++c) a.missP[c] = m.ray.origin[c], a.missR[c] = m.ray.direction[c];
    }
    return a;
  }

 private:
  /// REQUIRES mutex_.
  Result<SingleAnswer> askOne(RayKind kind, const SingleRay& r) {
    if (failed_) return *failed_;
    PipeQuery q;
    q.kind = kind;
    for (size_t c = 0; c < 3; ++c) {
      q.values[c] = r.origin[c];
      q.values[3 + c] = kind == RayKind::kVisibility ? r.origin[c] + r.direction[c] : r.direction[c];
    }
    q.values[6] = r.time;
    q.values[7] = 0.5f;
    std::vector<std::byte> bytes;
    putPipeQuery(bytes, q);
    if (!writePipe(ends_.toServer.get(), bytes)) return fail();
    std::array<std::byte, 28> reply;
    const size_t wanted = pipeReplyBytes(kind);
    for (size_t have = 0; have < wanted;) {
      auto n = readPipe(ends_.fromServer.get(), std::span(reply).subspan(have, wanted - have), -1);
      if (!n || *n == 0) return fail();
      have += *n;
    }
    SingleAnswer a;
    readPipeReply(std::span(reply).first(wanted), kind, WorldSpace(), a);
    return a;
  }
  Error fail() {
    if (!failed_) failed_ = serverGone(&ends_.child);
    gone_ = true;
    return *failed_;
  }

  const RayClientOptions options_;
  PipeEnds ends_;
  std::atomic<bool> gone_{false};
  std::mutex mutex_;
  std::optional<Error> failed_;
};

/// Answers in submit().
class Line1998 : public RayOracle {
 public:
  Line1998(std::shared_ptr<Link1998> link, uint32_t blocks) : link_(std::move(link)), slots_(blocks) {}

  Result<SingleAnswer> ask(const SingleRayMail& ray) override {
    if (ray.ray.kind > uint32_t(RayKind::kFullTrace))
      return makeError(RiError::kRange, "{} is no kind of ray", ray.ray.kind);
    return link_->ask(ray);
  }
  RayQuery* acquire() override {
    for (Slot& s : slots_) {
      if (s.used) continue;
      if (!s.query) s.query = std::make_unique<RayQuery>();
      s.used = true, s.answered = false;
      s.query->terms = RayTerms{};
      return s.query.get();
    }
    return nullptr;
  }
  Result<void> submit(RayQuery* q) override {
    Slot* slot = find(q);
    if (!slot || slot->answered)
      return makeError(RiError::kBadHandle, "a block of rays was submitted that was not acquired");
    if (uint32_t(q->kind) > uint32_t(RayKind::kFullTrace))
      return makeError(RiError::kRange, "{} is no kind of ray", uint32_t(q->kind));
    SingleRayMail m;
    m.ray.kind = uint8_t(q->kind);
    for (uint32_t i = 0; i < std::min(q->count, kMaxRays); ++i) {
      for (int c = 0; c < 3; ++c) m.ray.origin[c] = q->origin[c][i], m.ray.direction[c] = q->direction[c][i];
      m.ray.time = q->time[i];
      auto a = link_->ask(m);
      if (!a) return std::move(a).error();
      q->hitDistance[i] = a->hitDistance, q->missDepth[i] = a->missDepth, q->hitNode[i] = a->hitNode;
      for (int c = 0; c < 3; ++c) {
        q->color[c][i] = a->color[c];
        q->hitP[c][i] = a->hitP[c], q->hitN[c][i] = a->hitN[c];
        q->missP[c][i] = a->missP[c], q->missR[c][i] = a->missR[c];
      }
    }
    slot->answered = true;
    return {};
  }
  bool answered(const RayQuery* q) const override {
    const Slot* s = const_cast<Line1998*>(this)->find(q);
    return s && s->answered;
  }
  Result<void> wait() override {
    for (const Slot& s : slots_)
      if (s.used && s.answered) return {};
    return makeError(RiError::kIllState, "waiting for rays, but none were submitted");
  }
  void release(RayQuery* q) override {
    if (Slot* s = find(q)) s->used = false;
  }

 private:
  struct Slot {
    std::unique_ptr<RayQuery> query;
    bool used = false, answered = false;
  };
  Slot* find(const RayQuery* q) {
    for (Slot& s : slots_)
      if (s.used && s.query.get() == q) return &s;
    return nullptr;
  }
  std::shared_ptr<Link1998> link_;
  std::vector<Slot> slots_;
};

Result<std::unique_ptr<RayOracle>> Link1998::connect() {
  return std::unique_ptr<RayOracle>(std::make_unique<Line1998>(
      std::static_pointer_cast<Link1998>(shared_from_this()), std::clamp(options_.blocksPerLine, 1u, 64u)));
}

}  // namespace

LinkPtr openLink1998(PipeEnds ends, const RayClientOptions& options) {
  return std::make_shared<Link1998>(std::move(ends), options);
}

}  // namespace fr
