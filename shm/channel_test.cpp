#include "shm/channel.h"

#include <gtest/gtest.h>

#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <map>

#include "shm/channel_for_test.h"
#include "shm/file_descriptor.h"

namespace fr::shm {
namespace {

class ChannelTest : public ::testing::Test {
 protected:
  void SetUp() override { descriptors_ = openDescriptorCount(); }
  void TearDown() override { EXPECT_EQ(openDescriptorCount(), descriptors_) << "descriptors leak"; }
  int descriptors_ = 0;
};

TEST_F(ChannelTest, AnswersBlocksInPlace) {
  AddOneHandler handler;
  ServerForTest server(handler, 1);
  ClientChannel c = server.connect({.config = {.blockCount = 3, .blockBytes = 4096}});
  EXPECT_EQ(c.blockCount(), 3u);
  const std::optional<uint32_t> b = c.acquire();
  ASSERT_TRUE(b);
  ASSERT_EQ(c.data(*b).size(), 4096u);
  EXPECT_EQ(reinterpret_cast<uintptr_t>(c.data(*b).data()) % kCacheLine, 0u);
  fillQuestion(c.data(*b), 1000, 17);
  ASSERT_TRUE(c.submit(*b).ok());
  EXPECT_TRUE(c.data(*b).empty()) << "not ours while it is answered";
  const uint32_t list[] = {*b};
  const Result<uint32_t> done = c.waitAny(list);
  ASSERT_TRUE(done.ok()) << done.error().str();
  EXPECT_EQ(c.poll(*b), BlockStatus::kDone);
  EXPECT_TRUE(answerIsRight(c.data(*b), 1000, 17));
  // An answered block can be asked again as it is.
  fillQuestion(c.data(*b), 10, 99);
  ASSERT_TRUE(c.submit(*b).ok());
  ASSERT_TRUE(c.waitAny(list).ok());
  EXPECT_TRUE(answerIsRight(c.data(*b), 10, 99));
  c.release(*b);
  EXPECT_EQ(handler.blocks, 2u);
}

TEST_F(ChannelTest, RefusesMisuse) {
  AddOneHandler handler;
  ServerForTest server(handler, 1);
  ClientChannel c = server.connect({.config = {.blockCount = 2, .blockBytes = 100}});
  EXPECT_FALSE(c.submit(0).ok()) << "not acquired";
  EXPECT_FALSE(c.submit(2).ok());
  EXPECT_EQ(c.poll(0), BlockStatus::kBroken);
  EXPECT_FALSE(c.waitAny({}).ok());
  const uint32_t wrong[] = {7};
  EXPECT_FALSE(c.waitAny(wrong).ok());
  EXPECT_TRUE(c.data(0).empty());
  EXPECT_TRUE(c.data(99).empty());
  const auto a = c.acquire();
  const auto b = c.acquire();
  ASSERT_TRUE(a && b);
  EXPECT_NE(*a, *b);
  EXPECT_FALSE(c.acquire());
  c.release(*a);
  c.release(*a);
  EXPECT_TRUE(c.acquire());
  EXPECT_FALSE(c.acquire()) << "released twice, had once";
  EXPECT_FALSE(c.error());
  EXPECT_FALSE(ClientChannel::create(server.server->board(), {.config = {0, 100}}).ok());
  EXPECT_FALSE(ClientChannel::create(server.server->board(), {.config = {kMaxBlocks + 1, 100}}).ok());
  EXPECT_FALSE(ClientChannel::create(server.server->board(), {.config = {1, kMaxBlockBytes + 1}}).ok());
  EXPECT_FALSE(ClientChannel::create(nullptr, {}).ok());
}

TEST_F(ChannelTest, AFailedBlockSaysSoAndTheChannelLivesOn) {
  AddOneHandler handler;
  ServerForTest server(handler, 1);
  ClientChannel c = server.connect({.config = {.blockCount = 1, .blockBytes = 64}});
  const auto b = c.acquire();
  const uint32_t rubbish = 1000000;
  std::memcpy(c.data(*b).data(), &rubbish, 4);
  ASSERT_TRUE(c.submit(*b).ok());
  const uint32_t list[] = {*b};
  ASSERT_TRUE(c.waitAny(list).ok());
  EXPECT_EQ(c.poll(*b), BlockStatus::kFailed);
  c.release(*b);
  EXPECT_TRUE(exchange(c, 20, 1));
}

TEST_F(ChannelTest, MailsOfEverySize) {
  AddOneHandler handler;
  ServerForTest server(handler, 1);
  ClientChannel c = server.connect();
  std::byte request[kMailBytes + 1];
  std::byte answer[kMailBytes];
  for (size_t i = 0; i <= kMailBytes; ++i) request[i] = std::byte(i * 3);
  for (size_t n = 0; n <= kMailBytes; ++n) {
    const Result<uint32_t> got = c.call(std::span(request).first(n), answer);
    if (n == 13) {
      EXPECT_EQ(got.error().code, RiError::kIncapable);
      continue;
    }
    ASSERT_TRUE(got.ok()) << got.error().str();
    ASSERT_EQ(*got, n);
    for (size_t i = 0; i < n; ++i) ASSERT_EQ(answer[i], request[n - 1 - i]);
  }
  EXPECT_EQ(c.call(request, answer).error().code, RiError::kRange);
  EXPECT_EQ(c.call(std::span(request).first(20), std::span(answer).first(19)).error().code, RiError::kRange);
  EXPECT_TRUE(c.call(std::span(request).first(20), answer).ok());
}

TEST_F(ChannelTest, ManyClientsManyThreads) {
  for (const int serverThreads : {1, 2, 3}) {
    AddOneHandler handler;
    ServerForTest server(handler, serverThreads);
    std::vector<std::thread> clients;
    std::atomic<int> good{0};
    for (uint32_t t = 0; t < 4; ++t) {
      clients.emplace_back([&, t] {
        ClientChannel c = server.connect({.config = {.blockCount = t + 1, .blockBytes = 256}});
        good += exchange(c, 1500, t * 1000000);
      });
    }
    for (std::thread& t : clients) t.join();
    EXPECT_EQ(good, 4);
    EXPECT_EQ(handler.blocks, 6000u);
    server.stop();
    for (const auto& [id, message] : handler.endedChannels()) EXPECT_EQ(message, "") << id;
  }
}

/// Finishes blocks later, from another thread, the last first.
class DeferringHandler : public AddOneHandler {
 public:
  Served serveBlock(const ServedBlock& block) override {
    const std::lock_guard lock(mutex);
    waiting.push_back(block);
    return Served::kDeferred;
  }
  std::vector<ServedBlock> take() {
    const std::lock_guard lock(mutex);
    return std::exchange(waiting, {});
  }
  std::vector<ServedBlock> waiting;
};

TEST_F(ChannelTest, AnswersMayComeLaterAndInAnyOrder) {
  DeferringHandler handler;
  ServerForTest server(handler, 2);
  ClientChannel c = server.connect({.config = {.blockCount = 8, .blockBytes = 64}});
  std::atomic<bool> stop{false};
  std::thread finisher([&] {
    while (!stop) {
      std::vector<ServedBlock> list = handler.take();
      for (auto it = list.rbegin(); it != list.rend(); ++it) {
        const Served r = handler.AddOneHandler::serveBlock(*it);
        server.server->complete(*it, r == Served::kDone);
        server.server->complete(*it, true);  // a second time does nothing
      }
      std::this_thread::yield();
    }
  });
  EXPECT_TRUE(exchange(c, 1000, 5));
  stop = true;
  finisher.join();
}

TEST_F(ChannelTest, ADeferredBlockOutlivesItsChannel) {
  DeferringHandler handler;
  ServerForTest server(handler, 1);
  {
    ClientChannel c = server.connect();
    const auto b = c.acquire();
    ASSERT_TRUE(c.submit(*b).ok());
    while (handler.endedChannels().empty()) {
      const std::lock_guard lock(handler.mutex);
      if (!handler.waiting.empty()) break;
    }
  }
  while (server.server->channelCount() > 0) std::this_thread::yield();
  std::vector<ServedBlock> list = handler.take();
  ASSERT_EQ(list.size(), 1u);
  std::memset(list[0].bytes.data(), 1, list[0].bytes.size());
  server.server->complete(list[0], true);
}

TEST_F(ChannelTest, AClientThatLeavesIsRemoved) {
  AddOneHandler handler;
  ServerForTest server(handler, 2);
  {
    ClientChannel c = server.connect();
    EXPECT_TRUE(exchange(c, 3, 0));
    EXPECT_EQ(server.server->channelCount(), 1u);
  }
  while (handler.endedChannels().empty()) std::this_thread::yield();
  EXPECT_EQ(handler.endedChannels()[0].second, "");
  EXPECT_EQ(server.server->channelCount(), 0u);
}

/// How often each thread of this process but this one has gone to sleep.
std::map<std::string, std::string> sleepsOfOthers() {
  std::map<std::string, std::string> sleeps;
  const std::string self = std::to_string(::gettid());
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
    const std::string tid = task.path().filename();
    if (tid == self) continue;
    std::ifstream status(task.path() / "status");
    for (std::string line; std::getline(status, line);)
      if (line.starts_with("voluntary_ctxt_switches:")) sleeps[tid] = line;
  }
  return sleeps;
}

TEST_F(ChannelTest, AServerThatHasNothingToDoIsNeverWoken) {
  // A sanitizer has a thread of its own, made with the first other one, which wakes by itself.
  std::thread([] {}).join();
  const auto others = sleepsOfOthers();
  const auto sleepsOfServer = [&] {
    auto sleeps = sleepsOfOthers();
    for (const auto& [tid, line] : others) sleeps.erase(tid);
    return sleeps;
  };
  AddOneHandler handler;
  ServerForTest server(handler, 2);
  ClientChannel c = server.connect();
  EXPECT_TRUE(exchange(c, 3, 0));
  // Until all threads have stopped spinning. Then there is nothing that could wake them: no timer.
  const auto sleeping = [&] {
    uint32_t n = 0;
    for (uint32_t b = 0; b < DoorbellRow::kBells; ++b)
      n += server.server->board()->bells().bell(b).sleepers.load();
    return n;
  };
  while (sleeping() < 2) std::this_thread::yield();
  ::usleep(100000);  // from the announcement into the kernel
  const auto before = sleepsOfServer();
  ASSERT_GE(before.size(), 2u);
  ::usleep(600000);
  EXPECT_EQ(sleepsOfServer(), before);
  EXPECT_TRUE(exchange(c, 3, 0));
}

TEST_F(ChannelTest, ChannelsOfOtherProcessorsAreServedThoughOurOwnAreBusy) {
  AddOneHandler handler;
  ServerForTest server(handler, 1);
  std::atomic<bool> stop{false};
  std::vector<std::thread> near;
  for (uint32_t t = 0; t < 2; ++t)
    near.emplace_back([&, t] {
      ClientChannel c = server.connect({.config = {4, 256}});
      while (!stop) EXPECT_TRUE(exchange(c, 50, t));
    });
  // Far away: a processor on which nobody serves.
  auto memory = ChannelMemory::create({2, 64});
  ASSERT_TRUE(memory.ok());
  ASSERT_TRUE(server.server->add(std::move(*memory->share())).ok());
  for (uint64_t i = 0; i < 20; ++i) {
    memory->state(0).store(blockState(i + 1, BlockPhase::kSubmitted));
    memory->ringSlot(i).store(0);
    memory->control().tail.processor.store(0xfffffff0);
    memory->control().tail.value.store(i + 1);
    server.server->board()->bells().ringOne(0);
    while (memory->state(0).load() != blockState(i + 1, BlockPhase::kDone)) std::this_thread::yield();
  }
  stop = true;
  for (auto& t : near) t.join();
}

TEST_F(ChannelTest, AServerThatIsKnownToBeDeadEndsTheWait) {
  DeferringHandler handler;  // never answers
  ServerForTest server(handler, 1);
  ClientChannel c = server.connect({.wait = {std::chrono::nanoseconds(0), std::chrono::seconds(1000)}});
  const auto b = c.acquire();
  ASSERT_TRUE(c.submit(*b).ok());
  std::thread teller([&] {
    while (handler.take().empty()) std::this_thread::yield();
    c.serverIsGone();
  });
  const uint32_t list[] = {*b};
  const Result<uint32_t> r = c.waitAny(list);
  teller.join();
  ASSERT_FALSE(r.ok());
  EXPECT_EQ(r.error().code, RiError::kSystem);
  EXPECT_NE(r.error().message.find("gone"), std::string::npos) << r.error().str();
  EXPECT_FALSE(c.call({}, {}).ok());
}

TEST_F(ChannelTest, AServerThatLeavesEndsTheWait) {
  DeferringHandler handler;  // never answers
  auto server = std::make_unique<ServerForTest>(handler, 1);
  // A re-check so late that only the server's farewell can end the wait.
  ClientChannel c = server->connect({.wait = {std::chrono::nanoseconds(0), std::chrono::seconds(1000)}});
  const auto b = c.acquire();
  ASSERT_TRUE(c.submit(*b).ok());
  std::thread leaver([&] {
    while (handler.take().empty()) std::this_thread::yield();
    server->stop();
  });
  const uint32_t list[] = {*b};
  const Result<uint32_t> r = c.waitAny(list);
  leaver.join();
  ASSERT_FALSE(r.ok());
  EXPECT_NE(r.error().message.find("left"), std::string::npos) << r.error().str();
  EXPECT_EQ(c.poll(*b), BlockStatus::kBroken);
  EXPECT_FALSE(c.submit(*b).ok());
  EXPECT_FALSE(c.acquire());
  EXPECT_FALSE(c.call({}, {}).ok());
  EXPECT_FALSE(c.data(*b).empty()) << "the question is still there, to be asked elsewhere";
}

TEST_F(ChannelTest, ARemovedChannelEndsTheClientsWait) {
  DeferringHandler handler;
  ServerForTest server(handler, 1);
  ClientChannel c = server.connect({.wait = {std::chrono::nanoseconds(0), std::chrono::seconds(1000)}});
  const auto b = c.acquire();
  ASSERT_TRUE(c.submit(*b).ok());
  std::thread remover([&] {
    while (handler.take().empty()) std::this_thread::yield();
    server.server->remove(1);
  });
  const uint32_t list[] = {*b};
  EXPECT_FALSE(c.waitAny(list).ok());
  remover.join();
  EXPECT_TRUE(handler.endedChannels().empty()) << "not told what it did itself";
}

TEST_F(ChannelTest, AnotherVersionIsRefused) {
  const auto board = ServerBoard::create();
  ASSERT_TRUE(board.ok());
  const auto memory = ChannelMemory::create({});
  ASSERT_TRUE(memory.ok());
  memory->control().header.version = kChannelVersion + 1;
  const auto again = ChannelMemory::attach(std::move(*memory->share()), ChannelSide::kServer);
  ASSERT_FALSE(again.ok());
  EXPECT_EQ(again.error().code, RiError::kVersion);
  memory->control().header.version = kChannelVersion;
  memory->control().header.fingerprint ^= 1;
  EXPECT_EQ(ChannelMemory::attach(std::move(*memory->share()), ChannelSide::kServer).error().code,
            RiError::kVersion);
  // A board is not a channel, nor a channel a board.
  EXPECT_EQ(ChannelMemory::attach(std::move(*(*board)->share()), ChannelSide::kServer).error().code,
            RiError::kBadFile);
  memory->control().header.fingerprint ^= 1;
  EXPECT_EQ(ServerBoard::attach(std::move(*memory->share())).error().code, RiError::kBadFile);
}

}  // namespace
}  // namespace fr::shm
