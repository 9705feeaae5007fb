#include "tracer/server.h"

#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <cstring>
#include <new>
#include <system_error>
#include <thread>
#include <vector>

#include "shm/channel_server.h"
#include "shm/hang_up.h"
#include "shm/pager.h"
#include "tracer/server_messages.h"

namespace fr::tracer {
namespace {

using std::chrono::milliseconds;

/// The control thread sleeps until something is said. The end of the client is noticed at once (hang-up).
constexpr milliseconds kForever{-1};
constexpr int kMostThreads = 1024;

/// operator new's last resort: nobody can go on without memory, and the client shall know why we ended.
[[noreturn]] void outOfMemory() {
  static constexpr char kText[] = "rendrib: error: out of memory\n";  // no allocation here
  (void)!::write(STDERR_FILENO, kText, sizeof kText - 1);
  ::_exit(kOutOfMemoryStatus);
}

/// What the channel server calls from its threads.
class Handler : public shm::ChannelHandler {
 public:
  explicit Handler(RayTracer& tracer) : tracer_(tracer) {}

  shm::Served serveBlock(const shm::ServedBlock& block) override {
    if (block.bytes.size() < sizeof(RayQuery)) return shm::Served::kFailed;
    workplace().answer(*reinterpret_cast<RayQuery*>(block.bytes.data()));
    return shm::Served::kDone;
  }
  int serveMail(uint64_t, void*, std::span<const std::byte> request,
                std::span<std::byte, shm::kMailBytes> bytes) override {
    SingleRayMail mail;
    SingleAnswer answer;
    if (!readSingleRay(request, mail) || !workplace().answerOne(mail, answer)) return -1;
    const size_t size = singleAnswerBytes(RayKind(mail.ray.kind));
    std::memcpy(bytes.data(), &answer, size);
    return int(size);
  }
  void mailAnswered() override { workplace().publishCounts(); }
  void channelEnded(uint64_t, void*, const Error* error) override {
    if (error) report(*error);
  }

 private:
  /// One per thread; the threads end before the tracer does.
  AnswerThread& workplace() {
    thread_local std::unique_ptr<AnswerThread> thread;
    if (!thread) {
      // Better no answer than misses everywhere: the client would take them for the scene. The reason was
      // reported.
      if (const Result<void> r = tracer_.prepare(); !r)
        ::_exit(r.error().code == RiError::kNoMem ? kOutOfMemoryStatus : kUntraceableStatus);
      thread = std::make_unique<AnswerThread>(tracer_);
    }
    return *thread;
  }

  RayTracer& tracer_;
};

class Server {
 public:
  explicit Server(shm::PeerSocket parent) : parent_(std::move(parent)) {}

  Result<void> run() {
    Result<void> r = talk();
    if (!r) {
      if (parent_.alive())
        (void)sendMessage(parent_, MessageType::kRefused, {}, r.error().message);
      else
        r = {};  // the client is gone, in the middle of something: that is no fault to be reported
    }
    stop();
    return r;
  }

 private:
  Result<void> talk() {
    for (;;) {
      auto got = receiveMessage(parent_, kForever);
      if (!got) {
        if (!parent_.alive()) return {};  // the client is gone: so are we
        return std::move(got).error();
      }
      if (!*got) continue;
      ReceivedMessage& m = **got;
      switch (m.type) {
        case MessageType::kPath:
          options_.shaderPath.emplace_back(m.text());
          break;
        case MessageType::kScratch:
          scratch_ = m.text();
          break;
        case MessageType::kScene:
          if (Result<void> r = openScene(m); !r) return r;
          break;
        case MessageType::kChannel:
          if (Result<void> r = addChannel(m); !r) return r;
          break;
        case MessageType::kStatistics:
          if (Result<void> r = sendNumbers(); !r) return r;
          break;
        case MessageType::kGoodbye:
          stop();
          return sendNumbers();
        default:
          return makeError(RiError::kBadFile, "unexpected message {} from the renderer", uint32_t(m.type));
      }
    }
  }

  Result<void> openScene(ReceivedMessage& m) {
    SceneMessage scene;
    if (tracer_ || m.descriptors.size() != 3 || !m.read(scene))
      return makeError(RiError::kBadFile, "the renderer's description of the scene is damaged");
    options_.standardShaders = m.text(sizeof scene);
    options_.tracerSide = true;
    if (scene.memoryBudget > 0) {
      auto started = shm::Pager::start(scene.memoryBudget);
      if (!started) return std::move(started).error();
      pager_ = std::move(started).value();
    }
    auto cache = cache::SceneCache::attach(
        {m.descriptors[0].get(), m.descriptors[1].get(), m.descriptors[2].get()}, false, scratch_);
    if (!cache) return std::move(cache).error();
    cache_ = std::move(cache).value();
    options_.textureKilobytes = uint32_t(std::min<uint64_t>(scene.memoryBudget / 8 / 1024, 1u << 30));
    shading_ = std::make_unique<ShadingSystem>(*cache_, options_);
    shading_->loadShaders(cache::kForTracer);
    cache_->setDisplacer(&shading_->displacer());
    const int threads = std::clamp(scene.threads, 1, kMostThreads);
    RayTracerOptions options;
    options.maxRayLevel = scene.maxRayLevel;
    options.scene.patchMultiplier = scene.patchMultiplier;
    options.scene.threads = threads;
    tracer_ = std::make_unique<RayTracer>(*cache_, *shading_, options);
    if (pager_) {
      pager_->setHooks({[parent = ::getppid()] { return parent; },
                        [tracer = tracer_.get()](uint64_t wanted) { return tracer->giveBack(wanted); }});
    }
    handler_ = std::make_unique<Handler>(*tracer_);
    auto server = shm::ChannelServer::create(*handler_);
    if (!server) return std::move(server).error();
    server_ = std::move(server).value();
    try {
      for (int i = 0; i < threads; ++i) threads_.emplace_back([this] { server_->run(); });
    } catch (const std::system_error& e) {
      if (threads_.empty()) return makeError(RiError::kSystem, "no thread can be started: {}", e.what());
      reportWarning(RiError::kSystem, "only {} of {} threads could be started: {}", threads_.size(), threads,
                    e.what());
    }
    auto board = server_->board()->share();
    if (!board) return std::move(board).error();
    const int fd = board->get();
    return sendMessage(parent_, MessageType::kReady, {}, {}, std::span(&fd, 1));
  }

  Result<void> addChannel(ReceivedMessage& m) {
    if (!server_ || m.descriptors.size() != 1)
      return makeError(RiError::kBadFile, "a channel came without a scene or a descriptor");
    auto id = server_->add(std::move(m.descriptors[0]));
    if (!id) return std::move(id).error();
    return sendMessage(parent_, MessageType::kAdded);
  }

  Result<void> sendNumbers() {
    const TracerStatistics s = tracer_ ? tracer_->statistics() : TracerStatistics{};
    return sendMessage(parent_, MessageType::kNumbers, std::as_bytes(std::span(&s, 1)));
  }

  void stop() {
    if (server_) server_->stop();
    for (std::thread& t : threads_) t.join();
    threads_.clear();
  }

  shm::PeerSocket parent_;
  ShadingSystem::Options options_;
  std::string scratch_;
  std::unique_ptr<cache::SceneCache> cache_;
  std::unique_ptr<ShadingSystem> shading_;
  std::unique_ptr<RayTracer> tracer_;
  std::unique_ptr<shm::Pager> pager_;
  std::unique_ptr<Handler> handler_;
  std::unique_ptr<shm::ChannelServer> server_;
  std::vector<std::thread> threads_;
};

}  // namespace

Result<void> serveParent(shm::PeerSocket parent) {
  for (const int s : {SIGINT, SIGHUP, SIGPIPE, SIGXFSZ}) ::signal(s, SIG_IGN);
  std::set_new_handler(outOfMemory);
  try {
    // Ends the process when the client is gone, whatever the other threads are doing: building a tree or
    // shading a hit may take minutes. Nothing needs tidying up: memory and descriptors go with the process,
    // and claims on cache nodes are taken over from the dead. The end of the client is no fault to be
    // reported.
    const auto watch = shm::HangUpWatch::start(parent.descriptor(), [] { ::_exit(0); });
    if (!watch) return watch.error();
    return Server(std::move(parent)).run();
  } catch (const std::exception& e) {
    return makeError(RiError::kSystem, "{}", e.what());
  }
}

}  // namespace fr::tracer
