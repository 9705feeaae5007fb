// Lines and batches: rays of any number, cut into blocks, several of them in flight.
#include <algorithm>
#include <bit>
#include <cstring>

#include "base/random.h"
#include "frankenray/session.h"
#include "oracle/scene_info.h"

using namespace fr;
using namespace fr::frankenray;

/// Thread safety: none, like its line. `line` is null once the line was closed.
struct frankenray_batch {
  frankenray_line* line = nullptr;
  frankenray_rays rays;
  frankenray_answers answers;
  RayTerms terms{};
  size_t submitted = 0, answered = 0;
  frankenray_status status = FRANKENRAY_PENDING;
};

/// Invariants: every flight's batch is in `batches` and pending; batches after the first that has rays left
/// to submit have none submitted.
struct frankenray_line {
  struct Flight {
    RayQuery* block;
    frankenray_batch* batch;
    size_t first;
    uint32_t count;
  };
  std::shared_ptr<Session> session;
  uint64_t fork = forkNumber();
  uint64_t number = 0;  // of the session's client that `oracle` belongs to; 0: none
  std::unique_ptr<RayOracle> oracle;
  WorldSpace space;
  uint32_t stamp = 0;       // of places that this server gives
  bool knowsTerms = false;  // a server of 1998 does not
  std::vector<Flight> flights;
  std::deque<frankenray_batch*> batches;   // pending, oldest first
  std::vector<frankenray_batch*> handles;  // all that are not released
  std::string error;

  ~frankenray_line() {
    if (fork != forkNumber()) (void)oracle.release();  // the parent's
  }
};

namespace {

/// Rays of a block: enough blocks to keep several threads of the server busy, none too small to be worth it.
constexpr size_t kBlocksPerBatch = 4, kLeastRays = 256;

frankenray_status fail(frankenray_line& l, frankenray_status status, std::string text) {
  l.error = std::move(text);
  return status;
}

// ---- Columns ----

template <class T>
ptrdiff_t strideOf(const T& v) {
  return v.stride ? v.stride : 1;
}
template <class T>
bool complete(const T& v) {
  return v.x && v.y && v.z;
}
template <class T>
bool completeOrEmpty(const T& v) {
  return complete(v) || !v.x;
}

void readVectors(const frankenray_vectors& v, size_t first, uint32_t n, float (*to)[kRayRow]) {
  const ptrdiff_t stride = strideOf(v), at = ptrdiff_t(first) * stride;
  const float* const from[3] = {v.x, v.y, v.z};
  for (int c = 0; c < 3; ++c)
    for (uint32_t i = 0; i < n; ++i) to[c][i] = from[c][at + ptrdiff_t(i) * stride];
}

void writeVectors(const float (*from)[kRayRow], size_t first, uint32_t n, const frankenray_vectors_out& v) {
  if (!v.x) return;
  const ptrdiff_t stride = strideOf(v), at = ptrdiff_t(first) * stride;
  float* const to[3] = {v.x, v.y, v.z};
  for (int c = 0; c < 3; ++c)
    for (uint32_t i = 0; i < n; ++i) to[c][at + ptrdiff_t(i) * stride] = from[c][i];
}

DVec3 pointAt(const frankenray_points& v, size_t i) {
  const ptrdiff_t at = ptrdiff_t(i) * strideOf(v);
  return {v.x[at], v.y[at], v.z[at]};
}

void setPoint(const frankenray_points_out& v, size_t i, const DVec3& p) {
  if (!v.x) return;
  const ptrdiff_t at = ptrdiff_t(i) * strideOf(v);
  v.x[at] = p.x, v.y[at] = p.y, v.z[at] = p.z;
}

void readFloats(const float* from, size_t first, uint32_t n, float* to) {
  if (from)
    std::copy_n(from + first, n, to);
  else
    std::fill_n(to, n, 0.0f);
}

// ---- Places ----

/// What is in a frankenray_place.
enum PlaceWord { kPlaceStamp, kPlaceNode, kPlaceNormal, kPlaceWords = 8 };
static_assert(sizeof(frankenray_place) == kPlaceWords * 4 && kPlaceNormal + 3 <= kPlaceWords);

/// Node numbers are a server process's own. Never 0.
uint32_t stampOf(const RaySceneInfo& info) {
  return uint32_t(hashStep(hashStep(2, info.scene), uint64_t(info.processId))) | 1u;
}

frankenray_place makePlace(uint32_t stamp, uint32_t node, const Vec3& normal) {
  frankenray_place p{};
  if (node == SingleRayStart{}.node) return p;
  p.opaque[kPlaceStamp] = stamp;
  p.opaque[kPlaceNode] = node;
  for (int c = 0; c < 3; ++c) p.opaque[kPlaceNormal + c] = std::bit_cast<uint32_t>(normal[c]);
  return p;
}

/// Nowhere, or of this server.
bool isOurs(const frankenray_place& p, uint32_t stamp) {
  return p.opaque[kPlaceStamp] == 0 || p.opaque[kPlaceStamp] == stamp;
}

/// REQUIRES isOurs().
SingleRayStart startOf(const frankenray_place& p) {
  SingleRayStart s;
  if (p.opaque[kPlaceStamp] == 0) return s;
  s.node = p.opaque[kPlaceNode];
  for (int c = 0; c < 3; ++c) s.normal[c] = std::bit_cast<float>(p.opaque[kPlaceNormal + c]);
  return s;
}

// ---- Terms ----

template <size_t N>
bool copyText(const char* from, char (&to)[N]) {
  if (!from) return true;
  const size_t length = std::strlen(from);
  if (length >= N) return false;
  std::memcpy(to, from, length);
  return true;
}

/// Fields that rays and single rays have in common. False: `why` says what is wrong with them.
template <class Rays>
bool readTerms(const Rays& r, RayTerms& t, std::string& why) {
  if (!copyText(r.label, t.label))
    why = fmt::format("the label is longer than {} bytes", sizeof t.label - 1);
  else if (!copyText(r.subset, t.subset) || !copyText(r.exclude_subset, t.excludeSubset))
    why = fmt::format("a subset is longer than {} bytes", sizeof t.subset - 1);
  else if (!(r.max_distance >= 0))
    why = fmt::format("{} is no distance", r.max_distance);
  else if (r.ray_class != FRANKENRAY_SPECULAR && r.ray_class != FRANKENRAY_DIFFUSE)
    why = fmt::format("{} is no class of rays", r.ray_class);
  if (!why.empty()) return false;
  t.maxDistance = r.max_distance;
  t.rayClass = r.ray_class == FRANKENRAY_DIFFUSE ? RayClass::kDiffuse : RayClass::kSpecular;
  return true;
}

bool saysAnything(const RayTerms& t) {
  return t.label[0] || t.subset[0] || t.excludeSubset[0] || t.maxDistance > 0 || t.rayClass != RayClass{};
}

void fillBlock(const frankenray_line& l, const frankenray_batch& b, size_t first, uint32_t n, RayQuery& q) {
  const frankenray_rays& r = b.rays;
  q.kind = RayKind(r.kind);
  q.count = n;
  q.level = uint32_t(r.level);
  if (q.kind == RayKind::kVisibility) {
    for (uint32_t i = 0; i < n; ++i)
      l.space.setSegment(q, i, pointAt(r.origin, first + i), pointAt(r.target, first + i));
  } else {
    for (uint32_t i = 0; i < n; ++i) l.space.setOrigin(q, i, pointAt(r.origin, first + i));
    readVectors(r.direction, first, n, q.direction);
  }
  readFloats(r.time, first, n, q.time);
  readFloats(r.radius, first, n, q.radius);
  readFloats(r.spread, first, n, q.spread);
  for (uint32_t i = 0; i < n; ++i) q.seed[i] = r.seed ? r.seed[first + i] : hashStep(1, first + i);
  q.terms = b.terms;
  if (b.answers.place) q.terms.flags |= RayTerms::kWantsNode;
  for (uint32_t i = 0; i < n; ++i) {
    const SingleRayStart s = r.start ? startOf(r.start[first + i]) : SingleRayStart{};
    q.node[i] = s.node;
    for (int c = 0; c < 3; ++c) q.normal[c][i] = s.normal[c];
  }
  std::fill_n(q.cell, n, 0u);
  std::fill_n(q.importance, n, 0u);
  std::fill_n(q.point, n, 0u);
  std::fill_n(q.u, n, 0.0f);
  std::fill_n(q.v, n, 0.0f);
}

void readBlock(const frankenray_line& l, const frankenray_batch& b, size_t first, uint32_t n,
               const RayQuery& q) {
  const frankenray_answers& a = b.answers;
  const auto kind = RayKind(b.rays.kind);
  const bool full = kind == RayKind::kFullTrace, hit = full || kind == RayKind::kHitTest;
  if (kind != RayKind::kHitTest) writeVectors(q.color, first, n, a.color);
  if (kind != RayKind::kVisibility && a.distance) std::copy_n(q.hitDistance, n, a.distance + first);
  if (hit) {
    const float none = full ? kNoHitFullTrace : kNoHit;
    if (a.position.x)
      for (uint32_t i = 0; i < n; ++i)
        setPoint(a.position, first + i, q.hitDistance[i] < none ? l.space.hitPoint(q, i) : DVec3(0));
    writeVectors(q.hitN, first, n, a.normal);
    if (a.place)
      for (uint32_t i = 0; i < n; ++i)
        a.place[first + i] = makePlace(l.stamp, q.hitNode[i], {q.hitN[0][i], q.hitN[1][i], q.hitN[2][i]});
  }
  if (full) {
    if (a.miss_depth) std::copy_n(q.missDepth, n, a.miss_depth + first);
    if (a.miss_position.x)
      for (uint32_t i = 0; i < n; ++i)
        setPoint(a.miss_position, first + i, q.missDepth[i] > 0 ? l.space.missPoint(q, i) : DVec3(0));
    writeVectors(q.missR, first, n, a.miss_direction);
  }
}

/// Answers of rays that hit nothing, where the server gave none.
void writeMisses(const frankenray_batch& b, size_t first, size_t end) {
  const frankenray_answers& a = b.answers;
  const auto kind = RayKind(b.rays.kind);
  const bool full = kind == RayKind::kFullTrace, hit = full || kind == RayKind::kHitTest;
  const float zero[3] = {0, 0, 0};
  const auto vectors = [&](const frankenray_vectors_out& v, size_t i, const float value[3]) {
    if (!v.x) return;
    const ptrdiff_t at = ptrdiff_t(i) * strideOf(v);
    v.x[at] = value[0], v.y[at] = value[1], v.z[at] = value[2];
  };
  for (size_t i = first; i < end; ++i) {
    const float color = kind == RayKind::kVisibility ? 1.0f : 0.0f;
    const float three[3] = {color, color, color};
    if (kind != RayKind::kHitTest) vectors(a.color, i, three);
    if (kind != RayKind::kVisibility && a.distance)
      a.distance[i] = kind == RayKind::kHitTest ? kNoHit : kNoHitFullTrace;
    if (hit) setPoint(a.position, i, DVec3(0)), vectors(a.normal, i, zero);
    if (hit && a.place) a.place[i] = {};
    if (full) {
      if (a.miss_depth) a.miss_depth[i] = 1;
      setPoint(a.miss_position, i, pointAt(b.rays.origin, i));
      const ptrdiff_t at = ptrdiff_t(i) * strideOf(b.rays.direction);
      const frankenray_vectors& d = b.rays.direction;
      const float direction[3] = {d.x[at], d.y[at], d.z[at]};
      vectors(a.miss_direction, i, direction);
    }
  }
}

// ---- The line ----

/// The line is of no use until the session has another client: every batch ends.
frankenray_status breakLine(frankenray_line& l, const Error& e) {
  const frankenray_status status = statusOf(e, FRANKENRAY_ERROR_SERVER_GONE);
  for (const frankenray_line::Flight& f : l.flights) writeMisses(*f.batch, f.first, f.first + f.count);
  l.flights.clear();
  for (frankenray_batch* b : l.batches) {
    writeMisses(*b, b->submitted, b->rays.count);
    b->status = status;
  }
  l.batches.clear();
  l.oracle.reset();
  return fail(l, status, e.message);
}

/// Makes sure of a connection to the session's present client.
frankenray_status connect(frankenray_line& l) {
  Session& s = *l.session;
  if (l.number == s.number.load(std::memory_order_acquire) && l.number != 0)
    return l.oracle ? FRANKENRAY_OK : FRANKENRAY_ERROR_SERVER_GONE;  // its text stands since it broke
  if (l.oracle)
    (void)breakLine(l, makeError(RiError::kSystem, "the session left the ray server that had these rays"));
  std::lock_guard lock(s.mutex);
  l.number = s.number.load(std::memory_order_relaxed);
  if (!s.client) return fail(l, s.lost, s.error.empty() ? frankenray_status_text(s.lost) : s.error);
  auto made = s.client->connect();
  if (!made) return fail(l, statusOf(made.error(), FRANKENRAY_ERROR_SERVER_GONE), made.error().message);
  l.oracle = std::move(made).value();
  l.space = s.client->worldSpace();
  l.stamp = stampOf(s.client->scene());
  l.knowsTerms = s.client->transport() != RayTransport::kPipe1998;
  return FRANKENRAY_OK;
}

/// Takes in answered blocks, hands out further ones.
frankenray_status pump(frankenray_line& l) {
  for (size_t i = 0; i < l.flights.size();) {
    const frankenray_line::Flight f = l.flights[i];
    if (!l.oracle->answered(f.block)) {
      ++i;
      continue;
    }
    readBlock(l, *f.batch, f.first, f.count, *f.block);
    l.oracle->release(f.block);
    f.batch->answered += f.count;
    if (f.batch->answered == f.batch->rays.count) {
      f.batch->status = FRANKENRAY_OK;
      std::erase(l.batches, f.batch);
    }
    l.flights.erase(l.flights.begin() + ptrdiff_t(i));
  }
  for (frankenray_batch* b : l.batches) {
    const size_t share = (b->rays.count + kBlocksPerBatch - 1) / kBlocksPerBatch;
    const size_t most = std::clamp((share + 63) / 64 * 64, kLeastRays, size_t(kMaxRays));
    while (b->submitted < b->rays.count) {
      RayQuery* const q = l.oracle->acquire();
      if (!q) return FRANKENRAY_OK;
      const auto n = uint32_t(std::min(most, b->rays.count - b->submitted));
      fillBlock(l, *b, b->submitted, n, *q);
      l.flights.push_back({q, b, b->submitted, n});  // before submit: whatever happens, somebody answers
      b->submitted += n;
      if (auto r = l.oracle->submit(q); !r) return breakLine(l, r.error());
      l.session->blocks.fetch_add(1, std::memory_order_relaxed);
    }
  }
  return FRANKENRAY_OK;
}

/// Waits until `b` is done, or until any block is when b is null.
frankenray_status waitFor(frankenray_line& l, const frankenray_batch* b) {
  for (;;) {
    if (frankenray_status s = pump(l); s != FRANKENRAY_OK) return s;
    if (b ? b->status != FRANKENRAY_PENDING : l.flights.empty()) return b ? b->status : FRANKENRAY_OK;
    if (auto r = l.oracle->wait(); !r) return breakLine(l, r.error());
    if (!b) return pump(l);
  }
}

/// The way of every function of a line.
template <class Body>
frankenray_status within(frankenray_line* line, Body body) noexcept {
  if (!line) return FRANKENRAY_ERROR_ARGUMENT;
  if (line->fork != forkNumber()) return FRANKENRAY_ERROR_FORKED;
  return guarded([&] { return body(*line); });
}

frankenray_status check(frankenray_line& l, const frankenray_rays* rays, const frankenray_answers* answers,
                        frankenray_batch& b) {
  b.rays = FRANKENRAY_RAYS_INIT;
  b.answers = FRANKENRAY_ANSWERS_INIT;
  if (!readStructure(rays, b.rays) || !readStructure(answers, b.answers))
    return fail(l, FRANKENRAY_ERROR_ARGUMENT,
                "rays or answers are missing or damaged: begin with FRANKENRAY_RAYS_INIT, _ANSWERS_INIT");
  const frankenray_rays& r = b.rays;
  const frankenray_answers& a = b.answers;
  if (r.kind < FRANKENRAY_TRACE || r.kind > FRANKENRAY_FULLTRACE)
    return fail(l, FRANKENRAY_ERROR_ARGUMENT, fmt::format("{} is no kind of question", r.kind));
  b.terms = RayTerms{};
  if (std::string why; !readTerms(r, b.terms, why)) return fail(l, FRANKENRAY_ERROR_ARGUMENT, why);
  if (r.count > 0 && (!complete(r.origin) ||
                      !(r.kind == FRANKENRAY_VISIBILITY ? complete(r.target) : complete(r.direction))))
    return fail(l, FRANKENRAY_ERROR_ARGUMENT, "a column of the rays is missing");
  if (!completeOrEmpty(a.color) || !completeOrEmpty(a.position) || !completeOrEmpty(a.normal) ||
      !completeOrEmpty(a.miss_position) || !completeOrEmpty(a.miss_direction))
    return fail(l, FRANKENRAY_ERROR_ARGUMENT, "a column of answers has x but not y or z");
  b.rays.level = std::max(1, r.level);
  return FRANKENRAY_OK;
}

/// What can be known only once there is a server.
frankenray_status checkServer(frankenray_line& l, const RayTerms& terms, const frankenray_place* starts,
                              size_t count) {
  if (!l.knowsTerms && saysAnything(terms))
    return fail(l, FRANKENRAY_ERROR_ARGUMENT,
                "the server speaks the protocol of 1998, which has no labels, subsets, distances or classes");
  for (size_t i = 0; i < count; ++i)
    if (!isOurs(starts[i], l.stamp))
      return fail(l, FRANKENRAY_ERROR_ARGUMENT,
                  fmt::format("ray {} starts at a place that another server has told", i));
  return FRANKENRAY_OK;
}

frankenray_status submit(frankenray_line& l, frankenray_batch& b) {
  if (frankenray_status s = connect(l); s != FRANKENRAY_OK) {
    writeMisses(b, 0, b.rays.count);
    return s;
  }
  if (frankenray_status s = checkServer(l, b.terms, b.rays.start, b.rays.start ? b.rays.count : 0);
      s != FRANKENRAY_OK)
    return s;
  l.session->rays[b.rays.kind].fetch_add(b.rays.count, std::memory_order_relaxed);
  b.line = &l;
  if (b.rays.count == 0) {
    b.status = FRANKENRAY_OK;
    return FRANKENRAY_OK;
  }
  l.batches.push_back(&b);
  return pump(l);
}

frankenray_status ask(frankenray_line& l, const frankenray_ray& r, const RayTerms& terms,
                      frankenray_hit& out) {
  SingleRayMail m;
  const auto kind = RayKind(r.kind);
  const DVec3 origin(r.origin[0], r.origin[1], r.origin[2]),
      d(r.direction[0], r.direction[1], r.direction[2]);
  const Vec3 direction(kind == RayKind::kVisibility ? d - origin : d);
  out = FRANKENRAY_HIT_INIT;
  // A miss, until we know better.
  for (int c = 0; c < 3; ++c) out.color[c] = kind == RayKind::kVisibility ? 1.0f : 0.0f;
  if (kind != RayKind::kVisibility) out.distance = kind == RayKind::kHitTest ? kNoHit : kNoHitFullTrace;
  if (kind == RayKind::kFullTrace) {
    out.miss_depth = 1;
    for (int c = 0; c < 3; ++c) out.miss_position[c] = r.origin[c], out.miss_direction[c] = direction[c];
  }
  if (frankenray_status s = connect(l); s != FRANKENRAY_OK) return s;
  if (frankenray_status s = checkServer(l, terms, &r.start, 1); s != FRANKENRAY_OK) return s;
  m.start = startOf(r.start);
  l.space.setOrigin(m.ray, origin);
  for (int c = 0; c < 3; ++c) m.ray.direction[c] = direction[c];
  m.ray.time = r.time, m.ray.radius = r.radius, m.ray.spread = r.spread;
  m.ray.kind = uint8_t(kind);
  m.ray.level = uint16_t(std::clamp(r.level, 1, 65535));
  m.ray.seed = r.seed;
  const auto askOnce = [&] { return saysAnything(terms) ? l.oracle->ask(m, terms) : l.oracle->ask(m); };
  Result<SingleAnswer> got = askOnce();
  while (!got && got.error().code == RiError::kLimit && !l.flights.empty()) {
    if (frankenray_status s = waitFor(l, nullptr); s != FRANKENRAY_OK) return s;
    got = askOnce();
  }
  if (!got) return breakLine(l, got.error());
  l.session->rays[r.kind].fetch_add(1, std::memory_order_relaxed);
  l.session->singles.fetch_add(1, std::memory_order_relaxed);
  const SingleAnswer& a = *got;
  const bool hit = a.hitDistance < (kind == RayKind::kHitTest ? kNoHit : kNoHitFullTrace);
  const DVec3 P = l.space.hitPoint(a), M = l.space.missPoint(a);
  for (int c = 0; c < 3; ++c) {
    out.color[c] = a.color[c];
    out.normal[c] = a.hitN[c];
    out.position[c] = hit && kind >= RayKind::kHitTest ? P[c] : 0;
    out.miss_position[c] = a.missDepth > 0 ? M[c] : 0;
    out.miss_direction[c] = a.missR[c];
  }
  out.distance = a.hitDistance;
  out.miss_depth = a.missDepth;
  if (kind >= RayKind::kHitTest) out.place = makePlace(l.stamp, a.hitNode, {a.hitN[0], a.hitN[1], a.hitN[2]});
  return FRANKENRAY_OK;
}

frankenray_ray rayOf(int kind, const double origin[3], const double direction[3]) {
  frankenray_ray r = FRANKENRAY_RAY_INIT;
  r.kind = kind;
  std::copy_n(origin, 3, r.origin);
  std::copy_n(direction, 3, r.direction);
  return r;
}

}  // namespace

extern "C" {

frankenray_line* frankenray_line_open(frankenray_session* session) {
  if (!session) return nullptr;
  try {
    auto* l = new frankenray_line;
    l->session = session->shared;
    l->fork = session->shared->fork;
    l->flights.reserve(64);
    return l;
  } catch (...) {
    return nullptr;
  }
}

void frankenray_line_close(frankenray_line* line) {
  (void)within(line, [](frankenray_line& l) -> frankenray_status {
    while (l.oracle && !l.batches.empty()) (void)waitFor(l, l.batches.front());
    return FRANKENRAY_OK;
  });
  if (!line) return;
  for (frankenray_batch* b : line->handles) {
    b->line = nullptr;
    if (b->status == FRANKENRAY_PENDING) b->status = FRANKENRAY_ERROR_STATE;
  }
  delete line;
}

const char* frankenray_line_error_text(frankenray_line* line) {
  if (!line) return frankenray_status_text(FRANKENRAY_ERROR_ARGUMENT);
  if (line->fork != forkNumber()) return frankenray_status_text(FRANKENRAY_ERROR_FORKED);
  return line->error.c_str();
}

frankenray_status frankenray_submit(frankenray_line* line, const frankenray_rays* rays,
                                    const frankenray_answers* answers, frankenray_batch** batch) {
  if (batch) *batch = nullptr;
  return within(line, [&](frankenray_line& l) -> frankenray_status {
    if (!batch) return fail(l, FRANKENRAY_ERROR_ARGUMENT, "no place for the batch");
    auto b = std::make_unique<frankenray_batch>();
    if (frankenray_status s = check(l, rays, answers, *b); s != FRANKENRAY_OK) return s;
    l.handles.reserve(l.handles.size() + 1);
    if (frankenray_status s = submit(l, *b); s != FRANKENRAY_OK) return s;
    l.handles.push_back(b.get());
    *batch = b.release();
    return FRANKENRAY_OK;
  });
}

frankenray_status frankenray_poll(frankenray_batch* batch) {
  if (!batch) return FRANKENRAY_ERROR_ARGUMENT;
  if (batch->status != FRANKENRAY_PENDING || !batch->line) return batch->status;
  return within(batch->line, [&](frankenray_line& l) -> frankenray_status {
    if (frankenray_status s = connect(l); s == FRANKENRAY_OK) s = pump(l);
    return batch->status;
  });
}

frankenray_status frankenray_wait(frankenray_batch* batch) {
  if (!batch) return FRANKENRAY_ERROR_ARGUMENT;
  if (batch->status != FRANKENRAY_PENDING || !batch->line) return batch->status;
  return within(batch->line, [&](frankenray_line& l) -> frankenray_status {
    if (connect(l) == FRANKENRAY_OK && batch->status == FRANKENRAY_PENDING) (void)waitFor(l, batch);
    return batch->status;
  });
}

void frankenray_release(frankenray_batch* batch) {
  if (!batch) return;
  (void)frankenray_wait(batch);
  if (frankenray_line* const l = batch->line) {
    std::erase(l->handles, batch);
    std::erase(l->batches, batch);
  }
  delete batch;
}

frankenray_status frankenray_answer(frankenray_line* line, const frankenray_rays* rays,
                                    const frankenray_answers* answers) {
  return within(line, [&](frankenray_line& l) -> frankenray_status {
    frankenray_batch b;
    if (frankenray_status s = check(l, rays, answers, b); s != FRANKENRAY_OK) return s;
    try {
      if (frankenray_status s = submit(l, b); s != FRANKENRAY_OK) return s;
      if (b.status == FRANKENRAY_PENDING) (void)waitFor(l, &b);
    } catch (...) {
      (void)breakLine(l, makeError(RiError::kNoMem, "out of memory"));  // nothing may go on with this batch
      throw;
    }
    return b.status;
  });
}

frankenray_status frankenray_ask(frankenray_line* line, const frankenray_ray* ray, frankenray_hit* hit) {
  return within(line, [&](frankenray_line& l) -> frankenray_status {
    frankenray_ray r = FRANKENRAY_RAY_INIT;
    if (!readStructure(ray, r) || !hit || hit->size < sizeof(size_t))
      return fail(l, FRANKENRAY_ERROR_ARGUMENT,
                  "ray or hit is missing or damaged: begin with FRANKENRAY_RAY_INIT, _HIT_INIT");
    if (r.kind < FRANKENRAY_TRACE || r.kind > FRANKENRAY_FULLTRACE)
      return fail(l, FRANKENRAY_ERROR_ARGUMENT, fmt::format("{} is no kind of question", r.kind));
    RayTerms terms{};
    if (std::string why; !readTerms(r, terms, why)) return fail(l, FRANKENRAY_ERROR_ARGUMENT, why);
    frankenray_hit out;
    const frankenray_status s = ask(l, r, terms, out);
    const size_t size = hit->size;
    std::memcpy(hit, &out, std::min(size, sizeof out));
    hit->size = size;
    return s;
  });
}

frankenray_status frankenray_trace(frankenray_line* line, const double origin[3], const double direction[3],
                                   float color[3]) {
  if (!origin || !direction || !color) return FRANKENRAY_ERROR_ARGUMENT;
  const frankenray_ray r = rayOf(FRANKENRAY_TRACE, origin, direction);
  frankenray_hit h = FRANKENRAY_HIT_INIT;
  const frankenray_status s = frankenray_ask(line, &r, &h);
  std::copy_n(h.color, 3, color);
  return s;
}

frankenray_status frankenray_visibility(frankenray_line* line, const double from[3], const double to[3],
                                        float color[3]) {
  if (!from || !to || !color) return FRANKENRAY_ERROR_ARGUMENT;
  const frankenray_ray r = rayOf(FRANKENRAY_VISIBILITY, from, to);
  frankenray_hit h = FRANKENRAY_HIT_INIT;
  h.color[0] = h.color[1] = h.color[2] = 1;
  const frankenray_status s = frankenray_ask(line, &r, &h);
  std::copy_n(h.color, 3, color);
  return s;
}

frankenray_status frankenray_rayhittest(frankenray_line* line, const double origin[3],
                                        const double direction[3], float* distance, double position[3],
                                        float normal[3]) {
  if (!origin || !direction || !distance) return FRANKENRAY_ERROR_ARGUMENT;
  const frankenray_ray r = rayOf(FRANKENRAY_HITTEST, origin, direction);
  frankenray_hit h = FRANKENRAY_HIT_INIT;
  h.distance = FRANKENRAY_NO_HIT;
  const frankenray_status s = frankenray_ask(line, &r, &h);
  *distance = h.distance;
  if (h.distance < FRANKENRAY_NO_HIT) {
    if (position) std::copy_n(h.position, 3, position);
    if (normal) std::copy_n(h.normal, 3, normal);
  }
  return s;
}

frankenray_status frankenray_fulltrace(frankenray_line* line, const double origin[3],
                                       const double direction[3], frankenray_hit* hit) {
  if (!origin || !direction || !hit) return FRANKENRAY_ERROR_ARGUMENT;
  const frankenray_ray r = rayOf(FRANKENRAY_FULLTRACE, origin, direction);
  return frankenray_ask(line, &r, hit);
}

}  // extern "C"
