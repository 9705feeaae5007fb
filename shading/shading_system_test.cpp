// Shading over a real scene cache: RIB text in, colours of grids and hits out.
#include "shading/shading_system.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>

#include "scene_cache/scene_loader.h"
#include "shading/native_run.h"

namespace fr {
namespace {

class Scene {
 public:
  Scene(const std::string& world, const std::map<std::string, std::string>& shaders = {},
        const std::string& options = "") {
    folder_ =
        std::filesystem::path(::testing::TempDir()) / fmt::format("shading_system.{}.{}", getpid(), count_++);
    std::filesystem::create_directories(folder_);
    for (const auto& [name, text] : shaders) std::ofstream(folder_ / (name + ".sl")) << text;
    const std::string rib = (folder_ / "scene.rib").string();
    std::ofstream(rib)
        << options << "Format 64 64 1\nProjection \"perspective\" \"fov\" [40]\nTranslate 0 0 5\nWorldBegin\n"
        << world << "\nWorldEnd\n";
    const cache::RibInput input{rib};
    int fd = -1;
    auto loaded = cache::loadScene({&input, 1}, {}, [&](cache::Frame&& f) {
      auto made = cache::SceneCache::create(f.skeletonFd());
      if (made) cache = std::move(*made);
      return true;
    });
    (void)fd;
    EXPECT_TRUE(loaded.ok());
    if (!cache) return;
    ShadingSystem::Options o;
    o.shaderPath = {folder_.string()};
    o.standardShaders = std::string(FR_SOURCE_DIR) + "/shaders";
    shading = std::make_unique<ShadingSystem>(*cache, o);
    cache->setDisplacer(&shading->displacer());
  }
  ~Scene() {
    std::error_code e;
    std::filesystem::remove_all(folder_, e);
  }
  void forEachGrid(const std::function<void(const cache::GridRecord&)>& f) {
    uint32_t roots = uint32_t(cache->skeleton().rootPatches().size());
    std::vector<cache::NodeId> todo;
    for (uint32_t i = 0; i < roots; ++i) todo.push_back(i);
    while (!todo.empty()) {
      const cache::ResolvedNode r = cache->resolve(todo.back());
      todo.pop_back();
      if (r.state == cache::NodeState::kSplit) todo.push_back(r.children[0]), todo.push_back(r.children[1]);
      if (r.state == cache::NodeState::kGrid) f(*r.grid);
    }
  }
  /// Shades a grid, answering rays with `answer`.
  void shade(ShadeTask& task, const ShadePoints& points, const std::function<void(RayQuery&)>& answer = {}) {
    auto q = std::make_unique<RayQuery>();
    task.begin(points);
    while (task.run() == ShadeTask::Status::kNeedsRays) {
      ++suspensions;
      task.writeRays(*q);
      if (answer) {
        answer(*q);
        task.readAnswers(*q);
      } else {
        task.missAll();
      }
    }
  }
  std::unique_ptr<cache::SceneCache> cache;
  std::unique_ptr<ShadingSystem> shading;
  int suspensions = 0;

 private:
  std::filesystem::path folder_;
  static inline int count_ = 0;
};

ShadePoints gridPoints(const cache::GridRecord& g) {
  ShadePoints p;
  p.topology =
      g.kind == cache::GridKind::kMeshlet ? ShadePoints::Topology::kMeshlet : ShadePoints::Topology::kGrid;
  p.grid = &g;
  p.gridSeed = g.node;
  return p;
}
Vec3 vertex(const Scene& s, const cache::GridRecord& g, size_t i) {
  const cache::GridView v = s.cache->view(g);
  const size_t at = g.kind == cache::GridKind::kMeshlet ? i : i / (g.nu + 1u) * g.rowStride + i % (g.nu + 1u);
  return {v.positions[3 * at], v.positions[3 * at + 1], v.positions[3 * at + 2]};
}
/// Where the vertices of a grid are on their primitive.
struct VertexParameters {
  VertexParameters(const Scene& s, const cache::GridRecord& g)
      : cell(s.cache->view(g).vertexCount()), u(cell.size()), v(cell.size()) {
    s.cache->vertexParameters(g, cell.data(), u.data(), v.data());
  }
  std::vector<uint32_t> cell;
  std::vector<float> u, v;
};

/// A vertex of a grid whose shader has run.
struct ShadedVertex {
  const ShadeTask& task;
  const cache::GridRecord& grid;
  size_t i;
  float u, v;
  float color(int c) const { return task.color(c)[i]; }
  float opacity(int c) const { return task.opacity(c)[i]; }
};
/// Loads a scene's shaders, shades all of its grids, and looks at each vertex.
void shadeAll(Scene& s, const std::function<void(const ShadedVertex&)>& look) {
  ASSERT_TRUE(s.cache);
  s.shading->loadShaders(cache::kForReyes);
  ShadeTask task(*s.shading);
  s.forEachGrid([&](const cache::GridRecord& g) {
    s.shade(task, gridPoints(g));
    const VertexParameters at(s, g);
    for (size_t i = 0; i < at.u.size(); ++i) look({task, g, i, at.u[i], at.v[i]});
  });
}

/// Matte sphere of radius 1 about `center` (camera space) under a point light of intensity 20.
double matteSphere(const Vec3& P, const Vec3& center, const Vec3& light) {
  const Vec3 N = glm::normalize(P - center), L = light - P;
  const Vec3 Nf = glm::dot(N, P) > 0 ? -N : N;
  return std::max(0.0, 20.0 * double(glm::dot(Nf, glm::normalize(L)) / glm::dot(L, L)));
}
const char* kLitSphere =
    "LightSource \"pointlight\" 1 \"intensity\" [20] \"from\" [2 3 -4]\nSurface \"matte\" \"Ka\" [0]\nSphere "
    "1 -1 1 360\n";

TEST(ShadingSystem, MatteSphereUnderAPointLight) {
  Scene s(kLitSphere);
  ASSERT_TRUE(s.cache);
  const Mat4 m(s.cache->skeleton().cacheToCamera(0));
  size_t points = 0;
  double worst = 0, sum = 0;
  shadeAll(s, [&](const ShadedVertex& x) {
    ++points;
    const Vec3 P = transformPoint(m, vertex(s, x.grid, x.i));
    // Where the light grazes, or N turns to face the eye, rounding decides.
    if (std::fabs(glm::dot(glm::normalize(P), P - Vec3(0, 0, 5))) < 1e-3f) return;
    const double error = std::fabs(x.color(0) - matteSphere(P, {0, 0, 5}, {2, 3, 1}));
    worst = std::max(worst, error), sum += error;
    ASSERT_EQ(x.opacity(1), 1);
  });
  EXPECT_FALSE(s.shading->canAskRays());
  EXPECT_GT(points, 200u);
  // Border vertices that were moved onto their neighbours keep the normal of their own address.
  EXPECT_LT(worst, 5e-3);
  EXPECT_LT(sum / double(points), 2e-4);
  EXPECT_GE(s.shading->statistics().pointsShaded, points);
}

TEST(ShadingSystem, ManyInstancesOfFewShadersAreCompiledOnce) {
  constexpr int kShaders = 20, kInstances = 1000;
  std::map<std::string, std::string> shaders;
  for (int k = 0; k < kShaders; ++k)
    shaders[fmt::format("many{}", k)] = fmt::format(
        "surface many{0}(float gain = 1; color tint = 1;) {{ normal Nf = faceforward(normalize(N), I);"
        " Ci = tint * gain * diffuse(Nf) + {0}; Oi = 1; }}",
        k);
  std::string world =
      "Attribute \"dice\" \"int binary\" [0]\nShadingRate 64\nLightSource \"pointlight\" 1 \"intensity\" "
      "[20] \"from\" "
      "[2 3 -4]\nLightSource \"distantlight\" 2 \"intensity\" [.1]\n";
  for (int k = 0; k < kInstances; ++k)
    world += fmt::format(
        "AttributeBegin Surface \"many{}\" \"gain\" [{}] \"tint\" [{} .5 1] Translate {} {} 0 Polygon \"P\" "
        "[0 0 0  0 .1 0  "
        ".1 .1 0  .1 0 0] AttributeEnd\n",
        k % kShaders, .001 * k, .0005 * k, .04 * (k % 32) - .6, .04 * (k / 32) - .6);
  Scene s(world, shaders);
  ASSERT_TRUE(s.cache);
  s.shading->loadShaders(cache::kForReyes);
  ShadeTask task(*s.shading);
  int grids = 0;
  s.forEachGrid([&](const cache::GridRecord& g) {
    s.shade(task, gridPoints(g));
    ++grids;
  });
  EXPECT_GE(grids, kInstances);
  const ShadingStatistics n = s.shading->statistics();
  EXPECT_EQ(n.shadersLoaded, uint64_t(kShaders + 2));
  EXPECT_EQ(n.programs, uint64_t(kShaders + 2));
  EXPECT_EQ(n.machineCodes, nativeCodeAvailable() ? uint64_t(kShaders + 2) : 0u);
}

TEST(ShadingSystem, LightsWithShadowsAskAndStartOnTheSurface) {
  Scene s(std::string("Attribute \"light\" \"string shadows\" [\"on\"]\n") + kLitSphere);
  s.shading->loadShaders(cache::kForReyes);
  EXPECT_TRUE(s.shading->canAskRays());
  Scene plain(kLitSphere);
  plain.shading->loadShaders(cache::kForReyes);
  ShadeTask task(*s.shading), reference(*plain.shading);
  const Mat4 toCamera(s.cache->skeleton().cacheToCamera(0));
  size_t rays = 0;
  s.forEachGrid([&](const cache::GridRecord& g) {
    std::vector<float> unshadowed;
    s.shade(task, gridPoints(g));
    for (size_t i = 0; i < s.cache->view(g).vertexCount(); ++i) unshadowed.push_back(task.color(0)[i]);
    s.shade(task, gridPoints(g), [&](RayQuery& q) {
      EXPECT_EQ(q.kind, RayKind::kVisibility);
      EXPECT_EQ(q.level, 1u);
      for (uint32_t k = 0; k < q.count; ++k) {
        EXPECT_EQ(q.node[k], g.node);
        const Vec3 n(q.normal[0][k], q.normal[1][k], q.normal[2][k]);
        EXPECT_NEAR(glm::length(n), 1, 1e-5);
        const Vec3 from(q.origin[0][k], q.origin[1][k], q.origin[2][k]),
            d(q.direction[0][k], q.direction[1][k], q.direction[2][k]);
        const Vec3 end = transformPoint(toCamera, from + d);
        EXPECT_NEAR(glm::length(end - Vec3(2, 3, 1)), 0, 1e-4);
        EXPECT_GT(q.radius[k], 0);
        for (auto& c : q.color) c[k] = 0.5f;
      }
      rays += q.count;
    });
    for (size_t i = 0; i < unshadowed.size(); ++i) ASSERT_NEAR(task.color(0)[i], 0.5f * unshadowed[i], 1e-5);
  });
  EXPECT_GT(rays, 50u);
}

TEST(ShadingSystem, BadAnswersAreMisses) {
  Scene s("Surface \"ask\"\nSphere 1 -1 1 360\n",
          {{"ask",
            "surface ask() { point Ph = 0; vector Nh = 0; Ci = trace(P, N) + color(rayhittest(P, N, Ph, Nh) "
            "> 1e10 ? 1 : 0); Oi = 1; }"}});
  s.shading->loadShaders(cache::kForReyes);
  EXPECT_TRUE(s.shading->canAskRays());
  ShadeTask task(*s.shading);
  s.forEachGrid([&](const cache::GridRecord& g) {
    s.shade(task, gridPoints(g), [](RayQuery& q) {
      for (uint32_t k = 0; k < q.count; ++k) {
        for (auto& c : q.color) c[k] = NAN;
        q.hitDistance[k] = k % 2 ? NAN : -5;
        for (auto& c : q.hitP) c[k] = INFINITY;
      }
    });
    for (size_t i = 0; i < s.cache->view(g).vertexCount(); ++i) ASSERT_EQ(task.color(2)[i], 1);
  });
}

TEST(ShadingSystem, HitsAgreeWithGrids) {
  Scene s(
      "LightSource \"pointlight\" 1 \"intensity\" [20] \"from\" [2 3 -4]\nSurface \"curved\"\nSphere 1 -1 1 "
      "360\n",
      {{"curved",
        "surface curved() { normal Nf = normalize(N); Ci = diffuse(Nf) + color(length(Du(s) * dPdu), s, t); "
        "Oi = 1; }"}});
  s.shading->loadShaders(cache::kForReyes);
  ShadeTask grids(*s.shading), hits(*s.shading);
  const DMat4 cameraToCache = glm::inverse(s.cache->skeleton().cacheToCamera(0));
  const Vec3 eye(cameraToCache[3]);
  s.forEachGrid([&](const cache::GridRecord& g) {
    s.shade(grids, gridPoints(g));
    const VertexParameters at(s, g);
    const size_t n = at.u.size();
    std::vector<float> radius(n, 1e-3f), one(n, 1), direction[3];
    std::vector<cache::NodeId> node(n, g.node);
    for (int c = 0; c < 3; ++c)
      for (size_t i = 0; i < n; ++i) direction[c].push_back(vertex(s, g, i)[c] - eye[c]);
    ShadePoints p;
    p.topology = ShadePoints::Topology::kHits;
    p.count = n;
    p.node = node.data(), p.cell = at.cell.data(), p.u = at.u.data(), p.v = at.v.data();
    for (int c = 0; c < 3; ++c) p.direction[c] = direction[c].data();
    p.distance = one.data(), p.radius = radius.data();
    s.shade(hits, p);
    for (size_t i = 0; i < n; ++i) {
      EXPECT_NEAR(hits.color(1)[i], grids.color(1)[i], 2e-4) << i;
      EXPECT_NEAR(hits.color(2)[i], grids.color(2)[i], 2e-4) << i;
      EXPECT_NEAR(hits.color(0)[i], grids.color(0)[i], 2e-2 * (1 + grids.color(0)[i])) << i;
    }
  });
}

TEST(ShadingSystem, PrimitiveVariablesOverrideParameters) {
  Scene s(
      "Color [1 0.5 0.25]\nSurface \"show\" \"uniform float gain\" [3]\n"
      "Patch \"bilinear\" \"P\" [-1 -1 0  1 -1 0  -1 1 0  1 1 0] \"varying float gain\" [0 1 0 1]\n"
      "Patch \"bilinear\" \"P\" [-1 -1 1  1 -1 1  -1 1 1  1 1 1] \"varying color Cs\" [0 0 0  0 0 0  1 1 1  "
      "1 1 1]\n",
      {{"show", "surface show(float gain = 1) { Ci = Cs * gain; Oi = Os; }"}});
  shadeAll(s, [&](const ShadedVertex& x) {
    const bool first = &s.cache->objectOf(x.grid.node) == &s.cache->skeleton().objects()[0];
    ASSERT_NEAR(x.color(1), first ? 0.5f * x.u : 3 * x.v, 1e-4);
    ASSERT_NEAR(x.task.output("gain", 0)[x.i], first ? x.u : 3, 1e-4);
  });
  EXPECT_TRUE(s.shading->isOpaque(s.cache->skeleton().objects()[0].attributes));
}

TEST(ShadingSystem, DisplacementMovesGridsAndTheirNormals) {
  Scene s(
      "Attribute \"displacementbound\" \"sphere\" [0.2]\nDisplacement \"grow\" \"uniform float by\" "
      "[0.1]\nSurface \"matte\"\nSphere 1 -1 1 360\n",
      {{"grow", "displacement grow(float by = 0) { P += by * normalize(N); N = calculatenormal(P); }"}});
  const Mat4 m(s.cache->skeleton().cacheToCamera(0));
  size_t checked = 0;
  shadeAll(s, [&](const ShadedVertex& x) {
    const Vec3 P = transformPoint(m, vertex(s, x.grid, x.i)) - Vec3(0, 0, 5);
    EXPECT_NEAR(glm::length(P), 1.1, 1e-3);
    if (std::fabs(P.z) >= 0.9f) return;  // the poles
    Vec3 N;
    for (int c = 0; c < 3; ++c) N[c] = x.task.output("N", c)[x.i];
    EXPECT_GT(std::fabs(glm::dot(glm::normalize(N), glm::normalize(P))), 0.97);
    ++checked;
  });
  EXPECT_GT(checked, 50u);
}

// Surfaces of the first years displace; where a bound is given, the geometry is moved, and the shader sees
// its points moved once, not twice.
TEST(ShadingSystem, ASurfaceShaderDisplacesWhereThereIsABound) {
  const std::map<std::string, std::string> shaders = {
      {"swell",
       "surface swell(float by = .1) { P += by * normalize(N); N = calculatenormal(P);"
       " Ci = length(transform(\"object\", P)); Oi = 1; }"}};
  for (const bool bound : {true, false}) {
    Scene s(std::string(bound ? "Attribute \"displacementbound\" \"sphere\" [0.2]\n" : "") +
                "Surface \"swell\" Sphere 1 -1 1 360\n",
            shaders);
    const Mat4 m(s.cache->skeleton().cacheToCamera(0));
    shadeAll(s, [&](const ShadedVertex& x) {
      const Vec3 P = transformPoint(m, vertex(s, x.grid, x.i)) - Vec3(0, 0, 5);
      EXPECT_NEAR(glm::length(P), bound ? 1.1 : 1, 1e-3);
      EXPECT_NEAR(x.color(0), 1.1, 1e-3);
    });
  }
}

/// What is reported while it lives.
class Reports {
 public:
  Reports() {
    setReportSink([this](const Error& e) { all.push_back(e); });
  }
  ~Reports() { setReportSink({}); }
  std::vector<Error> all;
};

TEST(ShadingSystem, MissingShadersAreReplacedAndReported) {
  const Reports reports;
  Scene s(
      "LightSource \"nolight\" 1\nSurface \"nosuchsurface\"\nDisplacement \"nodisplacement\"\nSphere 1 -1 1 "
      "360\n");
  shadeAll(s, [&](const ShadedVertex& x) { ASSERT_GT(x.color(0), 0.1); });
  EXPECT_GE(reports.all.size(), 2u);
}

TEST(ShadingSystem, AShaderThatCannotBeCompiledSaysWhyOnce) {
  const Reports reports;
  Scene s("Surface \"broken\" Sphere 1 -1 1 360\nSurface \"broken\" \"Kd\" [2] Sphere 1 -1 1 360\n",
          {{"broken", "surface broken(float Kd = 1) { Ci = nosuchvariable; }"}});
  shadeAll(s, [&](const ShadedVertex& x) { ASSERT_GT(x.color(0), 0.1) << "the default surface"; });
  int reasons = 0, consequences = 0;
  for (const Error& e : reports.all) {
    reasons += e.message.find("nosuchvariable") != std::string::npos;
    consequences += e.message.find("cannot be compiled") != std::string::npos;
  }
  EXPECT_EQ(reasons, 1);
  EXPECT_EQ(consequences, 1);
}

TEST(ShadingSystem, ImagerChangesPixels) {
  Scene plain("Sphere 1 -1 1 360\n");
  float x[3] = {0, 1, 2}, c[3] = {1, 0.5f, 0.25f}, a[3] = {1, 1, 0};
  float* color[3] = {c, c, c};
  EXPECT_FALSE(plain.shading->runImager(3, x, x, color, nullptr, a));
}

TEST(ShadingSystem, AtmosphereFollowsTheSurface) {
  Scene s("Atmosphere \"dim\" \"uniform float by\" [0.25]\nSurface \"white\"\nSphere 1 -1 1 360\n",
          {{"white", "surface white() { Ci = 1; Oi = 1; }"},
           {"dim", "volume dim(float by = 1) { Ci = by * Ci * length(I) / length(P); Oi = Oi; }"}});
  shadeAll(s, [&](const ShadedVertex& x) { ASSERT_NEAR(x.color(0), 0.25, 1e-5); });
}

TEST(ShadingSystem, BumpMappingChangesNormalsAlone) {
  Scene s(
      "Displacement \"tilt\"\nSurface \"normals\"\nPatch \"bilinear\" \"P\" [-1 -1 0  1 -1 0  -1 1 0  1 1 "
      "0]\n",
      {{"tilt", "displacement tilt() { N = normalize(calculatenormal(P + vector(0, 0, 0.5 * u))); }"},
       {"normals", "surface normals() { Ci = color(N); Oi = 1; }"}});
  // z rises by 0.5 over a width of 2: the slope of N is a quarter.
  shadeAll(s, [&](const ShadedVertex& x) { ASSERT_NEAR(x.color(0) / x.color(2), -0.25, 1e-4); });
}

TEST(ShadingSystem, AParameterThatTheShaderDoesNotHaveIsSaidOnceWithItsPlace) {
  const Reports reports;
  Scene s(
      "Surface \"spot\" \"float Kd\" [0.5] \"float Kdd\" [0.5] \"float __handle\" [1]\nSphere 1 -1 1 360\n"
      "Surface \"spot\" \"float Kdd\" [0.7]\nSphere 1 -1 1 360\n",
      {{"spot", "surface spot(float Kd = 1) { Ci = Kd; Oi = 1; }"}});
  s.shading->loadShaders(cache::kForReyes);
  ASSERT_EQ(reports.all.size(), 1u);
  EXPECT_EQ(reports.all[0].severity, Severity::kWarning);
  EXPECT_NE(reports.all[0].message.find("\"Kdd\""), std::string::npos);
  EXPECT_GT(reports.all[0].where.line, 0);
}

TEST(ShadingSystem, AVariableOfAnotherTypeThanTheParameterIsSaidOnceWithItsPlace) {
  const Reports reports;
  const std::string patch = "Patch \"bilinear\" \"P\" [-1 -1 0  1 -1 0  -1 1 0  1 1 0] ";
  Scene s("Surface \"tinted\"\n" + patch + "\"constant color tint\" [1 0 0]\n" + patch +
              "\"constant float tint\" [0.5]\n" + patch + "\"constant float tint\" [0.25]\n",
          {{"tinted", "surface tinted(color tint = 1) { Ci = tint; Oi = 1; }"}});
  s.shading->loadShaders(cache::kForReyes);
  ASSERT_EQ(reports.all.size(), 1u);
  EXPECT_EQ(reports.all[0].severity, Severity::kWarning);
  EXPECT_NE(reports.all[0].message.find("\"tint\""), std::string::npos);
  EXPECT_NE(reports.all[0].message.find("\"tinted\""), std::string::npos);
  EXPECT_GT(reports.all[0].where.line, 0);
}

TEST(ShadingSystem, ADeformationMovesTheSurfaceAndItsNormal) {
  Scene s(
      "Attribute \"displacementbound\" \"sphere\" [1]\nDeformation \"shear\" \"float by\" 0.5\nSurface "
      "\"tells\"\n"
      "Patch \"bilinear\" \"P\" [-1 -1 0  1 -1 0  -1 1 0  1 1 0]\n",
      {{"shear",
        "transformation shear(float by = 9) { P += by * vector(0, 0, xcomp(transform(\"object\", P))); }"},
       {"tells", "surface tells() { Ci = color(normalize(N)); Oi = zcomp(transform(\"object\", P)); }"}});
  shadeAll(s, [&](const ShadedVertex& x) {
    ASSERT_NEAR(x.color(0) / x.color(2), -0.5, 1e-3);
    ASSERT_NEAR(x.opacity(0), 0.5 * (2 * x.u - 1), 1e-3);
  });
}

TEST(ShadingSystem, SurfacesReadWhatTheDisplacementComputed) {
  // The height depends on the undisplaced point, which the surface itself no longer sees.
  for (const bool moves : {true, false}) {
    Scene s(
        "Attribute \"displacementbound\" \"sphere\" [1]\nDisplacement \"lift\"\nSurface \"tells\"\n"
        "Patch \"bilinear\" \"P\" [-1 -1 0  1 -1 0  -1 1 0  1 1 0] \"varying float gain\" [1 1 2 2]\n",
        {{"lift", std::string("displacement lift(float gain = 9; output varying float height = -1) {"
                              " height = gain * (1 + xcomp(transform(\"object\", P)));") +
                      (moves ? " P += vector(0.25 * height, 0, 0); }" : " N = N; }")},
         {"tells",
          "surface tells() { float h = 7; float found = displacement(\"height\", h);"
          " Ci = color(h, found, u); Oi = 1; }"}});
    shadeAll(s, [&](const ShadedVertex& x) {
      ASSERT_NEAR(x.color(0), (1 + x.v) * 2 * x.u, 1e-4) << moves;
      ASSERT_EQ(x.color(1), 1);
    });
  }
}

TEST(ShadingSystem, VariablesByName) {
  Scene s(
      "Surface \"asks\" Patch \"bilinear\" \"P\" [-1 -1 0  1 -1 0  -1 1 0  1 1 0]\n"
      "\"varying float heat\" [0 1 0 1] \"constant vector aim\" [1 2 3]\n",
      {{"asks",
        "surface asks(output varying color aov = 0; output float other = 0) {\n"
        "  float h = 5, none = 4; vector a = 0; point p = 0; color c = 0;\n"
        "  float found = getvar(\"heat\", h) + getvar(null, \"aim\", a) + getvar(\"P\", p);\n"
        "  found += getvar(\"nowhere\", none) + getvar(\"heat\", c) + (none == 4 ? 0 : 100);\n"
        "  found += (p == P ? 0 : 100) + 10 * length(a);\n"
        "  Ci = color(h, found, isoutput(aov) + 2 * isoutput(\"other\") + 4 * isoutput(\"z\") + 8 * "
        "isoutput(Ci));\n"
        "  Oi = 1;\n}\n"}},
      "Display \"a.exr\" \"file\" \"rgba,varying color aov\"\nDisplay \"+b.exr\" \"file\" \"z\"\n");
  shadeAll(s, [&](const ShadedVertex& x) {
    ASSERT_NEAR(x.color(0), x.u, 1e-5);
    ASSERT_NEAR(x.color(1), 3 + 10 * std::sqrt(14.0), 1e-3);
    ASSERT_EQ(x.color(2), 1 + 4 + 8);
  });
}

TEST(ShadingSystem, DenseMeshesShadeAsMeshlets) {
  // A wavy sheet of small triangles.
  constexpr int n = 40;
  std::string points, counts, indices;
  for (int y = 0; y <= n; ++y)
    for (int x = 0; x <= n; ++x)
      points += fmt::format("{} {} {} ", 2.0 * x / n - 1, 2.0 * y / n - 1, 0.1 * std::sin(6.0 * x / n));
  for (int y = 0; y < n; ++y)
    for (int x = 0; x < n; ++x) {
      const int a = y * (n + 1) + x, b = a + 1, c = a + n + 1, d = c + 1;
      counts += "3 3 ";
      indices += fmt::format("{} {} {} {} {} {} ", a, b, d, a, d, c);
    }
  Scene s(
      "Surface \"slopes\"\nPointsPolygons [" + counts + "] [" + indices + "] \"P\" [" + points + "]\n",
      {{"slopes",
        "surface slopes() { Ci = color(length(normalize(N)), length(Du(P) - dPdu), area(P)); Oi = 1; }"}});
  size_t vertices = 0;
  shadeAll(s, [&](const ShadedVertex& x) {
    if (x.grid.kind != cache::GridKind::kMeshlet) return;
    ++vertices;
    ASSERT_NEAR(x.color(0), 1, 1e-5);
    ASSERT_NEAR(x.color(1), 0, 1e-5);
    ASSERT_GT(x.color(2), 0);
  });
  EXPECT_GT(vertices, 100u);
}

/// Ci of the first vertex of the first grid.
Color firstColor(Scene& s) {
  Color c(-1);
  bool done = false;
  shadeAll(s, [&](const ShadedVertex& x) {
    for (int k = 0; !done && k < 3; ++k) c[k] = x.color(k);
    done = true;
  });
  return c;
}

TEST(ShadingSystem, OptionsAndAttributesByName) {
  const std::string asks =
      "surface asks() {\n"
      "  float f = 0, xyz[3], pair[2]; string t = \"\"; color c = 0; matrix m = 0; float found = 0, right "
      "= 0;\n"
      "  found += attribute(\"Sides\", f); right += f == 1;\n"
      "  found += attribute(\"Ri:ShadingRate\", f); right += f == 4;\n"
      "  found += attribute(\"Ri:Color\", c); right += c == color(1, 0.5, 0.25);\n"
      "  found += attribute(\"identifier:name\", t); right += t == \"ball\";\n"
      "  found += attribute(\"user:mine\", f); right += f == 7;\n"
      "  found += attribute(\"grouping:membership\", t); right += t == \"a,b\";\n"
      "  found += attribute(\"Ri:Orientation\", t); right += t != \"\";\n"
      "  found += attribute(\"GeometricApproximation:motionfactor\", f); right += f == 1;\n"
      "  found += attribute(\"Ri:Transformation\", m); right += comp(m, 3, 2) == 5;\n"
      "  found += option(\"Format\", xyz); right += xyz[0] == 64;\n"
      "  found += option(\"Ri:PixelSamples\", pair); right += pair[0] == 2;\n"
      "  found += option(\"user:yours\", f); right += f == 9;\n"
      "  found += rendererinfo(\"renderer\", t); right += t == \"frankenrender\";\n"
      "  float none = attribute(\"user:absent\", f) + option(\"absent\", f) + rendererinfo(\"absent\", f);\n"
      "  none += attribute(\"identifier:name\", f);  /* a text is no number */\n"
      "  Ci = color(found, right, none + (f == 9 ? 0 : 100)); Oi = 1;\n"
      "}\n";
  Scene s(
      "Sides 1 ShadingRate 4 Color [1 0.5 0.25] Attribute \"identifier\" \"string name\" [\"ball\"]\n"
      "Attribute \"user\" \"float mine\" [7] Attribute \"grouping\" \"string membership\" [\"a\"]\n"
      "Attribute \"grouping\" \"string membership\" [\"+b\"]\n"
      "Surface \"asks\" Sphere 1 -1 1 360\n",
      {{"asks", asks}}, "Option \"user\" \"float yours\" [9]\n");
  const Color c = firstColor(s);
  EXPECT_EQ(c.x, 13);
  EXPECT_EQ(c.y, 13);
  EXPECT_EQ(c.z, 0);
}

TEST(ShadingSystem, SpecularExponentIsSelectable) {
  const std::string shiny =
      "surface shiny() { Ci = specularbrdf(normalize(vector(0.3, 0, 1)), normal(0, 0, 1), vector(0, 0, 1), "
      "0.5); Oi = 1; }\n";
  const auto value = [&](const std::string& option) {
    Scene s("Surface \"shiny\" Sphere 1 -1 1 360\n", {{"shiny", shiny}}, option);
    return double(firstColor(s).x);
  };
  const double theta = std::atan(0.3) / 2;
  EXPECT_NEAR(value(""), std::pow(std::cos(theta), 2), 1e-5);
  EXPECT_NEAR(value("Option \"render\" \"int prmanspecular\" [1]\n"), std::pow(std::cos(theta), 16), 1e-5);
}

TEST(ShadingSystem, VolumesReadWhatTheSurfaceComputed) {
  Scene s(
      "Surface \"tells\" Atmosphere \"reads\" Sphere 1 -1 1 360\n",
      {{"tells", "surface tells(output float told = 1) { told = 0.25; Ci = 1; Oi = 1; }\n"},
       {"reads", "volume reads() { float x = 0; if (surface(\"told\", x) == 1) Ci = x * length(I); }\n"}});
  const Color c = firstColor(s);
  EXPECT_GT(c.x, 0.99f);
  EXPECT_LT(c.x, 1.51f);
}

}  // namespace
}  // namespace fr
