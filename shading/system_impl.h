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
  std::shared_ptr<const ShaderInstance> surface, displacement, deformation, atmosphere, interior, exterior;
  std::vector<std::shared_ptr<const ShaderInstance>> lightOwners;
  std::vector<const ShaderInstance*> lights;
  /// Surface or displacement parameters that primitive variables of some object override.
  struct PrimvarParameter {
    std::string name;
    uint32_t parameter;
  };
  std::vector<PrimvarParameter> surfaceOverrides, displacementOverrides;
  bool colorPrimvar = false, opacityPrimvar = false;  // some object has "Cs", "Os"
  bool bumpOnly = false;  // the displacement shader changes N alone: it runs at shading time
  bool usesDerivatives = false;
  bool canAskRays = false;
  bool usesObjectSpace = false;
  bool displaced = false;                                // a displacement or deformation shader moves points
  bool surfaceDisplaces = false;                         // the displacement shader is the surface shader
  bool displacementIsAsked = false;                      // a surface or light wants a value that it computes
  uint64_t readsGlobals = 0;                             // of all programs that run when shading
  uint32_t maxDiffuseDepth = 1, maxSpecularDepth = ~0u;  // Attribute "trace"

  Machine::Partners partners() const {
    return {surface.get(), surfaceDisplaces ? nullptr : displacement.get(), atmosphere.get(), interior.get(),
            exterior.get()};
  }
};

struct ShadingSystem::Impl {
  Impl(cache::SceneCache& cache, Options options);

  cache::SceneCache& scene;
  Options options;
  ShadeopUser shadeops;  // first in, last out
  SceneHost host;
  ShaderLibrary library;
  float prmanSpecular = 0;
  float specularThreshold = 0;  // radians
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
  void reportOtherType(const cache::ObjectRecord& object, const std::string& variable,
                       const std::string& shader) const;
  void reportUnknownParameter(const std::string& shader, const std::string& parameter,
                              const cache::ShaderRecord& record) const;
  std::shared_ptr<const ShaderInstance> loadInstance(cache::ShaderId id, ShaderType type,
                                                     const std::vector<std::string>& varyingParameters);
  std::shared_ptr<const ShaderInstance> fallbackSurface();
  std::shared_ptr<const Executable> executable(const std::shared_ptr<const ShaderProgram>& program,
                                               const std::vector<std::string>& varying);
};

std::unique_ptr<cache::Displacer> makeDisplacer(ShadingSystem::Impl& system);

}  // namespace fr
