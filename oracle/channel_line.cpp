#include "oracle/channel_line.h"

#include <algorithm>

namespace fr {

ChannelLine::ChannelLine(shm::ClientChannel channel, std::function<Error(const Error&)> explain,
                         std::shared_ptr<void> keep)
    : keep_(std::move(keep)),
      explain_(std::move(explain)),
      channel_(std::move(channel)),
      slots_(channel_.blockCount()) {
  pending_.reserve(slots_.size());
}

ChannelLine::~ChannelLine() = default;

Result<SingleAnswer> ChannelLine::ask(const SingleRayMail& ray) {
  if (ray.ray.kind > uint32_t(RayKind::kFullTrace))
    return makeError(RiError::kRange, "{} is no kind of ray", ray.ray.kind);
  if (error_) return *error_;
  std::array<std::byte, shm::kMailBytes> bytes;
  const Result<uint32_t> n = channel_.call(singleRayBytes(ray), bytes);
  if (!n) return channel_.error() ? fail(n.error()) : n.error();
  SingleAnswer answer;
  if (!readSingleAnswer(std::span(bytes).first(*n), RayKind(ray.ray.kind), answer))
    return makeError(RiError::kConsistency, "the ray server's answer to a single ray has {} bytes", *n);
  return answer;
}

RayQuery* ChannelLine::acquire() {
  if (error_) {
    if (!orphan_) orphan_ = std::make_unique<RayQuery>();
    return orphan_.get();
  }
  const std::optional<uint32_t> index = channel_.acquire();
  if (!index || *index >= slots_.size()) return nullptr;
  const std::span<std::byte> bytes = channel_.data(*index);
  if (bytes.size() < sizeof(RayQuery)) return nullptr;
  slots_[*index] = {reinterpret_cast<RayQuery*>(bytes.data()), SlotState::kFilling};
  slots_[*index].query->terms = RayTerms{};
  return slots_[*index].query;
}

Result<void> ChannelLine::submit(RayQuery* q) {
  if (error_) return *error_;
  const int i = find(q);
  if (i < 0 || slots_[size_t(i)].state != SlotState::kFilling)
    return makeError(RiError::kBadHandle, "a block of rays was submitted that was not acquired");
  if (Result<void> r = channel_.submit(uint32_t(i)); !r) return fail(r.error());
  slots_[size_t(i)].state = SlotState::kSubmitted;
  return {};
}

bool ChannelLine::answered(const RayQuery* q) const {
  const int i = find(q);
  if (i < 0) return false;
  Slot& s = slots_[size_t(i)];
  if (s.state == SlotState::kSubmitted && !error_) {
    switch (channel_.poll(uint32_t(i))) {
      case shm::BlockStatus::kDone:
        s.state = SlotState::kAnswered;
        break;
      case shm::BlockStatus::kFailed:
        makeMisses(*s.query);
        s.state = SlotState::kAnswered;
        break;
      default:
        break;
    }
  }
  return s.state == SlotState::kAnswered;
}

Result<void> ChannelLine::wait() {
  if (error_) return *error_;
  pending_.clear();
  for (uint32_t i = 0; i < slots_.size(); ++i) {
    if (slots_[i].state == SlotState::kAnswered) return {};
    if (slots_[i].state == SlotState::kSubmitted) pending_.push_back(i);
  }
  if (pending_.empty()) return makeError(RiError::kIllState, "waiting for rays, but none were submitted");
  if (Result<uint32_t> r = channel_.waitAny(pending_); !r) return fail(r.error());
  return {};
}

void ChannelLine::release(RayQuery* q) {
  const int i = find(q);
  if (i < 0) return;
  Slot& s = slots_[size_t(i)];
  if (s.state == SlotState::kSubmitted && !answered(q)) return;  // the server's
  channel_.release(uint32_t(i));
  s = {};
}

int ChannelLine::find(const RayQuery* q) const {
  for (size_t i = 0; i < slots_.size(); ++i)
    if (q && slots_[i].query == q) return int(i);
  return -1;
}

Error ChannelLine::fail(const Error& e) {
  error_ = explain_ ? explain_(e) : e;
  return *error_;
}

void makeMisses(RayQuery& q) {
  const uint32_t n = std::min(q.count, kMaxRays);
  const float value = q.kind == RayKind::kVisibility ? 1.0f : 0.0f;
  for (uint32_t i = 0; i < n; ++i) {
    q.hitDistance[i] = q.kind == RayKind::kHitTest ? kNoHit : kNoHitFullTrace;
    q.missDepth[i] = 0;
    q.hitNode[i] = 0xffffffffu;
    for (int c = 0; c < 3; ++c)
      q.color[c][i] = value, q.hitP[c][i] = q.hitN[c][i] = q.missP[c][i] = q.missR[c][i] = 0;
  }
}

}  // namespace fr
