#include "tools/rendrib/ray_server_mode.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <signal.h>
#include <sys/stat.h>
#include <tbb/global_control.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <string_view>
#include <thread>

#include "base/cores.h"
#include "base/isa.h"
#include "base/log.h"
#include "shading/shader_library.h"
#include "shading/shading_system.h"
#include "shm/named_socket.h"
#include "tools/rendrib/ray_server_command.h"
#include "tools/shader_folders.h"
#include "tools/shader_traits.h"
#include "tracer/ray_server.h"

namespace fr::tools {
namespace {

std::atomic<tracer::RayServer*> runningServer{nullptr};
static_assert(std::atomic<tracer::RayServer*>::is_always_lock_free);

void onSignal(int) {
  if (tracer::RayServer* s = runningServer.load()) s->stop();
}

/// SIGTERM and SIGINT end the server in order; a second one has its usual effect.
void catchSignals() {
  struct sigaction act {};
  act.sa_handler = onSignal;
  act.sa_flags = int(SA_RESETHAND);
  ::sigemptyset(&act.sa_mask);
  for (const int s : {SIGTERM, SIGINT}) ::sigaction(s, &act, nullptr);
  ::signal(SIGPIPE, SIG_IGN);
}

/// A pipe, a socket or a file on standard input is a client; a terminal and /dev/null are nobody.
bool hasPipeClient() {
  struct stat in {};
  return ::fstat(STDIN_FILENO, &in) == 0 &&
         (S_ISFIFO(in.st_mode) || S_ISSOCK(in.st_mode) || S_ISREG(in.st_mode));
}

bool isCacheFile(const std::string& path) { return std::filesystem::path(path).extension() == ".fsc"; }

/// The first frame of the scene.
Result<std::unique_ptr<cache::SceneCache>> loadFrame(const RayServerCommand& c, const std::string& scratch) {
  if (c.inputs.size() == 1 && isCacheFile(c.inputs[0].path))
    return cache::SceneCache::openFile(c.inputs[0].path, scratch);
  for (const cache::RibInput& input : c.inputs)
    if (isCacheFile(input.path))
      return makeError(RiError::kBadFile, "{}: a .fsc file is a whole scene: give it alone", input.path);
  Result<std::unique_ptr<cache::SceneCache>> opened =
      makeError(RiError::kMissingData, "{}: there is nothing to serve", cache::noWorldFound(c.load));
  cache::LoadOptions load = c.load;
  load.scratch = scratch;
  ShaderTraits traits = shaderTraits(c.shaderPath, c.inputs);
  load.movesPoints = std::move(traits.movesPoints), load.takesString = std::move(traits.takesString);
  const Result<void> loaded = cache::loadScene(c.inputs, load, [&](cache::Frame&& frame) {
    opened = cache::SceneCache::create(frame.skeletonFd(), scratch);
    return false;
  });
  if (!loaded.ok() && !opened.ok()) return loaded.error();
  return opened;
}

bool jitterTimes() {
  const char* v = std::getenv("RAYSERVER_JITTER_TIMES");
  return v && *v && std::string_view(v) != "0";
}

Result<void> serve(const RayServerCommand& c, tracer::RayServer& server, int threads, bool announce) {
  const auto memory = MemoryBudget::hold(c.memory);
  if (!memory) return memory.error();
  auto cache = loadFrame(c, memory->folder());
  if (!cache.ok()) {
    server.refuse(cache.error());
    return std::move(cache).error();
  }
  cache::SceneCache& scene = **cache;
  if (server.stopped()) return server.result();
  ShadingSystem::Options shadingOptions;
  shadingOptions.shaderPath = shaderFolders(c.shaderPath, scene.skeleton(), c.inputs);
  shadingOptions.standardShaders = standardShaderFolder();
  shadingOptions.tracerSide = true;
  shadingOptions.textureKilobytes = textureKilobytes(c.memory);
  ShadingSystem shading(scene, shadingOptions);
  shading.loadShaders(cache::kForTracer);
  scene.setDisplacer(&shading.displacer());
  tracer::RayTracerOptions options;
  options.scene.threads = threads;
  options.scene.patchMultiplier = c.patchMultiplier;
  options.onBuilt = [&server](const tracer::RayTracer& t) { server.noteScene(t); };
  tracer::RayTracer tracer(scene, shading, options);
  const BudgetOfJob budget(*memory, {{}, [&](uint64_t wanted) { return tracer.giveBack(wanted); }});
  const RaySceneInfo info = tracer::describeScene(scene, tracer, c.patchMultiplier, threads);
  if (announce)
    logMessage(Severity::kInfo,
               fmt::format("ray server ready: frame {}, {} objects, {} threads; join as '{}'", info.frame,
                           scene.skeleton().objects().size(), threads, server.name()));
  Result<void> r = server.serve(tracer, info);
  scene.setDisplacer(nullptr);
  return r;
}

}  // namespace

int runRayServer(int argc, char** argv) {
  ParsedRayServerCommand parsed = parseRayServerCommand(argc, argv);
  if (!parsed.run) return parsed.exitCode;
  const RayServerCommand& c = *parsed.run;
  if (c.deterministic) beDeterministic();
  setLogLevel(c.silent ? Severity::kError : Severity::kInfo);
  const int threads = c.threads > 0 ? c.threads : availableCores();
  const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, size_t(threads));

  tracer::RayServerOptions options;
  options.name = c.name.empty() ? std::to_string(::getpid()) : c.name;
  options.threads = threads;
  options.jitterTimes = jitterTimes();
  if (std::getenv("FR_PEER_SOCKET")) {
    auto parent = shm::parentSocket();
    if (!parent) {
      report(parent.error());
      return 2;
    }
    options.parent = std::move(parent).value();
  } else if (hasPipeClient()) {
    // Answers go to a descriptor that nobody else knows: what shaders print must not get between them.
    options.input = ::fcntl(STDIN_FILENO, F_DUPFD_CLOEXEC, 3);
    options.output = ::fcntl(STDOUT_FILENO, F_DUPFD_CLOEXEC, 3);
    if (options.input < 0 || options.output < 0) {
      report(makeError(RiError::kSystem, "standard input and output are not both open"));
      return 2;
    }
    ::dup2(STDERR_FILENO, STDOUT_FILENO);
    options.outlivesSilentPipe = !c.name.empty();
  }
  const bool announce = !options.parent;
  auto server = tracer::RayServer::open(std::move(options));
  if (!server) {
    report(server.error());
    return 1;
  }
  runningServer = server->get();
  catchSignals();
  const Result<void> r = serve(c, **server, threads, announce);
  runningServer = nullptr;
  server->reset();
  if (!r) {
    report(r.error());
    return 1;
  }
  return 0;
}

}  // namespace fr::tools
