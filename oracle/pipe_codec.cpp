#include "oracle/pipe_codec.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <type_traits>

#include "oracle/control_message.h"
#include "oracle/query_fields.h"
#include "oracle/server_counters.h"
#include "shm/cache_line.h"

namespace fr {
namespace {

constexpr std::byte kFirst{'b'};

char letterOf(RayKind kind) {
  return kind == RayKind::kTrace ? 't' : kind == RayKind::kVisibility ? 'v' : 'h';
}

void put(std::vector<std::byte>& out, const void* data, size_t bytes) {
  const auto* p = static_cast<const std::byte*>(data);
  out.insert(out.end(), p, p + bytes);
}
template <class T>
void put(std::vector<std::byte>& out, const T& value) {
  static_assert(std::is_trivially_copyable_v<T>);
  put(out, &value, sizeof value);
}

struct FrameHeader {
  char letters[2] = {'b', 'F'};
  uint16_t type = 0;
  uint32_t id = 0;
  uint32_t bytes = 0;  // of the body
  uint32_t reserved = 0;
};
static_assert(sizeof(FrameHeader) == kPipeFrameHeaderBytes);

struct RaysHeader {
  uint32_t kind, count, level, reserved0;
  uint32_t columns;  // kHas...
  uint32_t flags;
  uint32_t reserved[2];
};
static_assert(sizeof(RaysHeader) == 32);

struct AnswersHeader {
  uint32_t kind, count;
  uint32_t extras;  // columns after those that the kind has
  uint32_t reserved;
};
static_assert(sizeof(AnswersHeader) == 16);

// Optional columns of a kRays frame.
enum : uint32_t {
  kHasTime = 1,
  kHasFootprint = 2,
  kHasStart = 4,
  kHasSeed = 8,
  kHasImportance = 16,
  kHasTerms = 32,  // no column: RayTerms, once, before the columns
  kAllColumns = 63
};

/// Calls f(array, element size) for every column of the question that `columns` says, in the order of the
/// stream.
template <class Query, class F>
void forEachQuestion(Query& q, uint32_t columns, F&& f) {
  for (auto& a : q.origin) f(a);
  for (auto& a : q.direction) f(a);
  if (columns & kHasTime) f(q.time);
  if (columns & kHasFootprint) f(q.radius), f(q.spread);
  if (columns & kHasStart) {
    for (auto& a : q.normal) f(a);
    f(q.node), f(q.cell), f(q.u), f(q.v);
  }
  if (columns & kHasSeed) f(q.seed);
  if (columns & kHasImportance) f(q.importance);
}
/// Whether the answers to these rays tell the patch that was hit.
bool tellsNode(RayKind kind, const RayTerms& terms) {
  return kind != RayKind::kVisibility && terms.flags & RayTerms::kWantsNode;
}
/// Whether they tell the point that was hit.
bool tellsPoint(RayKind kind, const RayTerms& terms) {
  return kind == RayKind::kFullTrace ||
         (kind == RayKind::kHitTest && !(terms.flags & (RayTerms::kOnlyDistance | RayTerms::kOnlyWhether)));
}
template <class Query, class F>
void forEachAnswer(Query& q, RayKind kind, F&& f) {
  if (kind != RayKind::kHitTest)
    for (auto& a : q.color) f(a);
  if (kind != RayKind::kVisibility) f(q.hitDistance);
  if (tellsPoint(kind, q.terms)) {
    for (auto& a : q.hitP) f(a);
    for (auto& a : q.hitN) f(a);
  }
  if (kind == RayKind::kFullTrace) {
    for (auto& a : q.missP) f(a);
    for (auto& a : q.missR) f(a);
    f(q.missDepth);
  }
  if (tellsNode(kind, q.terms)) f(q.hitNode);
}

size_t questionBytes(uint32_t columns) {
  return 24 + (columns & kHasTime ? 4 : 0) + (columns & kHasFootprint ? 8 : 0) +
         (columns & kHasStart ? 28 : 0) + (columns & kHasSeed ? 8 : 0) + (columns & kHasImportance ? 4 : 0);
}
size_t answerBytes(RayKind kind, const RayTerms& terms) {
  const size_t fixed = kind == RayKind::kTrace        ? 16
                       : kind == RayKind::kVisibility ? 12
                       : kind == RayKind::kHitTest    ? (tellsPoint(kind, terms) ? 28 : 4)
                                                      : 68;
  return fixed + (tellsNode(kind, terms) ? 4 : 0);
}

/// Bit by bit: -0 is not 0, and what is no number is itself.
template <class T>
bool anyOtherThan(const T* a, uint32_t n, T value) {
  using Bits = std::conditional_t<sizeof(T) == 4, uint32_t, uint64_t>;
  return std::any_of(a, a + n,
                     [&](const T& x) { return std::bit_cast<Bits>(x) != std::bit_cast<Bits>(value); });
}

}  // namespace

// ------------------------------------------------------------------------------------------------ 1998

void putPipeQuery(std::vector<std::byte>& out, const PipeQuery& q) {
  out.push_back(kFirst);
  out.push_back(std::byte(letterOf(q.kind)));
  put(out, q.values);
}

SingleRayMail pipeQueryRay(const PipeQuery& q, const WorldSpace& space, bool jitter) {
  SingleRayMail m;
  m.ray.kind = uint8_t(q.kind);
  const auto& f = q.values;
  const DVec3 origin(f[0], f[1], f[2]), second(f[3], f[4], f[5]);
  space.setOrigin(m.ray, origin);
  const Vec3 direction(q.kind == RayKind::kVisibility ? second - origin : second);
  for (int c = 0; c < 3; ++c) m.ray.direction[c] = direction[c];
  // The ray's own bits are all that it can be told from others by.
  uint64_t seed = 0xcbf29ce484222325ull;
  for (size_t i = 0; i < 7; ++i) {
    uint32_t bits;
    std::memcpy(&bits, &f[i], sizeof bits);
    seed = (seed ^ bits) * 0x9e3779b97f4a7c15ull;
    seed ^= seed >> 29;
  }
  m.ray.seed = seed;
  m.ray.time = jitter ? float(seed >> 40) * 0x1p-24f : f[6];
  return m;
}

void putPipeReply(std::vector<std::byte>& out, RayKind kind, const SingleAnswer& a, const WorldSpace& space) {
  switch (kind) {
    case RayKind::kTrace:
      put(out, a.color);
      put(out, a.hitDistance);
      break;
    case RayKind::kVisibility:
      put(out, a.color);
      break;
    default: {
      put(out, a.hitDistance);
      const bool hit = a.hitDistance < kNoHit;
      const Vec3 p = hit ? Vec3(space.hitPoint(a)) : Vec3(0);
      for (int c = 0; c < 3; ++c) put(out, p[c]);
      put(out, a.hitN);
    }
  }
}

bool readPipeReply(std::span<const std::byte> bytes, RayKind kind, const WorldSpace& space, SingleAnswer& a) {
  if (bytes.size() != pipeReplyBytes(kind)) return false;
  float f[7] = {};
  std::memcpy(f, bytes.data(), bytes.size());
  a = {};
  if (kind == RayKind::kHitTest) {
    a.hitDistance = f[0];
    if (f[0] < kNoHit) {
      const Vec3 p = space.pointToCache(DVec3(f[1], f[2], f[3]));
      for (int c = 0; c < 3; ++c) a.hitP[c] = p[c];
    }
    for (int c = 0; c < 3; ++c) a.hitN[c] = f[4 + c];
  } else {
    for (int c = 0; c < 3; ++c) a.color[c] = f[c];
    if (kind == RayKind::kTrace) a.hitDistance = f[3];
  }
  return true;
}

// ------------------------------------------------------------------------------------------------ finding
// out

uint64_t pipeFingerprint() {
  return shm::layoutHash(kPipeVersion, sizeof(RaysHeader), sizeof(AnswersHeader), sizeof(RaySceneInfo),
                         sizeof(RayTerms), offsetof(RayTerms, opaque), sizeof(RayServerNumbers),
                         uint64_t(kCounterCount), kMaxRays);
}

PipeQuery pipeHello() {
  PipeQuery q;
  q.values[5] = 1;
  q.values[7] = 0.5f;
  const uint64_t print = pipeFingerprint();
  const uint32_t words[4] = {kPipeHelloMagic, kPipeVersion, uint32_t(print), uint32_t(print >> 32)};
  std::memcpy(&q.values[8], words, sizeof words);
  return q;
}

std::optional<PipeHello> asPipeHello(const PipeQuery& q) {
  uint32_t words[4];
  std::memcpy(words, &q.values[8], sizeof words);
  if (q.kind != RayKind::kTrace || words[0] != kPipeHelloMagic) return std::nullopt;
  return PipeHello{words[1], words[2] | uint64_t(words[3]) << 32};
}

// ------------------------------------------------------------------------------------------------ frames

void putPipeFrame(std::vector<std::byte>& out, PipeFrameType type, uint32_t id,
                  std::span<const std::byte> body) {
  FrameHeader h;
  h.type = uint16_t(type);
  h.id = id;
  h.bytes = uint32_t(body.size());
  put(out, h);
  put(out, body.data(), body.size());
}

void putPipeRays(std::vector<std::byte>& out, uint32_t id, uint32_t flags, const RayQuery& q) {
  const uint32_t n = std::min(q.count, kMaxRays);
  RaysHeader r{};
  r.kind = uint32_t(q.kind), r.count = n, r.level = q.level, r.flags = flags;
  if (anyOtherThan(q.time, n, 0.0f)) r.columns |= kHasTime;
  if (anyOtherThan(q.radius, n, 0.0f) || anyOtherThan(q.spread, n, 0.0f)) r.columns |= kHasFootprint;
  if (anyOtherThan(q.node, n, 0xffffffffu) || anyOtherThan(q.normal[0], n, 0.0f) ||
      anyOtherThan(q.normal[1], n, 0.0f) || anyOtherThan(q.normal[2], n, 0.0f))
    r.columns |= kHasStart;
  if (anyOtherThan(q.seed, n, uint64_t(0))) r.columns |= kHasSeed;
  if (anyOtherThan(q.importance, n, 0x3f800000u)) r.columns |= kHasImportance;
  const auto terms = std::as_bytes(std::span(&q.terms, 1));
  if (std::any_of(terms.begin(), terms.end(), [](std::byte b) { return b != std::byte(0); }))
    r.columns |= kHasTerms;
  const size_t termsBytes = r.columns & kHasTerms ? sizeof(RayTerms) : 0;
  FrameHeader h;
  h.type = uint16_t(PipeFrameType::kRays);
  h.id = id;
  h.bytes = uint32_t(sizeof r + termsBytes + questionBytes(r.columns) * n);
  out.reserve(out.size() + sizeof h + h.bytes);
  put(out, h);
  put(out, r);
  put(out, &q.terms, termsBytes);
  forEachQuestion(q, r.columns, [&](const auto& a) { put(out, a, sizeof a[0] * n); });
}

Result<void> readPipeRays(std::span<const std::byte> body, RayQuery& q, uint32_t& flags) {
  RaysHeader r;
  if (body.size() < sizeof r) return makeError(RiError::kBadFile, "a frame of rays is cut off");
  std::memcpy(&r, body.data(), sizeof r);
  if (r.kind > uint32_t(RayKind::kFullTrace) || r.count > kMaxRays || (r.columns & ~kAllColumns) ||
      (r.flags & ~kPipeStartsAreRoots))
    return makeError(RiError::kBadFile, "a frame of rays has kind {}, {} rays, columns {:#x}, flags {:#x}",
                     r.kind, r.count, r.columns, r.flags);
  const uint32_t n = r.count;
  const size_t termsBytes = r.columns & kHasTerms ? sizeof(RayTerms) : 0;
  const size_t expected = sizeof r + termsBytes + questionBytes(r.columns) * n;
  if (body.size() != expected)
    return makeError(RiError::kBadFile, "a frame of {} rays has {} bytes instead of {}", n, body.size(),
                     expected);
  q.kind = RayKind(r.kind), q.count = n, q.level = r.level;
  flags = r.flags;
  std::fill_n(q.time, n, 0.0f), std::fill_n(q.radius, n, 0.0f), std::fill_n(q.spread, n, 0.0f);
  for (auto& a : q.normal) std::fill_n(a, n, 0.0f);
  std::fill_n(q.node, n, 0xffffffffu), std::fill_n(q.cell, n, 0u);
  std::fill_n(q.u, n, 0.0f), std::fill_n(q.v, n, 0.0f);
  std::fill_n(q.seed, n, uint64_t(0)), std::fill_n(q.importance, n, 0x3f800000u);
  std::fill_n(q.point, n, 0u);
  q.terms = RayTerms{};
  if (termsBytes) std::memcpy(&q.terms, body.data() + sizeof r, termsBytes);
  const std::byte* p = body.data() + sizeof r + termsBytes;
  forEachQuestion(q, r.columns, [&](auto& a) {
    std::memcpy(a, p, sizeof a[0] * n);
    p += sizeof a[0] * n;
  });
  return {};
}

namespace {
/// Extra columns of a block's answers.
uint32_t extrasOf(const RayQuery& q) { return q.kind == RayKind::kVisibility ? 0 : extraAnswers(q.terms); }
}  // namespace

void putPipeAnswers(std::vector<std::byte>& out, uint32_t id, const RayQuery& q) {
  const uint32_t n = std::min(q.count, kMaxRays);
  const uint32_t extras = extrasOf(q);
  const AnswersHeader r{uint32_t(q.kind), n, extras, 0};
  FrameHeader h;
  h.type = uint16_t(PipeFrameType::kAnswers);
  h.id = id;
  h.bytes = uint32_t(sizeof r + (answerBytes(q.kind, q.terms) + extras * sizeof(float)) * n);
  out.reserve(out.size() + sizeof h + h.bytes);
  put(out, h);
  put(out, r);
  forEachAnswer(q, q.kind, [&](const auto& a) { put(out, a, sizeof a[0] * n); });
  for (uint32_t k = 0; k < extras; ++k) put(out, q.extra[k], sizeof(float) * n);
}

Result<void> readPipeAnswers(std::span<const std::byte> body, RayKind kind, uint32_t count, RayQuery& q) {
  AnswersHeader r;
  if (body.size() < sizeof r) return makeError(RiError::kBadFile, "a frame of answers is cut off");
  std::memcpy(&r, body.data(), sizeof r);
  const uint32_t extras = kind == RayKind::kVisibility ? 0 : extraAnswers(q.terms);
  if (r.kind != uint32_t(kind) || r.count != count || count > kMaxRays || r.extras != extras ||
      body.size() != sizeof r + (answerBytes(kind, q.terms) + extras * sizeof(float)) * count)
    return makeError(RiError::kBadFile, "{} answers of kind {} in {} bytes came for {} rays of kind {}",
                     r.count, r.kind, body.size(), count, uint32_t(kind));
  const std::byte* p = body.data() + sizeof r;
  forEachAnswer(q, kind, [&](auto& a) {
    std::memcpy(a, p, sizeof a[0] * count);
    p += sizeof a[0] * count;
  });
  for (uint32_t k = 0; k < extras; ++k, p += sizeof(float) * count)
    std::memcpy(q.extra[k], p, sizeof(float) * count);
  return {};
}

// ------------------------------------------------------------------------------------------------ PipeReader

void PipeReader::feed(std::span<const std::byte> bytes) {
  if (error_) return;
  if (read_ > 0) {
    buffer_.erase(buffer_.begin(), buffer_.begin() + std::ptrdiff_t(read_));
    position_ += read_;
    read_ = 0;
  }
  buffer_.insert(buffer_.end(), bytes.begin(), bytes.end());
}

Error PipeReader::failed(std::string_view what) {
  error_ = makeError(RiError::kBadFile, "byte {} of the stream: {}", position_ + read_, what);
  return *error_;
}

Result<std::optional<PipeReader::Item>> PipeReader::next() {
  if (error_) return *error_;
  const std::span<const std::byte> rest = std::span(buffer_).subspan(read_);
  if (rest.empty()) return std::optional<Item>();
  if (rest[0] != kFirst) return failed(fmt::format("no ray query begins with {:#04x}", uint32_t(rest[0])));
  if (rest.size() < 2) return std::optional<Item>();
  const char letter = char(rest[1]);
  if (letter == 'F') {
    FrameHeader h;
    if (rest.size() < sizeof h) return std::optional<Item>();
    std::memcpy(&h, rest.data(), sizeof h);
    if (h.type < uint16_t(PipeFrameType::kRays) || h.type > uint16_t(PipeFrameType::kRefused) ||
        h.reserved != 0)
      return failed(fmt::format("no frame is of type {}", h.type));
    if (h.bytes > kMaxPipeFrameBytes) return failed(fmt::format("a frame of {} bytes is too long", h.bytes));
    if (rest.size() < sizeof h + h.bytes) return std::optional<Item>();
    PipeFrame f;
    f.type = PipeFrameType(h.type);
    f.id = h.id;
    f.body.assign(rest.begin() + sizeof h, rest.begin() + std::ptrdiff_t(sizeof h + h.bytes));
    read_ += sizeof h + h.bytes;
    return std::optional<Item>(std::move(f));
  }
  if (!queries_ || (letter != 't' && letter != 'v' && letter != 'h'))
    return failed(fmt::format("'b{}' ({:#04x}) is no ray query", letter >= 32 && letter < 127 ? letter : '?',
                              uint32_t(rest[1])));
  if (rest.size() < PipeQuery::kBytes) return std::optional<Item>();
  PipeQuery q;
  q.kind = letter == 't' ? RayKind::kTrace : letter == 'v' ? RayKind::kVisibility : RayKind::kHitTest;
  std::memcpy(q.values.data(), rest.data() + 2, sizeof q.values);
  read_ += PipeQuery::kBytes;
  return std::optional<Item>(q);
}

}  // namespace fr
