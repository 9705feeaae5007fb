#include "tracer/tracer_process.h"

#include <signal.h>
#include <unistd.h>

#include <array>
#include <thread>

#include "base/cores.h"
#include "shm/memory_info.h"
#include "tracer/inproc_oracle.h"
#include "tracer/server.h"

namespace fr::tracer {

using std::chrono::milliseconds;

namespace {

/// A tracer that answers nothing on its socket for so long, though it lives, is stuck. Loading shaders comes
/// before the first answer, building the ray scene does not.
constexpr milliseconds kConversation{60000};
/// A socket closes a moment before its process can be reaped, and a server leaves its board before it ends.
constexpr milliseconds kDying{200};
/// How often a waiting line looks after the tracer itself: a hang-up tells it at once, so seldom.
constexpr milliseconds kLookUp{1000};

std::string programBeside(const char* name) {
  char path[4096];
  const ssize_t n = readlink("/proc/self/exe", path, sizeof path - 1);
  if (n <= 0) return name;
  std::string s(path, size_t(n));
  return s.substr(0, s.rfind('/') + 1) + name;
}

/// Before the start that follows `deaths` deaths in a row: 0, 20, 80, 320 ms.
milliseconds pauseAfter(int deaths) {
  return deaths < 2 ? milliseconds(0) : milliseconds(20) * (1 << (2 * (deaths - 2)));
}

/// Errors of a conversation that end with the next tracer: the other end is gone.
bool isDeath(const Error& e) { return e.code == RiError::kSystem; }

}  // namespace

TracerProcess::TracerProcess(cache::SceneCache& cache, ShmOracleService::Options options)
    : cache_(cache), options_(std::move(options)) {}

TracerProcess::~TracerProcess() {
  const std::lock_guard lock(mutex_);
  // Orderly: the tracer ends its threads.
  if (child_ && board_ && !failed_) (void)converse(MessageType::kGoodbye, MessageType::kNumbers);
}

int TracerProcess::processId() const { return pid_.load(std::memory_order_relaxed); }

std::optional<TracerStatistics> TracerProcess::statistics() {
  const std::lock_guard lock(mutex_);
  if (!child_ || !board_ || failed_) return {};
  auto numbers = converse(MessageType::kStatistics, MessageType::kNumbers);
  TracerStatistics s;
  if (!numbers || !numbers->read(s)) return {};
  return s;
}

/// Sends and waits for the answer of type `wanted`. Errors: kSystem when the tracer is gone, others are for
/// good. REQUIRES mutex, child.
Result<ReceivedMessage> TracerProcess::converse(MessageType type, MessageType wanted,
                                                std::span<const std::byte> body, std::string_view text,
                                                std::span<const int> fds) {
  shm::PeerSocket& socket = child_->socket();
  if (Result<void> sent = sendMessage(socket, type, body, text, fds); !sent) return std::move(sent).error();
  auto got = receiveMessage(socket, kConversation);
  if (!got) return std::move(got).error();
  if (!*got) return makeError(RiError::kSystem, "does not answer");
  if ((**got).type == MessageType::kRefused)
    return fatal(makeError(RiError::kIncapable, "the ray tracer process refused: {}", (**got).text()));
  if ((**got).type != wanted)
    return fatal(
        makeError(RiError::kBadFile, "the ray tracer process gave an answer that was not asked for"));
  return std::move(**got);
}

Error TracerProcess::fatal(Error e) {
  if (!failed_) failed_ = std::move(e);
  return *failed_;
}

/// "was killed by signal 9 (Killed)". Ends the process if `why` is all that is wrong with it. REQUIRES mutex,
/// child.
std::string TracerProcess::howItEnded(const std::string& why) {
  if (!child_->wait(kDying)) {
    // It lives, but nobody can work with it.
    child_->signal(SIGKILL);
    child_->wait(milliseconds(2000));
    return "was ended: " + why;
  }
  std::string how = child_->statusText();
  if (how.starts_with("killed")) how = "was " + how;
  const std::optional<int> status = child_->exitStatus();
  if (status == -SIGKILL && shm::outOfMemoryKills() > outOfMemoryKills_)
    how += ", because the machine or its control group ran out of memory";
  if (status == kOutOfMemoryStatus) how += ": it ran out of memory";
  if (status == kUntraceableStatus) how += ": it cannot trace this scene";
  return how;
}

/// The tracer is dead or as good as dead. An error when there shall be no other. REQUIRES mutex, child.
Result<void> TracerProcess::bury(const std::string& why) {
  const std::string how = howItEnded(why);
  const std::optional<int> status = child_->exitStatus();
  pid_.store(0, std::memory_order_relaxed);
  watch_.reset();
  board_.reset();
  child_.reset();
  if (failed_) return *failed_;
  const bool answered = answeredLife_.load(std::memory_order_relaxed) == life_;
  deathsInARow_ = answered ? 1 : deathsInARow_ + 1;
  // What it could not do without ever having answered, the next one cannot do either.
  if (!answered && (status == kOutOfMemoryStatus || status == kUntraceableStatus))
    return fatal(makeError(status == kOutOfMemoryStatus ? RiError::kNoMem : RiError::kSystem,
                           "the ray tracer process {}", how));
  if (deathsInARow_ >= kMostDeathsInARow)
    return fatal(makeError(RiError::kSystem,
                           "the ray tracer process {}; {} of them ended without answering anything", how,
                           deathsInARow_));
  if (abortRequested()) return fatal(makeError(RiError::kSystem, "the ray tracer process {}", how));
  restarts_.fetch_add(1, std::memory_order_relaxed);
  reportWarning(RiError::kSystem,
                "the ray tracer process {}; another one is started, the picture is not affected", how);
  std::this_thread::sleep_for(pauseAfter(deathsInARow_));
  return {};
}

Result<TracerProcess::Line> TracerProcess::open() {
  const std::lock_guard lock(mutex_);
  return openLocked();
}

Result<TracerProcess::Line> TracerProcess::openAfter(uint64_t life, const Error& why) {
  const std::lock_guard lock(mutex_);
  if (life == life_ && child_)
    if (Result<void> r = bury(why.message); !r) return std::move(r).error();
  return openLocked();
}

/// REQUIRES mutex.
Result<TracerProcess::Line> TracerProcess::openLocked() {
  for (;;) {
    if (failed_) return *failed_;
    Result<void> r = child_ ? Result<void>{} : start();
    if (r && !board_) r = introduce();
    if (r) {
      Result<Line> line = addChannel();
      if (line) return line;
      r = std::move(line).error();
    }
    if (failed_ || !child_ || !isDeath(r.error())) {
      Error e = fatal(std::move(r).error());
      // A process of another build, or none of ours, is not worth a goodbye.
      if (child_ && !board_)
        (void)howItEnded({}), watch_.reset(), child_.reset(), pid_.store(0, std::memory_order_relaxed);
      return e;
    }
    if (Result<void> next = bury(r.error().message); !next) return std::move(next).error();
  }
}

/// REQUIRES mutex, no child.
Result<void> TracerProcess::start() {
  shm::SpawnOptions spawn;
  spawn.program = options_.program.empty() ? programBeside("rendrib") : options_.program;
  spawn.arguments = options_.arguments;
  outOfMemoryKills_ = shm::outOfMemoryKills();
  auto started = shm::ChildProcess::spawn(spawn);
  if (!started) return fatal(std::move(started).error().context("the ray tracer cannot be started"));
  child_ = std::make_shared<shm::ChildProcess>(std::move(started).value());
  channels_ = std::make_shared<Channels>();
  auto watch = shm::HangUpWatch::start(child_->socket().descriptor(), [channels = channels_] {
    const std::lock_guard lock(channels->mutex);
    channels->gone = true;
    for (const auto& weak : channels->list)
      if (const auto channel = weak.lock()) channel->serverIsGone();
  });
  if (!watch) return fatal(std::move(watch).error());
  watch_ = std::move(watch).value();
  ++life_;
  pid_.store(int(child_->pid()), std::memory_order_relaxed);
  return {};
}

/// Sends the scene, gets the board. REQUIRES mutex, child.
Result<void> TracerProcess::introduce() {
  for (const std::string& path : options_.shaderPath)
    if (Result<void> r = sendMessage(child_->socket(), MessageType::kPath, {}, path); !r) return r;
  if (!cache_.scratch().empty())
    if (Result<void> r = sendMessage(child_->socket(), MessageType::kScratch, {}, cache_.scratch()); !r)
      return r;
  SceneMessage scene{};
  scene.threads = options_.threads > 0 ? options_.threads : availableCores();
  scene.maxRayLevel = options_.maxRayLevel;
  scene.patchMultiplier = options_.patchMultiplier;
  scene.memoryBudget = options_.memoryBudget;
  const auto fds = cache_.segments();
  const std::array<int, 3> three{fds.skeleton, fds.nodes, fds.arena};
  auto ready = converse(MessageType::kScene, MessageType::kReady, std::as_bytes(std::span(&scene, 1)),
                        options_.standardShaders, three);
  if (!ready) return std::move(ready).error();
  if (ready->descriptors.size() != 1)
    return makeError(RiError::kBadFile, "the ray tracer process sent no board");
  auto attached = shm::ServerBoard::attach(std::move(ready->descriptors[0]));
  if (!attached) return fatal(std::move(attached).error());
  board_ = std::move(attached).value();
  return {};
}

/// REQUIRES mutex, board.
Result<TracerProcess::Line> TracerProcess::addChannel() {
  shm::ClientChannel::Options o;
  o.config.blockCount = kBlocksPerLine;
  o.config.blockBytes = sizeof(RayQuery);
  o.config.questionBytes = kQuestionBytes;
  o.wait.recheck = kLookUp;
  o.serverAlive = [process = child_] { return process->alive(); };
  auto channel = shm::ClientChannel::create(board_, std::move(o));
  if (!channel) return fatal(std::move(channel).error());
  auto fd = channel->share();
  if (!fd) return fatal(std::move(fd).error());
  const int one = fd->get();
  auto added = converse(MessageType::kChannel, MessageType::kAdded, {}, {}, std::span(&one, 1));
  if (!added) return std::move(added).error();
  auto shared = std::make_shared<shm::ClientChannel>(std::move(channel).value());
  const std::lock_guard lock(channels_->mutex);
  std::erase_if(channels_->list, [](const auto& weak) { return weak.expired(); });
  channels_->list.push_back(shared);
  if (channels_->gone) shared->serverIsGone();
  return Line{std::move(shared), life_};
}

}  // namespace fr::tracer
