#include "frankenray/shadeops/ray_session.h"

#include <pthread.h>

#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <mutex>
#include <new>
#include <string>

#include "base/random.h"

namespace fr::shadeops {
namespace {

constexpr double kDefaultBias = 0.01;  // BMRT's "minshadowbias"
/// A server that dies of a question would die of it again: this often it is started anew.
constexpr int kMostRestarts = 3;
constexpr size_t kMostTraces = 1024;

constexpr const char* kConsequence =
    "trace() and rs_indirect() are black, visibility() is clear, rayhittest() and fulltrace() hit nothing.";

struct Session {
  frankenray_session* handle = nullptr;
  bool jitterTimes = false;
  double bias = kDefaultBias;
  std::atomic<bool> failed{false};  // for good; has been said
  std::atomic<uint64_t> connection{0};
  int restarts = 0;  // under the host's mutex

  ~Session() { frankenray_close(handle); }
};

/// All that the process has. Never destroyed: threads may ask while the host ends.
struct Host {
  std::mutex mutex;
  int users = 0;
  std::shared_ptr<Session> session;
  /// Changes whenever `session` does: threads compare it with that of their line.
  std::atomic<uint64_t> generation{1};
  const void* said[16] = {};
};
alignas(Host) unsigned char hostBytes[sizeof(Host)];
std::atomic<bool> hostMade{false};

/// In the child of a fork: the parent's session and lines are not ours to use or to end, and the mutex may
/// have been held by a thread that does not exist here. What there was is left where it is.
void forgetInChild() {
  if (!hostMade.load(std::memory_order_acquire)) return;
  auto* h = reinterpret_cast<Host*>(hostBytes);
  const int users = h->users;
  const uint64_t generation = h->generation.load(std::memory_order_relaxed);
  h = new (hostBytes) Host;
  h->users = users;
  h->generation.store(generation + 1, std::memory_order_relaxed);
}

Host& host() {
  static Host* const made = [] {
    auto* h = new (hostBytes) Host;
    hostMade.store(true, std::memory_order_release);
    pthread_atfork(nullptr, nullptr, forgetInChild);
    return h;
  }();
  return *made;
}

/// REQUIRES h.mutex.
void sayOnceLocked(Host& h, const void* key, const char* text) {
  for (const void*& s : h.said) {
    if (s == key) return;
    if (!s) {
      s = key;
      std::fprintf(stderr, "rayserver: %s\n", text);
      return;
    }
  }
}

const char kNoServerKey[] = "no server";

/// REQUIRES h.mutex.
void fail(Host& h, Session& s, const std::string& why) {
  s.failed.store(true, std::memory_order_release);
  sayOnceLocked(h, kNoServerKey, (why + "\nrayserver: " + kConsequence).c_str());
}

/// REQUIRES h.mutex.
void connect(Host& h, Session& s) {
  const char* const command = std::getenv("RAYSERVER");
  if (!command || !*command)
    return fail(h, s,
                "no ray server: RAYSERVER is not set. Set it to the command line of one (RAYSERVER=\"rendrib "
                "-rayserver scene.rib\") or to the name of a running one (RAYSERVER=\"@name\").");
  s.handle = frankenray_create();
  if (!s.handle) return fail(h, s, "no ray server: out of memory.");
  frankenray_options options = FRANKENRAY_OPTIONS_INIT;
  if (const char* t = std::getenv("RAYSERVER_TRANSPORT"); t && std::strcmp(t, "pipe") == 0)
    options.transport = FRANKENRAY_PIPE;
  if (frankenray_start_command(s.handle, &options, command) != FRANKENRAY_OK)
    return fail(h, s,
                std::string("no ray server: RAYSERVER=\"") + command +
                    "\": " + frankenray_error_text(s.handle) + ".");
}

std::shared_ptr<Session> makeSession(Host& h) {
  std::lock_guard lock(h.mutex);
  if (h.session) return h.session;
  auto s = std::make_shared<Session>();
  if (const char* j = std::getenv("RAYSERVER_JITTER_TIMES")) s->jitterTimes = std::atoi(j) != 0;
  if (const char* b = std::getenv("RAYSERVER_BIAS")) {
    char* end = nullptr;
    const double bias = std::strtod(b, &end);
    if (end != b && std::isfinite(bias) && bias >= 0)
      s->bias = bias;
    else
      sayOnceLocked(h, &kDefaultBias, "RAYSERVER_BIAS is not a distance: 0.01 is used.");
  }
  connect(h, *s);
  h.session = s;
  h.generation.fetch_add(1, std::memory_order_release);
  return s;
}

/// The server of connection `seen` went away: another one, for all threads. False: there is none.
bool recover(Session& s, uint64_t seen, const std::string& why) {
  Host& h = host();
  std::lock_guard lock(h.mutex);
  if (s.failed.load(std::memory_order_relaxed)) return false;
  if (s.connection.load(std::memory_order_relaxed) != seen) return true;  // another thread saw to it
  if (s.restarts++ >= kMostRestarts) {
    fail(h, s, "the ray server keeps going away: " + why + ".");
    return false;
  }
  if (frankenray_reconnect(s.handle) != FRANKENRAY_OK) {
    fail(h, s, "the ray server went away: " + why + "; again: " + frankenray_error_text(s.handle) + ".");
    return false;
  }
  s.connection.fetch_add(1, std::memory_order_release);
  std::fprintf(stderr, "rayserver: %s; another one has been started or joined.\n", why.c_str());
  return true;
}

/// A thread's line. Made at its first question, closed at its end.
struct ThreadLine {
  uint64_t generation = 0;
  std::shared_ptr<Session> session;
  frankenray_line* line = nullptr;

  ~ThreadLine() { reset(); }
  void reset() {
    frankenray_line_close(line);
    line = nullptr;
    session.reset();
  }
};
thread_local ThreadLine threadLine;

/// This thread's line, or null when there is no server.
ThreadLine* currentLine() {
  Host& h = host();
  ThreadLine& t = threadLine;
  if (t.generation != h.generation.load(std::memory_order_acquire)) {
    t.reset();
    t.session = makeSession(h);
    t.generation = h.generation.load(std::memory_order_acquire);
    if (t.session->handle) t.line = frankenray_line_open(t.session->handle);
  }
  return t.line && !t.session->failed.load(std::memory_order_acquire) ? &t : nullptr;
}

void makeMiss(const frankenray_ray& ray, frankenray_hit& hit) {
  hit = FRANKENRAY_HIT_INIT;
  const bool segment = ray.kind == FRANKENRAY_VISIBILITY;
  for (int c = 0; c < 3; ++c) {
    hit.color[c] = segment ? 1.0f : 0.0f;
    hit.miss_position[c] = ray.origin[c];
    hit.miss_direction[c] = float(ray.direction[c]);
  }
  hit.distance = ray.kind == FRANKENRAY_HITTEST ? FRANKENRAY_NO_HIT : FRANKENRAY_NO_HIT_TRACE;
  hit.miss_depth = ray.kind == FRANKENRAY_FULLTRACE ? 1.0f : 0.0f;
}

/// Runs `question` on this thread's line, with another server if the first goes away.
template <class Question>
bool insist(Question question) {
  for (int attempt = 0; attempt <= kMostRestarts; ++attempt) {
    ThreadLine* const t = currentLine();
    if (!t) return false;
    const uint64_t connection = t->session->connection.load(std::memory_order_acquire);
    if (question(t->line) == FRANKENRAY_OK) return true;
    if (!recover(*t->session, connection, frankenray_line_error_text(t->line))) return false;
  }
  return false;
}

float timeOf(const Session& s, uint64_t seed) {
  return s.jitterTimes ? float(hashStep(seed, 0x74696d65) >> 40) * 0x1p-24f : 0.0f;
}

}  // namespace

void addUser() {
  Host& h = host();
  std::lock_guard lock(h.mutex);
  ++h.users;
}

void removeUser() {
  Host& h = host();
  std::shared_ptr<Session> last;
  {
    std::lock_guard lock(h.mutex);
    if (h.users > 0) --h.users;
    if (h.users > 0 || !h.session) return;
    last = std::move(h.session);
    h.session.reset();
    last->failed.store(true, std::memory_order_release);  // nobody recovers it
    h.generation.fetch_add(1, std::memory_order_release);
  }
  // Lines of other threads may hold the session for longer; the server is to end now.
  frankenray_close(last->handle);
  last->handle = nullptr;
}

uint64_t seedOf(const double origin[3], const double direction[3]) {
  uint64_t h = 0x7261797365727665ull;
  for (int c = 0; c < 3; ++c) {
    uint64_t a, b;
    std::memcpy(&a, &origin[c], sizeof a);
    std::memcpy(&b, &direction[c], sizeof b);
    h = hashStep(hashStep(h, a), b);
  }
  return h;
}

bool ask(frankenray_ray& ray, frankenray_hit& hit) {
  makeMiss(ray, hit);
  ThreadLine* const t = currentLine();
  if (!t) return false;
  const double bias = t->session->bias;
  frankenray_ray moved = ray;
  moved.seed = ray.seed = seedOf(ray.origin, ray.direction);
  moved.time = ray.time = timeOf(*t->session, ray.seed);
  double ahead = 0;
  if (bias > 0) {
    const bool segment = ray.kind == FRANKENRAY_VISIBILITY;
    double d[3], length2 = 0;
    for (int c = 0; c < 3; ++c) {
      d[c] = segment ? ray.direction[c] - ray.origin[c] : ray.direction[c];
      length2 += d[c] * d[c];
    }
    const double length = std::sqrt(length2);
    if (segment && length <= 2 * bias) return true;  // nothing fits in between: clear
    if (length > 0 && std::isfinite(length)) {
      ahead = bias;
      for (int c = 0; c < 3; ++c) {
        moved.origin[c] += d[c] * (bias / length);
        if (segment) moved.direction[c] -= d[c] * (bias / length);
      }
    }
  }
  frankenray_hit answer = FRANKENRAY_HIT_INIT;
  if (!insist([&](frankenray_line* line) { return frankenray_ask(line, &moved, &answer); })) return false;
  hit = answer;
  if (ray.kind != FRANKENRAY_VISIBILITY && hit.distance < FRANKENRAY_NO_HIT_TRACE)
    hit.distance += float(ahead);
  return true;
}

bool sumOfTraces(const double origin[3], const float* directions, size_t count, float color[3]) {
  color[0] = color[1] = color[2] = 0;
  ThreadLine* const t = currentLine();
  if (!t || count > kMostTraces) return false;
  double start[3 * kMostTraces];
  float time[kMostTraces], got[3 * kMostTraces];
  uint64_t seed[kMostTraces];
  const Session& s = *t->session;
  for (size_t i = 0; i < count; ++i) {
    const double d[3] = {directions[3 * i], directions[3 * i + 1], directions[3 * i + 2]};
    for (int c = 0; c < 3; ++c) start[3 * i + size_t(c)] = origin[c] + s.bias * d[c];
    seed[i] = seedOf(origin, d);
    time[i] = timeOf(s, seed[i]);
  }
  frankenray_rays rays = FRANKENRAY_RAYS_INIT;
  rays.count = count;
  rays.origin = {start, start + 1, start + 2, 3};
  rays.direction = {directions, directions + 1, directions + 2, 3};
  rays.time = time;
  rays.seed = seed;
  frankenray_answers answers = FRANKENRAY_ANSWERS_INIT;
  answers.color = {got, got + 1, got + 2, 3};
  if (!insist([&](frankenray_line* line) { return frankenray_answer(line, &rays, &answers); })) return false;
  for (size_t i = 0; i < count; ++i)
    for (int c = 0; c < 3; ++c) color[c] += got[3 * i + size_t(c)];
  return true;
}

void sayOnce(const char* key, const char* text) {
  Host& h = host();
  std::lock_guard lock(h.mutex);
  sayOnceLocked(h, key, text);
}

}  // namespace fr::shadeops
