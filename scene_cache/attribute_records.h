// Attribute states, shaders, lights and transforms of the RI as records of the skeleton.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <unordered_map>
#include <vector>

#include "ri/graphics_state.h"
#include "scene_cache/skeleton_writer.h"

namespace fr::cache {

/// Remembers what became of immutable shared objects. Holds them, so that an address is not reused for
/// another; forgets all when it grows large (the writer finds equal content again).
template <class T, class Id>
class IdentityCache {
 public:
  const Id* find(const std::shared_ptr<const T>& p) const {
    const auto it = ids_.find(p.get());
    return it == ids_.end() ? nullptr : &it->second.second;
  }
  Id add(const std::shared_ptr<const T>& p, Id id) {
    if (ids_.size() >= 4096) ids_.clear();
    ids_.emplace(p.get(), std::pair(p, id));
    return id;
  }

 private:
  std::unordered_map<const T*, std::pair<std::shared_ptr<const T>, Id>> ids_;
};

/// Visibility bits and shadow mode from Attribute "render" (BMRT) and "visibility", "shade" (PRMan), which
/// say the same things in two ways. Nothing given: visible to all rays, shadows by Os.
struct RayVisibility {
  uint32_t bits = kVisibleCamera | kVisibleReflection | kVisibleShadow;
  CastsShadows castsShadows = CastsShadows::kOs;
  uint32_t flags = 0;  // of AttributeFlags: kNo...Rays, k...HitsPrimitive
};
RayVisibility rayVisibility(const ri::NamedValues& attributes);

/// Largest factor by which the linear part of `m` stretches a vector (its largest singular value).
double largestStretch(const DMat4& m);

/// Which samples see a representation, as in AttributeRecord::thinning.
struct Thinning {
  float below = 0, above = 0;
  bool seen() const { return below < 1 - above; }
};

/// The records of one world. Not thread-safe.
class AttributeRecords {
 public:
  struct Rates {
    std::optional<float> shadingRate;      ///< replaces every ShadingRate
    std::optional<float> patchMultiplier;  ///< where the RIB has none
  };
  using MovesPoints = std::function<bool(const std::string& shader, const std::vector<std::string>& folders)>;
  using TakesString = std::function<bool(const std::string& shader, const std::vector<std::string>& folders,
                                         const std::string& parameter)>;
  /// `cameraMirrored`: world to camera swaps handedness.
  /// `movesPoints`, `takesString` as in LoadOptions; live as long.
  AttributeRecords(SkeletonWriter& writer, const ri::GraphicsState& state, bool cameraMirrored,
                   const Rates& rates, const MovesPoints& movesPoints, const TakesString& takesString);

  TransformId transform(const ri::TransformPtr& t);
  Result<ri::TransformPtr> toWorld(const ri::PlacedTransform& space) const { return state_.toWorld(space); }
  /// The state `a` for a primitive with this transform: displacement bound in world units, orientation.
  /// `subtracted`: it bounds a solid that is taken away from another (kSubtracted).
  AttributeId attributes(const ri::AttributePtr& a, const ri::TransformPtr& objectToWorld, Thinning thinning,
                         bool subtracted = false);
  /// The surface shader where it displaces, as many did before there were displacement shaders: it moves
  /// points, no other shader displaces, and there is a "displacementbound". Null elsewhere.
  ri::ShaderPtr movingSurface(const ri::AttributeState& a);
  /// The state `a` for a primitive with these variables: strings (one for all of it) stand in for parameters
  /// of its surface and displacement shaders, as numbers do when they are shaded. `a` itself where none does.
  ri::AttributePtr withStrings(const ri::AttributePtr& a, const ri::ParamList& variables);
  /// kNone for a null pointer.
  ShaderId shader(const ri::ShaderPtr& s);
  /// The shader of light `index` of the graphics state.
  ShaderId light(int index);
  size_t lightCount() const { return lights_.size(); }

 private:
  AttributeRecord baseRecord(const ri::AttributeState& a, bool withLights);
  ShaderRecord shaderRecord(const ri::ShaderInstance& s);
  /// Folders of shaders that the RIB names.
  std::vector<std::string> shaderFolders() const;
  ri::ShaderPtr withStrings(const ri::ShaderPtr& s, const std::vector<const ri::Param*>& strings);
  float displacementBound(const ri::AttributeState& a, const ri::TransformPtr& objectToWorld);

  SkeletonWriter& writer_;
  const ri::GraphicsState& state_;
  bool cameraMirrored_;
  Rates rates_;
  const MovesPoints& movesPoints_;
  const TakesString& takesString_;
  std::map<std::string, bool> moves_;  // what it said
  IdentityCache<ri::Transform, TransformId> transforms_;
  IdentityCache<ri::ShaderInstance, ShaderId> shaders_;
  IdentityCache<ri::AttributeState, AttributeRecord> states_;
  // What withStrings() did last: neighbours in a file are often alike.
  struct {
    ri::AttributePtr from, to;
    std::vector<ri::Param> strings;
  } last_;
  // By index; the shader pointer tells whether the index still means the same light.
  std::unordered_map<int, std::pair<ri::ShaderPtr, ShaderId>> lights_;
};

}  // namespace fr::cache
