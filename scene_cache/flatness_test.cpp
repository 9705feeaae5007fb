// GeometricApproximation "flatness": how far chords may lie from their curves, in pixels, however coarse the
// shading rate. On circles and spheres the distance is known: the radius less the distance of the chord's
// middle.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "scene_cache/dice_scene.h"

namespace fr::cache {
namespace {

constexpr double kPixel = 0.01;  // 240 pixels over 2.4 units

DiceScene diced(double flatness, const std::string& body) {
  const std::string approximation =
      flatness > 0 ? fmt::format("GeometricApproximation \"flatness\" {}\n", flatness) : "";
  return DiceScene(
      diceWorld("Format 240 240 1\nProjection \"orthographic\"\nScreenWindow -1.2 1.2 -1.2 1.2\n"
                "ShadingRate 4000\nTranslate 0 0 5\n",
                approximation + body));
}

/// Largest distance in pixels of the middles of edges, and of cells, from a sphere of radius 1.
struct Deviation {
  double edges = 0, cells = 0;
  size_t vertices = 0;
};
Deviation ofUnitSphere(DiceScene& scene) {
  Deviation d;
  scene.forEachGrid([&](NodeId, const GridRecord& g) {
    const GridView view = scene.cache->view(g);
    const DVec3 centre(scene.cache->skeleton().toCache(scene.cache->skeleton().objects()[0].transform, 0)[3]);
    const auto at = [&](uint32_t i, uint32_t j) {
      return DVec3(view.vertex(size_t(j) * g.rowStride + i)) - centre;
    };
    const auto pixels = [](const DVec3& middle) { return (1 - glm::length(middle)) / kPixel; };
    for (uint32_t j = 0; j <= g.nv; ++j) {
      for (uint32_t i = 0; i <= g.nu; ++i) {
        ++d.vertices;
        if (i < g.nu) d.edges = std::max(d.edges, pixels(0.5 * (at(i, j) + at(i + 1, j))));
        if (j < g.nv) d.edges = std::max(d.edges, pixels(0.5 * (at(i, j) + at(i, j + 1))));
        if (i < g.nu && j < g.nv)
          d.cells =
              std::max(d.cells, pixels(0.25 * (at(i, j) + at(i + 1, j) + at(i, j + 1) + at(i + 1, j + 1))));
      }
    }
  });
  return d;
}

TEST(Flatness, BoundsTheDeviationOfSurfaces) {
  const std::string sphere = "Rotate 30 1 1 0\nSphere 1 -1 1 360\n";
  DiceScene coarse = diced(0, sphere);
  EXPECT_GT(ofUnitSphere(coarse).edges, 1);
  size_t last = 0;
  for (const double flatness : {1.0, 0.25, 0.05}) {
    DiceScene scene = diced(flatness, sphere);
    const Deviation d = ofUnitSphere(scene);
    // The bound comes from eight second differences a curve: a circle's are 1 % short of its curvature.
    EXPECT_LE(d.edges, flatness * 1.02);
    EXPECT_LE(d.cells, 2 * flatness * 1.02);
    // Segments are powers of two, and the longest parallel decides for all: some of the bound is used.
    EXPECT_GE(d.edges, flatness / 8);
    EXPECT_GT(d.vertices, last);
    last = d.vertices;
  }
}

}  // namespace
}  // namespace fr::cache
