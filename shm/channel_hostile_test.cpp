// What the other side may write into shared memory: anything. Nobody crashes, hangs, or touches what is not
// theirs.
#include <gtest/gtest.h>

#include <random>

#include "shm/channel_for_test.h"

namespace fr::shm {
namespace {

constexpr uint64_t kBadWords[] = {
    0,          1,           2,          7,     8,         100,        0x7fffffff,    0x80000000,
    0xffffffff, 0x100000000, ~0ull >> 1, ~0ull, ~0ull - 7, 1ull << 63, kChannelMagic, 0xdeadbeef12345678};

std::atomic_ref<uint64_t> wordAt(const ChannelMemory& m, uint64_t offset) {
  return std::atomic_ref<uint64_t>(
      *reinterpret_cast<uint64_t*>(reinterpret_cast<std::byte*>(&m.control()) + offset));
}

/// Bytes of everything but the blocks.
uint64_t controlBytes(const ChannelMemory& m) {
  return uint64_t(m.block(0).data() - reinterpret_cast<std::byte*>(&m.control()));
}

TEST(HostileHeader, IsRefusedOrHarmless) {
  const ChannelConfig config{5, 1000};
  for (uint64_t offset = 0; offset < sizeof(ChannelHeader); offset += 4) {
    for (const uint64_t bad : kBadWords) {
      Result<ChannelMemory> m = ChannelMemory::create(config);
      ASSERT_TRUE(m.ok());
      uint32_t* word = reinterpret_cast<uint32_t*>(reinterpret_cast<std::byte*>(&m->control()) + offset);
      const uint32_t good = *word;
      if (good == uint32_t(bad)) continue;
      *word = uint32_t(bad);
      const Result<ChannelMemory> a = ChannelMemory::attach(std::move(*m->share()), ChannelSide::kServer);
      const bool matters = offset < sizeof(ChannelHeader) - sizeof(ChannelHeader::pad) &&
                           offset != offsetof(ChannelHeader, creatorPid);
      EXPECT_EQ(a.ok(), !matters) << "offset " << offset << " value " << bad;
      if (a.ok()) {
        EXPECT_EQ(a->blockCount(), 5u);
        EXPECT_EQ(a->block(4).size(), 1000u);
      }
    }
  }
}

TEST(HostileHeader, MemoryThatIsTooSmallIsRefused) {
  Result<ChannelMemory> m = ChannelMemory::create({4, 100000});
  ASSERT_TRUE(m.ok());
  for (const uint64_t bytes : {4096ull, 8192ull, 400000ull}) {
    Result<FileDescriptor> fd = createSealedMemory("small", bytes);
    ASSERT_TRUE(fd.ok());
    Result<Segment> s = Segment::attach(fd->duplicate(), Access::kReadWrite, {.reserve = 0});
    ASSERT_TRUE(s.ok());
    std::memcpy(s->data(), &m->control(), sizeof(ChannelControl));
    EXPECT_EQ(ChannelMemory::attach(std::move(*fd), ChannelSide::kServer).error().code, RiError::kBadFile)
        << bytes;
  }
  Result<FileDescriptor> nothing = createSealedMemory("none", 0);
  ASSERT_TRUE(nothing.ok());
  EXPECT_FALSE(ChannelMemory::attach(nothing->duplicate(), ChannelSide::kServer).ok());
  EXPECT_FALSE(ServerBoard::attach(nothing->duplicate()).ok());
}

/// A client that knows no rules, written against the bare memory.
struct BareClient {
  explicit BareClient(ChannelServer& server, ChannelConfig config = {4, 64})
      : memory(std::move(*ChannelMemory::create(config))) {
    id = *server.add(std::move(*memory.share()));
  }
  void push(uint64_t position, uint32_t index, uint64_t state) {
    if (index < memory.blockCount()) memory.state(index).store(state);
    memory.ringSlot(position).store(index);
    memory.control().tail.value.store(position + 1);
  }
  bool refused() const { return memory.control().serverState.value.load() == uint32_t(SideState::kBroken); }
  ChannelMemory memory;
  uint64_t id = 0;
};

TEST(HostileClient, EachBreachOfTheRulesEndsItsChannelOnly) {
  AddOneHandler handler;
  auto server = std::move(*ChannelServer::create(handler));
  Result<ClientChannel> honest = ClientChannel::create(server->board(), {.config = {2, 64}});
  ASSERT_TRUE(honest.ok() && server->add(std::move(*honest->share())).ok());
  auto honestStillServed = [&] {
    const auto b = honest->acquire();
    fillQuestion(honest->data(*b), 3, 8);
    if (!honest->submit(*b)) return false;
    server->serveOnce();
    const bool ok = honest->poll(*b) == BlockStatus::kDone && answerIsRight(honest->data(*b), 3, 8);
    honest->release(*b);
    return ok;
  };
  const uint64_t submitted = blockState(1, BlockPhase::kSubmitted);
  const std::vector<std::pair<const char*, std::function<void(BareClient&)>>> breaches = {
      {"index out of range", [&](BareClient& c) { c.push(0, 4, submitted); }},
      {"huge index", [&](BareClient& c) { c.push(0, 0xffffffff, submitted); }},
      {"more blocks than there are", [&](BareClient& c) { c.memory.control().tail.value.store(5); }},
      {"tail far ahead", [&](BareClient& c) { c.memory.control().tail.value.store(~0ull); }},
      {"state free", [&](BareClient& c) { c.push(0, 1, blockState(1, BlockPhase::kFree)); }},
      {"state done", [&](BareClient& c) { c.push(0, 1, blockState(1, BlockPhase::kDone)); }},
      {"no such phase", [&](BareClient& c) { c.push(0, 1, 8 + 7); }},
      {"use 0", [&](BareClient& c) { c.push(0, 1, blockState(0, BlockPhase::kSubmitted)); }},
      {"the same submission again",
       [&](BareClient& c) {
         c.push(0, 1, submitted);
         server->serveOnce();
         EXPECT_FALSE(c.refused());
         c.push(1, 1, submitted);
       }},
      {"tail goes back",
       [&](BareClient& c) {
         c.push(0, 1, submitted);
         server->serveOnce();
         EXPECT_FALSE(c.refused());
         c.memory.control().tail.value.store(0);
       }},
      {"mail state skips", [&](BareClient& c) { c.memory.control().mailbox.state.store(3); }},
      {"mail state even", [&](BareClient& c) { c.memory.control().mailbox.state.store(2); }},
      {"mail too large",
       [&](BareClient& c) {
         c.memory.control().mailbox.size.store(kMailBytes + 1);
         c.memory.control().mailbox.state.store(1);
       }},
      {"mail size negative",
       [&](BareClient& c) {
         c.memory.control().mailbox.size.store(~0u);
         c.memory.control().mailbox.state.store(1);
       }},
      {"client state unknown", [&](BareClient& c) { c.memory.control().clientState.value.store(77); }},
  };
  for (const auto& [name, breach] : breaches) {
    BareClient c(*server);
    ASSERT_EQ(server->channelCount(), 2u);
    breach(c);
    server->serveOnce();
    EXPECT_TRUE(c.refused()) << name;
    EXPECT_EQ(server->channelCount(), 1u) << name;
    ASSERT_EQ(handler.endedChannels().back().first, c.id) << name;
    EXPECT_NE(handler.endedChannels().back().second, "") << name;
    EXPECT_TRUE(honestStillServed()) << name;
  }
}

/// Runs until told, then answers.
class HoldingHandler : public AddOneHandler {
 public:
  Served serveBlock(const ServedBlock& block) override {
    const std::lock_guard lock(mutex);
    held.push_back(block);
    return Served::kDeferred;
  }
  std::vector<ServedBlock> held;
};

TEST(HostileClient, CannotHaveABlockRunTwiceAtOnce) {
  HoldingHandler handler;
  auto server = std::move(*ChannelServer::create(handler));
  BareClient c(*server);
  c.push(0, 2, blockState(1, BlockPhase::kSubmitted));
  server->serveOnce();
  ASSERT_EQ(handler.held.size(), 1u);
  c.push(1, 2, blockState(2, BlockPhase::kSubmitted));
  server->serveOnce();
  EXPECT_EQ(handler.held.size(), 1u);
  EXPECT_TRUE(c.refused());
  server->complete(handler.held[0], true);
}

/// Everything that a client can write, written at random while the server runs on two threads.
TEST(HostileClient, RandomScribblingHurtsNobodyElse) {
  AddOneHandler handler;
  ServerForTest server(handler, 2);
  std::atomic<bool> stop{false};
  std::thread scribbler([&] {
    std::mt19937_64 random(1);
    while (!stop) {
      BareClient c(*server.server, {uint32_t(1 + random() % 8), 256});
      const uint64_t words = controlBytes(c.memory) / 8;
      uint64_t tail = 0;
      for (int i = 0; i < 200 && !c.refused(); ++i) {
        if (random() % 2) {
          // Plausible moves, so that the scribbling meets a channel at work.
          c.push(tail, uint32_t(tail % c.memory.blockCount()), blockState(tail + 1, BlockPhase::kSubmitted));
          ++tail;
        } else {
          const uint64_t bad = random() % 2 ? random() : kBadWords[random() % std::size(kBadWords)];
          wordAt(c.memory, random() % words * 8).store(bad);
        }
        server.server->board()->bells().ringOne(0);
      }
      server.server->remove(c.id);
    }
  });
  ClientChannel honest = server.connect({.config = {3, 256}});
  EXPECT_TRUE(exchange(honest, 5000, 77));
  stop = true;
  scribbler.join();
}

TEST(HostileClient, RandomBytesOnTheBoardOnlyCostTime) {
  AddOneHandler handler;
  ServerForTest server(handler, 2);
  std::atomic<bool> stop{false};
  std::thread scribbler([&] {
    std::mt19937 random(2);
    while (!stop) {
      const Doorbell bell = server.server->board()->bells().bell(uint32_t(random()));
      bell.sleepers.store(uint32_t(random() % 2 ? 0 : random()));
      bell.sequence.store(uint32_t(random()));
      std::this_thread::yield();
    }
  });
  ClientChannel honest =
      server.connect({.config = {3, 256}, .wait = {.recheck = std::chrono::milliseconds(2)}});
  EXPECT_TRUE(exchange(honest, 500, 77));
  stop = true;
  scribbler.join();
}

TEST(HostileServer, AnImpossibleStateBreaksTheChannelWithAnError) {
  for (const uint64_t bad : {blockState(1, BlockPhase::kFree), blockState(1, BlockPhase::kFilling),
                             blockState(2, BlockPhase::kDone), blockState(0, BlockPhase::kDone),
                             uint64_t(8 + 6), uint64_t(8 + 7), ~uint64_t(0)}) {
    auto board = ServerBoard::create();
    Result<ClientChannel> c = ClientChannel::create(*board, {.config = {2, 64}});
    ASSERT_TRUE(c.ok());
    const Result<ChannelMemory> m = ChannelMemory::attach(std::move(*c->share()), ChannelSide::kServer);
    const auto b = c->acquire();
    ASSERT_TRUE(c->submit(*b).ok());
    EXPECT_EQ(c->poll(*b), BlockStatus::kPending);
    m->state(*b).store(bad);
    EXPECT_EQ(c->poll(*b), BlockStatus::kBroken);
    ASSERT_TRUE(c->error());
    EXPECT_EQ(c->error()->code, RiError::kConsistency);
    const uint32_t list[] = {*b};
    EXPECT_FALSE(c->waitAny(list).ok());
    m->state(*b).store(blockState(1, BlockPhase::kDone));
    EXPECT_FALSE(c->waitAny(list).ok()) << "broken for good";
  }
}

TEST(HostileServer, AnImpossibleMailBreaksTheChannelWithAnError) {
  const std::pair<uint32_t, uint32_t> answers[] = {
      {0, 0}, {3, 0}, {4, 0}, {~0u, 0}, {2, kMailBytes + 1}, {2, 0x7fffffff}};
  for (const auto& posted : answers) {
    const uint32_t state = posted.first, size = posted.second;
    auto board = ServerBoard::create();
    Result<ClientChannel> c = ClientChannel::create(*board, {.config = {2, 64}});
    ASSERT_TRUE(c.ok());
    const Result<ChannelMemory> m = ChannelMemory::attach(std::move(*c->share()), ChannelSide::kServer);
    MailboxLine& box = m->control().mailbox;
    std::thread server([&] {
      while (box.state.load() != 1) std::this_thread::yield();
      box.size.store(size);
      box.state.store(state);
      m->control().clientBell.bell().ring(1);
    });
    std::byte answer[kMailBytes];
    const Result<uint32_t> r = c->call({}, answer);
    server.join();
    ASSERT_FALSE(r.ok()) << state;
    EXPECT_EQ(r.error().code, RiError::kConsistency);
    EXPECT_FALSE(c->call({}, answer).ok()) << "broken for good";
  }
}

/// A server that scribbles everywhere and then dies: every wait ends, with an answer or an error.
TEST(HostileServer, RandomScribblingEndsInAnErrorNotInAHang) {
  std::mt19937_64 random(3);
  int errors = 0;
  for (int round = 0; round < 300; ++round) {
    auto board = ServerBoard::create();
    std::atomic<bool> alive{true};
    Result<ClientChannel> c = ClientChannel::create(
        *board, {.config = {4, 64}, .wait = {.recheck = std::chrono::milliseconds(1)}, .serverAlive = [&] {
                   return alive.load();
                 }});
    ASSERT_TRUE(c.ok());
    const Result<ChannelMemory> m = ChannelMemory::attach(std::move(*c->share()), ChannelSide::kServer);
    std::thread server([&, seed = random()] {
      std::mt19937_64 r(seed);
      const uint64_t words = controlBytes(*m) / 8;
      for (int i = 0; i < 100; ++i) {
        wordAt(*m, r() % words * 8).store(r() % 2 ? r() % 64 : kBadWords[r() % std::size(kBadWords)]);
      }
      alive = false;
    });
    std::vector<uint32_t> out;
    while (const auto b = c->acquire()) {
      if (!c->submit(*b)) break;
      out.push_back(*b);
    }
    while (!out.empty()) {
      const Result<uint32_t> r = c->waitAny(out);
      if (!r) {
        ++errors;
        break;
      }
      std::erase(out, *r);
      c->release(*r);
    }
    server.join();
  }
  EXPECT_GT(errors, 200);
}

}  // namespace
}  // namespace fr::shm
