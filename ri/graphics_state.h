// The RI graphics state: options, attributes, transformations, named spaces, lights (RISpec 3.2, sections 4
// and 5).
//
// Attribute states and transforms are immutable once someone holds them: everything made under one state
// shares one object, and comparing the pointers tells whether two things were. Not thread-safe; the shared
// objects may be read from any thread.
#pragma once

#include <array>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "base/error.h"
#include "base/math.h"
#include "ri/param_list.h"
#include "ri/primitives.h"
#include "ri/renderer.h"
#include "ri/transform.h"

namespace fr::ri {

/// What a transform leads to: outside the world block the CTM ends in camera space, inside it in world space.
enum class SpaceBase : uint8_t { kCamera, kWorld };
struct PlacedTransform {
  TransformPtr keys;
  SpaceBase base = SpaceBase::kWorld;
};

/// "category:name" -> value, of Option and Attribute. Copied on write, shared otherwise.
class NamedValues {
 public:
  const Param* find(std::string_view category, std::string_view name) const;
  const Param* find(std::string_view categoryAndName) const;
  void set(std::string_view category, Param p);
  float getFloat(std::string_view categoryAndName, float otherwise) const;
  int getInt(std::string_view categoryAndName, int otherwise) const;
  std::string getString(std::string_view categoryAndName, std::string_view otherwise) const;
  Color getColor(std::string_view categoryAndName, const Color& otherwise) const;
  /// Sorted by "category:name"; never null.
  using Map = std::map<std::string, Param, std::less<>>;
  const Map& all() const { return *map_; }
  bool operator==(const NamedValues& o) const { return map_ == o.map_; }

 private:
  std::shared_ptr<Map> map_ = std::make_shared<Map>();
};

struct ShaderInstance {
  ShaderKind kind = ShaderKind::kSurface;
  std::string name;
  ParamList params;
  PlacedTransform shaderSpace;  ///< CTM at the request: "shader" space to its base
  SourceLocation location;
};
using ShaderPtr = std::shared_ptr<const ShaderInstance>;

struct Basis {
  DMat4 u, v;  ///< bytes as in RIB: rows of the basis matrix are GLM columns
  int uStep = 3, vStep = 3;
  bool operator==(const Basis&) const = default;
};
/// One of the five named bases; nullopt for another name.
std::optional<DMat4> namedBasis(std::string_view name);

struct AttributeState {
  Color color{1}, opacity{1};
  std::array<float, 8> textureCoordinates{0, 0, 1, 0, 0, 1, 1, 1};
  ShaderPtr surface, displacement, atmosphere, interior, exterior, deformation;
  /// Lights that are on: indices into GraphicsState::lights(), ascending, in the order of declaration.
  std::shared_ptr<const std::vector<int>> lights = std::make_shared<std::vector<int>>();
  int areaLight = -1;  ///< geometry made now is this light's; -1 = none
  float shadingRate = 1;
  bool smoothShading = false;
  bool matte = false;
  std::optional<Bound> bound;
  std::optional<Bound> detail;
  TransformPtr boundSpace, detailSpace;  ///< CTM at the request: the space of these bounds to world space
  std::array<float, 4> detailRange{0, 0, kRiInfinity, kRiInfinity};
  float flatness = 0;                       ///< GeometricApproximation; 0: not set
  float motionFactor = 1, focusFactor = 1;  ///< GeometricApproximation
  bool reversed = false;                    ///< orientation is opposite to the handedness of object space
  int sides = 2;
  std::shared_ptr<const Basis> basis;  ///< never null
  std::shared_ptr<const TrimCurve> trimCurve;
  NamedValues values;  ///< Attribute request

  AttributeState();
};
using AttributePtr = std::shared_ptr<const AttributeState>;

struct LightInstance {
  Handle handle;
  int index = -1;
  bool isArea = false;
  ShaderPtr shader;
  AttributePtr attributes;  ///< in force at the declaration ("light:shadows" and others)
};

struct DisplayRequest {
  std::string name, type, mode;  ///< name without "+"
  ParamList params;
};
struct QuantizeState {
  int one = 255, min = 0, max = 255;
  float dither = 0.5f;
};
struct ClippingPlane {
  DVec3 point, normal;
  PlacedTransform space;
};

struct Options {
  std::optional<std::array<int, 2>> resolution;
  double pixelAspect = 1;
  std::optional<double> frameAspect;
  std::optional<std::array<double, 4>> screenWindow;  ///< left right bottom top
  std::array<double, 4> cropWindow{0, 1, 0, 1};       ///< xmin xmax ymin ymax
  std::string projection = "orthographic";            ///< "" = identity
  ParamList projectionParams;
  TransformPtr screenTransform;  ///< CTM before Projection; null = identity
  double near = 1e-10, far = 1e38;
  std::vector<ClippingPlane> clippingPlanes;
  double fstop = 1e38, focalLength = 0, focalDistance = 1;  ///< pinhole while fstop >= 1e37
  double shutterOpen = 0, shutterClose = 0;
  std::optional<double> pixelVariance;
  std::array<double, 2> pixelSamples{2, 2};
  bool pixelSamplesGiven = false;
  FilterKind filter = FilterKind::kGaussian;
  std::array<double, 2> filterWidth{2, 2};
  double gain = 1, gamma = 1;
  ShaderPtr imager;
  QuantizeState quantizeColor, quantizeDepth{0, 0, 0, 0};
  std::map<std::string, QuantizeState, std::less<>> quantizeOther;  ///< by the name of a shader variable
  std::vector<DisplayRequest> displays;
  std::vector<DisplayRequest> channels;  ///< DisplayChannel: name holds the declaration
  std::string hider = "hidden";
  ParamList hiderParams;
  std::vector<float> nRgb, rgbN;  ///< ColorSamples; empty = 3 samples, identity
  double relativeDetail = 1;
  std::map<std::string, std::vector<std::string>, std::less<>> searchPaths;  ///< expanded, by category
  NamedValues values;                                                        ///< Option request
};

enum class BlockKind : uint8_t {
  kFrame,
  kWorld,
  kAttribute,
  kTransform,
  kSolid,
  kObject,
  kMotion,
  kResource
};
const char* blockName(BlockKind k);  ///< "World" of WorldBegin/WorldEnd

class GraphicsState {
  using SpaceMap = std::map<std::string, PlacedTransform, std::less<>>;

 public:
  /// What is in force at one place of the world, to be put in force again later in the same world.
  struct Scope {
    AttributePtr attributes;
    TransformPtr ctm;
    std::shared_ptr<const SpaceMap> scopedSpaces;
  };

  GraphicsState();

  // Blocks. begin() saves what the block saves; end() restores it and closes forgotten inner blocks when a
  // world or frame ends. Errors are kNesting and leave the state as it was.
  Result<void> begin(BlockKind kind);
  Result<void> end(BlockKind kind);
  bool inside(BlockKind kind) const;
  bool inWorld() const { return inside(BlockKind::kWorld); }
  int depth() const { return int(stack_.size()); }
  /// The innermost open block.
  std::optional<BlockKind> top() const;
  /// The blocks that are open now cannot be ended until the floor is back where it was. Returns that place.
  size_t raiseFloor() { return std::exchange(floor_, stack_.size()); }
  void restoreFloor(size_t floor) { floor_ = floor; }
  /// False when the innermost block of this kind is below the floor, or there is none.
  bool mayEnd(BlockKind kind) const;

  // Reading. The pointers keep their objects alive and unchanged.
  const Options& options() const { return options_; }
  const AttributeState& attributes() const { return *attributes_; }
  AttributePtr shareAttributes() const { return attributes_; }
  const Transform& ctm() const { return *ctm_; }
  TransformPtr shareCtm() const { return ctm_; }
  SpaceBase base() const { return inWorld() ? SpaceBase::kWorld : SpaceBase::kCamera; }
  PlacedTransform place() const { return {ctm_, base()}; }
  TransformPtr worldToCamera() const { return worldToCamera_; }
  const std::vector<LightInstance>& lights() const { return lights_; }
  int frame() const { return frame_; }
  Scope scope() const { return {attributes_, ctm_, scopedSpaces_}; }

  // Writing.
  Options& editOptions() { return options_; }
  /// A state of its own to write to: copied first if anyone shares it.
  AttributeState& editAttributes();
  void setCtm(Transform t) { ctm_ = std::make_shared<const Transform>(std::move(t)); }
  void concatenate(const Transform& t);
  void setFrame(int n) { frame_ = n; }
  /// Inside a block that will end: the current attributes, transformation and scoped spaces are replaced.
  void setScope(const Scope& scope);

  /// Saves the screen transform and restarts the CTM as camera space (RISpec 3.2, "Projection").
  void setProjection(std::string name, ParamList params);

  // Lights.
  const LightInstance& addLight(Handle handle, bool isArea, ShaderPtr shader);
  /// Nothing happens for a light that is not there.
  void setLightShader(int light, ShaderPtr shader) {
    if (light >= 0 && size_t(light) < lights_.size()) lights_[size_t(light)].shader = std::move(shader);
  }
  const LightInstance* findLight(const Handle& handle) const;
  void illuminate(int light, bool on);

  // Named spaces.
  void nameSpace(std::string name, bool scoped);
  /// kBadToken when nobody named it. Knows "world", "camera" and, outside of shaders, "current" too.
  Result<PlacedTransform> findSpace(std::string_view name) const;
  /// All user-named spaces now visible.
  std::map<std::string, PlacedTransform, std::less<>> namedSpaces() const;
  /// The same transform, ending in world space. Only inside a world.
  Result<TransformPtr> toWorld(const PlacedTransform& t) const;

 private:
  struct Saved {
    BlockKind kind;
    AttributePtr attributes;
    TransformPtr ctm;
    std::shared_ptr<const SpaceMap> scopedSpaces;
    std::unique_ptr<Options> options;
    size_t lights = 0;
  };

  void pop();

  Options options_;
  std::shared_ptr<AttributeState> attributes_;
  TransformPtr ctm_, worldToCamera_;
  std::vector<LightInstance> lights_;
  std::map<std::string, int, std::less<>> lightHandles_;
  SpaceMap spaces_;
  std::shared_ptr<const SpaceMap> scopedSpaces_;
  std::vector<Saved> stack_;
  size_t floor_ = 0;  // blocks of the stack that cannot be ended now
  int frame_ = 0;
};

}  // namespace fr::ri
