// rendrib -rayserver from the outside: real processes, every transport, bad clients, dead clients, dead
// servers.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <random>
#include <thread>

#include "base/version.h"
#include "oracle/control_message.h"
#include "oracle/pipe_codec.h"
#include "oracle/pipe_io.h"
#include "oracle/ray_client.h"
#include "shm/named_socket.h"
#include "tests/end_to_end/program.h"

namespace fr::test {
namespace {

using namespace std::chrono_literals;
using Words = std::vector<std::string>;

std::string rendrib() { return std::string(FR_BINARY_DIR) + "/bin/rendrib"; }

// A unit sphere far from the origin of world space: answers are closed forms, and floats alone would not do.
const DVec3 kCenter(1e6, -2e6, 5);
const std::string kScene =
    "Display \"out.exr\" \"openexr\" \"rgba\"\nFormat 64 64 1\nProjection \"perspective\" \"fov\" [40]\n"
    "Translate -1000000 2000000 0\nWorldBegin\nColor [1 0.5 0.25]\nSurface \"constant\"\n"
    "Translate 1000000 -2000000 5\nSphere 1 -1 1 360\nWorldEnd\n";

/// A server of the scene, for as long as the object lives.
class Server {
 public:
  explicit Server(const char* what, const std::string& scene = kScene,
                  const std::vector<std::string>& more = {"-threads", "2"}) {
    static std::atomic<int> number{0};
    name = fmt::format("test-{}-{}-{}", what, ::getpid(), ++number);
    w.write("scene.rib", scene);
    shm::FileDescriptor nothing(::open("/dev/null", O_RDWR | O_CLOEXEC));
    shm::SpawnOptions o;
    o.program = rendrib();
    o.arguments = {"-rayserver", "-silent", "-name", name};
    o.arguments.insert(o.arguments.end(), more.begin(), more.end());
    o.arguments.push_back((w.path() / "scene.rib").string());
    o.socketVariable.clear();
    o.standardInput = o.standardOutput = nothing.get();
    auto child = shm::ChildProcess::spawn(o);
    EXPECT_TRUE(child) << child.error().str();
    if (child) process.emplace(std::move(child).value());
  }
  ~Server() {
    if (process) process->signal(SIGTERM);
  }
  std::unique_ptr<RayClient> join(RayClientOptions o = {}) {
    for (int i = 0; i < 6000; ++i) {
      auto c = RayClient::join(name, o);
      if (c) return std::move(c).value();
      if (c.error().code != RiError::kNoFile || process->exitStatus()) {
        ADD_FAILURE() << c.error().str();
        return nullptr;
      }
      std::this_thread::sleep_for(10ms);
    }
    ADD_FAILURE() << "the server never listened";
    return nullptr;
  }
  Workspace w;
  std::string name;
  std::optional<shm::ChildProcess> process;
};

/// Rays along z at offsets within the sphere's disk and outside of it, and what they must hit.
struct Shot {
  double x, y;
  double distance() const { return x * x + y * y < 1 ? 4 - std::sqrt(1 - x * x - y * y) : 0; }
};
std::vector<Shot> shots(uint32_t n, uint32_t seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> f(-1.3, 1.3);
  std::vector<Shot> s(n);
  for (Shot& a : s) do {
      a = {f(random), f(random)};
    } while (std::abs(std::hypot(a.x, a.y) - 1) < 0.1);  // the silhouette is a polygon's
  return s;
}
void fill(RayQuery& q, const std::vector<Shot>& s, const WorldSpace& space, RayKind kind) {
  q.kind = kind, q.count = uint32_t(s.size()), q.level = 1;
  for (uint32_t i = 0; i < q.count; ++i) {
    SingleRayMail m;
    space.setOrigin(m.ray, kCenter + DVec3(s[i].x, s[i].y, -4));
    m.ray.direction[2] = kind == RayKind::kVisibility ? 8.0f : 1.0f;
    m.ray.seed = i;
    putRay(q, i, m);
  }
}
/// How many answers are wrong. The traced sphere is dicing's: tolerances are its error. (At half the rate
/// neighbours of different rates show cracks; these tests are about who answers.)
int wrong(const RayQuery& q, const std::vector<Shot>& s, const WorldSpace& space) {
  int n = 0;
  for (uint32_t i = 0; i < q.count; ++i) {
    const double d = s[i].distance();
    bool bad = false;
    switch (q.kind) {
      case RayKind::kVisibility:
        bad = q.color[0][i] != (d > 0 ? 0.0f : 1.0f);
        break;
      case RayKind::kHitTest:
        if (d > 0) {
          const DVec3 p = space.hitPoint(q, i) - kCenter;
          bad = std::abs(double(q.hitDistance[i]) - d) > 0.1 || std::abs(glm::length(p) - 1) > 0.05;
        } else {
          bad = q.hitDistance[i] != kNoHit;
        }
        break;
      default:
        bad = d > 0 ? q.color[0][i] != 1.0f || q.color[1][i] != 0.5f : q.color[0][i] != 0.0f;
    }
    if (bad && ++n == 1)
      ADD_FAILURE() << "kind " << int(q.kind) << " at " << s[i].x << " " << s[i].y << ": expected distance "
                    << d << ", got " << q.hitDistance[i] << ", color " << q.color[0][i];
  }
  return n;
}
int askAll(RayOracle& line, const WorldSpace& space, uint32_t seed, int rounds) {
  int bad = 0;
  for (int r = 0; r < rounds; ++r) {
    const auto s = shots(200, seed + uint32_t(r));
    RayQuery* q = line.acquire();
    if (!q) return -1;
    fill(*q, s, space, RayKind(r % 4));
    if (!line.submit(q)) return -1;
    while (!line.answered(q))
      if (!line.wait()) return -1;
    bad += wrong(*q, s, space);
    line.release(q);
  }
  return bad;
}

TEST(RayServer, JoinedClientsGetAnswersInWorldSpaceFarFromTheOrigin) {
  Server server("join");
  auto client = server.join();
  ASSERT_TRUE(client);
  EXPECT_EQ(client->transport(), RayTransport::kShm);
  EXPECT_EQ(client->processId(), server.process->pid());
  EXPECT_EQ(client->scene().patchMultiplier, 0.5f);
  auto line = client->connect();
  ASSERT_TRUE(line) << line.error().str();
  EXPECT_EQ(askAll(**line, client->worldSpace(), 1, 8), 0);
  // The mailbox gives the bits of the block.
  const auto s = shots(50, 9);
  for (RayKind kind : {RayKind::kTrace, RayKind::kVisibility, RayKind::kHitTest, RayKind::kFullTrace}) {
    RayQuery* q = (*line)->acquire();
    fill(*q, s, client->worldSpace(), kind);
    q->terms.flags |= RayTerms::kWantsNode;
    ASSERT_TRUE((*line)->submit(q));
    ASSERT_TRUE((*line)->wait());
    ASSERT_TRUE((*line)->answered(q));
    for (uint32_t i = 0; i < q->count; ++i) {
      SingleRayMail m;
      m.ray.kind = uint8_t(kind);
      for (int c = 0; c < 3; ++c) m.ray.origin[c] = q->origin[c][i], m.ray.direction[c] = q->direction[c][i];
      m.ray.seed = q->seed[i];
      auto a = (*line)->ask(m);
      ASSERT_TRUE(a) << a.error().str();
      const SingleAnswer b = singleAnswerOf(*q, i, kind);
      EXPECT_EQ(std::memcmp(&*a, &b, sizeof b), 0) << int(kind) << " " << i;
    }
    (*line)->release(q);
  }
  auto numbers = client->numbers();
  ASSERT_TRUE(numbers);
  EXPECT_EQ((*numbers)[Counter::kSingles], 200u);
  EXPECT_EQ((*numbers)[Counter::kBlocks], 12u);
  EXPECT_EQ((*numbers)[Counter::kBlockRays], 8u * 200 + 4 * 50);
  EXPECT_EQ((*numbers)[Counter::kTrace], 2u * 200 + 50 + 50);
  EXPECT_EQ((*numbers)[Gauge::kClients], 1u);
  EXPECT_EQ((*numbers)[Gauge::kChannels], 1u);
  EXPECT_GT((*numbers)[Gauge::kGridsUsed], 0u);
}

TEST(RayServer, SixtyFourClientsAtOnceGetTheirOwnAnswers) {
  Server server("many");
  auto first = server.join();
  ASSERT_TRUE(first);
  std::atomic<int> good{0};
  std::vector<std::thread> threads;
  for (uint32_t t = 0; t < 64; ++t)
    threads.emplace_back([&, t] {
      RayClientOptions o;
      o.blocksPerLine = 2;
      auto client = RayClient::join(server.name, o);
      ASSERT_TRUE(client) << client.error().str();
      auto line = (*client)->connect();
      ASSERT_TRUE(line) << line.error().str();
      const int bad = askAll(**line, (*client)->worldSpace(), 100 * t, 6);
      EXPECT_EQ(bad, 0) << t;
      good += bad == 0;
    });
  for (auto& t : threads) t.join();
  EXPECT_EQ(good, 64);
  for (int i = 0; i < 500; ++i) {
    auto n = first->numbers();
    ASSERT_TRUE(n);
    if ((*n)[Gauge::kClients] == 1 && (*n)[Gauge::kChannels] == 0) break;
    std::this_thread::sleep_for(10ms);
  }
  auto n = first->numbers();
  ASSERT_TRUE(n);
  EXPECT_EQ((*n)[Gauge::kClients], 1u);
  EXPECT_EQ((*n)[Gauge::kChannels], 0u);
  EXPECT_EQ((*n)[Counter::kBlocks], 64u * 6);
}

TEST(RayServer, EveryTransportGivesTheSameBits) {
  Workspace w;
  w.write("scene.rib", kScene);
  const std::vector<std::string> command{rendrib(),  "-rayserver", "-silent",
                                         "-threads", "2",          (w.path() / "scene.rib").string()};
  std::vector<std::vector<std::byte>> answers;
  for (const bool pipe : {false, true}) {
    RayClientOptions o;
    o.pipe = pipe;
    auto client = RayClient::start(command, o);
    ASSERT_TRUE(client) << client.error().str();
    EXPECT_EQ((*client)->transport(), pipe ? RayTransport::kPipe : RayTransport::kShm);
    const int pid = (*client)->processId();
    auto line = (*client)->connect();
    ASSERT_TRUE(line);
    auto& all = answers.emplace_back();
    for (RayKind kind : {RayKind::kTrace, RayKind::kVisibility, RayKind::kHitTest, RayKind::kFullTrace}) {
      for (uint32_t n : {1u, 7u, 300u, 1024u}) {
        const auto s = shots(n, n);
        RayQuery* q = (*line)->acquire();
        fill(*q, s, (*client)->worldSpace(), kind);
        ASSERT_TRUE((*line)->submit(q));
        ASSERT_TRUE((*line)->wait());
        ASSERT_TRUE((*line)->answered(q));
        EXPECT_EQ(wrong(*q, s, (*client)->worldSpace()), 0);
        for (uint32_t i = 0; i < n; ++i) {
          const SingleAnswer a = singleAnswerOf(*q, i, kind);
          const auto bytes = std::as_bytes(std::span(&a, 1));
          all.insert(all.end(), bytes.begin(), bytes.end());
        }
        (*line)->release(q);
      }
    }
    auto numbers = (*client)->numbers();
    ASSERT_TRUE(numbers) << numbers.error().str();
    EXPECT_EQ((*numbers)[Counter::kBlocks], 16u);
    line->reset();
    client->reset();
    EXPECT_NE(::kill(pid, 0), 0) << "the server ends with the client that started it";
  }
  EXPECT_EQ(answers[0], answers[1]);
}

TEST(RayServer, ManyThreadsShareOnePipe) {
  Workspace w;
  w.write("scene.rib", kScene);
  RayClientOptions o;
  o.pipe = true;
  auto client = RayClient::start(
      Words{rendrib(), "-rayserver", "-silent", "-threads", "2", (w.path() / "scene.rib").string()}, o);
  ASSERT_TRUE(client) << client.error().str();
  std::atomic<int> good{0};
  std::vector<std::thread> threads;
  for (uint32_t t = 0; t < 8; ++t)
    threads.emplace_back([&, t] {
      auto line = (*client)->connect();
      good += line && askAll(**line, (*client)->worldSpace(), 10 * t, 12) == 0;
    });
  for (auto& t : threads) t.join();
  EXPECT_EQ(good, 8);
}

/// Bytes to a server's standard input, everything that comes back, and how it ended.
Outcome talk(const std::string& bytes, const std::map<std::string, std::string>& environment = {}) {
  Workspace w;
  w.write("scene.rib", kScene);
  w.write("input", bytes);
  // A file on standard input is a pipe client too.
  return run("rendrib", {"-rayserver", "-threads", "1", "scene.rib"}, w.path(), {}, environment,
             (w.path() / "input").string());
}
std::string query(char letter, const DVec3& a, const DVec3& b) {
  std::string s{'b', letter};
  const float f[12] = {float(a.x), float(a.y), float(a.z), float(b.x), float(b.y), float(b.z), 0, 0.5f};
  s.append(reinterpret_cast<const char*>(f), sizeof f);
  return s;
}
float floatAt(const std::string& s, size_t i) {
  float f;
  std::memcpy(&f, s.data() + 4 * i, 4);
  return f;
}

TEST(RayServer, SpeaksTheProtocolOf1998) {
  const std::string out = talk(query('h', kCenter + DVec3(0.5, 0, -4), {0, 0, 1}) +
                               query('t', kCenter - DVec3(0, 0, 4), {0, 0, 3}) +
                               query('v', kCenter - DVec3(0, 0, 4), kCenter + DVec3(0, 0, 4)) +
                               query('h', kCenter - DVec3(0, 4, 4), {0, 0, 1}) +
                               query('v', kCenter - DVec3(0, 4, 4), kCenter + DVec3(0, -4, 4)))
                              .out;
  ASSERT_EQ(out.size(), 28u + 16 + 12 + 28 + 12);
  const double z = std::sqrt(0.75);
  EXPECT_NEAR(floatAt(out, 0), 4 - z, 0.01);
  EXPECT_EQ(floatAt(out, 1), 1e6f + 0.5f);
  EXPECT_EQ(floatAt(out, 2), -2e6f);
  EXPECT_NEAR(floatAt(out, 3), 5 - z, 0.01);
  EXPECT_NEAR(floatAt(out, 4), 0.5, 0.01);
  EXPECT_NEAR(floatAt(out, 6), -z, 0.01);
  EXPECT_EQ(floatAt(out, 7), 1.0f);
  EXPECT_EQ(floatAt(out, 8), 0.5f);
  EXPECT_EQ(floatAt(out, 9), 0.25f);
  EXPECT_NEAR(floatAt(out, 10), 3, 0.01);
  EXPECT_EQ(floatAt(out, 11), 0.0f);
  EXPECT_EQ(floatAt(out, 14), 1e38f);
  EXPECT_EQ(floatAt(out, 21), 1.0f);
}

TEST(RayServer, ImpossibleRaysAreMissesAndGarbageEndsWithAMessage) {
  const double nan = std::nan(""), inf = INFINITY;
  const Outcome odd = talk(query('h', {nan, 0, 0}, {0, 0, 1}) + query('h', {0, 0, 0}, {0, 0, 0}) +
                           query('t', {inf, 0, 0}, {0, nan, 1}) + query('v', {0, 0, 0}, {inf, -inf, nan}));
  EXPECT_EQ(odd.exitCode, 0) << odd.err;
  ASSERT_EQ(odd.out.size(), 28u + 28 + 16 + 12);
  EXPECT_EQ(floatAt(odd.out, 0), 1e38f);
  EXPECT_EQ(floatAt(odd.out, 7), 1e38f);

  const Outcome garbage = talk(query('h', kCenter, {0, 0, 1}) + "GET / HTTP/1.1\r\n");
  EXPECT_EQ(garbage.exitCode, 1);
  EXPECT_NE(garbage.err.find("byte 50"), std::string::npos) << garbage.err;

  const Outcome cut = talk(query('t', kCenter, {0, 0, 1}) + "bt1234567");
  EXPECT_EQ(cut.exitCode, 1);
  EXPECT_EQ(cut.out.size(), 16u) << "what was whole is answered";
  EXPECT_NE(cut.err.find("9 bytes"), std::string::npos) << cut.err;

  std::mt19937 engine(3);
  for (int i = 0; i < 5; ++i) {
    std::string random(4000, 0);
    for (char& c : random) c = char(engine());
    random[0] = 'x';
    EXPECT_EQ(talk(random).exitCode, 1);
  }
  EXPECT_EQ(talk("").exitCode, 0);
}

TEST(RayServer, AnotherBuildIsRefusedByName) {
  Server server("version", kScene, {"-threads", "1"});
  auto client = server.join();
  ASSERT_TRUE(client);
  EXPECT_EQ(client->scene().patchMultiplier, 0.5f) << "of a ray server, as in 1998";
  auto socket = shm::connectNamed(server.name);
  ASSERT_TRUE(socket);
  ASSERT_TRUE(sendControl(*socket, uint32_t(ControlType::kHello), controlFingerprint() + 1));
  auto answer = receiveControl(*socket, controlFingerprint(), 10s, "the server");
  ASSERT_TRUE(answer && *answer) << answer.error().str();
  EXPECT_TRUE((*answer)->is(ControlType::kRefused));
  const std::string text((*answer)->text());
  EXPECT_NE(text.find(fmt::format("{:016x}", controlFingerprint())), std::string::npos) << text;
  EXPECT_NE(text.find(fmt::format("{:016x}", controlFingerprint() + 1)), std::string::npos) << text;
  EXPECT_NE(text.find(versionText()), std::string::npos) << text;
  // And a client says the same of a server.
  shm::PeerMessage message;
  message.bytes.resize(48);
  ControlHeader header;
  header.fingerprint = 5;
  std::strcpy(header.version, "7.7.7");
  std::memcpy(message.bytes.data(), &header, sizeof header);
  auto read = readControl(std::move(message), controlFingerprint(), "the ray server");
  ASSERT_FALSE(read);
  EXPECT_EQ(read.error().code, RiError::kVersion);
  EXPECT_NE(read.error().message.find("7.7.7"), std::string::npos);
  EXPECT_NE(read.error().message.find(versionText()), std::string::npos);
}

TEST(RayServer, RubbishOnTheSocketHarmsNobody) {
  Server server("rubbish");
  auto client = server.join();
  ASSERT_TRUE(client);
  auto line = client->connect();
  ASSERT_TRUE(line);
  std::mt19937 engine(4);
  for (int i = 0; i < 100; ++i) {
    auto socket = shm::connectNamed(server.name);
    ASSERT_TRUE(socket);
    std::vector<std::byte> bytes(1 + engine() % 300);
    for (auto& b : bytes) b = std::byte(engine());
    if (i % 2 && bytes.size() >= sizeof(ControlHeader)) {  // a good header, any type, odd descriptors
      ControlHeader h;
      h.type = 60 + uint32_t(engine() % 50);
      h.fingerprint = controlFingerprint();
      std::memcpy(bytes.data(), &h, sizeof h);
    }
    if (i % 3 == 0) {
      (void)sendControl(*socket, ControlType::kHello, {}, "x");
    }
    const int fds[] = {0, 1, 2};
    (void)socket->send(bytes, std::span(fds, engine() % 4));
  }
  EXPECT_EQ(askAll(**line, client->worldSpace(), 7, 4), 0);
}

/// Asks as fast as it can, blocks and single rays, until it is killed. In a child process: never returns.
[[noreturn]] void askUntilKilled(const std::string& server) {
  auto client = RayClient::join(server);
  if (!client) ::_exit(1);
  auto line = (*client)->connect();
  if (!line) ::_exit(1);
  const auto s = shots(1000, 1);
  for (;;) {
    while (RayQuery* q = (*line)->acquire()) {
      fill(*q, s, (*client)->worldSpace(), RayKind::kFullTrace);
      if (!(*line)->submit(q)) ::_exit(1);
    }
    (void)(*line)->ask({});
    ::usleep(1000);
  }
}
size_t entriesOf(const std::filesystem::path& folder) {
  const std::filesystem::directory_iterator all(folder);
  return size_t(std::distance(begin(all), end(all)));
}
size_t mappingsOf(pid_t pid) {
  std::ifstream in("/proc/" + std::to_string(pid) + "/maps");
  size_t n = 0;
  for (std::string line; std::getline(in, line);)
    n += line.find("frankenrender-channel") != std::string::npos;
  return n;
}

TEST(RayServer, AHundredKilledClientsAreForgotten) {
  constexpr int kKills = 100;
  Server server("dying");
  auto client = server.join();
  ASSERT_TRUE(client);
  auto line = client->connect();
  ASSERT_TRUE(line);
  EXPECT_EQ(askAll(**line, client->worldSpace(), 5, 4), 0);
  const auto alone = [&] {
    for (int k = 0; k < 3000; ++k) {
      auto n = client->numbers();
      if (!n) return false;
      if ((*n)[Gauge::kChannels] == 1 && (*n)[Gauge::kClients] == 1) return true;
      std::this_thread::sleep_for(10ms);
    }
    return false;
  };
  const std::filesystem::path descriptors = "/proc/" + std::to_string(server.process->pid()) + "/fd";
  const size_t descriptorsBefore = entriesOf(descriptors), mappingsBefore = mappingsOf(server.process->pid());

  // From the moment that a client is born to some time after its first answers; four at a time.
  std::mt19937 random(20);
  std::uniform_int_distribution<int> microseconds(0, 60000);
  for (int kills = 0; kills < kKills;) {
    std::array<pid_t, 4> clients{};
    for (pid_t& pid : clients) {
      pid = ::fork();
      if (pid == 0) askUntilKilled(server.name);
      ASSERT_GT(pid, 0);
    }
    for (const pid_t pid : clients) {
      std::this_thread::sleep_for(std::chrono::microseconds(microseconds(random)));
      ::kill(pid, SIGKILL);
      int status = 0;
      ::waitpid(pid, &status, 0);
      EXPECT_TRUE(WIFSIGNALED(status)) << "a client ended by itself with status " << status;
      ++kills;
    }
    ASSERT_EQ(askAll(**line, client->worldSpace(), uint32_t(kills), 4), 0) << "after " << kills << " kills";
  }
  ASSERT_TRUE(alone());
  EXPECT_LE(entriesOf(descriptors), descriptorsBefore);
  EXPECT_LE(mappingsOf(server.process->pid()), mappingsBefore);
}

TEST(RayServer, AServerThatIsKilledIsAnErrorAndNoHang) {
  for (const bool pipe : {false, true}) {
    Workspace w;
    w.write("scene.rib", kScene);
    RayClientOptions o;
    o.pipe = pipe;
    auto client =
        RayClient::start(Words{rendrib(), "-rayserver", "-silent", (w.path() / "scene.rib").string()}, o);
    ASSERT_TRUE(client) << client.error().str();
    auto line = (*client)->connect();
    ASSERT_TRUE(line);
    EXPECT_EQ(askAll(**line, (*client)->worldSpace(), 1, 2), 0);
    ::kill((*client)->processId(), SIGKILL);
    Result<void> r;
    for (int i = 0; i < 1000 && r.ok(); ++i) {
      RayQuery* q = (*line)->acquire();
      ASSERT_TRUE(q);
      fill(*q, shots(10, 1), (*client)->worldSpace(), RayKind::kTrace);
      r = (*line)->submit(q);
      if (r.ok()) r = (*line)->wait();
      (*line)->release(q);
    }
    ASSERT_FALSE(r.ok());
    EXPECT_NE(r.error().message.find("signal 9"), std::string::npos) << r.error().str();
    EXPECT_FALSE((*client)->alive());
    EXPECT_FALSE((*client)->connect());
    EXPECT_FALSE((*line)->ask({}));
  }
}

TEST(RayServer, WhoCannotServeSaysWhy) {
  Workspace w;
  for (const bool pipe : {false, true}) {
    RayClientOptions o;
    o.pipe = pipe;
    auto missing =
        RayClient::start(Words{rendrib(), "-rayserver", "-silent", (w.path() / "none.rib").string()}, o);
    ASSERT_FALSE(missing);
    EXPECT_NE(missing.error().message.find("none.rib"), std::string::npos) << missing.error().str();
    EXPECT_FALSE(RayClient::start(Words{"/no/such/program"}, o));
    auto silent = RayClient::start(Words{"/bin/false"}, o);
    ASSERT_FALSE(silent);
    EXPECT_NE(silent.error().message.find("status 1"), std::string::npos) << silent.error().str();
    o.patience = 300ms;
    auto deaf = RayClient::start(Words{"/bin/sleep", "100"}, o);
    ASSERT_FALSE(deaf);
    EXPECT_NE(deaf.error().message.find("no sign of life"), std::string::npos) << deaf.error().str();
  }
  EXPECT_FALSE(RayClient::join("nobody-here"));
}

TEST(RayServer, AProgramOf1998IsSpokenToAsIn1998) {
  // cat answers a trace with the first bytes of the question itself: no welcome of ours.
  auto client = RayClient::start("/bin/cat");
  ASSERT_TRUE(client) << client.error().str();
  EXPECT_EQ((*client)->transport(), RayTransport::kPipe1998);
  EXPECT_FALSE((*client)->numbers());
}

TEST(RayServer, ANameIsTakenOnce) {
  Server server("taken");
  ASSERT_TRUE(server.join());
  const Outcome o = run("rendrib", {"-rayserver", "-name", server.name, "scene.rib"}, server.w.path());
  EXPECT_EQ(o.exitCode, 1);
  EXPECT_NE(o.err.find(server.name), std::string::npos) << o.err;
}

TEST(RayServer, RaystatShowsIt) {
  Server server("stat");
  auto client = server.join();
  ASSERT_TRUE(client);
  auto line = client->connect();
  ASSERT_TRUE(line);
  EXPECT_EQ(askAll(**line, client->worldSpace(), 7, 4), 0);
  Workspace w;
  const std::string pid = std::to_string(server.process->pid());
  for (const std::string& which : {server.name, pid}) {
    const Outcome o = run("raystat", {"--once", "--json", which}, w.path());
    EXPECT_EQ(o.exitCode, 0) << o.err;
    EXPECT_NE(o.out.find("\"pid\":" + pid), std::string::npos) << o.out;
    EXPECT_NE(o.out.find("\"blockRays\":800"), std::string::npos) << o.out;
    EXPECT_NE(o.out.find("\"clients\":1,"), std::string::npos) << o.out;
  }
  const Outcome all = run("raystat", {"--once", "--all"}, w.path());
  EXPECT_EQ(all.exitCode, 0) << all.err;
  EXPECT_NE(all.out.find(pid), std::string::npos) << all.out;
  const Outcome none = run("raystat", {"--once", "nobody-here"}, w.path());
  EXPECT_EQ(none.exitCode, 1);
  EXPECT_NE(none.err.find("nobody-here"), std::string::npos);
}

/// How often each thread of a process has gone to sleep.
std::map<std::string, std::string> sleeps(pid_t pid) {
  std::map<std::string, std::string> all;
  for (const auto& task : std::filesystem::directory_iterator(fmt::format("/proc/{}/task", pid))) {
    std::ifstream status(task.path() / "status");
    for (std::string line; std::getline(status, line);)
      if (line.starts_with("voluntary_ctxt_switches:")) all[task.path().filename()] = line;
  }
  return all;
}

TEST(RayServer, AnIdleServerSleeps) {
  Server server("idle");
  auto client = server.join();
  ASSERT_TRUE(client);
  auto line = client->connect();
  ASSERT_TRUE(line);
  EXPECT_EQ(askAll(**line, client->worldSpace(), 7, 4), 0);
  // Whatever the last questions have set going comes to rest, on a busy machine a little later: then no
  // thread wakes for a second and a half. Timers would wake one in every such while.
  auto before = sleeps(server.process->pid());
  EXPECT_GE(before.size(), 3u);
  bool rested = false;
  for (int i = 0; i < 10 && !rested; ++i) {
    std::this_thread::sleep_for(1500ms);
    auto now = sleeps(server.process->pid());
    rested = now == before;
    before = std::move(now);
  }
  EXPECT_TRUE(rested) << "a thread is woken again and again: there should be no timers";
}

// ---------------------------------------------------------------------------------------- frankenrender
// --pipe

const std::string kCommon =
    "Display \"out.exr\" \"openexr\" \"rgba\"\nFormat 80 60 1\nPixelSamples 2 2\n"
    "Projection \"perspective\" \"fov\" [40]\nTranslate 0 0 5\nFrameBegin 3\nWorldBegin\n"
    "Attribute \"light\" \"string shadows\" [\"on\"]\n"
    "LightSource \"pointlight\" 1 \"intensity\" [20] \"from\" [2 3 -3]\n"
    "AttributeBegin\nSurface \"probe\"\nTranslate -0.8 0 0\nSphere 0.7 -0.7 0.7 360\nAttributeEnd\n"
    "AttributeBegin\nColor [1 0.3 0.2]\nSurface \"plastic\"\nTranslate 0.9 -0.1 -0.3\nRotate 90 1 0 0\n"
    "Torus 0.5 0.2 0 360 360\nAttributeEnd\n"
    "AttributeBegin\nOpacity [0.5 0.5 0.5]\nColor [0.2 0.4 1]\nSurface \"matte\"\nTranslate 0.1 0.6 -1\n"
    "Sphere 0.3 -0.3 0.3 360\nAttributeEnd\n"
    "AttributeBegin\nSurface \"matte\"\nPolygon \"P\" [-4 -0.8 -3 -4 -0.8 6 4 -0.8 6 4 -0.8 "
    "-3]\nAttributeEnd\n";
// Seen by rays alone.
const std::string kHidden =
    "AttributeBegin\nColor [0 1 0]\nSurface \"constant\"\nTranslate -1 1.5 -1\nSphere 0.5 -0.5 0.5 360\n"
    "AttributeEnd\n";
const std::string kEnd = "WorldEnd\nFrameEnd\n";
const std::string kProbe =
    "surface probe() {\n"
    "  normal Nf = faceforward(normalize(N), I);\n"
    "  vector R = reflect(normalize(I), Nf);\n"
    "  color c; float d; point Ph, Pm; vector Nh, Rm;\n"
    "  float depth = fulltrace(P, R, c, d, Ph, Nh, Pm, Rm);\n"
    "  Oi = 1;\n"
    "  Ci = 0.6 * c + 0.1 * visibility(P, P + 3 * R) + 0.02 * min(10, rayhittest(P, R, Ph, Nh)) + 0.01 * "
    "depth;\n"
    "}\n";

TEST(PipeTransport, PicturesAreTheSameBitForBit) {
  Workspace w;
  w.write("common.rib", kCommon);
  w.write("hidden.rib", kHidden);
  w.write("end.rib", kEnd);
  w.write("probe.sl", kProbe);
  std::vector<Picture> pictures;
  for (const std::string transport : {"--inproc", "--shm", "--pipe"}) {
    const Outcome o = run("frankenrender",
                          {transport, "--res", "60", "45", "--threads", "2", "common.rib", "-bmrt",
                           "hidden.rib", "-common", "end.rib"},
                          w.path());
    EXPECT_EQ(o.exitCode, 0) << o.err;
    EXPECT_EQ(o.err, "") << transport;
    pictures.push_back(readExr(w.path() / "out.exr"));
    std::filesystem::remove(w.path() / "out.exr");
  }
  EXPECT_TRUE(pictures[0] == pictures[1]);
  EXPECT_TRUE(pictures[0] == pictures[2]) << worst(pictures[0], pictures[2]);
}

TEST(PipeTransport, RayserverSaysWhoAnswers) {
  Workspace w;
  w.write("common.rib", kCommon + kEnd);
  w.write("probe.sl", kProbe);
  // Another scene (no overrides): works, and says so.
  const Outcome o = run("frankenrender", {"--pipe", "--res", "40", "30", "common.rib"}, w.path(), {},
                        {{"RAYSERVER", rendrib() + " -rayserver -silent common.rib"}});
  EXPECT_EQ(o.exitCode, 0) << o.err;
  EXPECT_NE(o.err.find("another scene"), std::string::npos) << o.err;
  const Outcome dead =
      run("frankenrender", {"--pipe", "common.rib"}, w.path(), {}, {{"RAYSERVER", "/bin/false"}});
  EXPECT_NE(dead.exitCode, 0);
  EXPECT_NE(dead.err.find("ended with status 1"), std::string::npos) << dead.err;
}

}  // namespace
}  // namespace fr::test
