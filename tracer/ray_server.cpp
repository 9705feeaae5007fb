#include "tracer/ray_server.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <cstring>
#include <list>
#include <mutex>
#include <thread>
#include <vector>

#include "oracle/control_message.h"
#include "shm/channel_server.h"
#include "shm/named_socket.h"
#include "tracer/pipe_session.h"

namespace fr::tracer {
namespace {

using std::chrono::milliseconds;

constexpr size_t kMostClients = 1024;
constexpr size_t kMostChannelsOfAClient = 256;
constexpr const char* kPeer = "a client";
/// A client that does not read what it asked for is not waited for.
constexpr milliseconds kPatience{2000};

/// What the channel server calls from its threads.
class Handler : public shm::ChannelHandler {
 public:
  Handler(RayTracer& tracer, ServerCounters& counters) : tracer_(tracer), counters_(counters) {}

  shm::Served serveBlock(const shm::ServedBlock& block) override {
    if (block.bytes.size() < sizeof(RayQuery)) return shm::Served::kFailed;
    Workplace& w = workplace();
    RayQuery& q = *reinterpret_cast<RayQuery*>(block.bytes.data());
    const uint32_t count = *const_cast<const volatile uint32_t*>(&q.count);
    w.thread.answer(q);
    w.row.add(Counter::kBlocks, 1);
    w.row.add(Counter::kBlockRays, std::min(count, kMaxRays));
    w.row.add(Counter::kWaiting, block.behind);
    return shm::Served::kDone;
  }
  int serveMail(uint64_t, void*, std::span<const std::byte> request,
                std::span<std::byte, shm::kMailBytes> bytes) override {
    SingleRayMail mail;
    SingleAnswer answer;
    if (!readSingleRay(request, mail)) return -1;
    Workplace& w = workplace();
    if (!w.thread.answerOne(mail, answer)) return -1;
    w.row.add(Counter::kSingles, 1);
    const size_t size = singleAnswerBytes(RayKind(mail.ray.kind));
    std::memcpy(bytes.data(), &answer, size);
    return int(size);
  }
  void mailAnswered() override { workplace().thread.publishCounts(); }
  void channelEnded(uint64_t, void*, const Error* error) override {
    if (error) report(*error);
  }

 private:
  struct Workplace {
    Workplace(RayTracer& tracer, CounterRow& r) : row(r), thread(tracer, &r) {}
    CounterRow& row;
    AnswerThread thread;
  };
  /// One per thread; the threads end before the tracer does.
  Workplace& workplace() {
    thread_local std::unique_ptr<Workplace> place;
    if (!place) place = std::make_unique<Workplace>(tracer_, counters_.row());
    return *place;
  }

  RayTracer& tracer_;
  ServerCounters& counters_;
};

Result<shm::FileDescriptor> makeEvent() {
  shm::FileDescriptor fd(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!fd) return makeError(RiError::kSystem, "cannot make an event descriptor: {}", std::strerror(errno));
  return fd;
}
void ring(const shm::FileDescriptor& event) {
  const uint64_t one = 1;
  (void)!::write(event.get(), &one, sizeof one);
}
void hush(const shm::FileDescriptor& event) {
  uint64_t n;
  (void)!::read(event.get(), &n, sizeof n);
}

/// The same file, without the right to write.
shm::FileDescriptor readOnly(int fd) {
  return shm::FileDescriptor(::open(fmt::format("/proc/self/fd/{}", fd).c_str(), O_RDONLY | O_CLOEXEC));
}

}  // namespace

/// The control thread owns listener, clients and their channels; what passes between it and the main thread
/// is under mutex_.
class RayServer::Impl {
 public:
  explicit Impl(RayServerOptions options) : options_(std::move(options)) {}

  ~Impl() {
    ring(stop_);
    if (control_.joinable()) control_.join();
    if (pipe_) pipe_->refuse(makeError(RiError::kSystem, "the ray server ends"));
    if (pipeThread_.joinable()) pipeThread_.join();
    pipe_.reset();
    if (channels_) channels_->stop();
    for (std::thread& t : threads_) t.join();
  }

  Result<void> open() {
    auto counters = ServerCounters::create();
    if (!counters) return std::move(counters).error();
    counters_ = std::move(counters).value();
    counters_->set(Gauge::kThreads, uint64_t(options_.threads));
    for (shm::FileDescriptor* event : {&stop_, &wake_}) {
      auto made = makeEvent();
      if (!made) return std::move(made).error();
      *event = std::move(made).value();
    }
    if (!options_.name.empty()) {
      auto listener = shm::NamedListener::listen(options_.name);
      if (!listener) return std::move(listener).error();
      listener_ = std::move(listener).value();
    }
    if (options_.parent) {
      clients_.emplace_back();
      clients_.back().socket = std::move(*options_.parent);
      clients_.back().isParent = true;
      clientsEver_ = 1;
    }
    if (options_.input >= 0) {
      PipeSession::Options p;
      p.input = options_.input, p.output = options_.output, p.stop = stop_.get();
      p.threads = options_.threads, p.jitterTimes = options_.jitterTimes;
      pipe_ = std::make_unique<PipeSession>(p, *counters_);
      pipeThread_ = std::thread([this] {
        Result<void> r = pipe_->run();
        if (!r) setResult(r.error());
        if (!r || pipe_->used() || !options_.outlivesSilentPipe) stop();
      });
    }
    control_ = std::thread([this] { control(); });
    return {};
  }

  Result<void> serve(RayTracer& tracer, const RaySceneInfo& scene) {
    handler_ = std::make_unique<Handler>(tracer, *counters_);
    auto server = shm::ChannelServer::create(*handler_);
    if (!server) return std::move(server).error();
    {
      std::lock_guard lock(mutex_);
      channels_ = std::move(server).value();
      scene_ = scene;
      tracer_ = &tracer;
    }
    counters_->set(Gauge::kReady, 1);
    if (pipe_) pipe_->open(tracer, scene);
    ring(wake_);
    for (int i = 0; i < options_.threads; ++i) threads_.emplace_back([this] { channels_->run(); });
    if (control_.joinable()) control_.join();  // until the end
    // The pipe client's last questions are answered before the channels end.
    if (pipeThread_.joinable()) pipeThread_.join();
    pipe_.reset();  // it counts into the tracer, which ends after this
    channels_->stop();
    for (std::thread& t : threads_) t.join();
    threads_.clear();
    return result();
  }
  Result<void> result() const {
    std::lock_guard lock(mutex_);
    if (result_) return *result_;
    return {};
  }

  void refuse(const Error& why) {
    {
      std::lock_guard lock(mutex_);
      refused_ = why;
    }
    if (pipe_) pipe_->refuse(why);
    ring(wake_);
  }

  void stop() { ring(stop_); }
  bool stopped() const {
    pollfd p{stop_.get(), POLLIN, 0};
    return ::poll(&p, 1, 0) > 0;
  }
  const std::string& name() const { return options_.name; }

  void noteScene(const RayTracer& tracer) {
    const TracerStatistics s = tracer.statistics();
    const cache::CacheStatistics c = tracer.cache().statistics();
    counters_->set(Gauge::kSceneBytes, c.skeletonBytes + c.nodeBytes + c.arenaBytes);
    counters_->set(Gauge::kTreeBytes, s.embreeBytes);
    counters_->set(Gauge::kRecordBytes, s.recordBytes);
    counters_->set(Gauge::kGridsUsed, s.grids + s.meshlets);
    counters_->set(Gauge::kGridsDiced, s.gridsDiced);
  }

 private:
  struct Client {
    shm::PeerSocket socket;
    std::string name;
    std::vector<uint64_t> channels;
    bool isParent = false;
    bool greeted = false;
    bool told = false;  // kReady or kRefused has gone out
    bool gone = false;
  };

  void setResult(const Error& e) {
    std::lock_guard lock(mutex_);
    if (!result_) result_ = e;
  }

  void control() {
    std::vector<pollfd> set;
    for (;;) {
      set.clear();
      set.push_back({stop_.get(), POLLIN, 0});
      set.push_back({wake_.get(), POLLIN, 0});
      // When we are full nobody is let in; those who wait stay in the queue.
      const bool listens = listener_.valid() && clients_.size() < kMostClients;
      set.push_back({listens ? listener_.descriptor() : -1, POLLIN, 0});
      for (const Client& c : clients_) set.push_back({c.socket.descriptor(), POLLIN, 0});
      const int n = ::poll(set.data(), nfds_t(set.size()), -1);
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) {
        setResult(makeError(RiError::kSystem, "the ray server cannot wait for its clients: {}",
                            std::strerror(errno)));
        break;
      }
      if (set[0].revents) break;
      if (set[1].revents) hush(wake_);
      size_t i = 3;
      for (Client& c : clients_)
        if (set[i++].revents) hear(c);
      for (Client& c : clients_) tell(c);
      if (set[2].revents) accept();
      bool end = false;
      for (auto c = clients_.begin(); c != clients_.end();) {
        if (!c->gone) {
          ++c;
          continue;
        }
        end |= c->isParent;
        drop(*c);
        c = clients_.erase(c);
      }
      count();
      if (end) break;
    }
    stop();  // the others see it too
    for (Client& c : clients_) {
      hear(c);  // whoever is waiting for the scene hears why there is none
      tell(c);
    }
    for (Client& c : clients_) drop(c);
    clients_.clear();
    listener_ = shm::NamedListener();
    count();
  }

  void accept() {
    for (;;) {
      auto client = listener_.accept();
      if (!client) {
        report(client.error());
        // Nothing can be accepted for want of descriptors: the listener stays readable; do not spin on it.
        if (client.error().code == RiError::kSystem) ::usleep(100000);
        return;
      }
      if (!*client) return;
      clients_.emplace_back();
      clients_.back().socket = std::move(**client);
      ++clientsEver_;
      if (clients_.size() >= kMostClients) return;
    }
  }

  /// Everything that a client has said.
  void hear(Client& c) {
    while (!c.gone) {
      auto got = c.socket.receive(milliseconds(0));
      if (!got) {
        c.gone = true;  // it left; a message that was too long counts as that
        return;
      }
      if (!*got) return;
      auto message = readControl(std::move(**got), controlFingerprint(), kPeer);
      if (!message) {
        refuseClient(c, message.error());
        return;
      }
      handle(c, *message);
    }
  }

  void handle(Client& c, ControlMessage& m) {
    switch (ControlType(m.type)) {
      case ControlType::kHello: {
        if (c.greeted) return refuseClient(c, makeError(RiError::kBadFile, "a client said hello twice"));
        c.name = m.text();
        auto fd = counters_->share();
        if (!fd) return refuseClient(c, fd.error());
        const int one = fd->get();
        c.greeted = send(c, ControlType::kGreeting, {}, std::span(&one, 1));
        return;
      }
      case ControlType::kChannel:
        return addChannel(c, m);
      case ControlType::kScene:
        return sendSegments(c);
      case ControlType::kStatistics: {
        const RayServerNumbers n = counters_->read();
        send(c, ControlType::kNumbers, std::as_bytes(std::span(&n, 1)));
        return;
      }
      case ControlType::kGoodbye:
        c.gone = true;
        return;
      default:
        return refuseClient(c, makeError(RiError::kBadFile, "a client said something unknown ({})", m.type));
    }
  }

  /// The news that everybody waits for.
  void tell(Client& c) {
    if (c.gone || !c.greeted || c.told) return;
    std::lock_guard lock(mutex_);
    if (refused_) {
      c.told = true;
      (void)sendControl(c.socket, ControlType::kRefused, {}, refused_->message);
      c.gone = true;
    } else if (channels_) {
      c.told = true;
      auto board = channels_->board()->share();
      if (!board) {
        refuseClient(c, board.error());
        return;
      }
      const int one = board->get();
      send(c, ControlType::kReady, std::as_bytes(std::span(&*scene_, 1)), std::span(&one, 1));
    }
  }

  void addChannel(Client& c, ControlMessage& m) {
    if (!c.told || m.descriptors.size() != 1)
      return refuseClient(c, makeError(RiError::kBadFile, "a client sent a channel out of turn"));
    if (c.channels.size() >= kMostChannelsOfAClient)
      return answerNo(c, makeError(RiError::kLimit, "a client cannot have more than {} channels",
                                   kMostChannelsOfAClient));
    auto id = channels_->add(std::move(m.descriptors[0]));
    if (!id) return answerNo(c, id.error());
    c.channels.push_back(*id);
    send(c, ControlType::kAdded);
  }

  void sendSegments(Client& c) {
    if (!c.told)
      return refuseClient(c, makeError(RiError::kBadFile, "a client asked for a scene out of turn"));
    const auto fds = tracer_->cache().segments();
    const shm::FileDescriptor three[] = {readOnly(fds.skeleton), readOnly(fds.nodes), readOnly(fds.arena)};
    if (!three[0] || !three[1] || !three[2])
      return answerNo(c, makeError(RiError::kSystem, "the scene cannot be shared: {}", std::strerror(errno)));
    const int numbers[] = {three[0].get(), three[1].get(), three[2].get()};
    send(c, ControlType::kSegments, {}, numbers);
  }

  bool send(Client& c, ControlType type, std::span<const std::byte> body = {},
            std::span<const int> fds = {}) {
    if (sendControl(c.socket, type, body, {}, fds)) return true;
    c.gone = true;
    return false;
  }
  /// A well-formed request that cannot be granted.
  void answerNo(Client& c, const Error& why) {
    report(Error(why));
    if (!sendControl(c.socket, ControlType::kRefused, {}, why.message.substr(0, 1000))) c.gone = true;
  }
  /// A client that we cannot talk to.
  void refuseClient(Client& c, const Error& why) {
    Error e = why;
    e.severity = Severity::kWarning;
    report(e);
    (void)sendControl(c.socket, ControlType::kRefused, {}, why.message.substr(0, 1000));
    c.gone = true;
  }
  void drop(Client& c) {
    if (channels_)
      for (const uint64_t id : c.channels) channels_->remove(id);
    c.channels.clear();
    c.socket.close();
  }

  void count() {
    counters_->set(Gauge::kClients,
                   uint64_t(std::count_if(clients_.begin(), clients_.end(), [](const Client& c) {
                     return c.greeted && c.name != kWatcherName;
                   })));
    counters_->set(Gauge::kClientsEver, clientsEver_);
    std::lock_guard lock(mutex_);
    counters_->set(Gauge::kChannels, channels_ ? channels_->channelCount() : 0);
  }

  RayServerOptions options_;
  std::unique_ptr<ServerCounters> counters_;
  shm::FileDescriptor stop_, wake_;
  std::thread control_;
  std::unique_ptr<PipeSession> pipe_;
  std::thread pipeThread_;
  std::unique_ptr<Handler> handler_;
  std::vector<std::thread> threads_;
  // Of the control thread, once it runs:
  shm::NamedListener listener_;
  std::list<Client> clients_;
  uint64_t clientsEver_ = 0;
  // Set once by the main thread:
  mutable std::mutex mutex_;
  std::unique_ptr<shm::ChannelServer> channels_;
  std::optional<RaySceneInfo> scene_;
  RayTracer* tracer_ = nullptr;
  std::optional<Error> refused_, result_;
};

RayServer::RayServer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
RayServer::~RayServer() = default;

Result<std::unique_ptr<RayServer>> RayServer::open(RayServerOptions options) {
  options.threads = std::clamp(options.threads, 1, 1024);
  auto impl = std::make_unique<Impl>(std::move(options));
  if (Result<void> r = impl->open(); !r) return std::move(r).error();
  return std::unique_ptr<RayServer>(new RayServer(std::move(impl)));
}

Result<void> RayServer::serve(RayTracer& tracer, const RaySceneInfo& scene) {
  return impl_->serve(tracer, scene);
}
void RayServer::refuse(const Error& why) { impl_->refuse(why); }
bool RayServer::stopped() const { return impl_->stopped(); }
Result<void> RayServer::result() const { return impl_->result(); }
void RayServer::stop() { impl_->stop(); }
void RayServer::noteScene(const RayTracer& tracer) { impl_->noteScene(tracer); }
const std::string& RayServer::name() const { return impl_->name(); }

uint64_t sceneHash(const cache::SceneCache& cache) {
  const auto bytes = cache.skeleton().bytes();
  uint64_t h = 0x9e3779b97f4a7c15ull + bytes.size();
  size_t i = 0;
  const auto mix = [&h](uint64_t w) {
    h = (h ^ w) * 0xff51afd7ed558ccdull;
    h ^= h >> 32;
  };
  for (; i + 8 <= bytes.size(); i += 8) {
    uint64_t w;
    std::memcpy(&w, bytes.data() + i, sizeof w);
    mix(w);
  }
  for (; i < bytes.size(); ++i) mix(uint64_t(bytes[i]));
  return h;
}

RaySceneInfo describeScene(const cache::SceneCache& cache, const RayTracer& tracer, float patchMultiplier,
                           int threads) {
  const cache::Skeleton& s = cache.skeleton();
  RaySceneInfo info;
  const DVec3& o = s.header().cacheOrigin;
  info.origin[0] = o.x, info.origin[1] = o.y, info.origin[2] = o.z;
  const DMat4 m = s.worldToCamera(0);
  for (int c = 0; c < 4; ++c)
    for (int r = 0; r < 4; ++r) info.worldToCamera[4 * c + r] = m[c][r];
  info.shutter[0] = double(s.camera().shutter[0]), info.shutter[1] = double(s.camera().shutter[1]);
  Vec3 low(kInfinity), high(-kInfinity);
  for (const cache::ObjectRecord& object : s.objects()) {
    if (!(object.sides & cache::kForTracer)) continue;
    low = glm::min(low, object.bound.min), high = glm::max(high, object.bound.max);
  }
  for (int c = 0; c < 3; ++c) info.boundMin[c] = low[c], info.boundMax[c] = high[c];
  info.scene = sceneHash(cache);
  info.frame = s.options().frameNumber;
  info.maxRayLevel = tracer.maxRayLevel();
  info.patchMultiplier = patchMultiplier;
  info.threads = threads;
  info.processId = int32_t(::getpid());
  return info;
}

}  // namespace fr::tracer
