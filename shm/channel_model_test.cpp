// The ring against a reference model, in one thread: every interleaving of whole operations is some sequence
// of these.
#include <gtest/gtest.h>

#include <deque>
#include <map>
#include <random>

#include "shm/channel_for_test.h"

namespace fr::shm {
namespace {

/// Takes what it is given, checks the order against the model, and answers at once or later.
class ModelHandler : public ChannelHandler {
 public:
  Served serveBlock(const ServedBlock& block) override {
    uint32_t tag = 0;
    std::memcpy(&tag, block.bytes.data(), 4);
    EXPECT_FALSE(submitted.empty()) << "a block that nobody submitted";
    if (submitted.empty()) return Served::kFailed;
    EXPECT_EQ(submitted.front(), std::pair(block.index, tag)) << "first in, first out";
    submitted.pop_front();
    switch ((*random)() % 4) {
      case 0:
        deferred.push_back(block);
        return Served::kDeferred;
      case 1:
        finished[block.index] = {tag, false};
        return Served::kFailed;
      default:
        answer(block, tag);
        return Served::kDone;
    }
  }
  void answer(const ServedBlock& block, uint32_t tag) {
    const uint32_t a = tag * 3 + 1;
    std::memcpy(block.bytes.data(), &a, 4);
    finished[block.index] = {tag, true};
  }
  int serveMail(uint64_t, void*, std::span<const std::byte>, std::span<std::byte, kMailBytes>) override {
    return 0;
  }
  void channelEnded(uint64_t, void*, const Error* e) override { ADD_FAILURE() << (e ? e->str() : "ended"); }

  std::mt19937* random = nullptr;
  std::deque<std::pair<uint32_t, uint32_t>> submitted;  // index, tag
  std::vector<ServedBlock> deferred;
  std::map<uint32_t, std::pair<uint32_t, bool>> finished;  // index -> tag, ok
};

class ChannelModelTest : public ::testing::TestWithParam<uint32_t> {};

TEST_P(ChannelModelTest, DoesWhatTheModelDoes) {
  const uint32_t blocks = GetParam();
  std::mt19937 random(blocks * 7919);
  ModelHandler handler;
  handler.random = &random;
  auto server = std::move(*ChannelServer::create(handler));
  Result<ClientChannel> created = ClientChannel::create(server->board(), {.config = {blocks, 8}});
  ASSERT_TRUE(created.ok());
  ClientChannel& c = *created;
  ASSERT_TRUE(server->add(std::move(*c.share())).ok());

  enum class Phase { kFree, kFilling, kOut, kSettled };
  std::vector<Phase> phase(blocks, Phase::kFree);
  std::vector<uint32_t> tag(blocks, 0);
  auto count = [&](Phase p) { return size_t(std::count(phase.begin(), phase.end(), p)); };
  uint32_t nextTag = 1;
  uint64_t submits = 0;
  const int steps = 60000;
  for (int step = 0; step < steps && !HasFailure(); ++step) {
    const uint32_t b = uint32_t(random() % blocks);
    switch (random() % 7) {
      case 0: {
        const std::optional<uint32_t> got = c.acquire();
        ASSERT_EQ(got.has_value(), count(Phase::kFree) > 0) << step;
        if (!got) break;
        ASSERT_EQ(phase[*got], Phase::kFree);
        phase[*got] = Phase::kFilling;
        break;
      }
      case 1:
      case 2: {
        const bool may = phase[b] == Phase::kFilling || phase[b] == Phase::kSettled;
        if (may) {
          tag[b] = nextTag++;
          std::memcpy(c.data(b).data(), &tag[b], 4);
          handler.submitted.emplace_back(b, tag[b]);
          handler.finished.erase(b);
        }
        ASSERT_EQ(c.submit(b).ok(), may);
        if (may) {
          phase[b] = Phase::kOut;
          ++submits;
        }
        break;
      }
      case 3: {
        const size_t before = handler.submitted.size();
        ASSERT_EQ(server->serveOnce(), std::min<size_t>(before, 1));
        break;
      }
      case 4:
        if (!handler.deferred.empty()) {
          const size_t i = random() % handler.deferred.size();
          const ServedBlock d = handler.deferred[i];
          handler.deferred.erase(handler.deferred.begin() + long(i));
          const bool ok = random() % 2;
          if (ok)
            handler.answer(d, tag[d.index]);
          else
            handler.finished[d.index] = {tag[d.index], false};
          server->complete(d, ok);
        }
        break;
      case 5: {
        const BlockStatus s = c.poll(b);
        if (phase[b] == Phase::kFree || phase[b] == Phase::kFilling) {
          ASSERT_EQ(s, BlockStatus::kBroken);
        } else if (const auto it = handler.finished.find(b); it == handler.finished.end()) {
          ASSERT_EQ(s, BlockStatus::kPending);
        } else {
          ASSERT_EQ(it->second.first, tag[b]);
          ASSERT_EQ(s, it->second.second ? BlockStatus::kDone : BlockStatus::kFailed);
          phase[b] = Phase::kSettled;
          uint32_t a = 0;
          std::memcpy(&a, c.data(b).data(), 4);
          if (it->second.second) {
            ASSERT_EQ(a, tag[b] * 3 + 1);
          }
        }
        break;
      }
      default:
        c.release(b);
        if (phase[b] == Phase::kFilling || phase[b] == Phase::kSettled) phase[b] = Phase::kFree;
    }
    ASSERT_FALSE(c.error()) << c.error()->str();
  }
  EXPECT_GT(submits, uint64_t(blocks) * 20) << "the ring has wrapped often";
  handler.deferred.clear();
}

INSTANTIATE_TEST_SUITE_P(Sizes, ChannelModelTest,
                         ::testing::Values(1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 64, 100));

TEST(ChannelWrap, EverySizeManyTimesAround) {
  for (uint32_t blocks = 1; blocks <= 33; ++blocks) {
    AddOneHandler handler;
    auto server = std::move(*ChannelServer::create(handler));
    Result<ClientChannel> c = ClientChannel::create(server->board(), {.config = {blocks, 64}});
    ASSERT_TRUE(c.ok());
    ASSERT_TRUE(server->add(std::move(*c->share())).ok());
    for (uint32_t round = 0; round < 100; ++round) {
      // Fill the ring to the brim, drain it to the bottom.
      std::vector<uint32_t> out;
      while (const auto b = c->acquire()) {
        fillQuestion(c->data(*b), 15, *b + round);
        ASSERT_TRUE(c->submit(*b).ok());
        out.push_back(*b);
      }
      ASSERT_EQ(out.size(), blocks);
      size_t served = 0;
      while (const size_t n = server->serveOnce()) served += n;
      ASSERT_EQ(served, blocks);
      for (const uint32_t b : out) {
        ASSERT_EQ(c->poll(b), BlockStatus::kDone);
        ASSERT_TRUE(answerIsRight(c->data(b), 15, b + round));
        c->release(b);
      }
    }
  }
}

}  // namespace
}  // namespace fr::shm
