// A shader with its parameter values, and what shaders ask of the world around them.
#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "base/math.h"
#include "shading/executable.h"

namespace fr {

class TextureLibrary;

/// A value that a parameter, option, attribute or message has. Triples and matrices as 3 and 16 floats.
struct ShaderValue {
  SlType type = SlType::kFloat;
  uint32_t arrayLength = 0;  // 0: not an array
  std::vector<float> floats;
  std::vector<std::string> strings;
};

/// What the machine asks the system it belongs to. Called at most once per instruction, never per point.
/// Const and thread-safe.
class ShaderHost {
 public:
  virtual ~ShaderHost() = default;
  /// Matrix from the named space ("world", "raster", a CoordinateSystem ...) to current space; false:
  /// unknown. "shader", "current" and "object" never arrive here.
  virtual bool spaceToCurrent(std::string_view name, DMat4& m) const = 0;
  virtual bool objectToCurrent(uint32_t object, DMat4& m) const = 0;
  /// attribute(), option(), rendererinfo(); false: there is none.
  virtual bool attribute(std::string_view name, uint32_t attributes, ShaderValue& v) const = 0;
  virtual bool option(std::string_view name, ShaderValue& v) const = 0;
  virtual bool rendererInfo(std::string_view name, ShaderValue& v) const = 0;
  /// Whether a display shows the output or predefined variable of that name.
  virtual bool isDisplayed(std::string_view name) const {
    (void)name;
    return false;
  }
  /// Near and far clipping distances, for depth().
  virtual Vec2 clipping() const = 0;
  /// Length that leaves the scene from anywhere in it: how far shadow rays of distant lights go.
  virtual float sceneDiameter() const = 0;
  /// printf() of a shader.
  virtual void print(std::string_view text) const = 0;
  /// Files for texture() and its kin; nullptr: there are none, every call gives a neutral value.
  virtual const TextureLibrary* textures() const { return nullptr; }
  /// Option "shadow" "bias0", "bias1"; the second is negative when neither was given.
  virtual Vec2 shadowBias() const { return {0, -1}; }
  /// Says once that a call for a file has no effect.
  virtual int textureCallUnavailable(std::string_view what) const = 0;
};

/// Points of an area light's geometry, for one sample of every point that it may light. Current space.
struct EmitterQuery {
  Operand Ps;           // what is lit
  const Vec2* xi;       // two numbers in [0,1) per lane
  const int32_t* mask;  // lanes that are wanted
  uint32_t lanes;
  Operand P, N;  // out: the sample, and the unit normal there
  /// Out: what to multiply the light's colour with, the cosine at the light included, so that its mean over
  /// many samples is the mean over the area of (colour times cosine).
  float* factor;
};

/// The geometry of an area light. Thread-safe.
class Emitter {
 public:
  virtual ~Emitter() = default;
  /// Prepared on the first call. False: there is no geometry, the light shines from its shader's origin.
  virtual bool ready() const = 0;
  virtual void sample(const EmitterQuery& q) const = 0;
};

/// A bound shader. Immutable once bound; shared by tasks.
struct ShaderInstance {
  std::shared_ptr<const Executable> exe;
  DMat4 toCurrent{1.0};             // shader space to current space
  uint32_t attributes = kNoIndex;   // attribute state, for attribute() in lights; surfaces use the batch's
  std::vector<ShaderValue> values;  // one per parameter of the program
  bool shadows = false;             // light: Cl is multiplied by the visibility of the light
  uint32_t samples = 1;             // light: Attribute "light" "nsamples"
  std::shared_ptr<const Emitter> emitter;  // light: of AreaLightSource
  uint32_t id = kNoIndex;                  // seed of its random numbers
  uint64_t serial = 0;                     // the same only for instances with the same values

  const ShaderProgram& program() const { return exe->program(); }
  /// Value of a parameter, nullptr if there is none.
  const ShaderValue* parameter(std::string_view name) const {
    const uint32_t i = program().findParameter(name);
    return i == kNoIndex ? nullptr : &values[i];
  }
};

/// A parameter given in the RIB, already in current space.
struct ParameterSetting {
  std::string name;
  ShaderValue value;
};
/// Binds: settings override defaults; default code runs once, in order of declaration. Settings of unknown
/// names are ignored; of wrong type or length: one warning, the default stays.
std::shared_ptr<const ShaderInstance> bindShader(std::shared_ptr<const Executable> exe,
                                                 const DMat4& shaderToCurrent,
                                                 const std::vector<ParameterSetting>& settings,
                                                 const ShaderHost& host);

}  // namespace fr
