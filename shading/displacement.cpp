// Deformation and displacement shaders while a grid is diced.
#include <algorithm>
#include <cmath>
#include <mutex>

#include "shading/point_columns.h"

namespace fr {

class ShadingSystem::Impl::Displacement final : public cache::Displacer {
 public:
  explicit Displacement(Impl& system) : system_(system) {}

  bool displaces(cache::ObjectId object) const override {
    const auto objects = system_.scene.skeleton().objects();
    if (object >= objects.size() || objects[object].attributes == cache::kNone) return false;
    const cache::AttributeRecord& a = system_.scene.skeleton().attributes()[objects[object].attributes];
    return (a.displacement != cache::kNone || a.deformation != 0) &&
           system_.setup(objects[object].attributes).displaced;
  }

  void displace(cache::NodeId node, size_t n, const uint32_t* cell, const float* u, const float* v,
                int gridNu, int gridNv, float* const P[3], float* const N[3]) override {
    const ShadeSetup& setup = system_.setup(system_.scene.objectOf(node).attributes);
    if (!setup.displaced || n == 0 || n > kMaxShadePoints) return;
    std::unique_ptr<Work> work = take();
    if (setup.deformation) {
      deform(*work, setup, {node, n, cell, u, v, gridNu, gridNv}, P, N);
      if (!setup.displacement || setup.bumpOnly) return give(std::move(work));
    }
    work->columns.fillForDicing(setup, node, n, cell, u, v, gridNu, gridNv, P, N);
    // A solid has one shape, whether it is added or taken away.
    const float side = work->columns.subtracted() ? -1.0f : 1.0f;
    if (side < 0) work->columns.turnOver();
    Batch batch = work->columns.batch();
    batch.saysMisses = !setup.surfaceDisplaces;
    work->machine.begin(batch, *setup.displacement, {}, setup.partners());
    work->machine.run();
    const Operand newP = work->machine.result(GlobalId::k_P), newN = work->machine.result(GlobalId::k_N);
    for (size_t k = 0; k < n; ++k) {
      const uint32_t i = uint32_t(k);
      if (newP.data) {
        const Vec3 p =
            transformPoint(system_.currentToCache, Vec3(newP.at(i, 0), newP.at(i, 1), newP.at(i, 2)));
        // A point that was moved out of the world stays where it was.
        if (isFinite(p))
          for (int c = 0; c < 3; ++c) P[c][k] = p[c];
      }
      if (newN.data) {
        const Vec3 m = system_.currentToCacheNormal * Vec3(newN.at(i, 0), newN.at(i, 1), newN.at(i, 2));
        const float length = glm::length(m);
        if (std::isfinite(length) && length > 0)
          for (int c = 0; c < 3; ++c) N[c][k] = side * m[c] / length;
      }
    }
    give(std::move(work));
  }

 private:
  struct Work {
    explicit Work(Impl& s) : columns(s), machine(s.host) {}
    PointColumns columns;
    Machine machine;
  };
  struct Places {
    cache::NodeId node;
    size_t n;
    const uint32_t* cell;
    const float *u, *v;
    int gridNu, gridNv;
  };

  /// P where the deformation takes it, in cache space; a point that is moved out of the world stays.
  std::vector<Vec3> deformed(Work& work, const ShadeSetup& setup, const Places& at, float* const P[3],
                             float* const N[3]) {
    work.columns.fillForDicing(setup, at.node, at.n, at.cell, at.u, at.v, at.gridNu, at.gridNv, P, N);
    Batch batch = work.columns.batch();
    batch.overrides = {};
    work.machine.begin(batch, *setup.deformation, {}, setup.partners());
    work.machine.run();
    const Operand moved = work.machine.result(GlobalId::k_P);
    std::vector<Vec3> out(at.n);
    for (size_t k = 0; k < at.n; ++k) {
      const auto i = uint32_t(k);
      out[k] = Vec3(P[0][k], P[1][k], P[2][k]);
      if (!moved.data) continue;
      const Vec3 p =
          transformPoint(system_.currentToCache, Vec3(moved.at(i, 0), moved.at(i, 1), moved.at(i, 2)));
      if (isFinite(p)) out[k] = p;
    }
    return out;
  }

  /// A deformation moves the space in which a surface stands. What it makes of the normal follows from what
  /// it makes of two small steps along the surface.
  void deform(Work& work, const ShadeSetup& setup, const Places& at, float* const P[3], float* const N[3]) {
    Box3f box;
    for (size_t k = 0; k < at.n; ++k) box.extend(Vec3(P[0][k], P[1][k], P[2][k]));
    const Vec3 far = glm::max(glm::abs(box.min), glm::abs(box.max));
    const float step = std::max({1e-2f * box.diagonal(), 1e-4f * std::max({far.x, far.y, far.z}), 1e-6f});
    const std::vector<Vec3> here = deformed(work, setup, at, P, N);
    std::vector<Vec3> along[2];
    std::vector<float> store(at.n * 3);
    float* const stepped[3] = {store.data(), store.data() + at.n, store.data() + 2 * at.n};
    for (int t = 0; t < 2; ++t) {
      for (size_t k = 0; k < at.n; ++k) {
        const Vec3 normal(N[0][k], N[1][k], N[2][k]);
        const Vec3 other = std::abs(normal.x) < 0.6f ? Vec3(1, 0, 0) : Vec3(0, 1, 0);
        const Vec3 first = glm::cross(normal, other);
        const Vec3 axis = t == 0 ? first : glm::cross(normal, first);  // first x axis points along the normal
        const float length = glm::length(axis);
        for (int c = 0; c < 3; ++c) stepped[c][k] = P[c][k] + (length > 0 ? step / length * axis[c] : 0.0f);
      }
      along[t] = deformed(work, setup, at, stepped, N);
    }
    for (size_t k = 0; k < at.n; ++k) {
      const Vec3 normal = glm::cross(along[0][k] - here[k], along[1][k] - here[k]);
      const float length = glm::length(normal);
      for (int c = 0; c < 3; ++c) {
        P[c][k] = here[k][c];
        if (std::isfinite(length) && length > 0) N[c][k] = normal[c] / length;
      }
    }
  }
  std::unique_ptr<Work> take() {
    const std::lock_guard lock(mutex_);
    if (free_.empty()) return std::make_unique<Work>(system_);
    auto w = std::move(free_.back());
    free_.pop_back();
    return w;
  }
  void give(std::unique_ptr<Work> w) {
    const std::lock_guard lock(mutex_);
    free_.push_back(std::move(w));
  }

  Impl& system_;
  std::mutex mutex_;
  std::vector<std::unique_ptr<Work>> free_;
};

std::unique_ptr<cache::Displacer> makeDisplacer(ShadingSystem::Impl& system) {
  return std::make_unique<ShadingSystem::Impl::Displacement>(system);
}

}  // namespace fr
