#include "libri/world_renderer.h"

#include <algorithm>
#include <memory>
#include <thread>

#include "base/cores.h"
#include "reyes/renderer.h"
#include "scene_cache/cache.h"
#include "shading/shader_library.h"
#include "shading/shading_system.h"
#include "tools/shader_folders.h"
#include "tracer/inproc_oracle.h"

namespace fr::libri {

void renderWorld(cache::Frame&& frame) {
  Result<std::unique_ptr<cache::SceneCache>> opened = cache::SceneCache::create(frame.skeletonFd());
  if (!opened) return report(opened.error());
  cache::SceneCache& scene = **opened;

  ShadingSystem::Options shadingOptions;
  shadingOptions.shaderPath = tools::shaderFolders({}, scene.skeleton(), {});
  shadingOptions.standardShaders = standardShaderFolder();
  ShadingSystem shading(scene, shadingOptions);
  shading.loadShaders(cache::kForReyes);
  scene.setDisplacer(&shading.displacer());

  const int threads = availableCores();
  std::unique_ptr<ShadingSystem> hitShading;
  std::unique_ptr<tracer::InprocOracleService> oracle;
  scene.setMeetsRays(shading.canAskRays());
  if (shading.canAskRays()) {
    ShadingSystem::Options hitOptions = shadingOptions;
    hitOptions.tracerSide = true;
    hitShading = std::make_unique<ShadingSystem>(scene, hitOptions);
    hitShading->loadShaders(cache::kForTracer);
    tracer::RayTracerOptions options;
    options.scene.threads = threads;
    oracle = std::make_unique<tracer::InprocOracleService>(scene, *hitShading, options);
  }
  RenderOptions options;
  options.threads = threads;
  const Result<FrameStatistics> rendered = renderFrame(scene, shading, oracle.get(), options);
  scene.setDisplacer(nullptr);
  if (!rendered) report(rendered.error());
}

}  // namespace fr::libri
