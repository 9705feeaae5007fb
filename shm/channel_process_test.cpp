// Real processes: the server in a child, clients here, or the other way round; and what happens when one is
// killed.
#include <gtest/gtest.h>
#include <signal.h>

#include "shm/channel_for_test.h"
#include "shm/fork_for_test.h"
#include "shm/hang_up.h"
#include "shm/peer.h"

namespace fr::shm {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

std::span<const std::byte> oneByte() {
  static constexpr std::byte b{1};
  return {&b, 1};
}

/// The server's process: sends its board, takes channels as they come, until the socket hangs up.
int serverProcess(PeerSocket socket, int threads, ChannelHandler& handler) {
  ServerForTest server(handler, threads);
  Result<FileDescriptor> board = server.server->board()->share();
  CHILD_EXPECT(board.ok());
  const int fds[] = {board->get()};
  CHILD_EXPECT(socket.send(oneByte(), fds).ok());
  for (;;) {
    Result<std::optional<PeerMessage>> m = socket.receive(seconds(1));
    if (!m) return 0;
    if (!*m) continue;
    for (FileDescriptor& fd : (*m)->descriptors) {
      CHILD_EXPECT(server.server->add(std::move(fd)).ok());
    }
    CHILD_EXPECT(socket.send(oneByte(), {}).ok());
  }
}

/// A server process and this process's end of the line to it.
class ProcessTest : public ::testing::Test {
 protected:
  void SetUp() override { descriptors_ = openDescriptorCount(); }
  void TearDown() override {
    stop();
    EXPECT_EQ(openDescriptorCount(), descriptors_) << "descriptors leak";
  }
  void start(int threads, std::function<int(PeerSocket)> body = {}) {
    auto ends = PeerSocket::pair();
    ASSERT_TRUE(ends.ok());
    server_ = forkChild([&]() -> int {
      ends->first.close();
      AddOneHandler handler;
      return body ? body(std::move(ends->second)) : serverProcess(std::move(ends->second), threads, handler);
    });
    ends->second.close();
    socket_ = std::move(ends->first);
    Result<std::optional<PeerMessage>> m = socket_.receive(seconds(60));
    ASSERT_TRUE(m.ok() && *m && (*m)->descriptors.size() == 1);
    auto board = ServerBoard::attach(std::move((*m)->descriptors[0]));
    ASSERT_TRUE(board.ok()) << board.error().str();
    board_ = *board;
  }
  int stop() {
    if (server_ < 0) return 0;
    socket_.close();
    board_.reset();
    return joinChild(std::exchange(server_, -1));
  }
  ClientChannel connect(ChannelConfig config) {
    Result<ClientChannel> c =
        ClientChannel::create(board_, {.config = config, .serverAlive = [this] { return socket_.alive(); }});
    FR_CHECK(c.ok());
    Result<FileDescriptor> fd = c->share();
    const int fds[] = {fd->get()};
    FR_CHECK(socket_.send(oneByte(), fds).ok());
    Result<std::optional<PeerMessage>> m = socket_.receive(seconds(60));
    FR_CHECK(m.ok() && *m);
    return std::move(*c);
  }
  int descriptors_ = 0;
  pid_t server_ = -1;
  PeerSocket socket_;
  std::shared_ptr<ServerBoard> board_;
};

class ProcessCounts : public ProcessTest, public ::testing::WithParamInterface<std::pair<int, int>> {};

TEST_P(ProcessCounts, ThousandsOfBlocksThroughTwoProcesses) {
  const auto [clients, threads] = GetParam();
  start(threads);
  std::vector<ClientChannel> channels;
  channels.reserve(size_t(clients));
  for (int i = 0; i < clients; ++i) channels.push_back(connect({uint32_t(3 + i), 1024}));
  std::vector<std::thread> pool;
  pool.reserve(size_t(clients));
  std::atomic<int> good{0};
  for (int i = 0; i < clients; ++i) {
    pool.emplace_back([&, i] { good += exchange(channels[size_t(i)], 4000, uint32_t(i) << 20); });
  }
  for (std::thread& t : pool) t.join();
  EXPECT_EQ(good, clients);
  channels.clear();
  EXPECT_EQ(stop(), 0);
}
INSTANTIATE_TEST_SUITE_P(Threads, ProcessCounts,
                         ::testing::Values(std::pair(1, 1), std::pair(2, 1), std::pair(3, 1), std::pair(1, 2),
                                           std::pair(3, 2)));

TEST_F(ProcessTest, TheServerCannotWriteQuestions) {
  const ChannelConfig config{2, 8192 + 128, 4096};
  Result<ClientChannel> c = ClientChannel::create(*ServerBoard::create(), {.config = config});
  ASSERT_TRUE(c.ok()) << c.error().str();
  const auto first = c->acquire(), second = c->acquire();
  ASSERT_TRUE(first && second);
  for (const uint32_t b : {*first, *second}) std::memset(c->data(b).data(), 42, c->data(b).size());
  const auto writes = [&](uint32_t block, size_t offset) {
    return joinChild(forkChild([&] {
      ::signal(SIGSEGV, SIG_DFL);
      auto m = ChannelMemory::attach(std::move(*c->share()), ChannelSide::kServer);
      CHILD_EXPECT(m.ok());
      CHILD_EXPECT(m->block(block)[offset] == std::byte(42));  // it reads what we have written
      *const_cast<volatile std::byte*>(&m->block(block)[offset]) = std::byte(1);
      return 0;
    }));
  };
  for (const uint32_t b : {*first, *second}) {
    EXPECT_NE(writes(b, 0), 0);
    EXPECT_NE(writes(b, 4095), 0);
    EXPECT_EQ(c->data(b)[0], std::byte(42));
    EXPECT_EQ(c->data(b)[4095], std::byte(42));
    EXPECT_EQ(writes(b, 4096), 0);
    EXPECT_EQ(c->data(b)[4096], std::byte(1)) << "answers are the server's to write";
  }
  EXPECT_FALSE(ClientChannel::create(*ServerBoard::create(), {.config = {2, 8192, 100}}).ok());
  EXPECT_FALSE(ClientChannel::create(*ServerBoard::create(), {.config = {2, 4096, 8192}}).ok());
}

/// Answers nothing.
class SilentHandler : public AddOneHandler {
 public:
  Served serveBlock(const ServedBlock&) override { return Served::kDeferred; }
  int serveMail(uint64_t, void*, std::span<const std::byte>, std::span<std::byte, kMailBytes>) override {
    for (;;) ::pause();
  }
};

TEST_F(ProcessTest, AServerKilledWhileWeWaitIsAnError) {
  start(1, [](PeerSocket socket) {
    SilentHandler silent;
    return serverProcess(std::move(socket), 1, silent);
  });
  ClientChannel a = connect({2, 64});
  ClientChannel b = connect({2, 64});
  const auto block = a.acquire();
  fillQuestion(a.data(*block), 5, 50);
  ASSERT_TRUE(a.submit(*block).ok());
  const pid_t victim = server_;
  std::thread killer([&] {
    ::usleep(20000);  // the server has the block by then, and we sleep
    ::kill(victim, SIGKILL);
  });
  const uint32_t list[] = {*block};
  const Result<uint32_t> r = a.waitAny(list);
  killer.join();
  ASSERT_FALSE(r.ok());
  EXPECT_NE(r.error().message.find("gone"), std::string::npos) << r.error().str();
  EXPECT_EQ(r.error().code, RiError::kSystem);
  std::byte answer[8];
  EXPECT_FALSE(b.call({}, answer).ok());

  // The question is still there: the next server answers it.
  std::vector<std::byte> question(a.data(*block).begin(), a.data(*block).end());
  EXPECT_EQ(stop(), -SIGKILL);
  start(1);
  ClientChannel again = connect({2, 64});
  const auto next = again.acquire();
  std::copy(question.begin(), question.end(), again.data(*next).begin());
  ASSERT_TRUE(again.submit(*next).ok());
  const uint32_t nextList[] = {*next};
  ASSERT_TRUE(again.waitAny(nextList).ok());
  EXPECT_TRUE(answerIsRight(again.data(*next), 5, 50));
}

TEST_F(ProcessTest, AServerKilledAtAnyMomentIsAnError) {
  std::srand(1);
  for (int round = 0; round < 25; ++round) {
    start(2);
    ClientChannel c = connect({4, 256});
    const pid_t victim = server_;
    std::thread killer([victim, delay = std::rand() % 5000] {
      ::usleep(useconds_t(delay));
      ::kill(victim, SIGKILL);
    });
    // Either everything came through before the kill, or there is an error; never a wrong answer that goes
    // unnoticed, never a hang.
    const bool all = exchange(c, 3000, uint32_t(round));
    killer.join();
    if (!all) {
      // The error is the server's death, not a protocol error that a half-done step left behind.
      ASSERT_TRUE(c.error()) << "a wrong answer";
      EXPECT_EQ(c.error()->code, RiError::kSystem) << c.error()->str();
    }
    EXPECT_EQ(stop(), -SIGKILL);
  }
}

TEST_F(ProcessTest, AClientKilledAtAnyMomentIsRemoved) {
  // Here the server lives in this process and the clients die.
  AddOneHandler handler;
  ServerForTest server(handler, 2);
  ClientChannel honest = server.connect({.config = {2, 64}});
  std::srand(2);
  for (int round = 0; round < 20; ++round) {
    auto ends = PeerSocket::pair();
    ASSERT_TRUE(ends.ok());
    Result<ClientChannel> c = ClientChannel::create(server.server->board(), {.config = {3, 128}});
    ASSERT_TRUE(c.ok());
    const Result<uint64_t> id = server.server->add(std::move(*c->share()));
    ASSERT_TRUE(id.ok());
    const auto watch = HangUpWatch::start(ends->first.descriptor(), [&] { server.server->remove(*id); });
    ASSERT_TRUE(watch.ok());
    const pid_t child = forkChild([&] {
      ends->first.close();
      return exchange(*c, 100000000, 1) ? 0 : 1;
    });
    ends->second.close();
    ::usleep(useconds_t(std::rand() % 3000));
    ::kill(child, SIGKILL);
    EXPECT_EQ(joinChild(child), -SIGKILL);
    EXPECT_TRUE(exchange(honest, 100, uint32_t(round)));
    while (server.server->channelCount() > 1) ::usleep(200);
  }
  EXPECT_TRUE(exchange(honest, 100, 7));
}

}  // namespace
}  // namespace fr::shm
