// The ring transport with real processes.
#include "tracer/shm_oracle.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <random>
#include <thread>

#include "base/version.h"
#include "shm/file_descriptor.h"
#include "shm/peer.h"
#include "tracer/inproc_oracle.h"
#include "tracer/server_messages.h"
#include "tracer/testing/ray_batches.h"

namespace fr::tracer {
namespace {

using testing::AnalyticScene;

std::string serverProgram() { return std::string(FR_BINARY_DIR) + "/tests/tracer_analytic_server"; }

std::unique_ptr<cache::SceneCache> zoo() {
  AnalyticScene s;
  testing::addZoo(s);
  return s.finish();
}

ShmOracleService::Options options(int threads = 2) {
  ShmOracleService::Options o;
  o.program = serverProgram();
  o.threads = threads;
  return o;
}

TEST(ShmOracle, AnswersBitForBitAsInproc) {
  auto cache = zoo();
  ShadingSystem shading(*cache, {});
  InprocOracleService inproc(*cache, shading, {});
  ShmOracleService shm(*cache, options());
  auto here = std::move(inproc.connect()).value(), there = std::move(shm.connect()).value();
  for (RayKind kind : {RayKind::kTrace, RayKind::kVisibility, RayKind::kHitTest, RayKind::kFullTrace})
    for (uint32_t batch : {1u, 100u, 1024u}) {
      const auto rays = testing::randomRays(*cache, batch == 1 ? 300 : 5000, 11 + batch);
      auto a = testing::askInBatches(*here, rays, kind, 333);
      auto b = testing::askInBatches(*there, rays, kind, batch);
      ASSERT_TRUE(a.ok());
      ASSERT_TRUE(b.ok()) << b.error().str();
      EXPECT_EQ(*a, *b) << int(kind) << " in batches of " << batch;
    }
}

TEST(ShmOracle, SingleRaysAreAnsweredBitForBitAsBlocks) {
  auto cache = zoo();
  ShadingSystem shading(*cache, {});
  InprocOracleService inproc(*cache, shading, {});
  ShmOracleService shm(*cache, options());
  auto here = std::move(inproc.connect()).value(), there = std::move(shm.connect()).value();
  const auto rays = testing::randomRays(*cache, 1000, 5);
  for (RayKind kind : {RayKind::kTrace, RayKind::kVisibility, RayKind::kHitTest, RayKind::kFullTrace}) {
    const auto blocks = testing::askInBatches(*here, rays, kind, 333);
    const auto local = testing::askOneByOne(*here, rays, kind);
    const auto mail = testing::askOneByOne(*there, rays, kind);
    ASSERT_TRUE(blocks.ok() && local.ok());
    ASSERT_TRUE(mail.ok()) << mail.error().str();
    EXPECT_EQ(*blocks, *local) << int(kind);
    EXPECT_EQ(*blocks, *mail) << int(kind);
  }
  SingleRayMail none;
  none.ray.kind = 4;
  EXPECT_FALSE(there->ask(none).ok());
  EXPECT_TRUE(there->ask({}).ok()) << "the line is as good as before";
}

/// Answers blocks only.
class BlocksOnly : public RayOracle {
 public:
  explicit BlocksOnly(RayOracle& o) : oracle_(o) {}
  RayQuery* acquire() override { return oracle_.acquire(); }
  Result<void> submit(RayQuery* q) override { return oracle_.submit(q); }
  bool answered(const RayQuery* q) const override { return oracle_.answered(q); }
  Result<void> wait() override { return oracle_.wait(); }
  void release(RayQuery* q) override { oracle_.release(q); }

 private:
  RayOracle& oracle_;
};

TEST(RayOracle, SingleRaysGoThroughBlocksWhereThereIsNoOtherWay) {
  auto cache = zoo();
  ShmOracleService shm(*cache, options());
  auto line = std::move(shm.connect()).value();
  BlocksOnly blocks(*line);
  const auto rays = testing::randomRays(*cache, 300, 6);
  // Another block is in flight all the time, answered or not.
  RayQuery* other = line->acquire();
  other->kind = RayKind::kHitTest, other->count = 1, other->level = 1;
  testing::setRay(*other, 0, rays[0]);
  ASSERT_TRUE(line->submit(other).ok());
  for (RayKind kind : {RayKind::kTrace, RayKind::kVisibility, RayKind::kHitTest, RayKind::kFullTrace}) {
    const auto a = testing::askOneByOne(blocks, rays, kind), b = testing::askOneByOne(*line, rays, kind);
    ASSERT_TRUE(a.ok() && b.ok());
    EXPECT_EQ(*a, *b);
  }
  std::vector<RayQuery*> all;
  while (RayQuery* q = line->acquire()) all.push_back(q);
  EXPECT_FALSE(blocks.ask({}).ok()) << "no block is left";
  EXPECT_TRUE(line->ask({}).ok()) << "the mailbox needs none";
}

TEST(ShmOracle, ManyThreadsGetTheirOwnAnswers) {
  auto cache = zoo();
  ShadingSystem shading(*cache, {});
  InprocOracleService inproc(*cache, shading, {});
  ShmOracleService shm(*cache, options(3));
  std::atomic<int> same{0};
  std::vector<std::thread> threads;
  for (uint32_t t = 0; t < 4; ++t)
    threads.emplace_back([&, t] {
      auto here = std::move(inproc.connect()).value(), there = std::move(shm.connect()).value();
      const auto rays = testing::randomRays(*cache, 2000, t);
      auto a = testing::askInBatches(*here, rays, RayKind::kFullTrace, 64);
      auto b = testing::askInBatches(*there, rays, RayKind::kFullTrace, 50 + t);
      same += a.ok() && b.ok() && *a == *b;
    });
  for (auto& t : threads) t.join();
  EXPECT_EQ(same, 4);
  const auto numbers = shm.statistics();
  ASSERT_TRUE(numbers);
  EXPECT_EQ(numbers->rays[int(RayKind::kFullTrace)], 8000u);
  EXPECT_GT(numbers->embreeBytes, 0u);
}

TEST(ShmOracle, NothingStartsBeforeTheFirstBlock) {
  auto cache = zoo();
  ShmOracleService::Options o = options();
  o.program = "/nowhere/rendrib";
  ShmOracleService shm(*cache, o);
  auto line = shm.connect();
  ASSERT_TRUE(line.ok());
  EXPECT_EQ(shm.processId(), 0);
  RayQuery* q = (*line)->acquire();
  ASSERT_TRUE(q);
  q->count = 0;
  const Result<void> r = (*line)->submit(q);
  ASSERT_FALSE(r.ok());
  EXPECT_NE(r.error().message.find("rendrib"), std::string::npos) << r.error().message;
  EXPECT_FALSE((*line)->wait().ok());
  EXPECT_FALSE((*line)->answered(q));
  (*line)->release(q);
}

TEST(ShmOracle, AProgramThatBabblesIsAnError) {
  auto cache = zoo();
  for (const char* what : {"babble"}) {
    ShmOracleService::Options o = options();
    o.arguments = {what};
    ShmOracleService shm(*cache, o);
    auto line = std::move(shm.connect()).value();
    RayQuery* q = line->acquire();
    ASSERT_TRUE(q);
    EXPECT_FALSE(line->submit(q).ok()) << what;
  }
}

/// Kills the tracers of a service at random moments, also while they start, until it is stopped. Too many in
/// a row that have answered nothing would be taken for a fault: after two, something must have been answered
/// (`progress` changes).
class Killer {
 public:
  Killer(ShmOracleService& service, const std::atomic<int>& progress, uint32_t seed, int mostMicroseconds)
      : thread_([this, &service, &progress, seed, mostMicroseconds] {
          std::mt19937 random(seed);
          std::uniform_int_distribution<int> delay(0, mostMicroseconds);
          for (int last = 0, inARow = 0, seen = 0; !stop_;) {
            usleep(unsigned(delay(random)));
            if (const int now = progress; now != seen) seen = now, inARow = 0;
            const int pid = service.processId();
            if (pid == 0 || pid == last || inARow == 2) continue;
            last = pid, ++inARow;
            if (kill(pid, SIGKILL) == 0) ++kills_;
          }
        }) {}
  ~Killer() { stop(); }
  int stop() {
    stop_ = true;
    if (thread_.joinable()) thread_.join();
    return kills_;
  }

 private:
  std::atomic<bool> stop_{false};
  std::atomic<int> kills_{0};
  std::thread thread_;
};

TEST(ShmOracle, AnswersAreTheSameHoweverOftenTheTracerIsKilled) {
  auto cache = zoo();
  ShadingSystem shading(*cache, {});
  InprocOracleService inproc(*cache, shading, {});
  ShmOracleService shm(*cache, options());
  int warnings = 0, others = 0;
  setReportSink([&](const Error& e) {
    const bool expected =
        e.severity == Severity::kWarning &&
        e.message.find("was killed by signal 9 (Killed); another one is started") != std::string::npos;
    ++(expected ? warnings : others);
  });
  const int descriptors = shm::openDescriptorCount();
  std::atomic<int> same{0}, rounds{0};
  int kills = 0;
  {
    Killer killer(shm, rounds, 7, 40000);
    std::vector<std::thread> threads;
    for (uint32_t t = 0; t < 2; ++t)
      threads.emplace_back([&, t] {
        auto here = std::move(inproc.connect()).value(), there = std::move(shm.connect()).value();
        for (uint32_t i = 0; shm.restarts() < 20; ++i) {
          const RayKind kind = RayKind(i % 4);
          const auto rays = testing::randomRays(*cache, 3000, 10 * i + t);
          auto a = testing::askInBatches(*here, rays, kind, 64);
          auto b = testing::askInBatches(*there, rays, kind, 50 + t);
          EXPECT_TRUE(b.ok()) << b.error().str();
          ++rounds, same += a.ok() && b.ok() && *a == *b;
          if (!b.ok()) return;
        }
      });
    for (auto& t : threads) t.join();
    kills = killer.stop();
    EXPECT_GE(kills, 20);
  }
  EXPECT_EQ(same, rounds);
  // The descriptors of the last tracer: its socket, pidfd and board, and the two of the watch over its
  // socket. And the records of the ray scene in this process.
  EXPECT_LE(shm::openDescriptorCount(), descriptors + 6);
  setReportSink({});
  EXPECT_GE(warnings, 20);
  EXPECT_EQ(others, 0);
}

TEST(ShmOracle, SingleRaysSurviveTheirTracer) {
  auto cache = zoo();
  ShadingSystem shading(*cache, {});
  InprocOracleService inproc(*cache, shading, {});
  ShmOracleService shm(*cache, options(1));
  setReportSink([](const Error&) {});
  auto here = std::move(inproc.connect()).value(), there = std::move(shm.connect()).value();
  std::atomic<int> answers{0};
  Killer killer(shm, answers, 3, 30000);
  std::mt19937 random(5);
  std::uniform_real_distribution<float> f(-3, 3);
  for (int i = 0; shm.restarts() < 8; ++i) {
    SingleRayMail mail;
    for (int c = 0; c < 3; ++c) mail.ray.origin[c] = f(random), mail.ray.direction[c] = f(random);
    mail.ray.kind = uint8_t(i % 4);
    const auto a = here->ask(mail), b = there->ask(mail);
    ASSERT_TRUE(a.ok() && b.ok()) << b.error().str();
    ASSERT_EQ(std::memcmp(&*a, &*b, sizeof *a), 0);
    ++answers;
  }
  killer.stop();
  setReportSink({});
}

TEST(ShmOracle, BlocksStayWhereTheyAreWhenTheTracerDies) {
  auto cache = zoo();
  ShmOracleService shm(*cache, options(1));
  setReportSink([](const Error&) {});
  auto line = std::move(shm.connect()).value();
  RayQuery *answered = line->acquire(), *filling = line->acquire();
  for (RayQuery* q : {answered, filling}) {
    q->kind = RayKind::kHitTest, q->count = 1, q->level = 1;
    testing::setRay(*q, 0, {0, 0, -9}, {0, 0, 1});
  }
  ASSERT_TRUE(line->submit(answered).ok());
  while (!line->answered(answered)) ASSERT_TRUE(line->wait().ok());
  const float distance = answered->hitDistance[0];
  ASSERT_EQ(kill(shm.processId(), SIGKILL), 0);
  usleep(50000);
  ASSERT_TRUE(line->submit(filling).ok());
  while (!line->answered(filling)) {
    ASSERT_TRUE(line->wait().ok());
    if (!line->answered(filling)) usleep(1000);
  }
  EXPECT_EQ(filling->hitDistance[0], distance);
  EXPECT_EQ(answered->hitDistance[0], distance);
  EXPECT_TRUE(line->answered(answered));
  line->release(answered), line->release(filling);
  // All blocks of the new channel are there.
  std::vector<RayQuery*> all;
  while (RayQuery* q = line->acquire()) all.push_back(q);
  EXPECT_EQ(all.size(), kBlocksPerLine);
  EXPECT_EQ(shm.restarts(), 1u);
  setReportSink({});
}

TEST(ShmOracle, TracersThatDieAgainAndAgainAreAClearError) {
  auto cache = zoo();
  for (const char* how : {"die", "die-later", "exit", "no-memory"}) {
    ShmOracleService::Options o = options();
    o.arguments = {how};
    ShmOracleService shm(*cache, o);
    int warnings = 0;
    setReportSink([&](const Error& e) { warnings += e.severity == Severity::kWarning; });
    auto line = std::move(shm.connect()).value();
    RayQuery* q = line->acquire();
    ASSERT_TRUE(q);
    q->count = 0;
    const Result<void> r = line->submit(q);
    setReportSink({});
    ASSERT_FALSE(r.ok()) << how;
    const std::string& text = r.error().message;
    // One that says that memory ran out is not started again.
    const bool hopeless = how == std::string("no-memory");
    EXPECT_NE(text.find(hopeless                     ? "it ran out of memory"
                        : how == std::string("exit") ? "ended with status 3"
                                                     : "killed by signal 9"),
              std::string::npos)
        << text;
    EXPECT_EQ(warnings, hopeless ? 0 : 4) << how;
    EXPECT_EQ(text.find("5 of them") == std::string::npos, hopeless) << text;
    EXPECT_EQ(shm.processId(), 0);
    // Others are told the same, at once.
    auto other = std::move(shm.connect()).value();
    RayQuery* again = other->acquire();
    again->count = 0;
    const Result<void> s = other->submit(again);
    ASSERT_FALSE(s.ok());
    EXPECT_EQ(s.error().message, text);
    EXPECT_FALSE(shm.statistics());
  }
}

TEST(ShmOracle, ATracerOfAnotherBuildIsRefusedAndBothAreNamed) {
  auto cache = zoo();
  ShmOracleService::Options o = options();
  o.arguments = {"other-build"};
  ShmOracleService shm(*cache, o);
  auto line = std::move(shm.connect()).value();
  RayQuery* q = line->acquire();
  q->count = 0;
  const Result<void> r = line->submit(q);
  ASSERT_FALSE(r.ok());
  EXPECT_EQ(r.error().code, RiError::kVersion);
  EXPECT_NE(r.error().message.find("version 9.8.7"), std::string::npos) << r.error().message;
  EXPECT_NE(r.error().message.find(std::string("this one is version ") + versionText()), std::string::npos)
      << r.error().message;
  EXPECT_EQ(shm.restarts(), 0u);
  EXPECT_EQ(shm.processId(), 0);
}

/// And the other way round: the tracer refuses a renderer of another build.
TEST(ShmOracle, ARendererOfAnotherBuildIsRefused) {
  shm::SpawnOptions spawn;
  spawn.program = serverProgram();
  auto child = shm::ChildProcess::spawn(spawn);
  ASSERT_TRUE(child.ok());
  MessageHeader h;
  h.type = MessageType::kScene;
  h.fingerprint ^= 1;
  ASSERT_TRUE(child->socket().send(std::as_bytes(std::span(&h, 1)), {}).ok());
  auto answer = receiveMessage(child->socket(), std::chrono::seconds(20));
  ASSERT_TRUE(answer.ok() && *answer) << answer.error().str();
  EXPECT_EQ((**answer).type, MessageType::kRefused);
  EXPECT_NE((**answer).text().find("different builds"), std::string::npos);
  EXPECT_TRUE(child->wait(std::chrono::seconds(20)));
}

TEST(ShmOracle, TheTracerEndsWithItsClient) {
  auto cache = zoo();
  int pipes[2];
  ASSERT_EQ(pipe(pipes), 0);
  const pid_t client = fork();
  if (client == 0) {
    ShmOracleService shm(*cache, options());
    auto line = std::move(shm.connect()).value();
    const auto rays = testing::randomRays(*cache, 100, 1);
    (void)testing::askInBatches(*line, rays, RayKind::kHitTest, 10);
    const int pid = shm.processId();
    (void)!write(pipes[1], &pid, sizeof pid);
    raise(SIGKILL);
  }
  int pid = 0;
  ASSERT_EQ(read(pipes[0], &pid, sizeof pid), ssize_t(sizeof pid));
  ASSERT_GT(pid, 0);
  int status;
  waitpid(client, &status, 0);
  EXPECT_TRUE(WIFSIGNALED(status));
  // Nobody of ours reaps it: it is gone when it is no process any more or a zombie.
  const auto alive = [&] {
    std::error_code e;
    const auto exe = std::filesystem::read_symlink("/proc/" + std::to_string(pid) + "/exe", e);
    return !e && exe.string().find("tracer_analytic_server") != std::string::npos;
  };
  for (int i = 0; i < 500 && alive(); ++i) usleep(10000);
  EXPECT_FALSE(alive());
  close(pipes[0]), close(pipes[1]);
}

TEST(ShmOracle, LeavesNothingBehind) {
  auto cache = zoo();
  const auto files = [] {
    return std::distance(std::filesystem::directory_iterator("/dev/shm"),
                         std::filesystem::directory_iterator{});
  };
  const auto before = files();
  const int descriptors = shm::openDescriptorCount();
  for (int i = 0; i < 3; ++i) {
    ShmOracleService service(*cache, options());
    auto line = std::move(service.connect()).value();
    EXPECT_TRUE(testing::askInBatches(*line, testing::randomRays(*cache, 500, 1), RayKind::kTrace, 100).ok());
    EXPECT_EQ(files(), before);
  }
  EXPECT_EQ(shm::openDescriptorCount(), descriptors);
}

TEST(ShmOracle, AClientThatScribblesOverItsBlocksHarmsOnlyItself) {
  auto cache = zoo();
  ShadingSystem shading(*cache, {});
  InprocOracleService inproc(*cache, shading, {});
  ShmOracleService shm(*cache, options());
  auto hostile = std::move(shm.connect()).value();
  RayQuery* q = hostile->acquire();
  ASSERT_TRUE(q);
  std::atomic<bool> stop{false};
  std::thread scribbler([&] {  // also while the server reads
    std::mt19937 g(1);
    auto* words = reinterpret_cast<volatile uint32_t*>(q);
    while (!stop)
      for (int i = 0; i < 1000; ++i)
        words[i < 500 ? g() % 4 : g() % (sizeof(RayQuery) / 4)] = i & 1 ? uint32_t(g()) : g() % 8;
  });
  for (int i = 0; i < 200; ++i) {
    ASSERT_TRUE(hostile->submit(q).ok());
    while (!hostile->answered(q)) ASSERT_TRUE(hostile->wait().ok());
    hostile->release(q);
    ASSERT_EQ(hostile->acquire(), q);
  }
  stop = true;
  scribbler.join();
  auto good = std::move(shm.connect()).value();
  auto here = std::move(inproc.connect()).value();
  const auto rays = testing::randomRays(*cache, 1000, 3);
  auto a = testing::askInBatches(*good, rays, RayKind::kTrace, 100);
  auto b = testing::askInBatches(*here, rays, RayKind::kTrace, 100);
  ASSERT_TRUE(a.ok() && b.ok());
  EXPECT_EQ(*a, *b);
}

TEST(ShmOracle, HostileQuestionsHarmNobody) {
  auto cache = zoo();
  ShadingSystem shading(*cache, {});
  InprocOracleService inproc(*cache, shading, {});
  ShmOracleService shm(*cache, options());
  auto hostile = std::move(shm.connect()).value();
  std::mt19937 g(21);
  const float wild[] = {NAN, INFINITY, -INFINITY, 0, 1e38f, -1e38f, 1e-42f, 1, 3e19f};
  const auto pick = [&] { return wild[g() % std::size(wild)]; };
  for (int i = 0; i < 3000; ++i) {  // any bytes that are a ray by their kind
    SingleRayMail m;
    auto* bytes = reinterpret_cast<unsigned char*>(&m);
    for (size_t b = 0; b < sizeof m; ++b) bytes[b] = uint8_t(g());
    if (i & 1)
      for (int c = 0; c < 3; ++c)
        m.ray.origin[c] = pick(), m.ray.direction[c] = pick(), m.start.normal[c] = pick();
    m.ray.kind = uint8_t(g() % 4);
    m.ray.level = i & 2 ? uint16_t(g()) : uint16_t(1);
    ASSERT_TRUE(hostile->ask(m).ok());
  }
  for (int i = 0; i < 60; ++i) {
    RayQuery* q = hostile->acquire();
    ASSERT_TRUE(q);
    q->kind = RayKind(i % 3 ? g() % 4 : g());
    q->count = i % 2 ? 1000000u : i % 4 ? 0xffffffffu : uint32_t(g() % 2000);
    q->level = uint32_t(g());
    for (uint32_t k = 0; k < kMaxRays; ++k) {
      for (int c = 0; c < 3; ++c)
        q->origin[c][k] = pick(), q->direction[c][k] = pick(), q->normal[c][k] = pick();
      q->time[k] = pick(), q->radius[k] = pick(), q->spread[k] = pick(), q->u[k] = pick(), q->v[k] = pick();
      q->node[k] = g() % 2 ? uint32_t(g()) : uint32_t(g() % 8), q->cell[k] = uint32_t(g()), q->seed[k] = g();
    }
    ASSERT_TRUE(hostile->submit(q).ok());
    while (!hostile->answered(q)) ASSERT_TRUE(hostile->wait().ok());
    hostile->release(q);
  }
  auto good = std::move(shm.connect()).value(), here = std::move(inproc.connect()).value();
  const auto rays = testing::randomRays(*cache, 500, 3);
  auto a = testing::askInBatches(*good, rays, RayKind::kFullTrace, 100);
  auto b = testing::askInBatches(*here, rays, RayKind::kFullTrace, 100);
  ASSERT_TRUE(a.ok() && b.ok());
  EXPECT_EQ(*a, *b);
  EXPECT_GT(shm.processId(), 0);
}

}  // namespace
}  // namespace fr::tracer
