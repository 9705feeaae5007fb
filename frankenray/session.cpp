// Sessions: starting, joining and leaving servers.
#include "frankenray/session.h"

#include <pthread.h>
#include <unistd.h>

#include <cstdlib>
#include <cstring>
#include <new>

#include "base/version.h"

namespace fr::frankenray {

namespace {
std::atomic<uint64_t> forks{0};
void countFork() { forks.fetch_add(1, std::memory_order_relaxed); }
}  // namespace

uint64_t forkNumber() {
  static const bool watching = pthread_atfork(nullptr, nullptr, countFork) == 0;
  (void)watching;
  return forks.load(std::memory_order_relaxed);
}

Session::~Session() {
  // In a child process the connection is the parent's: saying goodbye would end it there.
  if (fork != forkNumber()) (void)client.release();
}

frankenray_status statusOf(const Error& e, frankenray_status otherwise) {
  switch (e.code) {
    case RiError::kNoFile:
    case RiError::kBadHandle:  // another user's
      return FRANKENRAY_ERROR_NO_SERVER;
    case RiError::kVersion:
      return FRANKENRAY_ERROR_VERSION;
    case RiError::kNoMem:
    case RiError::kDiskFull:
      return FRANKENRAY_ERROR_MEMORY;
    case RiError::kRange:
    case RiError::kSyntax:
      return FRANKENRAY_ERROR_ARGUMENT;
    default:
      return otherwise;
  }
}

namespace {

using Recipe = std::function<Result<std::unique_ptr<RayClient>>()>;

/// REQUIRES s.mutex.
frankenray_status refuse(Session& s, frankenray_status status, std::string text) {
  s.error = std::move(text);
  return status;
}

/// REQUIRES s.mutex.
frankenray_status connect(Session& s) {
  s.number.store(0, std::memory_order_release);
  s.client.reset();
  auto made = s.recipe();
  if (!made) {
    s.lost = statusOf(made.error(), FRANKENRAY_ERROR_START);
    return refuse(s, s.lost, made.error().message);
  }
  s.client = std::move(made).value();
  s.number.store(++s.connections, std::memory_order_release);
  return FRANKENRAY_OK;
}

/// The way of every function of a session: checks the handle, locks, guards.
template <class Body>
frankenray_status within(frankenray_session* session, Body body) noexcept {
  if (!session) return FRANKENRAY_ERROR_ARGUMENT;
  Session& s = *session->shared;
  if (s.fork != forkNumber()) return FRANKENRAY_ERROR_FORKED;
  return guarded([&] {
    std::lock_guard lock(s.mutex);
    return body(s);
  });
}

frankenray_status begin(Session& s, Recipe recipe) {
  if (s.client) return refuse(s, FRANKENRAY_ERROR_STATE, "this session has a server already");
  s.recipe = std::move(recipe);
  return connect(s);
}

RayClientOptions clientOptions(const frankenray_options& o) {
  RayClientOptions c;
  c.name = "frankenray";
  c.pipe = o.transport == FRANKENRAY_PIPE;
  return c;
}

/// Null or the caller's. False: a structure that makes no sense.
bool readOptions(const frankenray_options* from, frankenray_options& to) {
  to = FRANKENRAY_OPTIONS_INIT;
  return !from || (readStructure(from, to) &&
                   (to.transport == FRANKENRAY_SHARED_MEMORY || to.transport == FRANKENRAY_PIPE));
}

constexpr const char* kBadOptions = "the options are damaged: begin with FRANKENRAY_OPTIONS_INIT";

std::string programOf(const frankenray_options& o) {
  if (o.program && *o.program) return o.program;
  const char* named = std::getenv("FRANKENRAY_RENDRIB");
  return named && *named ? named : "rendrib";
}

}  // namespace
}  // namespace fr::frankenray

using namespace fr;
using namespace fr::frankenray;

extern "C" {

int frankenray_interface(void) { return FRANKENRAY_INTERFACE; }

const char* frankenray_version(void) { return versionText(); }

const char* frankenray_status_text(frankenray_status status) {
  switch (status) {
    case FRANKENRAY_OK:
      return "no error";
    case FRANKENRAY_PENDING:
      return "not all rays are answered yet";
    case FRANKENRAY_ERROR_ARGUMENT:
      return "an argument makes no sense";
    case FRANKENRAY_ERROR_NOT_CONNECTED:
      return "the session has no server";
    case FRANKENRAY_ERROR_NO_SERVER:
      return "the server, its program or its scene was not found";
    case FRANKENRAY_ERROR_START:
      return "the server refused";
    case FRANKENRAY_ERROR_VERSION:
      return "the server is of another version";
    case FRANKENRAY_ERROR_SERVER_GONE:
      return "the server is gone";
    case FRANKENRAY_ERROR_MEMORY:
      return "out of memory or descriptors";
    case FRANKENRAY_ERROR_STATE:
      return "the call does not fit what was done before";
    case FRANKENRAY_ERROR_FORKED:
      return "the handle belongs to the parent process";
    case FRANKENRAY_ERROR_INTERNAL:
      return "a fault of the library";
    default:
      return "unknown status";
  }
}

frankenray_session* frankenray_create(void) {
  try {
    return new frankenray_session{std::make_shared<Session>()};
  } catch (...) {
    return nullptr;
  }
}

frankenray_status frankenray_start(frankenray_session* session, const frankenray_options* options,
                                   const char* scene) {
  return within(session, [&](Session& s) -> frankenray_status {
    frankenray_options o;
    if (!readOptions(options, o)) return refuse(s, FRANKENRAY_ERROR_ARGUMENT, kBadOptions);
    if (!scene || !*scene) return refuse(s, FRANKENRAY_ERROR_ARGUMENT, "no scene is named");
    if (access(scene, R_OK) != 0)
      return refuse(s, FRANKENRAY_ERROR_NO_SERVER, fmt::format("{}: {}", scene, std::strerror(errno)));
    std::vector<std::string> words{programOf(o)};
    if (o.threads > 0) words.insert(words.end(), {"-threads", std::to_string(o.threads)});
    for (const char* const* a = o.arguments; a && *a; ++a) words.emplace_back(*a);
    words.insert(words.end(), {"-rayserver", scene});
    return begin(s, [words, c = clientOptions(o)] { return RayClient::start(words, c); });
  });
}

frankenray_status frankenray_start_command(frankenray_session* session, const frankenray_options* options,
                                           const char* command) {
  return within(session, [&](Session& s) -> frankenray_status {
    frankenray_options o;
    if (!readOptions(options, o)) return refuse(s, FRANKENRAY_ERROR_ARGUMENT, kBadOptions);
    std::string line = command ? command : "";
    const size_t first = line.find_first_not_of(" \t\n");
    if (first == std::string::npos) return refuse(s, FRANKENRAY_ERROR_ARGUMENT, "the command is empty");
    if (line[first] == '@') {
      const size_t last = line.find_last_not_of(" \t\n");
      return begin(s, [name = line.substr(first + 1, last - first), c = clientOptions(o)] {
        return RayClient::join(name, c);
      });
    }
    return begin(s, [line, c = clientOptions(o)] { return RayClient::start(std::string_view(line), c); });
  });
}

frankenray_status frankenray_join(frankenray_session* session, const frankenray_options* options,
                                  const char* name) {
  return within(session, [&](Session& s) -> frankenray_status {
    frankenray_options o;
    if (!readOptions(options, o)) return refuse(s, FRANKENRAY_ERROR_ARGUMENT, kBadOptions);
    if (!name || !*name) return refuse(s, FRANKENRAY_ERROR_ARGUMENT, "no server is named");
    return begin(s, [n = std::string(name), c = clientOptions(o)] { return RayClient::join(n, c); });
  });
}

frankenray_status frankenray_reconnect(frankenray_session* session) {
  return within(session, [&](Session& s) -> frankenray_status {
    if (!s.recipe)
      return refuse(s, FRANKENRAY_ERROR_NOT_CONNECTED, "this session was neither started nor joined");
    return connect(s);
  });
}

frankenray_status frankenray_state(frankenray_session* session) {
  return within(session, [&](Session& s) -> frankenray_status {
    if (!s.client) return s.lost;
    return s.client->alive() ? FRANKENRAY_OK : FRANKENRAY_ERROR_SERVER_GONE;
  });
}

int frankenray_server_pid(frankenray_session* session) {
  int pid = 0;
  (void)within(session, [&](Session& s) -> frankenray_status {
    if (s.client) pid = s.client->processId();
    return FRANKENRAY_OK;
  });
  return pid;
}

const char* frankenray_error_text(frankenray_session* session) {
  thread_local std::string text;
  const frankenray_status status = within(session, [&](Session& s) -> frankenray_status {
    text = s.error;
    return FRANKENRAY_OK;
  });
  return status == FRANKENRAY_OK ? text.c_str() : frankenray_status_text(status);
}

void frankenray_close(frankenray_session* session) {
  (void)within(session, [&](Session& s) -> frankenray_status {
    s.number.store(0, std::memory_order_release);
    s.lost = FRANKENRAY_ERROR_NOT_CONNECTED;
    s.error = "the session was closed";
    s.client.reset();
    return FRANKENRAY_OK;
  });
  delete session;
}

frankenray_status frankenray_read_statistics(frankenray_session* session, frankenray_statistics* statistics) {
  return within(session, [&](Session& s) -> frankenray_status {
    frankenray_statistics n;
    if (!readStructure(statistics, n))
      return refuse(s, FRANKENRAY_ERROR_ARGUMENT, "the statistics have no size");
    const size_t size = statistics->size;
    n = {};
    for (int k = 0; k < 4; ++k) n.rays[k] = s.rays[k].load(std::memory_order_relaxed);
    n.single_rays = s.singles.load(std::memory_order_relaxed);
    n.blocks = s.blocks.load(std::memory_order_relaxed);
    n.connections = s.connections;
    if (s.client) {
      if (auto got = s.client->numbers()) {
        const RayServerNumbers& r = *got;
        for (uint32_t k = 0; k < 4; ++k) {
          n.server_rays[k] = r[Counter(uint32_t(Counter::kTrace) + k)];
          n.server_nested[k] = r[Counter(uint32_t(Counter::kNestedTrace) + k)];
        }
        n.server_hits_shaded = r[Counter::kHitsShaded];
        n.server_bytes = r[Gauge::kTreeBytes] + r[Gauge::kRecordBytes];
      }
    }
    std::memcpy(statistics, &n, std::min(size, sizeof n));
    statistics->size = size;
    return FRANKENRAY_OK;
  });
}

}  // extern "C"
