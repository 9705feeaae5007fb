// What a scene cache's skeleton answers to shaders: coordinate systems, attributes, options, parameter
// values.
#pragma once

#include "scene_cache/cache.h"
#include "shading/shader_instance.h"
#include "shading/texture_library.h"

namespace fr {

/// "current" space is camera space at shutter open. All matrices are concatenated in double, once.
class SceneHost final : public ShaderHost {
 public:
  /// `textureKilobytes`: most for texels, 0: as the scene says.
  explicit SceneHost(const cache::Skeleton& skeleton, uint32_t textureKilobytes = 0);

  const DMat4& cacheToCurrent() const { return cacheToCurrent_; }
  const DMat4& currentToCache() const { return currentToCache_; }
  DMat4 transformToCurrent(cache::TransformId t) const;
  bool perspective() const { return perspective_; }
  /// RIB value of a parameter of a shader whose space is `toCurrent`, carried to current space.
  ShaderValue value(const cache::ParamRecord& p, const DMat4* toCurrent) const;
  float optionFloat(std::string_view name, float fallback) const;
  float attributeFloat(const cache::AttributeRecord& a, std::string_view name, float fallback) const;

  bool spaceToCurrent(std::string_view name, DMat4& m) const override;
  bool objectToCurrent(uint32_t object, DMat4& m) const override;
  bool attribute(std::string_view name, uint32_t attributes, ShaderValue& v) const override;
  bool option(std::string_view name, ShaderValue& v) const override;
  bool rendererInfo(std::string_view name, ShaderValue& v) const override;
  bool isDisplayed(std::string_view name) const override;
  Vec2 clipping() const override;
  float sceneDiameter() const override { return sceneDiameter_; }
  void print(std::string_view text) const override;
  const TextureLibrary* textures() const override { return &textures_; }
  Vec2 shadowBias() const override { return shadowBias_; }
  int textureCallUnavailable(std::string_view what) const override;

 private:
  cache::Skeleton skeleton_;
  float shutterOpen_;
  bool perspective_;
  DMat4 worldToCurrent_, cacheToCurrent_, currentToCache_, currentToScreen_, currentToNdc_, currentToRaster_;
  float sceneDiameter_ = 1;
  Vec2 shadowBias_{0, -1};
  TextureLibrary textures_;
};

}  // namespace fr
