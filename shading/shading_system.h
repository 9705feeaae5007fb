// Running shaders over batches of points, from the two renderers' side.
//
// A ShadingSystem belongs to one process and one scene cache: it loads the shaders that live objects use,
// specialises instances, and knows the coordinate systems. A ShadeTask runs the surface shader (with its
// lights) of one batch of points; run() returns early whenever the shader asks for rays, and goes on where it
// stopped once they are answered:
//
//   task.begin(points);
//   while (task.run() == ShadeTask::Status::kNeedsRays) {
//     task.writeRays(query);      // fill a block of the oracle
//     oracle answers
//     task.readAnswers(query);
//   }
//   use task.color(c), task.opacity(c)
//
// "current" space is camera space at shutter open, for both renderers.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "base/error.h"
#include "oracle/ray_query.h"
#include "scene_cache/cache.h"

namespace fr {

inline constexpr size_t kMaxShadePoints = 1024;

/// Points to shade, all on objects with the same surface shader instance and attribute state; a grid, a
/// meshlet or ray hits. kVolume: the ends of rays in a volume where no surface is.
/// Arrays belong to the caller and stay valid until the task is done.
struct ShadePoints {
  enum class Topology { kGrid, kMeshlet, kHits, kVolume };
  /// Which volume shader changes the colours on their way to where the ray came from.
  enum class Volume {
    kAtmosphere,  // of the points' own attributes, over the whole ray
    kInterior,    // of volumeAttributes, over the ray from segmentStart on (Atmosphere if there is none)
    kExterior,
  };
  Topology topology = Topology::kGrid;
  size_t count = 0;
  // kGrid, kMeshlet: the vertices of one diced node.
  const cache::GridRecord* grid = nullptr;
  // kGrid: every strideU-th column and strideV-th row alone; powers of two that divide nu and nv.
  uint32_t strideU = 1, strideV = 1;
  // kHits: per point. kVolume: the same without an address.
  const cache::NodeId* node = nullptr;
  const uint32_t* cell = nullptr;
  const float* u = nullptr;
  const float* v = nullptr;
  const float* direction[3] = {};   // of the incoming ray, cache space
  const float* origin[3] = {};      // of the incoming ray, cache space
  const float* distance = nullptr;  // along the incoming ray (in units of |direction|)
  const float* radius = nullptr;    // footprint of the incoming ray at the hit
  const float* spread = nullptr;
  const float* time = nullptr;
  const uint64_t* seed = nullptr;
  const float* segmentStart = nullptr;  // distance at which the volume begins; nullptr: 0
  Volume volume = Volume::kAtmosphere;
  cache::AttributeId volumeAttributes = cache::kNone;
  RayClass rayClass = RayClass::kSpecular;  // of the incoming rays, where level is not 0
  HitMode hitMode = HitMode::kDefault;
  uint32_t diffuseDepth = 0, shadowDepth = 0;
  std::string_view label;
  bool valuesOnly = false;  // no shader runs: output() gives primitive variables and attributes
  uint32_t level = 0;       // raylevel(): 0 camera
  bool shadowRay = false;   // isshadowray(): only the opacity is wanted
  uint64_t gridSeed = 0;    // seed of a grid's or meshlet's points

  /// kGrid: points in a row.
  uint32_t columns() const { return grid->nu / strideU + 1u; }
  /// kGrid: points of the whole grid.
  size_t gridPoints() const { return size_t(columns()) * (grid->nv / strideV + 1u); }
  /// kGrid: place of point i among the (nu + 1) (nv + 1) vertices of the grid, rows without padding.
  size_t vertexOf(size_t i) const {
    return i / columns() * strideV * (grid->nu + 1u) + i % columns() * strideU;
  }
};

class ShadingSystem;

/// One batch in flight. Reusable; not thread-safe itself, but several tasks may be interleaved on one thread
/// and a suspended task may be resumed by another thread.
class ShadeTask {
 public:
  enum class Status { kDone, kNeedsRays };
  explicit ShadeTask(ShadingSystem& system);
  ~ShadeTask();
  ShadeTask(ShadeTask&&) noexcept;
  ShadeTask& operator=(ShadeTask&&) noexcept;

  void begin(const ShadePoints& points);
  Status run();
  /// kNeedsRays: how many rays wait (1..kMaxRays).
  uint32_t rayCount() const;
  void writeRays(RayQuery& q) const;
  /// Answers are checked: NaN and infinities become misses.
  void readAnswers(const RayQuery& q);
  /// The oracle failed: every waiting ray is a miss.
  void missAll();
  /// Results per point, valid when done.
  const float* color(int component) const;
  const float* opacity(int component) const;
  /// An output variable or predefined variable by name ("N", "s", an output parameter), or a value by the
  /// names of RayTerms::extras; nullptr if there is none.
  const float* output(std::string_view name, int component) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

struct ShadingStatistics {
  uint64_t pointsShaded = 0, lightPoints = 0, opsExecuted = 0, lanesActive = 0, lanesTotal = 0;
  uint64_t shadersLoaded = 0, shadersCompiled = 0;
  double compileSeconds = 0;
  // Programs prepared for the virtual machine, which instances share, and how often machine code was made of
  // one.
  uint64_t programs = 0, machineCodes = 0;
  // Of this process since it opened its first texture; all 0 when there was none.
  uint64_t textureFiles = 0, textureLookups = 0, textureBytesRead = 0, textureMemory = 0;
};

class ShadingSystem {
 public:
  struct Options {
    std::vector<std::string> shaderPath;  // searched in order, before the standard shaders
    std::string standardShaders;          // folder of the shaders that come with the program
    bool tracerSide = false;              // raylevel() > 0 everywhere
    uint32_t textureKilobytes = 0;        // most that texels may take, whatever the scene says; 0: no matter
  };
  /// Loads nothing yet.
  ShadingSystem(cache::SceneCache& cache, Options options);
  ~ShadingSystem();

  /// Loads and specialises the shaders of all objects that `side` (cache::kForReyes or kForTracer) can see. A
  /// missing or broken shader is reported (kNoShader) and replaced by the default surface, or by nothing for
  /// lights and displacements.
  void loadShaders(uint32_t side);
  /// True when a loaded live shader can ask for rays, a light has ray-traced shadows included.
  bool canAskRays() const;
  /// Opacity is 1 wherever this object is hit, whatever its shader does (attribute state and program
  /// analysis).
  bool isOpaque(cache::AttributeId attributes) const;
  /// Numbers in a value of the output variable or predefined variable `name` (ShadeTask::output), by the
  /// surface shaders that are loaded; 0 when none of them knows it.
  int outputComponents(std::string_view name) const;
  /// Same attribute state -> same shade batch; hits are grouped by this key.
  uint32_t shadeGroup(cache::AttributeId attributes) const;
  /// Runs displacement shaders for dicing; pass to SceneCache::setDisplacer.
  cache::Displacer& displacer();
  /// Imager shader of the frame, if any, on n pixels in place: color[3], alpha; P = raster position. False:
  /// no imager.
  bool runImager(size_t n, const float* rasterX, const float* rasterY, float* const color[3],
                 float* const opacity[3], float* alpha);
  ShadingStatistics statistics() const;

  struct Impl;  // shading/system_impl.h

 private:
  friend class ShadeTask;
  std::unique_ptr<Impl> impl_;
};

}  // namespace fr
