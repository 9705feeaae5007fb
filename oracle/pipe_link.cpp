// A RayClient over pipes: frames with ids, multiplexed over one connection.
//
// One connection for all threads of the client, because a connection is a server and a server is a scene in
// memory. A thread of ours reads all answers and hands them to the lines, so that the server can always write
// and a client thread that is stuck in a full pipe always gets on.
#include <sys/eventfd.h>
#include <unistd.h>

#include <atomic>
#include <condition_variable>
#include <map>
#include <mutex>
#include <thread>

#include "base/version.h"
#include "oracle/client_link.h"
#include "oracle/pipe_codec.h"
#include "oracle/pipe_io.h"

namespace fr {
namespace {

using std::chrono::milliseconds;

/// Where the reading thread puts what came for a line.
struct LineMail {
  std::mutex mutex;
  std::condition_variable changed;
};
struct PipeBlock {
  std::unique_ptr<RayQuery> query = std::make_unique<RayQuery>();
  RayKind kind{};  // as asked: what the answer is checked against
  uint32_t count = 0;
  enum State : uint8_t { kFree, kFilling, kSubmitted, kAnswered };
  std::atomic<State> state{kFree};
  std::shared_ptr<LineMail> mail;
};

class PipeLink : public RayClient::Link {
 public:
  PipeLink(PipeEnds ends, const RayClientOptions& options) : options_(options), ends_(std::move(ends)) {}
  ~PipeLink() override {
    ends_.toServer.reset();  // the end of its input ends the server
    ends_.child.wait(shm::ChildProcess::kGrace);
    const uint64_t one = 1;
    if (stop_) (void)!::write(stop_.get(), &one, sizeof one);
    if (reader_.joinable()) reader_.join();
  }

  Result<void> open(const PipeWelcome& welcome) {
    stop_ = shm::FileDescriptor(::eventfd(0, EFD_CLOEXEC));
    if (!stop_) return makeError(RiError::kSystem, "cannot make an event descriptor");
    // Its greeting says which version it is, whether it fits or not.
    PipeReader reader(false);
    auto greeting = readOne(reader);
    if (!greeting) return std::move(greeting).error();
    if (welcome.version != kPipeVersion || welcome.fingerprint != pipeFingerprint())
      return makeError(
          RiError::kVersion,
          "the ray server is another build: it is {} (frames version {}, {:016x}), this is version {} "
          "(frames version {}, {:016x}); use programs of one installation",
          greeting->text(), welcome.version, welcome.fingerprint, versionText(), kPipeVersion,
          pipeFingerprint());
    auto ready = readOne(reader);
    if (!ready) return std::move(ready).error();
    if (ready->type == PipeFrameType::kRefused)
      return makeError(RiError::kSystem, "the ray server refused: {}", ready->text());
    if (ready->type != PipeFrameType::kReady || ready->body.size() != sizeof scene_)
      return makeError(RiError::kBadFile, "the ray server's description of its scene is damaged");
    std::memcpy(static_cast<void*>(&scene_), ready->body.data(), sizeof scene_);
    reader_ = std::thread([this, r = std::move(reader)]() mutable { readAnswers(r); });
    return {};
  }

  RayTransport transport() const override { return RayTransport::kPipe; }
  Result<std::unique_ptr<RayOracle>> connect() override;
  bool alive() const override { return !gone_.load(std::memory_order_acquire); }
  int processId() const override { return int(ends_.child.pid()); }

  Result<RayServerNumbers> numbers() override {
    std::unique_lock lock(mutex_);
    if (failed_) return *failed_;
    const uint32_t id = nextId_++;
    wanted_ = id, numbers_.reset();
    lock.unlock();
    std::vector<std::byte> bytes;
    putPipeFrame(bytes, PipeFrameType::kStatistics, id, {});
    if (Result<void> r = send(bytes); !r) return std::move(r).error();
    lock.lock();
    numbersCame_.wait(lock, [&] { return failed_ || (numbers_ && numbersId_ == id) || wanted_ != id; });
    if (failed_) return *failed_;
    if (!numbers_ || numbersId_ != id)
      return makeError(RiError::kIllState, "the ray server's numbers were asked for twice at once");
    return *numbers_;
  }

  /// The line's thread: registers before sending.
  Result<void> submit(const std::shared_ptr<PipeBlock>& block) {
    uint32_t id = 0;
    {
      std::lock_guard lock(mutex_);
      if (failed_) return *failed_;
      id = nextId_++;
      inFlight_[id] = block;
    }
    std::vector<std::byte> bytes;
    putPipeRays(bytes, id, options_.startsAreRoots ? kPipeStartsAreRoots : 0, *block->query);
    return send(bytes);
  }
  std::optional<Error> error() {
    std::lock_guard lock(mutex_);
    return failed_;
  }

 private:
  /// Before the reading thread runs. Waits as long as the server lives: it may be loading.
  Result<PipeFrame> readOne(PipeReader& reader) {
    std::array<std::byte, 4096> bytes;
    for (;;) {
      auto item = reader.next();
      if (!item) return std::move(item).error().context("the ray server");
      if (*item) {
        if (auto* frame = std::get_if<PipeFrame>(&**item)) return std::move(*frame);
        return makeError(RiError::kBadFile, "the ray server sent a query");
      }
      auto n = readPipe(ends_.fromServer.get(), bytes, -1);
      if (!n) return std::move(n).error();
      if (*n == 0) return serverGone(&ends_.child);
      reader.feed(std::span(bytes).first(*n));
    }
  }

  Result<void> send(std::span<const std::byte> bytes) {
    std::lock_guard lock(writing_);
    if (Result<void> r = writePipe(ends_.toServer.get(), bytes); !r) return fail({});
    return {};
  }

  /// The first error stands, and everybody who waits gets it. `why` empty: the server is gone.
  Error fail(std::optional<Error> why) {
    std::map<uint32_t, std::shared_ptr<PipeBlock>> left;
    Error e;
    {
      std::lock_guard lock(mutex_);
      if (!failed_) failed_ = why ? *why : serverGone(&ends_.child);
      e = *failed_;
      gone_.store(true, std::memory_order_release);
      left.swap(inFlight_);
      numbersCame_.notify_all();
    }
    for (auto& [id, block] : left) {
      std::lock_guard lock(block->mail->mutex);
      block->mail->changed.notify_all();
    }
    return e;
  }

  void readAnswers(PipeReader& reader) {
    std::vector<std::byte> bytes(1 << 16);
    for (;;) {
      for (;;) {
        auto item = reader.next();
        if (!item) {
          fail(std::move(item).error().context("the ray server's answers"));
          return;
        }
        if (!*item) break;
        if (auto* frame = std::get_if<PipeFrame>(&**item))
          if (Result<void> r = take(*frame); !r) {
            fail(r.error());
            return;
          }
      }
      auto n = readPipe(ends_.fromServer.get(), bytes, stop_.get());
      if (!n || *n == 0) {
        fail({});
        return;
      }
      reader.feed(std::span(bytes).first(*n));
    }
  }

  Result<void> take(const PipeFrame& frame) {
    if (frame.type == PipeFrameType::kNumbers) {
      std::lock_guard lock(mutex_);
      RayServerNumbers n;
      if (frame.body.size() != sizeof n)
        return makeError(RiError::kBadFile, "the ray server's numbers are damaged");
      std::memcpy(static_cast<void*>(&n), frame.body.data(), sizeof n);
      numbers_ = n, numbersId_ = frame.id;
      numbersCame_.notify_all();
      return {};
    }
    if (frame.type == PipeFrameType::kRefused && frame.id == 0)
      return makeError(RiError::kSystem, "the ray server refused: {}", frame.text());
    std::shared_ptr<PipeBlock> block;
    {
      std::lock_guard lock(mutex_);
      const auto at = inFlight_.find(frame.id);
      if (at == inFlight_.end())
        return makeError(RiError::kBadFile, "the ray server answered rays that were not asked");
      block = std::move(at->second);
      inFlight_.erase(at);
    }
    if (frame.type != PipeFrameType::kAnswers)
      return makeError(
          RiError::kSystem, "the ray server refused rays: {}",
          frame.type == PipeFrameType::kRefused ? frame.text() : std::string_view("another frame"));
    if (Result<void> r = readPipeAnswers(frame.body, block->kind, block->count, *block->query); !r) return r;
    // SYNC POINT: release, pairs with PipeLine::answered.
    std::lock_guard lock(block->mail->mutex);
    block->state.store(PipeBlock::kAnswered, std::memory_order_release);
    block->mail->changed.notify_all();
    return {};
  }

  const RayClientOptions options_;
  PipeEnds ends_;
  shm::FileDescriptor stop_;
  std::thread reader_;
  std::mutex writing_;  // of the pipe to the server
  std::atomic<bool> gone_{false};
  std::mutex mutex_;  // all below
  std::optional<Error> failed_;
  uint32_t nextId_ = 1;
  std::map<uint32_t, std::shared_ptr<PipeBlock>> inFlight_;
  uint32_t wanted_ = 0, numbersId_ = 0;
  std::optional<RayServerNumbers> numbers_;
  std::condition_variable numbersCame_;
};

class PipeLine : public RayOracle {
 public:
  PipeLine(std::shared_ptr<PipeLink> link, uint32_t blocks) : link_(std::move(link)), blocks_(blocks) {}

  RayQuery* acquire() override {
    for (auto& b : blocks_) {
      if (!b) b = std::make_shared<PipeBlock>(), b->mail = mail_;
      if (b->state.load(std::memory_order_relaxed) != PipeBlock::kFree) continue;
      b->state.store(PipeBlock::kFilling, std::memory_order_relaxed);
      b->query->terms = RayTerms{};
      return b->query.get();
    }
    return nullptr;
  }
  Result<void> submit(RayQuery* q) override {
    const auto b = find(q);
    if (!b || b->state.load(std::memory_order_relaxed) != PipeBlock::kFilling)
      return makeError(RiError::kBadHandle, "a block of rays was submitted that was not acquired");
    if (uint32_t(q->kind) > uint32_t(RayKind::kFullTrace))
      return makeError(RiError::kRange, "{} is no kind of ray", uint32_t(q->kind));
    q->count = std::min(q->count, kMaxRays);
    b->kind = q->kind, b->count = q->count;
    b->state.store(PipeBlock::kSubmitted, std::memory_order_relaxed);
    return link_->submit(b);
  }
  bool answered(const RayQuery* q) const override {
    const auto b = find(q);
    return b && b->state.load(std::memory_order_acquire) == PipeBlock::kAnswered;
  }
  Result<void> wait() override {
    bool submitted = false;
    std::unique_lock lock(mail_->mutex);
    for (;;) {
      submitted = false;
      for (const auto& b : blocks_) {
        if (!b) continue;
        const auto s = b->state.load(std::memory_order_acquire);
        if (s == PipeBlock::kAnswered) return {};
        submitted |= s == PipeBlock::kSubmitted;
      }
      if (!submitted) return makeError(RiError::kIllState, "waiting for rays, but none were submitted");
      if (!link_->alive()) {
        lock.unlock();
        if (auto e = link_->error()) return *e;
        return makeError(RiError::kSystem, "the ray server is gone");
      }
      mail_->changed.wait(lock);
    }
  }
  void release(RayQuery* q) override {
    const auto b = find(q);
    if (!b) return;
    if (b->state.load(std::memory_order_acquire) == PipeBlock::kSubmitted && link_->alive())
      return;  // the server's
    b->state.store(PipeBlock::kFree, std::memory_order_relaxed);
  }

 private:
  std::shared_ptr<PipeBlock> find(const RayQuery* q) const {
    for (const auto& b : blocks_)
      if (b && q && b->query.get() == q) return b;
    return nullptr;
  }
  std::shared_ptr<PipeLink> link_;
  std::shared_ptr<LineMail> mail_ = std::make_shared<LineMail>();
  std::vector<std::shared_ptr<PipeBlock>> blocks_;
};

Result<std::unique_ptr<RayOracle>> PipeLink::connect() {
  if (auto e = error()) return *e;
  return std::unique_ptr<RayOracle>(std::make_unique<PipeLine>(
      std::static_pointer_cast<PipeLink>(shared_from_this()), std::clamp(options_.blocksPerLine, 1u, 64u)));
}

}  // namespace

Result<LinkPtr> openFramedLink(PipeEnds ends, const PipeWelcome& welcome, const RayClientOptions& options) {
  auto link = std::make_shared<PipeLink>(std::move(ends), options);
  if (Result<void> r = link->open(welcome); !r) return std::move(r).error();
  return LinkPtr(std::move(link));
}

}  // namespace fr
