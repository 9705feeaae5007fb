// A closed model as the tracer has it.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <memory>

#include "base/random.h"
#include "scene_cache/dice_scene.h"
#include "tests/stability/models.h"
#include "tracer/ray_scene.h"

namespace fr::test {

/// Waves over the parameters of a sphere that agree where its ends meet and vanish at its poles.
class Bumps : public cache::Displacer {
 public:
  explicit Bumps(double height) : height_(height) {}
  bool displaces(cache::ObjectId) const override { return height_ > 0; }
  void displace(cache::NodeId, size_t n, const uint32_t*, const float* u, const float* v, int, int,
                float* const P[3], float* const N[3]) override {
    for (size_t i = 0; i < n; ++i) {
      const double a = 6.283185307179586 * double(u[i]), b = 3.141592653589793 * double(v[i]);
      const auto by = float(height_ * std::sin(5 * a) * std::sin(b) * std::sin(7 * b));
      for (int c = 0; c < 3; ++c) P[c][i] += by * N[c][i];
    }
  }

 private:
  double height_;
};

class TracedModel {
 public:
  explicit TracedModel(const Model& m, const std::string& attributes = "Sides 2")
      : scene_(cache::diceWorld(
            cache::diceCamera(m.distance, m.shadingRate * (std::getenv("FR_STRESS") ? 1 : 4), 512) + "\n" +
                attributes,
            (m.bumps > 0 ? fmt::format("Attribute \"displacementbound\" \"float sphere\" [{}] ", m.bumps)
                         : std::string()) +
                m.rib)),
        bumps_(m.bumps) {
    for (const Error& e : scene_.reports) ADD_FAILURE() << e.str();
    if (!scene_.cache) throw std::runtime_error("no scene");
    scene_.cache->setDisplacer(&bumps_);
    inside = Vec3(m.inside - scene_.cache->skeleton().header().cacheOrigin);
  }
  ~TracedModel() { scene_.cache->setDisplacer(nullptr); }
  TracedModel(const TracedModel&) = delete;
  TracedModel& operator=(const TracedModel&) = delete;

  /// `clusters`: cut into small clusters, all of whose borders are open.
  std::unique_ptr<tracer::RayScene> trace(float multiplier, bool clusters = false) {
    tracer::RaySceneOptions o;
    o.patchMultiplier = multiplier;
    o.flatMicropolygons = clusters ? 0 : 1e12;
    if (clusters) o.clusterMicropolygons = 20000;
    auto made = tracer::RayScene::build(
        *scene_.cache, [](cache::ObjectId) { return true; }, o);
    EXPECT_TRUE(made.ok()) << (made.ok() ? "" : made.error().str());
    return made.ok() ? std::move(*made) : nullptr;
  }
  cache::SceneCache& cache() { return *scene_.cache; }
  cache::DiceScene& scene() { return scene_; }

  Vec3 inside;  // cache space

 private:
  cache::DiceScene scene_;
  Bumps bumps_;
};

/// Numbers in [0, 1) that follow from how many were asked for.
class Counted {
 public:
  explicit Counted(uint64_t seed = 0) : next_(mix64(seed)) {}
  float operator()() { return toUnitFloat(uint32_t(mix64(next_++) >> 20)); }
  Vec3 direction() {
    const float z = 2 * (*this)() - 1, a = 6.2831853f * (*this)();
    const float r = std::sqrt(std::max(0.0f, 1 - z * z));
    return {r * std::cos(a), r * std::sin(a), z};
  }

 private:
  uint64_t next_;
};

/// More with FR_STRESS set.
inline uint64_t effort(uint64_t usual, uint64_t stress) { return std::getenv("FR_STRESS") ? stress : usual; }

}  // namespace fr::test
