// Displacement shaders while a grid is diced.
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
    return a.displacement != cache::kNone && system_.setup(objects[object].attributes).displaced;
  }

  void displace(cache::NodeId node, size_t n, const uint32_t* cell, const float* u, const float* v,
                int gridNu, int gridNv, float* const P[3], float* const N[3]) override {
    const ShadeSetup& setup = system_.setup(system_.scene.objectOf(node).attributes);
    if (!setup.displaced || n == 0 || n > kMaxShadePoints) return;
    std::unique_ptr<Work> work = take();
    work->columns.fillForDicing(setup, node, n, cell, u, v, gridNu, gridNv, P, N);
    // A solid has one shape, whether it is added or taken away.
    const float side = work->columns.subtracted() ? -1.0f : 1.0f;
    if (side < 0) work->columns.turnOver();
    work->machine.begin(work->columns.batch(), *setup.displacement, {}, setup.partners());
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
