// Rays as a stream of bytes over a server's standard input and output: the protocol of 1998, and our frames
// over the same stream. docs/format/pipe.md specifies both.
//
// A stream is read by PipeReader: bytes in, whole queries and frames out, whatever the pieces in which they
// came. It trusts nothing and holds at most one frame.
#pragma once

#include <array>
#include <cstdint>
#include <cstring>
#include <optional>
#include <span>
#include <string_view>
#include <variant>
#include <vector>

#include "base/error.h"
#include "oracle/ray_query.h"
#include "oracle/scene_info.h"
#include "oracle/single_ray.h"

namespace fr {

// ------------------------------------------------------------------------------------------------ 1998

/// A query of 1998: two letters, then twelve floats of this machine. World space.
struct PipeQuery {
  static constexpr size_t kBytes = 2 + 12 * 4;
  RayKind kind = RayKind::kTrace;  // "bt" kTrace, "bv" kVisibility, "bh" kHitTest
  std::array<float, 12>
      values{};  // 0-2 origin (from), 3-5 direction ("bv": to), 6 time, 7 detail, 8-11 reserved
};
/// Appends the 50 bytes. REQUIRES kind other than kFullTrace.
void putPipeQuery(std::vector<std::byte>& out, const PipeQuery& q);
/// As a ray in cache space. Time is 0 at shutter open, 1 at close. `jitter`: a time drawn from the ray itself
/// instead of the one it brings.
SingleRayMail pipeQueryRay(const PipeQuery& q, const WorldSpace& space, bool jitter);

/// Bytes of a reply: kTrace 16 (colour, distance), kVisibility 12 (colour), kHitTest 28 (distance, point,
/// normal).
constexpr size_t pipeReplyBytes(RayKind kind) {
  return kind == RayKind::kTrace ? 16 : kind == RayKind::kVisibility ? 12 : 28;
}
/// Appends the reply to a query of this kind, points in world space.
void putPipeReply(std::vector<std::byte>& out, RayKind kind, const SingleAnswer& answer,
                  const WorldSpace& space);
/// The client's side; false when `bytes` has the wrong size.
bool readPipeReply(std::span<const std::byte> bytes, RayKind kind, const WorldSpace& space,
                   SingleAnswer& out);

// ------------------------------------------------------------------------------------------------ finding
// out

/// A hello is a query of 1998 (trace, along z from the origin) whose reserved floats hold these words; a
/// server of 1998 answers it as the ray that it is, ours with a PipeWelcome: 16 bytes either way.
inline constexpr uint32_t kPipeHelloMagic = 0x48505246;    // "FRPH"
inline constexpr uint32_t kPipeWelcomeMagic = 0x57505246;  // "FRPW"
inline constexpr uint32_t kPipeVersion = 2;

struct PipeWelcome {
  uint32_t magic = kPipeWelcomeMagic;
  uint32_t version = kPipeVersion;
  uint64_t fingerprint = 0;
};
static_assert(sizeof(PipeWelcome) == 16);

uint64_t pipeFingerprint();
PipeQuery pipeHello();
struct PipeHello {
  uint32_t version = 0;
  uint64_t fingerprint = 0;
};
/// What a query says if it is a hello.
std::optional<PipeHello> asPipeHello(const PipeQuery& q);

// ------------------------------------------------------------------------------------------------ frames

enum class PipeFrameType : uint16_t {
  kRays = 1,    // client: PipeRaysHeader and columns
  kAnswers,     // server: PipeAnswersHeader and columns, the id of the rays
  kStatistics,  // client: asks for kNumbers
  kNumbers,     // server: RayServerNumbers, the id of the question
  kGreeting,    // server, once, right after its welcome: text of its version
  kReady,       // server, once, when the scene is loaded: RaySceneInfo
  kRefused,     // server: text. Id 0: the conversation is over; else that question will get no other answer
};
inline constexpr size_t kPipeFrameHeaderBytes = 16;
inline constexpr uint32_t kMaxPipeFrameBytes = 1u << 20;  // of a body

struct PipeFrame {
  PipeFrameType type{};
  uint32_t id = 0;
  std::vector<std::byte> body;
  std::string_view text() const { return {reinterpret_cast<const char*>(body.data()), body.size()}; }
};
void putPipeFrame(std::vector<std::byte>& out, PipeFrameType type, uint32_t id,
                  std::span<const std::byte> body);

/// Where rays of a frame start, instead of node numbers, which are a process's own: RayQuery::node holds the
/// root patch, RayQuery::cell the place of the patch in it: (1 << du | iu) in the low, (1 << dv | iv) in the
/// high half. Meshlets are root patches and keep their cell.
inline constexpr uint32_t kPipeStartsAreRoots = 1;

/// Appends a frame with the first q.count rays. Columns that hold nothing are left out.
void putPipeRays(std::vector<std::byte>& out, uint32_t id, uint32_t flags, const RayQuery& q);
/// Reads a kRays body into `q`; `flags` as given to putPipeRays. Errors: kBadFile (sizes, counts, kind).
Result<void> readPipeRays(std::span<const std::byte> body, RayQuery& q, uint32_t& flags);
/// Appends a frame with the answers that q.kind has.
void putPipeAnswers(std::vector<std::byte>& out, uint32_t id, const RayQuery& q);
/// Reads a kAnswers body into the outputs of `q`, whose kind and count are what was asked. Errors: kBadFile.
Result<void> readPipeAnswers(std::span<const std::byte> body, RayKind kind, uint32_t count, RayQuery& q);

/// Reads a stream from its pieces. Not thread-safe.
class PipeReader {
 public:
  /// frames: expect queries of 1998 and frames (a server); false: frames only (a client, after the welcome).
  explicit PipeReader(bool queries) : queries_(queries) {}
  void feed(std::span<const std::byte> bytes);
  using Item = std::variant<PipeQuery, PipeFrame>;
  /// The next whole item; nothing when more bytes are needed. An error (kBadFile) is for good: after
  /// something that is no query, nothing that follows can be trusted.
  Result<std::optional<Item>> next();
  /// Bytes of an item that has begun.
  size_t pending() const { return buffer_.size() - read_; }

 private:
  Error failed(std::string_view what);
  std::vector<std::byte> buffer_;
  size_t read_ = 0;
  uint64_t position_ = 0;  // of buffer_[0] in the stream
  bool queries_;
  std::optional<Error> error_;
};

}  // namespace fr
