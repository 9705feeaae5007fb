// One ray question and its answer, small enough for the mailbox of a channel (shm/channel.h,
// ClientChannel::call).
//
// A question is SingleRay (48 bytes: with the mailbox's own words one 64-byte line) or SingleRay followed by
// SingleRayStart (88 bytes, two lines) when the ray starts on a surface. An answer is
// SingleAnswer without or with its last part, see singleAnswerBytes(). The same ray gets the same bits as in
// a block (oracle/ray_query.h). Everything spatial is in cache space. Trivially copyable: these are the bytes
// that travel, and whoever receives them checks every field.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <type_traits>

#include "oracle/ray_query.h"

namespace fr {

/// What a ray that starts on no known surface needs.
struct SingleRay {
  float origin[3] = {};
  float direction[3] = {};  // need not be unit; kVisibility: to - from
  float time = 0;           // 0..1 within the shutter
  float radius = 0;         // footprint at the origin
  float spread = 0;         // growth of the footprint's radius per unit of distance
  uint8_t kind = 0;         // RayKind
  uint8_t reserved = 0;     // 0
  uint16_t level = 1;       // ray level: 1 for rays asked by camera-visible points
  uint64_t seed = 0;        // path of counter-based random numbers
};

/// Where a ray starts, and what is rarely set.
struct SingleRayStart {
  float normal[3] = {};         // geometric normal (unit, oriented); 0: does not start on a surface
  uint32_t node = 0xffffffffu;  // patch, cache::kNone: none
  uint32_t cell = 0;
  float u = 0, v = 0;
  uint32_t importance = 0;    // weight as float bits; reserved for pruning
  uint32_t reserved[2] = {};  // 0
};

/// A whole question.
struct SingleRayMail {
  SingleRay ray;
  SingleRayStart start;
};

/// Meaningful by kind as in RayQuery; the rest is 0.
struct SingleAnswer {
  float color[3] = {};
  float hitDistance = 0;
  float hitP[3] = {};
  float hitN[3] = {};
  float missDepth = 0;
  uint32_t hitNode = 0xffffffffu;  // patch that was hit; cache::kNone: nothing, or not asked for by this kind
  // Of kFullTrace only:
  float missP[3] = {};
  float missR[3] = {};
};

inline constexpr size_t kSingleRayBytes = 48;
inline constexpr size_t kSingleRayMailBytes = 88;
inline constexpr size_t kSingleAnswerBytes = 48;
inline constexpr size_t kSingleFullAnswerBytes = 72;

static_assert(std::is_trivially_copyable_v<SingleRayMail> && std::is_standard_layout_v<SingleRayMail> &&
              std::is_trivially_copyable_v<SingleAnswer> && std::is_standard_layout_v<SingleAnswer>);
static_assert(sizeof(SingleRay) == kSingleRayBytes && offsetof(SingleRay, time) == 24 &&
              offsetof(SingleRay, kind) == 36 && offsetof(SingleRay, level) == 38 &&
              offsetof(SingleRay, seed) == 40);
static_assert(sizeof(SingleRayMail) == kSingleRayMailBytes &&
              offsetof(SingleRayMail, start) == kSingleRayBytes && offsetof(SingleRayStart, node) == 12 &&
              offsetof(SingleRayStart, importance) == 28);
static_assert(sizeof(SingleAnswer) == kSingleFullAnswerBytes &&
              offsetof(SingleAnswer, missP) == kSingleAnswerBytes && offsetof(SingleAnswer, missDepth) == 40);

/// Bytes of the answer to a question of this kind.
constexpr size_t singleAnswerBytes(RayKind kind) {
  return kind == RayKind::kFullTrace ? kSingleFullAnswerBytes : kSingleAnswerBytes;
}

/// The bytes to send: what starts nowhere travels in one cache line.
inline std::span<const std::byte> singleRayBytes(const SingleRayMail& mail) {
  const SingleRayStart& s = mail.start;
  const bool starts =
      s.node != 0xffffffffu || s.normal[0] != 0 || s.normal[1] != 0 || s.normal[2] != 0 || s.importance != 0;
  const std::span<const std::byte> all = std::as_bytes(std::span(&mail, 1));
  return starts ? all : all.first(kSingleRayBytes);
}

/// The server's side: false when these bytes are no question (size, kind). Numbers are not looked at: any
/// float is a ray, one that makes no sense hits nothing.
inline bool readSingleRay(std::span<const std::byte> bytes, SingleRayMail& out) {
  if (bytes.size() != kSingleRayBytes && bytes.size() != kSingleRayMailBytes) return false;
  out = {};
  std::memcpy(static_cast<void*>(&out), bytes.data(), bytes.size());
  return out.ray.kind <= uint32_t(RayKind::kFullTrace);
}

/// The client's side: false when `bytes` are no answer to a question of this kind. Floats may be anything.
inline bool readSingleAnswer(std::span<const std::byte> bytes, RayKind kind, SingleAnswer& out) {
  if (bytes.size() != singleAnswerBytes(kind)) return false;
  out = {};
  std::memcpy(static_cast<void*>(&out), bytes.data(), bytes.size());
  return true;
}

/// The same ray as place `i` of a block, whose kind and level are the block's. REQUIRES i < kMaxRays.
inline void putRay(RayQuery& q, uint32_t i, const SingleRayMail& m) {
  for (int c = 0; c < 3; ++c) {
    q.origin[c][i] = m.ray.origin[c];
    q.direction[c][i] = m.ray.direction[c];
    q.normal[c][i] = m.start.normal[c];
  }
  q.time[i] = m.ray.time, q.radius[i] = m.ray.radius, q.spread[i] = m.ray.spread;
  q.node[i] = m.start.node, q.cell[i] = m.start.cell, q.u[i] = m.start.u, q.v[i] = m.start.v;
  q.seed[i] = m.ray.seed, q.importance[i] = m.start.importance, q.point[i] = 0;
}

/// Answer `i` of a block of this kind as a single one. REQUIRES i < kMaxRays.
inline SingleAnswer singleAnswerOf(const RayQuery& q, uint32_t i, RayKind kind) {
  SingleAnswer a;
  const bool full = kind == RayKind::kFullTrace, hit = full || kind == RayKind::kHitTest;
  if (kind != RayKind::kVisibility) a.hitDistance = q.hitDistance[i];
  if (full) a.missDepth = q.missDepth[i];
  if (kind != RayKind::kVisibility && q.terms.flags & RayTerms::kWantsNode) a.hitNode = q.hitNode[i];
  for (int c = 0; c < 3; ++c) {
    if (kind != RayKind::kHitTest) a.color[c] = q.color[c][i];
    if (hit) a.hitP[c] = q.hitP[c][i], a.hitN[c] = q.hitN[c][i];
    if (full) a.missP[c] = q.missP[c][i], a.missR[c] = q.missR[c][i];
  }
  return a;
}

}  // namespace fr
