// A program's connection to a ray server: one that runs already, or one that it starts.
//
//   auto client = RayClient::join("teapots");            // or RayClient::start("rendrib -rayserver
//   teapots.rib") auto line = client->connect();                       // one per thread RayQuery* q =
//   line->acquire(); ... fill ...; line->submit(q); line->wait(); ... read ...; line->release(q);
//   line->ask(ray)                                       // or one ray at a time
//
// Rays are in cache space; WorldSpace(client->scene()) converts (scene_info.h).
#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "oracle/ray_oracle.h"
#include "oracle/scene_info.h"
#include "oracle/server_counters.h"
#include "shm/futex.h"

namespace fr {

/// How rays travel. Answers are bit-identical over kShm and kPipe.
enum class RayTransport {
  kShm,       // channels in shared memory
  kPipe,      // our frames over the server's standard input and output (docs/format/pipe.md)
  kPipe1998,  // one ray at a time over the same, as BMRT spoke: world-space floats. No fulltrace of its own:
              // nearest hit and colour are asked separately, and only a ray that misses itself counts as
              // missed
};

struct RayClientOptions {
  std::string name = "client";  // what the server calls us in its messages; programs give their own
  bool pipe = false;            // start(): pipes, even if the server offers shared memory
  /// How long a server may show no sign of life before it has greeted us. Loading a scene does not count: a
  /// server of ours greets first.
  std::chrono::milliseconds patience{60000};
  uint32_t blocksPerLine = 4;  // 1 ... 64; how many blocks a line can have in flight; 164 KiB each
  shm::WaitPolicy wait = {};   // of channels
  /// kPipe: RayQuery::node and cell say root patches and places in them (pipe_codec.h, kPipeStartsAreRoots),
  /// because node numbers are a process's own. Otherwise leave both alone, or give the server's numbers.
  bool startsAreRoots = false;
};

/// Thread safety: everything from any thread; each line belongs to one thread at a time. Lines keep what they
/// need of the client alive and may outlive it; their calls fail once the server is gone. Errors of lines and
/// connect(): kSystem with a message that says how the server ended; nobody waits for a dead one.
class RayClient : public RayOracleService {
 public:
  /// A server of this user that was started with -name (or any, by its process id). Waits until its scene is
  /// loaded. Errors: kNoFile (no such server), kVersion (another build; names both), kBadHandle (another
  /// user's), kSystem.
  static Result<std::unique_ptr<RayClient>> join(std::string_view name, const RayClientOptions& options = {});

  /// Starts a server and waits until it can answer. The words of `commandLine` are divided at blanks; quotes
  /// and backslashes as in sh, no expansion. A server of ours is found out by what it says on the socket that
  /// it inherits (FR_PEER_SOCKET): shared memory then. Anything else is spoken to over its standard input and
  /// output: our frames if it knows them, else the protocol of 1998. The server ends with the client. Errors:
  /// kNoFile (no such program), kRange (no words), kVersion, kSystem (it ended, or gave no sign of life).
  static Result<std::unique_ptr<RayClient>> start(std::string_view commandLine,
                                                  const RayClientOptions& options = {});
  static Result<std::unique_ptr<RayClient>> start(std::vector<std::string> words,
                                                  const RayClientOptions& options = {});
  ~RayClient() override;

  /// A line for one thread. Errors: the server is gone or refuses.
  Result<std::unique_ptr<RayOracle>> connect() override;

  /// As known when the client was made. kPipe1998: all zero; cache space is world space then.
  const RaySceneInfo& scene() const;
  WorldSpace worldSpace() const { return WorldSpace(scene()); }
  RayTransport transport() const;
  /// The server's numbers (of all its clients). kShm: a look at shared memory. Errors: kIncapable
  /// (kPipe1998), the server is gone.
  Result<RayServerNumbers> numbers();
  /// False once the server is known to be gone.
  bool alive() const;
  /// The server's process, 0 unknown.
  int processId() const;

  /// Descriptors of skeleton, nodes and arena, to be mapped read-only (scene_cache). Errors: kIncapable
  /// (pipes), the server is gone.
  struct Segments {
    shm::FileDescriptor skeleton, nodes, arena;
  };
  Result<Segments> sceneSegments();

  /// What a transport implements; internal.
  class Link;

 private:
  explicit RayClient(std::shared_ptr<Link> link);
  std::shared_ptr<Link> link_;
};

/// The words of a command line as start() reads it. Errors: kSyntax (a quote that does not end), kRange
/// (none).
Result<std::vector<std::string>> splitCommandLine(std::string_view commandLine);

}  // namespace fr
