// What stands behind a RayClient: one implementation for each transport. Internal to oracle/.
#pragma once

#include <memory>
#include <optional>
#include <string>

#include "oracle/pipe_codec.h"
#include "oracle/ray_client.h"
#include "shm/peer.h"

namespace fr {

class RayClient::Link : public std::enable_shared_from_this<RayClient::Link> {
 public:
  virtual ~Link() = default;
  virtual RayTransport transport() const = 0;
  virtual Result<std::unique_ptr<RayOracle>> connect() = 0;
  virtual Result<RayServerNumbers> numbers() = 0;
  virtual bool alive() const = 0;
  virtual int processId() const = 0;
  virtual Result<Segments> sceneSegments() {
    return makeError(RiError::kIncapable, "a scene can only be shared by a ray server in shared memory");
  }
  const RaySceneInfo& scene() const { return scene_; }

 protected:
  RaySceneInfo scene_;
};

/// How a child of ours ended, as a sentence: "the ray server was killed by signal 9 (Killed)".
Error serverGone(shm::ChildProcess* child);

using LinkPtr = std::shared_ptr<RayClient::Link>;

/// Says hello over a socket. Errors: the server is gone.
Result<void> greetServer(shm::PeerSocket& socket, const RayClientOptions& options);
/// The conversation with a server over its socket, from the greeting on; greetServer() came before. `child`:
/// when we started it. Errors: as RayClient::join.
Result<LinkPtr> openShmLink(shm::PeerSocket socket, std::optional<shm::ChildProcess> child,
                            const RayClientOptions& options);

/// A child and its standard input and output.
struct PipeEnds {
  shm::FileDescriptor toServer, fromServer;
  shm::ChildProcess child;
};
/// The conversation in frames, after its welcome (pipe_codec.h) has been read. Errors: as RayClient::start.
Result<LinkPtr> openFramedLink(PipeEnds ends, const PipeWelcome& welcome, const RayClientOptions& options);
/// The conversation with a server of 1998, after its answer to the hello has been read.
LinkPtr openLink1998(PipeEnds ends, const RayClientOptions& options);

}  // namespace fr
