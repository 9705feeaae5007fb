// A scene of analytic shapes for tests of the tracer alone: an implementation of SceneCache (and of the
// skeleton's reader) whose surfaces have closed forms, over real shared segments, without RIB, dicing or
// displacement.
//
// Programs that link tracer_analytic get these instead of the renderer's own scene cache and shading.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "scene_cache/cache.h"

namespace fr::testing {

struct AnalyticShape {
  enum Kind : uint32_t { kSphere, kTorus, kPlane, kMeshSphere };
  Kind kind = kSphere;
  Vec3 center{0};
  Vec3 axisU{1, 0, 0}, axisV{0, 1, 0};  // kPlane: center + (2u-1) axisU + (2v-1) axisV
  float radius = 1;                     // sphere, torus (ring)
  float tube = 0.25f;                   // torus
  uint32_t patchesU = 2, patchesV = 2, cells = 16;
  uint32_t inward = 0;            // oriented normal points inwards
  uint32_t group = cache::kNone;  // surface group; kNone: its own
  Vec3 motion{0};                 // from shutter open to close; other than 0: two motion keys
};

/// Shading and visibility of a shape.
struct AnalyticLook {
  std::string shader = "constant";
  Color color{1, 1, 1}, opacity{1, 1, 1};
  uint32_t visibility = cache::kVisibleCamera | cache::kVisibleReflection | cache::kVisibleShadow;
  cache::CastsShadows castsShadows = cache::CastsShadows::kOs;
  float patchMultiplier = -1;
  float bias = -1;
  uint32_t sides = 2;
  bool forTracer = true;
};

class AnalyticScene {
 public:
  AnalyticScene();
  cache::ObjectId add(const AnalyticShape& shape, const AnalyticLook& look = {});
  void setMaxRayLevel(int level) { maxRayLevel_ = level; }
  /// Segments are made and everything is diced.
  std::unique_ptr<cache::SceneCache> finish();

 private:
  cache::StringId intern(const std::string& s);
  std::vector<cache::ObjectRecord> objects_;
  std::vector<cache::AttributeRecord> attributes_;
  std::vector<cache::ShaderRecord> shaders_;
  std::vector<cache::RootPatchRecord> roots_;
  std::vector<AnalyticShape> shapes_;
  std::vector<std::string> strings_;
  int maxRayLevel_ = 4;
};

/// Point and unit outward normal of a shape at (u,v) of the whole shape.
Vec3 analyticPoint(const AnalyticShape& s, double u, double v);
Vec3 analyticNormal(const AnalyticShape& s, double u, double v);
/// The shape of an object of an analytic cache.
const AnalyticShape& shapeOf(const cache::SceneCache& cache, cache::ObjectId object);
/// Parameters of the whole shape for an address on one of its patches.
void wholeParameters(const cache::SceneCache& cache, cache::NodeId node, uint32_t cell, float u, float v,
                     double* wu, double* wv);

}  // namespace fr::testing
