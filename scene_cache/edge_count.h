// For tests: is what was diced watertight?
#pragma once

#include <algorithm>
#include <array>
#include <cstring>
#include <unordered_map>
#include <vector>

#include "base/random.h"
#include "scene_cache/dice_scene.h"

namespace fr::cache {

using Key = std::array<uint32_t, 3>;
inline Key keyOf(const float* p) {
  Key k;
  for (int i = 0; i < 3; ++i) {
    const float x = p[i] + 0.0f;  // -0 and 0 are one place
    std::memcpy(&k[size_t(i)], &x, 4);
  }
  return k;
}

struct KeyHash {
  size_t operator()(const Key& k) const { return size_t(hashStep(hashStep(k[0], k[1]), k[2])); }
};

struct EdgeCount {
  size_t edges = 0, open = 0, crowded = 0, faces = 0, grids = 0, splits = 0;
  std::string example;
};

/// Edges of all micropolygons after merging vertices with equal bits; cells without area are left out.
inline EdgeCount countEdges(DiceScene& scene) {
  std::unordered_map<Key, uint32_t, KeyHash> ids;
  std::vector<Key> places;
  std::unordered_map<uint64_t, int> uses;
  EdgeCount r;
  const auto vertex = [&](const float* p) {
    const auto [it, fresh] = ids.try_emplace(keyOf(p), uint32_t(ids.size()));
    if (fresh) places.push_back(it->first);
    return it->second;
  };
  const auto face = [&](const std::vector<uint32_t>& v) {
    std::vector<uint32_t> loop;
    for (uint32_t x : v) {
      if (loop.empty() || loop.back() != x) loop.push_back(x);
    }
    while (loop.size() > 1 && loop.front() == loop.back()) loop.pop_back();
    if (loop.size() < 3) return;
    ++r.faces;
    for (size_t i = 0; i < loop.size(); ++i) {
      const uint32_t a = loop[i], b = loop[(i + 1) % loop.size()];
      ++uses[uint64_t(std::min(a, b)) << 32 | std::max(a, b)];
    }
  };
  scene.forEachGrid([&](NodeId id, const GridRecord& g) {
    ++r.grids;
    const GridView v = scene.cache->view(g);
    r.splits += scene.cache->node(id).du + scene.cache->node(id).dv > 0;
    if (g.kind == GridKind::kMeshlet) {
      for (int t = 0; t < g.nv; ++t) {
        face({vertex(v.positions + v.indices[t * 3] * 3), vertex(v.positions + v.indices[t * 3 + 1] * 3),
              vertex(v.positions + v.indices[t * 3 + 2] * 3)});
      }
      return;
    }
    const auto at = [&](int i, int j) {
      return vertex(v.positions + (size_t(j) * g.rowStride + size_t(i)) * 3);
    };
    for (int j = 0; j < g.nv; ++j) {
      for (int i = 0; i < g.nu; ++i) face({at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)});
    }
  });
  for (const auto& [edge, n] : uses) {
    ++r.edges;
    if (n == 2) continue;
    // Two collapsed triangles may lie on one another; an even number still closes the surface.
    ++(n % 2 ? r.open : r.crowded);
    if (n % 2 && r.example.empty()) {
      float p[6];
      std::memcpy(p, &places[size_t(edge >> 32)], 12);
      std::memcpy(p + 3, &places[size_t(edge & 0xffffffffu)], 12);
      r.example = fmt::format("({} {} {}) - ({} {} {}) used {}", p[0], p[1], p[2], p[3], p[4], p[5], n);
    }
  }
  return r;
}

inline void expectWatertight(const std::string& name, const std::string& body,
                             std::initializer_list<double> distances, double shadingRate = 1) {
  for (const double d : distances) {
    DiceScene scene(diceWorld(diceCamera(d, shadingRate, 40), body));
    ASSERT_TRUE(scene.cache) << name;
    const EdgeCount c = countEdges(scene);
    EXPECT_EQ(c.open, 0u) << name << " at " << d << ": " << c.example << ", " << c.edges << " edges, "
                          << c.faces << " faces, " << c.grids << " grids, " << c.splits
                          << " of them from splits";
    EXPECT_LE(c.crowded, c.edges / 50) << name << " at " << d;
    EXPECT_GT(c.faces, 3u) << name << " at " << d;
  }
}

}  // namespace fr::cache
