#include "oracle/ray_client.h"

#include <poll.h>
#include <signal.h>
#include <sys/socket.h>

#include <array>
#include <cstring>

#include "oracle/client_link.h"
#include "oracle/pipe_codec.h"
#include "oracle/pipe_io.h"
#include "shm/named_socket.h"

namespace fr {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

constexpr int kLookUp = 200;  // milliseconds

/// Finds out what a child speaks: whoever answers first, its socket or its standard output.
Result<LinkPtr> meet(PipeEnds ends, shm::PeerSocket socket, const RayClientOptions& options) {
  const Clock::time_point end = Clock::now() + options.patience;
  std::array<std::byte, sizeof(PipeWelcome)> reply;
  size_t have = 0;
  for (;;) {
    // A descriptor of -1 is passed over.
    pollfd p[2] = {{ends.fromServer.get(), POLLIN, 0},
                   {socket.valid() ? socket.descriptor() : -1, POLLIN, 0}};
    const int n = ::poll(p, 2, kLookUp);
    if (n < 0 && errno != EINTR)
      return makeError(RiError::kSystem, "cannot wait for the ray server: {}", std::strerror(errno));
    // The end of a child that never spoke reads as "something there" as well: look for a message.
    std::byte first;
    if (n > 0 && (p[1].revents & POLLIN) &&
        ::recv(socket.descriptor(), &first, 1, MSG_PEEK | MSG_DONTWAIT) > 0) {
      ends.toServer.reset();
      ends.fromServer.reset();
      return openShmLink(std::move(socket), std::move(ends.child), options);
    }
    if (n > 0 && (p[1].revents & (POLLHUP | POLLERR | POLLNVAL)))
      socket.close();  // a program that closes what it
                       // does not know, or that ended
    if (n > 0 && p[0].revents != 0) {
      auto got = readPipe(ends.fromServer.get(), std::span(reply).subspan(have), -1);
      if (!got || *got == 0) return serverGone(&ends.child);
      have += *got;
      if (have < reply.size()) continue;
      PipeWelcome welcome;
      std::memcpy(&welcome, reply.data(), sizeof welcome);
      if (welcome.magic == kPipeWelcomeMagic) return openFramedLink(std::move(ends), welcome, options);
      return openLink1998(std::move(ends), options);
    }
    if (ends.child.exitStatus()) return serverGone(&ends.child);
    if (Clock::now() >= end) {
      ends.child.signal(SIGKILL);
      return makeError(RiError::kSystem, "the ray server gave no sign of life in {} s",
                       double(options.patience.count()) / 1000.0);
    }
  }
}

}  // namespace

RayClient::RayClient(std::shared_ptr<Link> link) : link_(std::move(link)) {}
RayClient::~RayClient() = default;

Result<std::unique_ptr<RayClient>> RayClient::join(std::string_view name, const RayClientOptions& options) {
  auto socket = shm::connectNamed(name);
  if (!socket) return std::move(socket).error();
  if (Result<void> r = greetServer(*socket, options); !r) return std::move(r).error();
  auto link = openShmLink(std::move(socket).value(), std::nullopt, options);
  if (!link) return std::move(link).error();
  return std::unique_ptr<RayClient>(new RayClient(std::move(link).value()));
}

Result<std::unique_ptr<RayClient>> RayClient::start(std::string_view commandLine,
                                                    const RayClientOptions& options) {
  auto words = splitCommandLine(commandLine);
  if (!words) return std::move(words).error();
  return start(std::move(words).value(), options);
}

Result<std::unique_ptr<RayClient>> RayClient::start(std::vector<std::string> words,
                                                    const RayClientOptions& options) {
  if (words.empty()) return makeError(RiError::kRange, "the ray server's command line is empty");
  auto toServer = makePipe();
  if (!toServer) return std::move(toServer).error();
  auto fromServer = makePipe();
  if (!fromServer) return std::move(fromServer).error();
  shm::SpawnOptions spawn;
  spawn.program = words[0];
  spawn.arguments.assign(words.begin() + 1, words.end());
  spawn.standardInput = toServer->read.get();
  spawn.standardOutput = fromServer->write.get();
  if (options.pipe) spawn.socketVariable.clear();
  auto child = shm::ChildProcess::spawn(spawn);
  if (!child) return std::move(child).error().context("the ray server cannot be started");
  toServer->read.reset();
  fromServer->write.reset();
  shm::PeerSocket socket = std::move(child->socket());
  // Both at once: nobody knows yet which of them it reads. Failing here is found out below.
  if (socket.valid()) (void)greetServer(socket, options);
  std::vector<std::byte> hello;
  putPipeQuery(hello, pipeHello());
  (void)writePipe(toServer->write.get(), hello);
  auto link =
      meet(PipeEnds{std::move(toServer->write), std::move(fromServer->read), std::move(child).value()},
           std::move(socket), options);
  if (!link) return std::move(link).error();
  return std::unique_ptr<RayClient>(new RayClient(std::move(link).value()));
}

Result<std::unique_ptr<RayOracle>> RayClient::connect() { return link_->connect(); }
const RaySceneInfo& RayClient::scene() const { return link_->scene(); }
RayTransport RayClient::transport() const { return link_->transport(); }
Result<RayServerNumbers> RayClient::numbers() { return link_->numbers(); }
bool RayClient::alive() const { return link_->alive(); }
int RayClient::processId() const { return link_->processId(); }
Result<RayClient::Segments> RayClient::sceneSegments() { return link_->sceneSegments(); }

}  // namespace fr
