#include "tracer/pipe_session.h"

#include <algorithm>
#include <chrono>
#include <cstring>

#include "base/version.h"
#include "oracle/pipe_io.h"
#include "tracer/node_address.h"

namespace fr::tracer {
namespace {

constexpr size_t kReadBytes = 1 << 16;
/// A frame of so few rays is answered sooner than a thread wakes up.
constexpr uint32_t kSmallFrame = 16;
constexpr std::chrono::milliseconds kHelloPatience{500};
constexpr size_t kFewJobs = 4;  // waiting, for each thread; then we stop reading

uint32_t rayCount(std::span<const std::byte> body) {
  uint32_t n = 0;
  if (body.size() >= 8) std::memcpy(&n, body.data() + 4, sizeof n);
  return n;
}

std::span<const std::byte> bytesOf(std::string_view text) { return std::as_bytes(std::span(text)); }

}  // namespace

PipeSession::PipeSession(const Options& options, ServerCounters& counters)
    : options_(options), counters_(counters) {}
PipeSession::~PipeSession() { finish(); }

Result<void> PipeSession::run() {
  PipeReader reader(true);
  std::vector<std::byte> bytes(kReadBytes);
  row_ = &counters_.row();
  Result<void> result;
  for (;;) {
    auto n = readPipe(options_.input, bytes, options_.stop);
    if (!n) {
      result = std::move(n).error();
      break;
    }
    if (*n == 0) {
      if (reader.pending() > 0)
        result =
            makeError(RiError::kBadFile, "the client's input ended in the middle of a query ({} bytes of it)",
                      reader.pending());
      break;
    }
    used_.store(true, std::memory_order_relaxed);
    reader.feed(std::span(bytes).first(*n));
    for (;;) {
      auto item = reader.next();
      if (!item) {
        result = std::move(item).error();
        break;
      }
      if (!*item) break;
      if (result = take(**item); !result) break;
    }
    if (!result) break;
  }
  bool framed = false;
  {
    std::lock_guard lock(mutex_);
    framed = framed_;
  }
  if (!result && framed) writeFrame(PipeFrameType::kRefused, 0, bytesOf(result.error().message));
  finish();
  return result;
}

void PipeSession::open(RayTracer& tracer, const RaySceneInfo& info) {
  bool tell = false;
  {
    std::lock_guard lock(mutex_);
    tracer_ = &tracer;
    info_ = info;
    tell = framed_;
    changed_.notify_all();
  }
  if (tell) writeFrame(PipeFrameType::kReady, 0, std::as_bytes(std::span(&info, 1)));
}

void PipeSession::refuse(const Error& why) {
  bool tell = false;
  {
    std::unique_lock lock(mutex_);
    if (refused_ || tracer_) return;
    refused_ = why;
    tell = framed_;
    changed_.notify_all();
    // A client that has just started us may be about to say hello: it shall hear why, and not only that we
    // ended.
    if (!tell) changed_.wait_for(lock, kHelloPatience, [&] { return framed_ || ended_; });
  }
  if (tell) writeFrame(PipeFrameType::kRefused, 0, bytesOf(why.message));
}

Result<void> PipeSession::take(PipeReader::Item& item) {
  if (auto* query = std::get_if<PipeQuery>(&item)) return answerQuery(*query);
  return answerFrame(std::get<PipeFrame>(item));
}

/// False: there will be no scene, or the end has come.
bool PipeSession::waitUntilOpen() {
  std::unique_lock lock(mutex_);
  changed_.wait(lock, [&] { return tracer_ || refused_ || ended_; });
  if (!tracer_ || refused_) return false;
  if (!thread_) {
    thread_ = std::make_unique<AnswerThread>(*tracer_, row_);
    block_ = std::make_unique<RayQuery>();
  }
  return true;
}

Result<void> PipeSession::answerQuery(const PipeQuery& query) {
  if (const auto hello = asPipeHello(query)) {
    std::vector<std::byte> out;
    PipeWelcome welcome;
    welcome.fingerprint = pipeFingerprint();
    const auto bytes = std::as_bytes(std::span(&welcome, 1));
    out.insert(out.end(), bytes.begin(), bytes.end());
    putPipeFrame(out, PipeFrameType::kGreeting, 0, bytesOf(std::string("version ") + versionText()));
    // One lock from here to the end: open() must not say "ready" before the greeting has gone out.
    std::lock_guard lock(mutex_);
    if (Result<void> r = write(out); !r) return r;
    if (hello->version != kPipeVersion || hello->fingerprint != pipeFingerprint())
      return makeError(
          RiError::kVersion,
          "the client is another build: its frames are version {} ({:016x}), ours {} ({:016x}); this is "
          "version {}",
          hello->version, hello->fingerprint, kPipeVersion, pipeFingerprint(), versionText());
    framed_ = true;
    changed_.notify_all();
    if (refused_) writeFrame(PipeFrameType::kRefused, 0, bytesOf(refused_->message));
    if (tracer_) writeFrame(PipeFrameType::kReady, 0, std::as_bytes(std::span(&info_, 1)));
    return {};
  }
  // Without a scene there is no answer: the end of our output tells the client.
  if (!waitUntilOpen()) return makeError(RiError::kSystem, "a ray was asked, but there is no scene");
  const WorldSpace space(info_);
  SingleAnswer answer;
  (void)thread_->answerOne(pipeQueryRay(query, space, options_.jitterTimes), answer);
  row_->add(Counter::kPipeQueries, 1);
  thread_->publishCounts();
  std::vector<std::byte> out;
  putPipeReply(out, query.kind, answer, space);
  return write(out);
}

Result<void> PipeSession::answerFrame(PipeFrame& frame) {
  switch (frame.type) {
    case PipeFrameType::kStatistics: {
      const RayServerNumbers n = counters_.read();
      std::vector<std::byte> out;
      putPipeFrame(out, PipeFrameType::kNumbers, frame.id, std::as_bytes(std::span(&n, 1)));
      return write(out);
    }
    case PipeFrameType::kRays:
      break;
    default:
      return makeError(RiError::kBadFile, "a client does not send frames of type {}", uint32_t(frame.type));
  }
  if (!waitUntilOpen()) return makeError(RiError::kSystem, "rays were asked, but there is no scene");
  bool idle = false;
  {
    std::lock_guard lock(mutex_);
    idle = jobs_.empty();
  }
  if (options_.threads <= 1 || (idle && rayCount(frame.body) <= kSmallFrame))
    return answerRays(frame.id, frame.body, *thread_, *row_, *block_);
  startThreads();
  std::unique_lock lock(mutex_);
  room_.wait(lock, [&] { return jobs_.size() < kFewJobs * threads_.size() || ended_; });
  jobs_.push_back({frame.id, std::move(frame.body)});
  changed_.notify_all();
  return {};
}

Result<void> PipeSession::answerRays(uint32_t id, std::span<const std::byte> body, AnswerThread& thread,
                                     CounterRow& row, RayQuery& block) {
  uint32_t flags = 0;
  std::vector<std::byte> out;
  if (Result<void> r = readPipeRays(body, block, flags); !r) {
    // The frame is whole, so the stream is in step: only this question has no answer.
    putPipeFrame(out, PipeFrameType::kRefused, id, bytesOf(r.error().message));
    return write(out);
  }
  if (flags & kPipeStartsAreRoots) {
    (void)tracer_->prepare();  // patches are split by it
    for (uint32_t i = 0; i < block.count; ++i) {
      if (block.node[i] == cache::kNone) continue;
      block.node[i] = nodeAt(tracer_->cache(), {block.node[i], block.cell[i]});
    }
  }
  const RayKind kind = block.kind;
  const uint32_t count = block.count;
  thread.answer(block);
  row.add(Counter::kBlocks, 1);
  row.add(Counter::kBlockRays, count);
  row.add(Counter::kPipeFrames, 1);
  block.kind = kind, block.count = count;
  putPipeAnswers(out, id, block);
  return write(out);
}

void PipeSession::startThreads() {
  std::lock_guard lock(mutex_);
  if (!threads_.empty() || ended_) return;
  for (int i = 0; i < options_.threads; ++i) threads_.emplace_back([this] { work(); });
}

void PipeSession::work() {
  CounterRow& row = counters_.row();
  std::unique_lock lock(mutex_);
  AnswerThread thread(*tracer_, &row);
  const auto block = std::make_unique<RayQuery>();
  for (;;) {
    changed_.wait(lock, [&] { return !jobs_.empty() || ended_; });
    if (jobs_.empty()) return;  // what was asked is answered before the end
    const Job job = std::move(jobs_.front());
    jobs_.pop_front();
    room_.notify_one();
    lock.unlock();
    (void)answerRays(job.id, job.body, thread, row, *block);  // a client that is gone ends run()
    lock.lock();
  }
}

void PipeSession::finish() {
  std::vector<std::thread> threads;
  {
    std::lock_guard lock(mutex_);
    ended_ = true;
    changed_.notify_all();
    room_.notify_all();
    threads.swap(threads_);
  }
  for (std::thread& t : threads) t.join();
}

Result<void> PipeSession::write(std::span<const std::byte> bytes) {
  std::lock_guard lock(writing_);
  return writePipe(options_.output, bytes);
}

void PipeSession::writeFrame(PipeFrameType type, uint32_t id, std::span<const std::byte> body) {
  std::vector<std::byte> out;
  putPipeFrame(out, type, id, body);
  (void)write(out);  // a client that is gone is found out by reading
}

}  // namespace fr::tracer
