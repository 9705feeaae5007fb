// A RayClient over shared memory: the socket carries greetings and descriptors, channels carry rays.
#include <mutex>

#include "oracle/channel_line.h"
#include "oracle/client_link.h"
#include "oracle/control_message.h"

namespace fr {
namespace {

using std::chrono::milliseconds;

/// A server that has greeted answers everything at once; one that does not for so long is stuck.
constexpr milliseconds kConversation{60000};
constexpr milliseconds kLookUp{1000};
constexpr const char* kPeer = "the ray server";

class ShmLink : public RayClient::Link {
 public:
  ShmLink(shm::PeerSocket socket, std::optional<shm::ChildProcess> child, const RayClientOptions& options)
      : options_(options), child_(std::move(child)), socket_(std::move(socket)) {}
  ~ShmLink() override {
    if (alive()) (void)sendControl(socket_, ControlType::kGoodbye);
    socket_.close();
  }

  /// Greeting, ready.
  Result<void> open() {
    auto greeting = await(ControlType::kGreeting, options_.patience, false);
    if (!greeting) return std::move(greeting).error();
    if (greeting->descriptors.size() != 1)
      return makeError(RiError::kBadFile, "the ray server's greeting is damaged");
    auto counters = CounterReader::attach(std::move(greeting->descriptors[0]));
    if (!counters) return std::move(counters).error();
    counters_.emplace(std::move(counters).value());
    // Scenes may take long to load; the server lives, or its socket hangs up.
    auto ready = await(ControlType::kReady, milliseconds(0), true);
    if (!ready) return std::move(ready).error();
    if (ready->descriptors.size() != 1 || !ready->read(scene_))
      return makeError(RiError::kBadFile, "the ray server's description of its scene is damaged");
    auto board = shm::ServerBoard::attach(std::move(ready->descriptors[0]));
    if (!board) return std::move(board).error();
    board_ = std::move(board).value();
    return {};
  }

  RayTransport transport() const override { return RayTransport::kShm; }

  Result<std::unique_ptr<RayOracle>> connect() override {
    std::lock_guard lock(mutex_);
    if (failed_) return *failed_;
    const auto self = std::static_pointer_cast<ShmLink>(shared_from_this());
    shm::ClientChannel::Options o;
    o.config.blockCount = std::clamp(options_.blocksPerLine, 1u, 64u);
    o.config.blockBytes = sizeof(RayQuery);
    o.config.questionBytes = kQuestionBytes;
    o.wait = options_.wait;
    o.serverAlive = [link = self.get()] { return link->alive(); };  // the line keeps the link
    auto channel = shm::ClientChannel::create(board_, std::move(o));
    if (!channel) return std::move(channel).error();
    auto fd = channel->share();
    if (!fd) return std::move(fd).error();
    const int one = fd->get();
    auto added = converse(ControlType::kChannel, ControlType::kAdded, std::span(&one, 1));
    if (!added) return std::move(added).error();
    return std::unique_ptr<RayOracle>(std::make_unique<ChannelLine>(
        std::move(channel).value(),
        [link = self.get()](const Error& e) { return link->alive() ? e : link->goneLocked(); }, self));
  }

  Result<RayServerNumbers> numbers() override {
    if (!alive()) return goneLocked();
    return counters_->read();
  }

  Result<RayClient::Segments> sceneSegments() override {
    std::lock_guard lock(mutex_);
    if (failed_) return *failed_;
    auto got = converse(ControlType::kScene, ControlType::kSegments);
    if (!got) return std::move(got).error();
    if (got->descriptors.size() != 3)
      return makeError(RiError::kBadFile, "the ray server did not send its scene");
    return RayClient::Segments{std::move(got->descriptors[0]), std::move(got->descriptors[1]),
                               std::move(got->descriptors[2])};
  }

  bool alive() const override { return socket_.alive(); }
  int processId() const override { return scene_.processId; }

 private:
  Error goneLocked() {
    std::lock_guard lock(mutex_);
    return gone();
  }
  /// REQUIRES mutex_ (or a single thread).
  Error gone() {
    if (!failed_) failed_ = serverGone(child_ ? &*child_ : nullptr);
    return *failed_;
  }

  Result<ControlMessage> await(ControlType wanted, milliseconds patience, bool forEver) {
    const auto end = std::chrono::steady_clock::now() + patience;
    for (;;) {
      auto got = receiveControl(socket_, controlFingerprint(), kLookUp, kPeer);
      if (!got) return got.error().code == RiError::kSystem ? gone() : std::move(got).error();
      if (*got) {
        if ((**got).is(ControlType::kRefused))
          return makeError(RiError::kSystem, "the ray server refused: {}", (**got).text());
        if (!(**got).is(wanted))
          return makeError(RiError::kBadFile, "the ray server said something that was not asked for");
        return std::move(**got);
      }
      if (!socket_.alive()) return gone();
      if (!forEver && std::chrono::steady_clock::now() >= end)
        return makeError(RiError::kSystem, "the ray server does not answer");
    }
  }
  /// REQUIRES mutex_.
  Result<ControlMessage> converse(ControlType type, ControlType wanted, std::span<const int> fds = {}) {
    if (Result<void> r = sendControl(socket_, type, {}, {}, fds); !r) return gone();
    return await(wanted, kConversation, false);
  }

  const RayClientOptions options_;
  std::mutex mutex_;  // the conversation, and all below
  std::optional<shm::ChildProcess> child_;
  shm::PeerSocket socket_;
  std::optional<CounterReader> counters_;
  std::shared_ptr<shm::ServerBoard> board_;
  std::optional<Error> failed_;
};

}  // namespace

Error serverGone(shm::ChildProcess* child) {
  if (!child) return makeError(RiError::kSystem, "the ray server is gone");
  child->wait(milliseconds(200));  // a socket closes a moment before its process can be reaped
  std::string how = child->statusText();
  if (how.starts_with("killed"))
    how = "was " + how;
  else if (how == "running")
    how = "has closed the connection";
  return makeError(RiError::kSystem, "the ray server {}", how);
}

Result<void> greetServer(shm::PeerSocket& socket, const RayClientOptions& options) {
  return sendControl(socket, ControlType::kHello, {}, options.name.substr(0, 200));
}

Result<LinkPtr> openShmLink(shm::PeerSocket socket, std::optional<shm::ChildProcess> child,
                            const RayClientOptions& options) {
  auto link = std::make_shared<ShmLink>(std::move(socket), std::move(child), options);
  if (Result<void> r = link->open(); !r) return std::move(r).error();
  return LinkPtr(std::move(link));
}

}  // namespace fr
