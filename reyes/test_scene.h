// Tests only: a scene of given grids with given colours, in place of the scene cache's dicer and the shader
// machine.
//
// test_scene.cpp defines the members of cache::SceneCache and ShadingSystem that the hider calls, so a test
// that links it tests the hider alone, with exact geometry.
#pragma once

#include <deque>
#include <functional>
#include <memory>
#include <vector>

#include "reyes/renderer.h"
#include "scene_cache/skeleton_writer.h"

namespace fr::reyes {

struct TestSurface {
  bool opaque = true, matte = false, smooth = false, reverse = false;
  uint32_t sides = 2;
  Color opacity{1, 1, 1};
  std::function<Color(const Vec3&)> color = [](const Vec3&) { return Color(1, 1, 1); };
  int rayRounds = 0;  // how often a grid asks for rays; each answer's hit distance is added to green
};

struct TestGrid {
  int nu = 0, nv = 0;  // cells; 0, 0: a meshlet
  std::vector<Vec3> positions;
  std::vector<uint8_t> indices;
};

class TestScene {
 public:
  /// A camera at the origin that looks along z: orthographic, one unit a pixel, raster (x, y) at camera (x,
  /// -y), near 0.1, far 1000.
  TestScene(int width, int height);
  ~TestScene();

  cache::CameraRecord camera{};
  float pixelSamples[2] = {4, 4};
  std::string filter = "box", displayName, displayType = "openexr", displayMode = "rgba";
  float filterWidth[2] = {1, 1};
  bool jitter = true;

  /// fov degrees over the shorter side.
  void setPerspective(float fov);
  uint32_t addSurface(TestSurface s);
  /// A patch that splits into these grids.
  void addPatch(uint32_t surface, std::vector<TestGrid> grids);
  /// A bilinear patch diced into nu x nv cells: corners (0,0) (1,0) (0,1) (1,1).
  void addQuad(uint32_t surface, Vec3 p00, Vec3 p10, Vec3 p01, Vec3 p11, int nu = 1, int nv = 1);
  /// The same with its corners in raster pixels of the orthographic camera, at depth z.
  void addRasterRect(uint32_t surface, float x0, float y0, float x1, float y1, float z, int nu = 1,
                     int nv = 1);

  /// The image, RGBAZ, planes of the crop.
  struct Image {
    int width = 0, height = 0;
    std::vector<std::vector<float>> channels;
    FrameStatistics statistics;
    float at(int c, int x, int y) const { return channels[size_t(c)][size_t(y * width + x)]; }
    double mean(int c) const;
  };
  Image render(const RenderOptions& options = {}, RayOracleService* oracle = nullptr);
  /// Makes the cache; render() does so by itself.
  cache::SceneCache& cache();

  // For the fakes.
  struct Patch {
    uint32_t surface;
    std::vector<TestGrid> grids;
  };
  struct Node {
    cache::PatchNode node;
    std::vector<uint32_t> grids;  // one: a grid; more: splits
    cache::NodeId children[2] = {cache::kNone, cache::kNone};
    cache::GridRecord record;
    const TestGrid* grid = nullptr;
    uint32_t object = 0;
  };
  std::deque<TestSurface> surfaces;
  std::deque<Patch> patches;
  std::deque<Node> nodes;
  std::vector<float> flatPositions;
  std::atomic<int> resolved{0}, shaded{0};

 private:
  void makeNode(cache::NodeId id, uint32_t root, const std::vector<uint32_t>& grids, int depth, uint32_t iu);
  std::unique_ptr<cache::SceneCache> cache_;
};

}  // namespace fr::reyes
