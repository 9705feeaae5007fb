// A line over a channel in shared memory.
#pragma once

#include <array>
#include <functional>
#include <optional>
#include <vector>

#include "oracle/ray_oracle.h"
#include "shm/channel.h"

namespace fr {

/// Not thread-safe. Errors are for good: after the first every call returns it, and blocks come from private
/// memory.
class ChannelLine : public RayOracle {
 public:
  /// `explain` turns an error of the channel into what the user should read. `keep`: kept alive as long as
  /// the line.
  ChannelLine(shm::ClientChannel channel, std::function<Error(const Error&)> explain,
              std::shared_ptr<void> keep);
  ~ChannelLine() override;

  Result<SingleAnswer> ask(const SingleRayMail& ray) override;
  RayQuery* acquire() override;
  Result<void> submit(RayQuery* q) override;
  bool answered(const RayQuery* q) const override;
  Result<void> wait() override;
  void release(RayQuery* q) override;

 private:
  enum class SlotState : uint8_t { kFree, kFilling, kSubmitted, kAnswered };
  struct Slot {
    RayQuery* query = nullptr;
    SlotState state = SlotState::kFree;
  };
  int find(const RayQuery* q) const;
  Error fail(const Error& e);

  std::shared_ptr<void> keep_;  // first: the channel's callbacks use it
  std::function<Error(const Error&)> explain_;
  mutable shm::ClientChannel channel_;
  mutable std::vector<Slot> slots_;
  std::vector<uint32_t> pending_;
  std::optional<Error> error_;
  std::unique_ptr<RayQuery> orphan_;
};

/// Answers that say that nothing was hit: for blocks that a server would not answer.
void makeMisses(RayQuery& q);

}  // namespace fr
