// A ray server for many clients: over shared memory (docs/format/ring.md) and over one pipe
// (docs/format/pipe.md).
#pragma once

#include <atomic>
#include <memory>
#include <optional>
#include <string>

#include "base/error.h"
#include "oracle/scene_info.h"
#include "oracle/server_counters.h"
#include "shm/peer.h"
#include "tracer/ray_tracer.h"

namespace fr::tracer {

struct RayServerOptions {
  /// Where clients join (shm/named_socket.h). Empty: nobody can.
  std::string name;
  /// The client that started us, served until it leaves; then the server ends.
  std::optional<shm::PeerSocket> parent;
  /// A pipe client, served until its input ends; then the server ends. -1: none.
  int input = -1, output = -1;
  /// An input that ends before anything came on it was no client: the server goes on.
  bool outlivesSilentPipe = false;
  int threads = 1;
  bool jitterTimes = false;  // of queries of 1998
};

/// open() -> (load the scene; clients are greeted meanwhile) -> serve() or refuse().
///
/// Clients never get the scene writable: rays come in by value, and whoever asks gets the cache's segments
/// read-only. A client that dies or says rubbish loses its channels and its connection; the others notice
/// nothing. While nobody asks the process sleeps. Thread safety: stop() from any thread and from signal
/// handlers; all else from one thread.
class RayServer {
 public:
  /// Listens and greets from now on, in a thread of its own. Errors: the name is taken or impossible, no
  /// memory.
  static Result<std::unique_ptr<RayServer>> open(RayServerOptions options);
  ~RayServer();

  /// Answers until the end: see the options, and stop(). Errors: what the pipe client or the parent did
  /// wrong.
  Result<void> serve(RayTracer& tracer, const RaySceneInfo& scene);
  /// Tells everybody that there will be no scene.
  void refuse(const Error& why);
  /// True when serve() would return at once: the client that we are for has left while we were loading.
  bool stopped() const;
  /// What the pipe client did wrong so far.
  Result<void> result() const;
  void stop();

  const std::string& name() const;
  /// Shows the ray scene's figures to those who watch. For RayTracerOptions::onBuilt.
  void noteScene(const RayTracer& tracer);

 private:
  class Impl;
  explicit RayServer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// What clients should know of this scene. `threads`: of the server. Hashes the skeleton.
RaySceneInfo describeScene(const cache::SceneCache& cache, const RayTracer& tracer, float patchMultiplier,
                           int threads);
/// The hash alone: RaySceneInfo::scene.
uint64_t sceneHash(const cache::SceneCache& cache);

}  // namespace fr::tracer
