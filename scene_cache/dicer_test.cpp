#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstring>
#include <fstream>
#include <map>
#include <sstream>

#include "scene_cache/edge_count.h"

namespace fr::cache {
namespace {

// Distances at which the near side is much finer than the far side, so that patches split unevenly.
const auto kDistances = {1.05, 1.3, 3.0, 10.0, 300.0};

TEST(Watertight, Sphere) { expectWatertight("sphere", "Sphere 1 -1 1 360", kDistances); }
TEST(Watertight, TurnedSphere) {
  expectWatertight("sphere", "Rotate 77 1 2 3 Scale 1 0.5 0.9 Sphere 1 -1 1 360", {0.95, 1.3, 3, 20});
}
TEST(Watertight, Torus) {
  expectWatertight("torus", "Rotate 50 1 0.3 0 Torus 0.8 0.3 0 360 360", {0.75, 1.1, 4, 50});
}
TEST(Watertight, CappedCylinder) {
  expectWatertight("cylinder",
                   "Rotate 70 1 0.4 0 Cylinder 0.5 -0.7 0.7 360 Disk -0.7 0.5 360 Disk 0.7 0.5 360",
                   {0.8, 1.1, 4, 50});
}
TEST(Watertight, CappedConeAndHemisphere) {
  expectWatertight("cone", "Rotate 110 1 0.4 0 Cone 1 0.5 360 Sphere 0.5 -0.5 0 360", {0.8, 1.1, 4, 50});
}

// The eight octants of a sphere as rational bicubic patches would need weights; a closed box of bicubic
// patches with bulges serves as well: each face is a separate primitive with its parameters in another
// direction.
std::string bicubicBox(bool transpose) {
  const auto corner = [](int axis, int side, double a, double b) {
    double p[3];
    p[axis] = side ? 1 : -1, p[(axis + 1) % 3] = a, p[(axis + 2) % 3] = b;
    // Pulls the cube's surface towards the sphere, the same way from every face.
    const double l = std::sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
    const double k = 0.4 + 0.6 / l + 0.1 * std::sin(5 * p[0] + 3 * p[1] * p[1] + 2 * p[2]);
    return std::array<double, 3>{p[0] * k, p[1] * k, p[2] * k};
  };
  std::string rib;
  for (int axis = 0; axis < 3; ++axis) {
    for (int side = 0; side < 2; ++side) {
      rib += "Patch \"bicubic\" \"P\" [";
      for (int j = 0; j < 4; ++j) {
        for (int i = 0; i < 4; ++i) {
          double a = -1 + 2 * i / 3.0, b = -1 + 2 * j / 3.0;
          if (side != 0) a = -a;
          if (axis == 1) std::swap(a, b);
          if (transpose && axis == 2) b = -b;
          const auto p = corner(axis, side, std::round(a * 3) / 3, std::round(b * 3) / 3);
          rib += fmt::format("{:.6f} {:.6f} {:.6f} ", p[0], p[1], p[2]);
        }
      }
      rib += "]\n";
    }
  }
  return rib;
}
TEST(Watertight, SeparateBicubicPatches) {
  for (const bool transpose : {false, true}) {
    expectWatertight("box", "Rotate 33 1 2 0.5\n" + bicubicBox(transpose), {1.05, 1.3, 3, 10, 100});
  }
}
// Closed boxes of bicubic patches with very uneven parameters: long thin cells, splits of every depth next to
// each other.
std::string unevenBox(uint32_t seed) {
  const auto random = [&seed] { return double(toUnitFloat(mix32(seed += 0x9e3779b9u))); };
  // One warp of each coordinate for all faces, so that shared edges keep their control points.
  double warp[3][4];
  for (auto& w : warp) {
    w[0] = -1, w[3] = 1;
    w[1] = -1 + 2 * random() * random(), w[2] = 1 - 2 * random() * random();
  }
  const double bend = random() * 3;
  std::string rib;
  for (int axis = 0; axis < 3; ++axis) {
    for (int side = 0; side < 2; ++side) {
      const bool flip = random() < 0.5, turn = random() < 0.5;
      rib += "Patch \"bicubic\" \"P\" [";
      for (int j = 0; j < 4; ++j) {
        for (int i = 0; i < 4; ++i) {
          const int a = turn ? j : i, b = turn ? i : flip ? 3 - j : j;
          double p[3];
          p[axis] = side ? 1 : -1, p[(axis + 1) % 3] = warp[(axis + 1) % 3][a],
          p[(axis + 2) % 3] = warp[(axis + 2) % 3][b];
          const double k = 1 + 0.15 * std::sin(bend * p[0] + 2 * p[1] * p[2]) + 0.1 * std::cos(3 * p[2]);
          rib += fmt::format("{:.6f} {:.6f} {:.6f} ", p[0] * k, p[1] * k, p[2] * k);
        }
      }
      rib += "]\n";
    }
  }
  return rib;
}
TEST(Watertight, UnevenParameters) {
  for (uint32_t seed = 1; seed <= 30; ++seed) {
    const double turn = 360.0 * toUnitFloat(mix32(seed));
    expectWatertight(fmt::format("uneven box {}", seed),
                     fmt::format("Rotate {:.3f} 1 {} 0.5\n", turn, seed % 3) + unevenBox(seed),
                     {1.25, 1.8, 4}, seed % 4 == 0 ? 0.5 : 3);
  }
}
// A long edge opposite a short one: splits end on a border that keeps fewer vertices than there are splits.
TEST(Watertight, Wedges) {
  for (const double top : {0.003, 0.02, 0.1, 0.3}) {
    const auto corner = [&](int k) {  // bits: x, y, z; a flat frustum, the small end off centre
      const double s = k & 4 ? 1.0 : top;
      return fmt::format("{:.5f} {:.5f} {} ", (k & 1 ? s : -s) + (k & 4 ? 0 : 0.2), k & 2 ? s : -s,
                         k & 4 ? 1 : -1);
    };
    const int faces[6][4] = {{0, 1, 2, 3}, {5, 4, 7, 6}, {1, 0, 5, 4},
                             {2, 3, 6, 7}, {0, 2, 4, 6}, {7, 3, 5, 1}};
    std::string rib;
    for (const auto& f : faces) {
      rib += "Patch \"bilinear\" \"P\" [";
      for (const int k : f) rib += corner(k);
      rib += "]\n";
    }
    expectWatertight(fmt::format("wedge {}", top), "Rotate 20 1 1 0\n" + rib, {1.5, 3, 8, 40});
    expectWatertight(fmt::format("wedge {}", top), "Rotate 200 1 1 0\n" + rib, {1.5, 3, 8}, 0.3);
  }
}
TEST(Watertight, CoarseShadingRates) {
  for (const double rate : {0.4, 7.0, 100.0}) {
    expectWatertight("sphere", "Sphere 1 -1 1 360", {1.05, 1.5, 4}, rate);
    expectWatertight("box", bicubicBox(true), {1.3, 1.5, 4}, rate);
  }
}

// ---- grids

TEST(Grid, StridesUseTheGridsOwnVertices) {
  DiceScene scene(diceWorld(diceCamera(3), "Sphere 1 -1 1 360"));
  size_t grids = 0;
  scene.forEachGrid([&](NodeId, const GridRecord& g) {
    ++grids;
    const auto arena = scene.cache->arena();
    EXPECT_EQ(g.positions % positionAlign(g.levels), 0u);
    for (int level = 0; level < g.levels; ++level) {
      const size_t k = size_t(1) << level;
      EXPECT_EQ(g.nu % k, 0u);
      EXPECT_EQ(g.nv % k, 0u);
      // As Embree addresses it: byte stride 12 k, the same row stride, first vertex positions / (12 k).
      EXPECT_EQ(g.positions % (12 * k), 0u);
      const size_t last = g.positions + 12 * k * (g.nv / k * g.rowStride + g.nu / k);
      EXPECT_LE(last + 12, g.positions + 12 * (size_t(g.rowStride) * g.nv + g.nu + 1));
      EXPECT_LT(last + 12 + 64, arena.size());
    }
    EXPECT_GE(g.levels, 1);
  });
  EXPECT_GT(grids, 4u);
}

TEST(Grid, DeviationOfTheUnitSphere) {
  DiceScene scene(diceWorld(diceCamera(4), "Sphere 1 -1 1 360"));
  scene.forEachGrid([&](NodeId id, const GridRecord& g) {
    const PatchNode& n = scene.cache->node(id);
    for (int level = 0; level < g.levels; ++level) {
      // Sagitta of the longest coarse steps: latitude of pi / (nv 2^dv), longitude of 2 pi / (nu 2^du) on the
      // equator.
      const double k = double(1 << level);
      const double a = M_PI * k / (g.nv * std::ldexp(1.0, n.dv)),
                   b = 2 * M_PI * k / (g.nu * std::ldexp(1.0, n.du));
      const double most = (1 - std::cos(a / 2)) + (1 - std::cos(b / 2));
      const double fine = level == 0 ? 0 : most / k / k * 2;
      EXPECT_LE(double(g.deviation[level]), 1.6 * most + 1e-6) << level;
      if (level == 1) {
        EXPECT_GE(double(g.deviation[level]), 0.5 * (1 - std::cos(a / 2)) - fine) << level;
      }
    }
  });
}

TEST(Grid, EveryVertexLiesOnTheSphereAndInItsBounds) {
  DiceScene scene(diceWorld(diceCamera(1.2, 1, 64), "Sphere 1 -1 1 360"));
  const DVec3 origin = scene.cache->skeleton().header().cacheOrigin;
  size_t vertices = 0;
  scene.forEachGrid([&](NodeId id, const GridRecord& g) {
    const GridView v = scene.cache->view(g);
    const Box3f node = scene.cache->node(id).bound;
    std::vector<float> u(v.vertexCount()), w(v.vertexCount());
    std::vector<uint32_t> cell(v.vertexCount());
    scene.cache->vertexParameters(g, cell.data(), u.data(), w.data());
    for (int j = 0; j <= g.nv; ++j) {
      for (int i = 0; i <= g.nu; ++i, ++vertices) {
        const float* p = v.positions + (size_t(j) * g.rowStride + size_t(i)) * 3;
        EXPECT_NEAR(glm::length(DVec3(p[0], p[1], p[2]) + origin), 1.0, 1e-6);
        for (int c = 0; c < 3; ++c) {
          EXPECT_GE(p[c], node.min[c]);
          EXPECT_LE(p[c], node.max[c]);
        }
        const size_t k = size_t(j * (g.nu + 1) + i);
        const double theta = 2 * M_PI * u[k], phi = M_PI * (w[k] - 0.5);
        EXPECT_NEAR(p[2] + origin.z, std::sin(phi), 1e-6);
        EXPECT_NEAR(p[0] + origin.x, std::cos(phi) * std::cos(theta), 1e-6);
      }
    }
  });
  EXPECT_GT(vertices, 1000u);
}

TEST(Grid, MicropolygonsAreAboutAPixel) {
  DiceScene scene(diceWorld(diceCamera(3), "Sphere 1 -1 1 360"));
  const auto area = [&] {
    double total = 0;
    scene.forEachGrid([&](NodeId, const GridRecord& g) { total += double(g.nu) * g.nv; });
    return total;
  };
  // 4 pi of solid area seen from about 3: pixel edge 3 tan(20 deg) * 2 / 256.
  const double pixel = 2.6 * std::tan(20 * M_PI / 180) * 2 / 256;
  const double needed = 4 * M_PI / (pixel * pixel);
  EXPECT_GT(area(), needed * 0.5);
  EXPECT_LT(area(), needed * 6);
}

// What only rays can see is rated by its distance too, up to four times coarser.
// Nothing but its distance from what an orthographic camera sees makes a ground plane coarse: within the
// cylinder around the view its micropolygons are what they are for a small plane, outside as much larger as
// they are farther.
// Two units high, 4000 deep, and one pixel wide on the raster: in cells of 0.04 units 5 million of them, and
// a sixteenth of that when lengths along the line of sight count as much less. Edges rated by their longest
// piece and in powers of two may make it four times as many.
TEST(Grid, AWallThatLeadsAwayFromAnOrthographicCameraIsNotDicedWhole) {
  DiceScene scene(diceWorld("Format 100 100 1\nProjection \"orthographic\"\nScreenWindow -2 2 -2 2\n",
                            "Patch \"bilinear\" \"P\" [0 -1 1 0.04 -1 4000 0 1 1 0.04 1 4000]"));
  scene.forEachGrid([](NodeId, const GridRecord&) {});
  EXPECT_LT(scene.cache->statistics().micropolygonsDiced, uint64_t(4 * 50 * 100000 / 16));
}

TEST(Grid, AGroundPlaneUnderAnOrthographicCameraEnds) {
  const auto micropolygons = [](double size) {
    DiceScene scene(diceWorld(
        "Format 100 100 1\nProjection \"orthographic\"\nScreenWindow -2 2 -2 2\nShadingRate 4\n"
        "Rotate -60 1 0 0\nTranslate 0 -1 5\n",
        fmt::format("Patch \"bilinear\" \"P\" [-{0} 0 -{0} {0} 0 -{0} -{0} 0 {0} {0} 0 {0}]", size)));
    scene.forEachGrid([](NodeId, const GridRecord&) {});
    return double(scene.cache->statistics().micropolygonsDiced);
  };
  // The plane's area in micropolygons of 0.08 units, as it is seen at 60 degrees and rounded to powers of
  // two; then 2 pi R^2 (ln L - ln R) of them outside a radius of 3. Powers of two, and edges rated by their
  // nearest place, may make it eight times as many.
  EXPECT_GT(micropolygons(2), 4 * 4 * 0.86 / 1.42 / 0.0064);
  const double expected = 9 * 6.3 / 0.0064 * std::log(1e5 / 3);
  EXPECT_LT(micropolygons(1e5), 8 * expected);
}

TEST(Grid, BehindTheEyeIsDicedToo) {
  const auto grids = [](const std::string& turn) {
    DiceScene scene(
        diceWorld("Format 256 256 1 Projection \"perspective\" \"fov\" [40] " + turn + " Translate 0 0 3",
                  "Sphere 1 -1 1 360"));
    size_t n = 0;
    scene.forEachGrid([&](NodeId, const GridRecord& g) { n += size_t(g.nu) * g.nv; });
    return n;
  };
  EXPECT_LE(grids("Rotate 180 0 1 0"), grids(""));
  EXPECT_GE(grids("Rotate 180 0 1 0"), grids("") / 64);
  EXPECT_EQ(grids("Rotate 5 0 1 0"), grids(""));
}

}  // namespace
}  // namespace fr::cache
