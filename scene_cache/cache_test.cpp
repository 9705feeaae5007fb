#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cstdio>
#include <fstream>
#include <thread>

#include "scene_cache/cache_impl.h"
#include "scene_cache/edge_count.h"

namespace fr::cache {
namespace {

const std::string kScene = "Sphere 1 -1 1 360\nTranslate 1 0 0\nTorus 0.5 0.2 0 360 360\n";

std::string temporaryPath(const char* name) {
  return fmt::format("{}/{}.{}.fsc", ::testing::TempDir(), name, getpid());
}

TEST(Cache, ThreadsDiceEachNodeOnce) {
  DiceScene scene(diceWorld(diceCamera(3, 1, 64), kScene));
  DiceScene alone(diceWorld(diceCamera(3, 1, 64), kScene));
  alone.forEachGrid([](NodeId, const GridRecord&) {});
  std::vector<std::thread> threads;
  std::atomic<size_t> grids{0};
  for (int t = 0; t < 8; ++t) {
    threads.emplace_back([&] { scene.forEachGrid([&](NodeId, const GridRecord&) { ++grids; }); });
  }
  for (auto& t : threads) t.join();
  EXPECT_EQ(scene.cache->statistics().gridsDiced, alone.cache->statistics().gridsDiced);
  EXPECT_EQ(scene.cache->statistics().nodesSplit, alone.cache->statistics().nodesSplit);
  EXPECT_EQ(grids.load(), 8 * alone.cache->statistics().gridsDiced);
}

TEST(Cache, TwoMappingsSeeEachOthersGrids) {
  DiceScene scene(diceWorld(diceCamera(3, 1, 64), kScene));
  auto other = SceneCache::attach(scene.cache->segments(), false);
  ASSERT_TRUE(other.ok());
  auto reader = SceneCache::attach(scene.cache->segments(), true);
  ASSERT_TRUE(reader.ok());
  EXPECT_EQ((*reader)->resolve(0).state, NodeState::kEmpty);  // read only: nothing is made
  NodeId node = 0;
  ResolvedNode r = (*other)->resolve(node);
  while (r.state == NodeState::kSplit) r = (*other)->resolve(node = r.children[0]);
  ASSERT_EQ(r.state, NodeState::kGrid);
  const ResolvedNode seen = (*reader)->resolve(node);
  ASSERT_EQ(seen.state, NodeState::kGrid);
  const ResolvedNode mine = scene.cache->resolve(node);
  const GridView a = (*other)->view(*r.grid), b = scene.cache->view(*mine.grid);
  EXPECT_EQ(std::memcmp(a.positions, b.positions, r.grid->nu * 12u), 0);
  EXPECT_EQ(scene.cache->statistics().gridsDiced, 0u);
}

TEST(Cache, ADeadOwnersClaimIsTakenOver) {
  DiceScene scene(diceWorld(diceCamera(3, 1, 64), kScene));
  const SceneCache::Segments fds = scene.cache->segments();
  const pid_t child = fork();
  if (child == 0) {
    // Claims node 0 as dicing does, and dies at it.
    auto c = SceneCache::attach(fds, false);
    if (!c) _exit(2);
    const uint64_t word = buildingWord(2, 1);  // the second process has slot 2
    const_cast<PatchNode&>((*c)->node(0)).state.store(word);
    _exit(0);
  }
  int status = 0;
  waitpid(child, &status, 0);
  ASSERT_EQ(status, 0);
  ASSERT_EQ(stateOf(scene.cache->node(0).state.load()), NodeState::kBuilding);
  const ResolvedNode r = scene.cache->resolve(0);
  EXPECT_NE(r.state, NodeState::kEmpty);
  EXPECT_EQ(scene.cache->statistics().claimsTakenOver, 1u);
}

TEST(Cache, KilledAtAnyTimeTheSurvivorFinishes) {
  DiceScene reference(diceWorld(diceCamera(3, 1, 128), kScene));
  const EdgeCount whole = countEdges(reference);
  for (int round = 0; round < 6; ++round) {
    DiceScene scene(diceWorld(diceCamera(3, 1, 128), kScene));
    const SceneCache::Segments fds = scene.cache->segments();
    const pid_t child = fork();
    if (child == 0) {
      auto c = SceneCache::attach(fds, false);
      if (!c) _exit(2);
      for (NodeId i = 0;; ++i) {
        if (i >= (*c)->nodeCount()) i = 0;
        (*c)->resolve(i);
      }
    }
    usleep(useconds_t(1000 + round * 3000));
    kill(child, SIGKILL);
    waitpid(child, nullptr, 0);
    const EdgeCount c = countEdges(scene);
    EXPECT_EQ(c.open, 0u);
    EXPECT_EQ(c.faces, whole.faces);
  }
}

TEST(Cache, AttachRefusesOtherThings) {
  DiceScene scene(diceWorld(diceCamera(3, 1, 64), kScene));
  SceneCache::Segments fds = scene.cache->segments();
  std::swap(fds.nodes, fds.arena);
  EXPECT_FALSE(SceneCache::attach(fds, false).ok());
  fds.nodes = -1;
  EXPECT_FALSE(SceneCache::attach(fds, false).ok());
}

TEST(Cache, DamagedSharedMemoryIsRefusedNotFollowed) {
  DiceScene scene(diceWorld(diceCamera(3, 1, 64), kScene));
  scene.forEachGrid([](NodeId, const GridRecord&) {});
  for (uint32_t k = 0; k < 4000; ++k) {
    const NodeId id = mix32(k) % scene.cache->nodeCount();
    auto& state = const_cast<PatchNode&>(scene.cache->node(id)).state;
    const uint64_t good = state.load();
    uint64_t bad = good ^ (uint64_t(1) << (mix32(k * 31 + 5) % 64));
    if (stateOf(bad) == NodeState::kBuilding) bad ^= 1;  // a claim is nobody's lie to find out here
    state.store(bad);
    const ResolvedNode r = scene.cache->peek(id);
    if (r.state == NodeState::kGrid) {
      ASSERT_TRUE(r.grid);
      EXPECT_EQ(r.grid->node, id);
    }
    state.store(good);
  }
}

TEST(CacheFile, SaveAndOpen) {
  const std::string path = temporaryPath("saved");
  EdgeCount before;
  {
    DiceScene scene(diceWorld(diceCamera(3, 1, 64), kScene));
    scene.visit(0, [](NodeId, const GridRecord&) {});  // half of it diced
    ASSERT_TRUE(scene.cache->save(path).ok());
    before = countEdges(scene);
  }
  auto opened = SceneCache::openFile(path);
  ASSERT_TRUE(opened.ok()) << opened.error().str();
  DiceScene again("");
  again.cache = *std::move(opened);
  const EdgeCount after = countEdges(again);
  EXPECT_EQ(after.open, 0u);
  EXPECT_EQ(after.faces, before.faces);
  EXPECT_LT(again.cache->statistics().gridsDiced, after.grids);
  EXPECT_GT(again.cache->statistics().gridsDiced, 0u);
  std::remove(path.c_str());
}

TEST(CacheFile, DamageIsFound) {
  const std::string path = temporaryPath("damaged");
  {
    DiceScene scene(diceWorld(diceCamera(3, 1, 32), kScene));
    scene.forEachGrid([](NodeId, const GridRecord&) {});
    ASSERT_TRUE(scene.cache->save(path).ok());
  }
  std::string bytes;
  {
    std::ifstream in(path, std::ios::binary);
    bytes.assign(std::istreambuf_iterator<char>(in), {});
  }
  const auto opens = [&](const std::string& content) {
    {
      std::ofstream out(path, std::ios::binary | std::ios::trunc);
      out << content;
    }
    auto c = SceneCache::openFile(path);
    if (!c) {
      EXPECT_EQ(c.error().where.file, path);
    }
    return c.ok();
  };
  EXPECT_TRUE(opens(bytes));
  for (uint32_t k = 0; k < 60; ++k) {
    std::string bad = bytes;
    const size_t at = k < 30 ? k * 5 : mix32(k) % bytes.size();
    bad[at] = char(bad[at] ^ (1 << k % 8));
    const bool padding = opens(bad);
    // Only the bytes between the parts may change unnoticed.
    if (padding) {
      EXPECT_TRUE(at > 100 && bytes[at] == 0) << at;
    }
  }
  for (const size_t length : {size_t(0), size_t(10), size_t(4096), bytes.size() / 2, bytes.size() - 1}) {
    EXPECT_FALSE(opens(bytes.substr(0, length))) << length;
  }
  std::remove(path.c_str());
  EXPECT_FALSE(SceneCache::openFile(path).ok());
}

TEST(CacheFile, AFullDiskIsAnError) {
  DiceScene scene(diceWorld(diceCamera(3, 1, 32), kScene));
  const auto r = scene.cache->save("/dev/full/x.fsc");
  EXPECT_FALSE(r.ok());
  EXPECT_FALSE(scene.cache->save("/no/such/folder/x.fsc").ok());
}

// ---- displacement

class Outwards : public Displacer {
 public:
  explicit Outwards(float by) : by_(by) {}
  bool displaces(ObjectId) const override { return true; }
  void displace(NodeId, size_t n, const uint32_t*, const float*, const float*, int nu, int nv,
                float* const P[3], float* const N[3]) override {
    EXPECT_EQ(n, size_t(nu + 1) * size_t(nv + 1));
    for (int c = 0; c < 3; ++c) {
      for (size_t i = 0; i < n; ++i) P[c][i] += N[c][i] * by_;
    }
  }

 private:
  float by_;
};

TEST(Displacement, MovesTheGridAndWarnsBeyondTheBound) {
  for (const float by : {0.1f, 0.3f}) {
    DiceScene scene(diceWorld(
        diceCamera(4, 1, 64),
        "Attribute \"displacementbound\" \"float sphere\" [0.2] \"string coordinatesystem\" [\"world\"]\n"
        "Displacement \"anything\"\nSphere 1 -1 1 360"));
    Outwards displacer(by);
    scene.cache->setDisplacer(&displacer);
    std::vector<Error> said;
    setReportSink([&](const Error& e) { said.push_back(e); });
    const DVec3 origin = scene.cache->skeleton().header().cacheOrigin;
    float far = 0;
    scene.forEachGrid([&](NodeId id, const GridRecord& g) {
      const GridView v = scene.cache->view(g);
      ASSERT_TRUE(v.normals);
      EXPECT_TRUE(g.flags & kGridHasNormals);
      const float* p = v.positions + (size_t(g.nv / 2) * g.rowStride + size_t(g.nu / 2)) * 3;
      far = float(glm::length(DVec3(p[0], p[1], p[2]) + origin));
      EXPECT_NEAR(std::abs(far - 1), by, 1e-3);
      // Addresses on the diced surface give the displaced point.
      std::vector<float> u(v.vertexCount()), w(v.vertexCount());
      std::vector<uint32_t> cell(v.vertexCount());
      scene.cache->vertexParameters(g, cell.data(), u.data(), w.data());
      const size_t middle = size_t(g.nv / 2 * (g.nu + 1) + g.nu / 2);
      Vec3 q;
      SurfaceOut out;
      for (int c = 0; c < 3; ++c) out.P[c] = &q[c];
      scene.cache->evaluateDiced(id, 1, nullptr, &u[middle], &w[middle], out);
      EXPECT_NEAR(glm::length(q - Vec3(p[0], p[1], p[2])), 0, 1e-5);
      for (int c = 0; c < 3; ++c) {
        EXPECT_LE(g.bound.min[c], p[c]);
        EXPECT_GE(g.bound.max[c], p[c]);
      }
    });
    setReportSink({});
    EXPECT_EQ(said.size(), by > 0.2f ? 1u : 0u);
  }
}

}  // namespace
}  // namespace fr::cache
