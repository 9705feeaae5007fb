#include "tests/hiders/hider_pair.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <mutex>

#include "reyes/renderer.h"
#include "scene_cache/dice_scene.h"
#include "shading/shader_library.h"
#include "tracer/inproc_oracle.h"

namespace fr::test {
namespace {

/// A temporary folder of shader sources.
class ShaderFolder {
 public:
  explicit ShaderFolder(const std::map<std::string, std::string>& shaders) {
    std::string pattern = (std::filesystem::temp_directory_path() / "fr-hiders-XXXXXX").string();
    const char* made = ::mkdtemp(pattern.data());
    EXPECT_NE(made, nullptr);
    if (made) path_ = made;
    for (const auto& [name, text] : shaders) std::ofstream(path_ / (name + ".sl")) << text;
  }
  ~ShaderFolder() {
    std::error_code ignored;
    if (!path_.empty()) std::filesystem::remove_all(path_, ignored);
  }
  ShaderFolder(const ShaderFolder&) = delete;
  ShaderFolder& operator=(const ShaderFolder&) = delete;
  std::string path() const { return path_.string(); }

 private:
  std::filesystem::path path_;
};

/// Puts finished tiles where they belong.
class Collector {
 public:
  Collector(const cache::CameraRecord& camera, Channels& to) : to_(to) {
    to_.width = camera.resolution[0], to_.height = camera.resolution[1];
  }
  void operator()(const FilmTile& t) {
    to_.values.resize(t.channels.size(),
                      std::vector<float>(size_t(to_.width) * size_t(to_.height), std::nanf("")));
    size_t i = 0;
    for (int y = t.rect.y0; y < t.rect.y1; ++y)
      for (int x = t.rect.x0; x < t.rect.x1; ++x, ++i)
        for (size_t c = 0; c < t.channels.size(); ++c)
          to_.values[c][size_t(y) * size_t(to_.width) + size_t(x)] = t.channels[c][i];
  }

 private:
  Channels& to_;
};

}  // namespace

namespace {

ShadingSystem::Options shadingOptions(const ShaderFolder& folder, bool tracerSide) {
  ShadingSystem::Options o;
  o.shaderPath = {folder.path()};
  o.standardShaders = standardShaderFolder();
  o.tracerSide = tracerSide;
  return o;
}

/// Loads the scene, and calls render(cache, folder). Messages count as failures unless they are wanted.
template <class F>
void withScene(const std::string& rib, const std::map<std::string, std::string>& shaders,
               std::vector<Error>* wanted, F&& render) {
  const ShaderFolder folder(shaders);
  cache::DiceScene scene(rib);
  const auto tell = [wanted](const Error& e) {
    if (wanted)
      wanted->push_back(e);
    else
      ADD_FAILURE() << e.str();
  };
  for (const Error& e : scene.reports) tell(e);
  if (!scene.cache) return;
  std::mutex mutex;
  std::vector<Error> reports;
  setReportSink([&](const Error& e) {
    const std::lock_guard lock(mutex);
    reports.push_back(e);
  });
  render(*scene.cache, folder);
  scene.cache->setDisplacer(nullptr);
  setReportSink({});
  for (const Error& e : reports) tell(e);
}

}  // namespace

Channels renderByReyes(const std::string& rib, const std::map<std::string, std::string>& shaders,
                       const RenderOptions& options, std::vector<Error>* reports,
                       FrameStatistics* statistics) {
  Channels image;
  withScene(rib, shaders, reports, [&](cache::SceneCache& cache, const ShaderFolder& folder) {
    ShadingSystem shading(cache, shadingOptions(folder, false));
    shading.loadShaders(cache::kForReyes);
    cache.setDisplacer(&shading.displacer());
    ShadingSystem hitShading(cache, shadingOptions(folder, true));
    hitShading.loadShaders(cache::kForTracer);
    tracer::RayTracerOptions oracleOptions;
    oracleOptions.scene.patchMultiplier = 1;  // as the other hider traces
    tracer::InprocOracleService oracle(cache, hitShading, oracleOptions);
    Collector collect(cache.skeleton().camera(), image);
    RenderOptions o = options;
    o.writeDisplays = false;
    o.pixels = std::ref(collect);
    const auto done = renderFrame(cache, shading, &oracle, o);
    EXPECT_TRUE(done.ok() || reports) << done.error().str();
    if (done.ok() && statistics) *statistics = *done;
    if (!done.ok() && reports) reports->push_back(done.error());
  });
  return image;
}

Channels renderByRays(const std::string& rib, const std::map<std::string, std::string>& shaders,
                      const tracer::TraceRenderOptions& options, tracer::TraceRenderStatistics* statistics,
                      std::vector<Error>* reports) {
  Channels image;
  withScene(rib, shaders, reports, [&](cache::SceneCache& cache, const ShaderFolder& folder) {
    ShadingSystem shading(cache, shadingOptions(folder, false));
    shading.loadShaders(cache::kForTracer);
    cache.setDisplacer(&shading.displacer());
    Collector collect(cache.skeleton().camera(), image);
    tracer::TraceRenderOptions o = options;
    o.writeDisplays = false;
    o.pixels = std::ref(collect);
    const auto done = tracer::renderFrame(cache, shading, o);
    EXPECT_TRUE(done.ok() || reports) << done.error().str();
    if (done.ok() && statistics) *statistics = *done;
    if (!done.ok() && reports) reports->push_back(done.error());
  });
  return image;
}

HiderPair renderBoth(const std::string& rib, const std::map<std::string, std::string>& shaders,
                     std::vector<Error>* reports) {
  return {renderByReyes(rib, shaders, {}, reports), renderByRays(rib, shaders, {}, nullptr, reports)};
}

Difference compare(const HiderPair& pair, double depthTolerance) {
  Difference d;
  const Channels &a = pair.reyes, &b = pair.rays;
  EXPECT_EQ(a.values.size(), b.values.size());
  if (a.values.size() < 5 || b.values.size() < 5) {
    ADD_FAILURE() << "nothing was rendered";
    return d;
  }
  d.pixels = a.values[0].size();
  double squares = 0;
  const auto width = size_t(a.width);
  for (size_t i = 0; i < d.pixels; ++i) {
    for (size_t c = 0; c < 3; ++c) {
      EXPECT_TRUE(std::isfinite(a.at(c, i)) && std::isfinite(b.at(c, i)));
      squares += std::pow(double(a.at(c, i)) - double(b.at(c, i)), 2);
    }
    d.alphaSum[0] += double(a.at(3, i)), d.alphaSum[1] += double(b.at(3, i));
    const double za = double(a.at(4, i)), zb = double(b.at(4, i));
    const bool seenA = za < 1e30, seenB = zb < 1e30;
    d.covered += seenA;
    for (const size_t j : {i + 1, i + width})
      if (j < d.pixels) {
        const double zj = double(a.at(4, j));
        d.outline += (zj < 1e30) != seenA || (seenA && std::abs(zj - za) > 0.02 * za);
      }
    if (std::abs(a.at(3, i) - b.at(3, i)) > 1e-3f) {
      ++d.alpha;
    } else if (seenA && seenB) {
      const double off = std::abs(za - zb) / std::max(1e-6, std::abs(za));
      if (off > depthTolerance)
        ++d.depth;
      else
        d.worstDepth = std::max(d.worstDepth, off);
    } else {
      d.depth += seenA != seenB;
    }
  }
  d.colorRms = std::sqrt(squares / double(3 * d.pixels));
  return d;
}

}  // namespace fr::test
