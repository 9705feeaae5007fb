#include "bench/memory/cost.h"

#include <embree3/rtcore.h>
#include <fmt/format.h>

#include <atomic>
#include <cstdlib>
#include <functional>
#include <memory>
#include <random>

#include "ri/reader.h"
#include "scene_cache/cache.h"
#include "scene_cache/scene_builder.h"
#include "tracer/ray_scene.h"

namespace fr::bench {
namespace {

std::string world(double shadingRate, const std::string& body) {
  return fmt::format(
      "Format 512 512 1\nShutter 0 1\nProjection \"perspective\" \"fov\" [40]\nShadingRate {}\nTranslate 0 0 "
      "4\nWorldBegin\n{}"
      "\nWorldEnd\n",
      shadingRate, body);
}

/// A ball of small triangles that no two of are alike.
std::string irregularMesh(int rows, bool quads) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> jitter(-0.3, 0.3);
  std::string counts, indices, points;
  const int columns = rows * 2;
  for (int j = 0; j <= rows; ++j)
    for (int i = 0; i < columns; ++i) {
      const bool pole = j == 0 || j == rows;
      const double theta = 3.14159265 * (j + (pole ? 0.0 : jitter(random))) / rows,
                   phi = 6.2831853 * (i + jitter(random)) / columns;
      points += fmt::format("{:.6f} {:.6f} {:.6f} ", std::sin(theta) * std::cos(phi),
                            std::sin(theta) * std::sin(phi), std::cos(theta));
    }
  for (int j = 0; j < rows; ++j)
    for (int i = 0; i < columns; ++i) {
      const int a = j * columns + i, b = j * columns + (i + 1) % columns, c = a + columns, d = b + columns;
      if (quads) {
        counts += "4 ";
        indices += fmt::format("{} {} {} {} ", a, b, d, c);
      } else {
        counts += "3 3 ";
        indices += fmt::format("{} {} {} {} {} {} ", a, b, c, b, d, c);
      }
    }
  return fmt::format("PointsPolygons [{}] [{}] \"P\" [{}]\n", counts, indices, points);
}

std::string manyCurves() {
  std::mt19937 random(2);
  std::uniform_real_distribution<float> at(-1, 1);
  std::string counts, points;
  for (int i = 0; i < 20000; ++i) {
    counts += "4 ";
    float p[3] = {at(random), at(random), at(random)};
    for (int k = 0; k < 4; ++k) {
      points += fmt::format("{:.5f} {:.5f} {:.5f} ", p[0], p[1], p[2]);
      for (float& x : p) x += 0.1f * at(random);
    }
  }
  return fmt::format("Curves \"cubic\" [{}] \"nonperiodic\" \"P\" [{}] \"constantwidth\" [0.004]\n", counts,
                     points);
}

std::string manyPoints() {
  std::mt19937 random(3);
  std::uniform_real_distribution<float> at(-1, 1);
  std::string points;
  for (int i = 0; i < 100000; ++i)
    points += fmt::format("{:.5f} {:.5f} {:.5f} ", at(random), at(random), at(random));
  return fmt::format("Points \"P\" [{}] \"constantwidth\" [0.01]\n", points);
}

/// Stands for a displacement shader.
class Outwards : public cache::Displacer {
 public:
  explicit Outwards(const cache::Skeleton& skeleton) : skeleton_(skeleton) {}
  bool displaces(cache::ObjectId id) const override {
    return skeleton_.attributes()[skeleton_.objects()[id].attributes].displacement != cache::kNone;
  }
  void displace(cache::NodeId, size_t n, const uint32_t*, const float*, const float*, int, int,
                float* const P[3], float* const N[3]) override {
    for (int c = 0; c < 3; ++c)
      for (size_t i = 0; i < n; ++i) P[c][i] += 0.05f * N[c][i];
  }

 private:
  const cache::Skeleton& skeleton_;
};

struct Diced {
  cache::Frame frame;
  std::unique_ptr<cache::SceneCache> cache;
  std::unique_ptr<Outwards> displacer;
  uint64_t faces = 0, grids = 0;
};

void visit(cache::SceneCache& c, cache::NodeId id,
           const std::function<void(cache::NodeId, const cache::GridRecord&)>& f) {
  const cache::ResolvedNode n = c.resolve(id);
  if (n.state == cache::NodeState::kSplit) {
    visit(c, n.children[0], f);
    visit(c, n.children[1], f);
  } else if (n.state == cache::NodeState::kGrid) {
    f(id, *n.grid);
  }
}

[[noreturn]] void stop(const Error& e) {
  report(e);
  std::exit(1);
}

Diced dice(const std::string& rib,
           const std::function<void(const cache::SceneCache&, const cache::GridRecord&)>& each = {}) {
  Diced d;
  {
    cache::SceneBuilder builder({},
                                [&d](cache::Frame&& f) {
                                  d.frame = std::move(f);
                                  return true;
                                },
                                {});
    ri::Reader reader(builder);
    if (auto r = reader.readBuffer(rib, "bench.rib"); !r) stop(r.error());
    builder.finish();
  }
  auto c = cache::SceneCache::create(d.frame.skeletonFd());
  if (!c) stop(c.error());
  d.cache = *std::move(c);
  d.displacer = std::make_unique<Outwards>(d.cache->skeleton());
  d.cache->setDisplacer(d.displacer.get());
  for (cache::NodeId root = 0; root < d.cache->skeleton().rootPatches().size(); ++root)
    visit(*d.cache, root, [&](cache::NodeId, const cache::GridRecord& g) {
      d.faces += g.kind == cache::GridKind::kMeshlet ? g.nv : uint64_t(g.nu) * g.nv;
      ++d.grids;
      if (each) each(*d.cache, g);
    });
  return d;
}

}  // namespace

std::vector<MemoryCase> memoryCases() {
  const std::string cube =
      "SubdivisionMesh \"catmull-clark\" [4 4 4 4 4 4] [0 1 3 2 2 3 5 4 4 5 7 6 6 7 1 0 1 7 5 3 6 0 2 4] "
      "[\"interpolateboundary\"] [0 0] [] [] \"P\" [-1 -1 1 1 -1 1 -1 1 1 1 1 1 -1 1 -1 1 1 -1 -1 -1 -1 1 -1 "
      "-1]\n";
  const std::string bicubic =
      "Patch \"bicubic\" \"P\" [-1 -1 0  -.3 -1 1  .3 -1 -1  1 -1 0  -1 -.3 1  -.3 -.3 0  .3 -.3 1  1 -.3 0  "
      "-1 .3 0 "
      "-.3 .3 1  .3 .3 0  1 .3 1  -1 1 0  -.3 1 0  .3 1 1  1 1 0]\n";
  const std::string nurbs =
      "NuPatch 4 4 [0 0 0 0 1 1 1 1] 0 1 4 4 [0 0 0 0 1 1 1 1] 0 1 \"P\" [-1 -1 0  -.3 -1 1  .3 -1 -1  1 -1 "
      "0  -1 -.3 1  "
      "-.3 -.3 0  .3 -.3 1  1 -.3 0  -1 .3 0  -.3 .3 1  .3 .3 0  1 .3 1  -1 1 0  -.3 1 0  .3 1 1  1 1 0]\n";
  const std::string moving =
      "MotionBegin [0 1]\nTranslate 0 0 0\nTranslate 0.3 0 0\nMotionEnd\nSphere 1 -1 1 360\n";
  std::string small;
  for (int i = 0; i < 20000; ++i)
    small += fmt::format("Patch \"bilinear\" \"P\" [{0} {1} 0  {2} {1} 0.002  {0} {3} 0.001  {2} {3} 0]\n",
                         (i % 141) * 0.0142 - 1, (i / 141) * 0.0142 - 1, (i % 141) * 0.0142 - 0.986,
                         (i / 141) * 0.0142 - 0.986);
  constexpr double kGrids = 40, kMeshes = 50;
  return {
      {"sphere", world(0.5, "Sphere 1 -1 1 360\n"), false, kGrids, kGrids},
      {"displaced sphere",
       world(0.5,
             "Displacement \"outwards\"\nAttribute \"displacementbound\" \"float sphere\" [0.05]\nSphere 1 "
             "-1 1 360\n"),
       false, kGrids, kGrids},
      {"torus", world(0.5, "Torus 1 0.3 0 360 360\n"), false, kGrids, kGrids},
      {"bilinear patch", world(0.1, "Patch \"bilinear\" \"P\" [-1 -1 0  1 -1 1  -1 1 1  1 1 0]\n"), false,
       kGrids, kGrids},
      {"bicubic patch", world(0.1, bicubic), false, kGrids, kGrids},
      {"NURBS", world(0.1, nurbs), false, kGrids, kGrids},
      {"subdivision", world(0.25, cube), false, kGrids, kGrids},
      {"moving sphere", world(0.5, moving), false, 0, 100},
      {"small patches", world(1, small), false, kGrids, 145},
      {"triangle mesh", world(1, irregularMesh(300, false)), true, kMeshes, 43},
      {"quad mesh", world(1, irregularMesh(300, true)), true, kMeshes, 43},
      {"curves", world(1, manyCurves()), true, kMeshes, kMeshes},
      {"points", world(1, manyPoints()), true, kMeshes, kMeshes},
  };
}

MemoryCost memoryCost(const std::string& rib, float patchMultiplier) {
  Diced d = dice(rib);
  tracer::RaySceneOptions options;
  options.patchMultiplier = patchMultiplier;
  options.cameraRays = true;
  options.quadCells = 0;  // the bytes of large scenes are asked for
  auto rays = tracer::RayScene::build(
      *d.cache, [](cache::ObjectId) { return true; }, options);
  if (!rays) stop(rays.error());
  const cache::CacheStatistics s = d.cache->statistics();
  const tracer::RaySceneStatistics t = (*rays)->statistics();
  MemoryCost c;
  const double n = double(std::max<uint64_t>(d.faces, 1));
  c.faces = d.faces;
  c.facesAGrid = n / double(std::max<uint64_t>(d.grids, 1));
  c.scene = double(d.cache->skeleton().header().totalBytes) / n;
  c.nodes = double(s.nodeBytes) / n;
  c.vertices = double(s.arenaBytes) / n;
  c.tree = double(t.embreeBytes) / n;
  c.records = double(t.recordBytes) / n;
  return c;
}

double embreeTriangles(const std::string& rib, bool compact) {
  std::vector<float> points;
  std::vector<uint32_t> indices;
  const Diced d = dice(rib, [&](const cache::SceneCache& c, const cache::GridRecord& g) {
    const cache::GridView v = c.view(g);
    const auto first = uint32_t(points.size() / 3);
    const auto add = [&](size_t i) {
      const Vec3 p = v.vertex(i);
      points.insert(points.end(), {p.x, p.y, p.z});
    };
    if (g.kind == cache::GridKind::kMeshlet) {
      for (size_t i = 0; i < g.nu; ++i) add(i);
      for (size_t i = 0; i < size_t(g.nv) * 3; ++i) indices.push_back(first + v.indices[i]);
      return;
    }
    for (size_t j = 0; j <= g.nv; ++j)
      for (size_t i = 0; i <= g.nu; ++i) add(j * g.rowStride + i);
    for (uint32_t j = 0; j < g.nv; ++j)
      for (uint32_t i = 0; i < g.nu; ++i) {
        const uint32_t a = first + j * (g.nu + 1u) + i, b = a + g.nu + 1u;
        indices.insert(indices.end(), {a, a + 1, b, a + 1, b + 1, b});
      }
  });
  static std::atomic<int64_t> bytes;
  bytes = 0;
  RTCDevice device = rtcNewDevice("threads=1");
  rtcSetDeviceMemoryMonitorFunction(
      device, [](void*, ssize_t n, bool) { return bytes += n, true; }, nullptr);
  RTCScene scene = rtcNewScene(device);
  if (compact) rtcSetSceneFlags(scene, RTC_SCENE_FLAG_COMPACT);
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
  auto* p = static_cast<float*>(
      rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, points.size() / 3));
  std::copy(points.begin(), points.end(), p);
  auto* t = static_cast<uint32_t*>(
      rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, indices.size() / 3));
  std::copy(indices.begin(), indices.end(), t);
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(scene, geometry);
  rtcReleaseGeometry(geometry);
  rtcCommitScene(scene);
  const double all = double(bytes.load());
  rtcReleaseScene(scene);
  rtcReleaseDevice(device);
  return all / double(std::max<uint64_t>(d.faces, 1));
}

}  // namespace fr::bench
