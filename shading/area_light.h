// The geometry of an AreaLightSource as a place to sample: the diced surfaces of its objects, by area; a
// whole sphere by the solid angle that it is seen under.
#pragma once

#include <mutex>

#include "scene_cache/cache.h"
#include "shading/scene_host.h"

namespace fr {

/// Thread-safe. Grids are diced on first need, so nothing may call this while it holds a claim on a node.
class AreaLight final : public Emitter {
 public:
  AreaLight(cache::SceneCache& scene, const SceneHost& host, cache::ShaderId light);

  bool ready() const override;
  void sample(const EmitterQuery& q) const override;
  /// Of all surfaces, in current space. REQUIRES ready().
  double totalArea() const { return area_; }

 private:
  struct Cell {
    Vec3 corner[4];  // (0,0) (1,0) (0,1) (1,1); triangles repeat the last
    Vec3 normal;
    float area;
  };
  /// Cells of one diced patch, row after row.
  struct Patch {
    uint32_t firstCell, firstRow, columns, rows;
    double end;  // area of all patches up to this one
  };
  struct Ball {
    Vec3 center;
    float radius;
    bool inward;  // normals point to the centre
  };
  void build();
  void addGrid(const cache::GridRecord& grid, bool reversed);
  bool asBall(const cache::ObjectRecord& object, Ball& ball) const;
  void finishPatch(Patch p);
  void sampleCells(const Vec2& xi, Vec3& P, Vec3& N) const;
  bool sampleBall(const Vec3& from, const Vec2& xi, Vec3& P, Vec3& N, float& factor) const;

  cache::SceneCache& scene_;
  const SceneHost& host_;
  const cache::ShaderId light_;
  mutable std::once_flag once_;
  std::vector<Cell> cells_;
  std::vector<float> rowEnds_;   // running area within a patch, a value per row
  std::vector<float> cellEnds_;  // running area within a row, a value per cell
  std::vector<Patch> patches_;
  Ball ball_{};
  bool isBall_ = false;
  double area_ = 0;
};

}  // namespace fr
