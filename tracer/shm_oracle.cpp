#include "tracer/shm_oracle.h"

#include <unistd.h>

#include <array>
#include <mutex>
#include <thread>

#include "shm/channel.h"
#include "tracer/inproc_oracle.h"
#include "tracer/server_messages.h"

namespace fr::tracer {

using std::chrono::milliseconds;

namespace {

/// A tracer that answers nothing on its socket for so long, though it lives, is stuck. Loading shaders comes
/// before the first answer, building the ray scene does not.
constexpr milliseconds kConversation{60000};

std::string programBeside(const char* name) {
  char path[4096];
  const ssize_t n = readlink("/proc/self/exe", path, sizeof path - 1);
  if (n <= 0) return name;
  std::string s(path, size_t(n));
  return s.substr(0, s.rfind('/') + 1) + name;
}

}  // namespace

/// The process and the conversation with it, shared with the lines.
struct ShmOracleService::State {
  cache::SceneCache& cache;
  Options options;
  std::mutex mutex;  // all below
  std::optional<shm::ChildProcess> child;
  std::shared_ptr<shm::ServerBoard> board;
  std::optional<Error> failed;  // for good

  State(cache::SceneCache& c, Options o) : cache(c), options(std::move(o)) {}

  /// How the tracer ended, as one sentence. REQUIRES mutex.
  Error gone() {
    if (!failed) {
      std::string how = "does not answer";
      if (child) {
        child->wait(milliseconds(200));  // a socket closes a moment before its process can be reaped
        how = child->statusText();
        if (how.starts_with("killed"))
          how = "was " + how;
        else if (how == "running")
          how = "does not answer";
      }
      failed = makeError(RiError::kSystem, "the ray tracer process {}", how);
    }
    return *failed;
  }

  /// Sends and waits for the answer of type `wanted`. REQUIRES mutex, child.
  Result<ReceivedMessage> converse(MessageType type, MessageType wanted, std::span<const std::byte> body = {},
                                   std::string_view text = {}, std::span<const int> fds = {}) {
    shm::PeerSocket& socket = child->socket();
    if (!sendMessage(socket, type, body, text, fds)) return gone();
    auto got = receiveMessage(socket, kConversation);
    if (!got) return got.error().code == RiError::kVersion ? std::move(got).error() : gone();
    if (!*got) return gone();
    if ((**got).type == MessageType::kRefused)
      return makeError(RiError::kSystem, "the ray tracer process refused: {}", (**got).text());
    if ((**got).type != wanted)
      return makeError(RiError::kBadFile, "the ray tracer process gave an answer that was not asked for");
    return std::move(**got);
  }

  /// REQUIRES mutex.
  Result<void> start() {
    if (failed) return *failed;
    if (board) return {};
    Result<void> r = startProcess();
    if (!r && !failed) failed = r.error();
    return r;
  }

  Result<void> startProcess() {
    shm::SpawnOptions spawn;
    spawn.program = options.program.empty() ? programBeside("rendrib") : options.program;
    spawn.arguments = options.arguments;
    auto started = shm::ChildProcess::spawn(spawn);
    if (!started) return std::move(started).error().context("the ray tracer cannot be started");
    child.emplace(std::move(started).value());
    for (const std::string& path : options.shaderPath)
      if (Result<void> r = sendMessage(child->socket(), MessageType::kPath, {}, path); !r)
        return r.error().code == RiError::kRange ? std::move(r).error() : gone();
    SceneMessage scene{};
    scene.threads =
        options.threads > 0 ? options.threads : int(std::max(1u, std::thread::hardware_concurrency()));
    scene.maxRayLevel = options.maxRayLevel;
    scene.patchMultiplier = options.patchMultiplier;
    const auto fds = cache.segments();
    const std::array<int, 3> three{fds.skeleton, fds.nodes, fds.arena};
    auto ready = converse(MessageType::kScene, MessageType::kReady, std::as_bytes(std::span(&scene, 1)),
                          options.standardShaders, three);
    if (!ready) return std::move(ready).error();
    if (ready->descriptors.size() != 1)
      return makeError(RiError::kBadFile, "the ray tracer process sent no board");
    auto attached = shm::ServerBoard::attach(std::move(ready->descriptors[0]));
    if (!attached) return std::move(attached).error();
    board = std::move(attached).value();
    return {};
  }

  Result<shm::ClientChannel> openChannel() {
    std::lock_guard lock(mutex);
    if (Result<void> r = start(); !r) return std::move(r).error();
    shm::ClientChannel::Options o;
    o.config.blockCount = kBlocksPerLine;
    o.config.blockBytes = sizeof(RayQuery);
    // The child stays in place until the state ends, and lines hold the state.
    o.serverAlive = [process = &*child] { return process->alive(); };
    auto channel = shm::ClientChannel::create(board, std::move(o));
    if (!channel) return std::move(channel).error();
    auto fd = channel->share();
    if (!fd) return std::move(fd).error();
    const int one = fd->get();
    auto added = converse(MessageType::kChannel, MessageType::kAdded, {}, {}, std::span(&one, 1));
    if (!added) return std::move(added).error();
    return channel;
  }

  /// What to tell a line whose channel broke.
  Error explain(const Error& channelError) {
    std::lock_guard lock(mutex);
    if (failed) return *failed;
    if (child && !child->alive()) return gone();
    return channelError;
  }
};

/// One line. Blocks live in the channel; before there is one, and after it broke, in a private block that can
/// be filled but not submitted.
class ShmOracle : public RayOracle {
 public:
  explicit ShmOracle(std::shared_ptr<ShmOracleService::State> state) : state_(std::move(state)) {}

  /// Through the channel's mailbox: one line there and back.
  Result<SingleAnswer> ask(const SingleRayMail& ray) override {
    if (ray.ray.kind > uint32_t(RayKind::kFullTrace))
      return makeError(RiError::kRange, "{} is no kind of ray", ray.ray.kind);
    open();
    if (error_) return *error_;
    const RayKind kind = RayKind(ray.ray.kind);
    std::array<std::byte, shm::kMailBytes> bytes;
    const Result<uint32_t> n = channel_->call(singleRayBytes(ray), bytes);
    if (!n) return channel_->error() ? fail(n.error()) : n.error();
    SingleAnswer answer;
    if (!readSingleAnswer(std::span(bytes).first(*n), kind, answer))
      return makeError(RiError::kConsistency, "the ray tracer's answer to a single ray has {} bytes", *n);
    return answer;
  }

  RayQuery* acquire() override {
    open();
    if (error_) {
      if (!orphan_) orphan_ = std::make_unique<RayQuery>();
      return orphan_.get();
    }
    const std::optional<uint32_t> index = channel_->acquire();
    if (!index) return nullptr;
    const std::span<std::byte> bytes = channel_->data(*index);
    if (bytes.size() < sizeof(RayQuery) || *index >= slots_.size()) return nullptr;
    slots_[*index] = {reinterpret_cast<RayQuery*>(bytes.data()), SlotState::kFilling};
    return slots_[*index].query;
  }

  Result<void> submit(RayQuery* q) override {
    if (error_) return *error_;
    const int i = find(q);
    if (i < 0 || slots_[size_t(i)].state != SlotState::kFilling)
      return makeError(RiError::kBadHandle, "a block of rays was submitted that was not acquired");
    if (Result<void> r = channel_->submit(uint32_t(i)); !r) return fail(r.error());
    slots_[size_t(i)].state = SlotState::kSubmitted;
    return {};
  }

  bool answered(const RayQuery* q) const override {
    const int i = find(q);
    if (i < 0) return false;
    Slot& s = slots_[size_t(i)];
    if (s.state == SlotState::kSubmitted && !error_) {
      switch (channel_->poll(uint32_t(i))) {
        case shm::BlockStatus::kDone:
          s.state = SlotState::kAnswered;
          break;
        case shm::BlockStatus::kFailed:  // the server would not have it: nothing was hit
          makeMisses(*s.query);
          s.state = SlotState::kAnswered;
          break;
        default:
          break;
      }
    }
    return s.state == SlotState::kAnswered;
  }

  Result<void> wait() override {
    if (error_) return *error_;
    std::array<uint32_t, kBlocksPerLine> pending;
    size_t n = 0;
    for (uint32_t i = 0; i < slots_.size(); ++i) {
      if (slots_[i].state == SlotState::kAnswered) return {};
      if (slots_[i].state == SlotState::kSubmitted) pending[n++] = i;
    }
    if (n == 0) return makeError(RiError::kIllState, "waiting for rays, but none were submitted");
    Result<uint32_t> r = channel_->waitAny(std::span(pending.data(), n));
    if (!r) return fail(r.error());
    return {};
  }

  void release(RayQuery* q) override {
    const int i = find(q);
    if (i < 0) return;
    Slot& s = slots_[size_t(i)];
    if (s.state == SlotState::kSubmitted) return;  // the server's
    channel_->release(uint32_t(i));
    s = {};
  }

 private:
  enum class SlotState : uint8_t { kFree, kFilling, kSubmitted, kAnswered };
  struct Slot {
    RayQuery* query = nullptr;
    SlotState state = SlotState::kFree;
  };

  void open() {
    if (channel_ || error_) return;
    auto opened = state_->openChannel();
    if (opened)
      channel_.emplace(std::move(opened).value());
    else
      error_ = std::move(opened).error();
  }
  int find(const RayQuery* q) const {
    for (size_t i = 0; i < slots_.size(); ++i)
      if (q && slots_[i].query == q) return int(i);
    return -1;
  }
  Error fail(const Error& e) {
    error_ = state_->explain(e);
    return *error_;
  }
  static void makeMisses(RayQuery& q) {
    const uint32_t n = std::min(q.count, kMaxRays);
    const float value = q.kind == RayKind::kVisibility ? 1.0f : 0.0f;
    for (uint32_t i = 0; i < n; ++i) {
      q.hitDistance[i] = q.kind == RayKind::kHitTest ? kNoHit : kNoHitFullTrace;
      q.missDepth[i] = 0;
      for (int c = 0; c < 3; ++c)
        q.color[c][i] = value, q.hitP[c][i] = q.hitN[c][i] = q.missP[c][i] = q.missR[c][i] = 0;
    }
  }

  std::shared_ptr<ShmOracleService::State> state_;
  mutable std::optional<shm::ClientChannel> channel_;
  mutable std::array<Slot, kBlocksPerLine> slots_;
  std::optional<Error> error_;
  std::unique_ptr<RayQuery> orphan_;
};

ShmOracleService::ShmOracleService(cache::SceneCache& cache, Options options)
    : state_(std::make_shared<State>(cache, std::move(options))) {}

ShmOracleService::~ShmOracleService() {
  std::lock_guard lock(state_->mutex);
  // Orderly: the tracer ends its threads. ~ChildProcess sees to the rest.
  if (state_->child && state_->board && !state_->failed)
    (void)state_->converse(MessageType::kGoodbye, MessageType::kNumbers);
}

Result<std::unique_ptr<RayOracle>> ShmOracleService::connect() {
  return std::unique_ptr<RayOracle>(std::make_unique<ShmOracle>(state_));
}

std::optional<TracerStatistics> ShmOracleService::statistics() {
  std::lock_guard lock(state_->mutex);
  if (!state_->child || !state_->board || state_->failed) return {};
  auto numbers = state_->converse(MessageType::kStatistics, MessageType::kNumbers);
  TracerStatistics s;
  if (!numbers || !numbers->read(s)) return {};
  return s;
}

int ShmOracleService::processId() const {
  std::lock_guard lock(state_->mutex);
  return state_->child && state_->child->alive() ? int(state_->child->pid()) : 0;
}

}  // namespace fr::tracer
