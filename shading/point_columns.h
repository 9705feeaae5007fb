// From addresses on patches to the predefined variables of a batch, in current space.
#pragma once

#include "shading/system_impl.h"

namespace fr {

/// Columns of one batch and the stencil that goes with them. Reused from batch to batch.
class PointColumns final : public PointVariables {
 public:
  explicit PointColumns(ShadingSystem::Impl& system) : system_(system) {}

  /// Everything that `setup` can look at, for the points to shade.
  void fill(const ShadePoints& points, const ShadeSetup& setup);
  /// For displacement: points given by the cache, P and N in cache space.
  void fillForDicing(const ShadeSetup& setup, cache::NodeId node, size_t n, const uint32_t* cell,
                     const float* u, const float* v, int gridNu, int gridNv, float* const P[3],
                     float* const N[3]);
  /// The points bound a solid that is taken away from another (kSubtracted).
  bool subtracted() const;
  /// Turns normals and orientation over.
  void turnOver();
  /// Ends of rays in a volume: no surface, Ci and Oi are 0.
  void fillVolume(const ShadePoints& points, const ShadeSetup& setup);
  /// A primitive variable of the points' objects, in current space; nullptr when none has it. Of floats and
  /// triples.
  const float* primvar(std::string_view name, uint32_t component) const;
  const float* variable(std::string_view name, uint32_t component) const override {
    return primvar(name, component);
  }
  /// Length of the incoming ray of a hit or of a volume's end.
  float distance(uint32_t lane) const { return distance_[lane]; }
  /// Primitive variables that are parameters of the displacement shader; valid until the next batch.
  std::span<const Batch::Override> displacementOverrides(const ShadeSetup& setup);
  /// The points as the displacement shader found them, on the undisplaced surface. The rest is batch()'s.
  Batch beforeDisplacement(const ShadeSetup& setup);
  const Batch& batch() const { return batch_; }
  Batch& batch() { return batch_; }
  uint32_t count() const { return count_; }
  /// Address of a lane's point, for rays that start there.
  cache::NodeId node(uint32_t lane) const { return nodes_[lane]; }
  uint32_t cell(uint32_t lane) const { return cells_[lane]; }
  float u(uint32_t lane) const { return patchU_[lane]; }
  float v(uint32_t lane) const { return patchV_[lane]; }

 private:
  enum Column : uint32_t {
    kP = 0,
    kN = 3,
    kNg = 6,
    kDPdu = 9,
    kDPdv = 12,
    kI = 15,
    kCs = 18,
    kOs = 21,
    kCi = 24,
    kOi = 27,
    kU = 30,
    kV,
    kS,
    kT,
    kDu,
    kDv,
    kRadius,
    kSpread,
    kScratch,
    kColumns = kScratch + 4
  };
  float* column(uint32_t c) { return memory_.data() + size_t(c) * lanes_; }
  Operand operand(uint32_t c) { return {column(c), lanes_, ~0u}; }
  void vertexAddresses(const ShadePoints& points);
  void reset(uint32_t points, uint32_t lanes, const ShadeSetup& setup);
  void evaluate(uint32_t first, uint32_t n, bool diced);
  void toCurrent(uint32_t c, bool normal);
  void differencesFromStencil(bool normals, float orientation);
  /// Values of parameters that primitive variables override.
  struct Overrides {
    AlignedFloats memory;
    std::vector<Batch::Override> list;
  };
  void primvars(const std::vector<ShadeSetup::PrimvarParameter>& parameters, const ShaderInstance& shader,
                Overrides& to);
  void finish(const ShadeSetup& setup);
  void objectTable();
  void describeRays(const ShadePoints& points);
  template <class F>
  void eachRun(F&& f);

  ShadingSystem::Impl& system_;
  const ShadeSetup* setup_ = nullptr;
  uint32_t count_ = 0, lanes_ = 0;
  AlignedFloats memory_, undisplaced_;
  std::vector<int32_t> maskMemory_;
  std::vector<cache::NodeId> nodes_;
  std::vector<uint32_t> cells_, gridCells_;
  std::vector<float> patchU_, patchV_, distance_, gridU_, gridV_;
  mutable std::vector<float> primvar_[3];
  std::vector<uint64_t> seeds_;
  std::vector<uint16_t> object_;
  std::vector<uint32_t> objects_;
  Overrides overrides_, displacementOverrides_;
  AlignedFloats mask_;
  AlignedFloats uniforms_;
  DerivativeStencil stencil_;
  Batch batch_;
};

}  // namespace fr
