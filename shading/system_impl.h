// The inside of ShadingSystem, shared by the files that implement it and its tasks.
#pragma once

#include <atomic>
#include <map>
#include <mutex>

#include "shading/machine.h"
#include "shading/scene_host.h"
#include "shading/shader_library.h"
#include "shading/shading_system.h"

namespace fr {

/// Everything that shades points of one attribute state.
struct ShadeSetup {
  cache::AttributeId attributes = cache::kNone;
  std::shared_ptr<const ShaderInstance> surface, displacement, atmosphere, interior, exterior;
  std::vector<std::shared_ptr<const ShaderInstance>> lightOwners;
  std::vector<const ShaderInstance*> lights;
  /// Surface or displacement parameters that primitive variables of some object override.
  struct PrimvarParameter {
    std::string name;
    uint32_t parameter;
  };
  std::vector<PrimvarParameter> surfaceOverrides, displacementOverrides;
  bool colorPrimvar = false, opacityPrimvar = false;  // some object has "Cs", "Os"
  bool bumpOnly = false;       // the displacement shader changes N alone: it runs at shading time
  bool usesDerivatives = false;
  bool canAskRays = false;
  bool usesObjectSpace = false;
  bool displaced = false;      // the displacement shader moves points
  uint64_t readsGlobals = 0;   // of all programs that run when shading

  Machine::Partners partners() const {
    return {surface.get(), displacement.get(), atmosphere.get(), interior.get(), exterior.get()};
  }
};

struct ShadingSystem::Impl {
  Impl(cache::SceneCache& cache, Options options);

  cache::SceneCache& scene;
  Options options;
  SceneHost host;
  ShaderLibrary library;
  float prmanSpecular = 0;
  Mat4 cacheToCurrent;
  Mat3 cacheToCurrentNormal, currentToCacheNormal;
  Mat4 currentToCache;

  /// Loaded on first need; the pointer never changes once set. Thread-safe.
  const ShadeSetup& setup(cache::AttributeId attributes);
  std::shared_ptr<const ShaderInstance> instance(cache::ShaderId id, ShaderType type,
                                                 const std::vector<std::string>& varyingParameters);
  void addStatistics(MachineStatistics& s, uint64_t points);

  mutable std::mutex mutex;
  std::vector<std::atomic<const ShadeSetup*>> setups;
  std::vector<std::unique_ptr<ShadeSetup>> owned;
  std::map<std::pair<const ShaderProgram*, std::string>, std::shared_ptr<const Executable>> executables;
  std::map<std::pair<cache::ShaderId, std::string>, std::shared_ptr<const ShaderInstance>> instances;
  std::map<cache::AttributeId, std::vector<const cache::ObjectRecord*>> objectsOf;
  std::shared_ptr<const ShaderProgram> defaultSurface;
  std::shared_ptr<const ShaderInstance> imager;
  bool imagerLoaded = false;

  std::atomic<uint64_t> points{0}, lightPoints{0}, ops{0}, lanesActive{0}, lanesTotal{0};

  class Displacement;
  std::unique_ptr<cache::Displacer> displacement;

 private:
  std::unique_ptr<ShadeSetup> load(cache::AttributeId attributes);
  std::shared_ptr<const ShaderInstance> loadInstance(cache::ShaderId id, ShaderType type,
                                                     const std::vector<std::string>& varyingParameters);
  std::shared_ptr<const ShaderInstance> fallbackSurface();
  std::shared_ptr<const Executable> executable(const std::shared_ptr<const ShaderProgram>& program,
                                               const std::vector<std::string>& varying);
};

std::unique_ptr<cache::Displacer> makeDisplacer(ShadingSystem::Impl& system);

/// Fills a stencil for (nu+1) x (nv+1) points in rows, cells of du by dv: central differences inside, one-sided at
/// the borders (RISpec 16).
void gridStencil(DerivativeStencil& s, uint32_t nu, uint32_t nv, uint32_t lanes, float du, float dv);
/// For meshlets: the two other vertices of one triangle of each vertex; du = dv = 1.
void meshletStencil(DerivativeStencil& s, uint32_t vertices, uint32_t triangles, const uint8_t* indices, uint32_t lanes);
/// For hits shaded as three points: lane i, its neighbour in u at period + i, in v at 2 period + i.
void tripleStencil(DerivativeStencil& s, uint32_t period, const float* du, const float* dv);

}  // namespace fr
