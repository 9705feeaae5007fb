// A Renderer that keeps the graphics state and turns requests into finished things: worlds, lights,
// primitives with their attributes, transforms and motion samples. The scene builder derives from it and
// implements the hooks.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <variant>
#include <vector>

#include "ri/graphics_state.h"
#include "ri/renderer.h"

namespace fr::ri {

/// A primitive with all its motion samples and the attributes that belong to its geometry. Immutable and
/// shared: the instances of an object hold the same one.
struct MovingPrimitive {
  std::vector<float> times;        ///< empty: still, one sample
  std::vector<Primitive> samples;  ///< checked by checkPrimitive, all of one kind and one topology
  ValueCounts counts;
  std::shared_ptr<const Basis> basis;
  std::shared_ptr<const TrimCurve> trimCurve;
  SourceLocation location;
};
using MovingPrimitivePtr = std::shared_ptr<const MovingPrimitive>;

/// What stands in the scene: a primitive under attributes and a transform (object to world).
struct PlacedPrimitive {
  MovingPrimitivePtr source;
  AttributePtr attributes;
  TransformPtr objectToWorld;
};
struct PlacedProcedural {
  std::shared_ptr<const Procedural> source;
  AttributePtr attributes;
  TransformPtr objectToWorld;
  SourceLocation location;
};

/// Contents of ObjectBegin ... ObjectEnd. Transforms lead from the object's own space to the space in which
/// ObjectBegin stood; attributes come from the instance.
struct RetainedObject {
  struct SolidStart {
    std::string operation;
  };
  struct SolidStop {};
  struct Shape {
    std::variant<MovingPrimitivePtr, std::shared_ptr<const Procedural>, std::shared_ptr<const RetainedObject>,
                 SolidStart, SolidStop>
        what;
    TransformPtr toObject;
    SourceLocation location;
  };
  Handle handle;
  std::vector<Shape> shapes;
  int nesting = 0;  ///< instances within instances below this one
};

/// A MotionBegin ... MotionEnd being read.
struct MotionBlock {
  std::vector<float> times;
  std::string request;  // the one kind of request in the block
  size_t count = 0;     // how many came
  std::vector<TransformRequest> transforms;
  std::vector<Primitive> primitives;
  std::vector<Color> colors;
  std::vector<ShaderPtr> shaders;  // nullptr: none
  std::vector<Bound> bounds;
  std::vector<double> zooms;  // half the picture's size at distance 1, by each Projection
  int light = -1;             // whose shader moves
  SourceLocation location;
};

class StateRenderer : public Renderer {
 public:
  /// `standardPaths`: what "@" means, by searchpath category; also the initial lists.
  using PathLists = std::map<std::string, std::vector<std::string>, std::less<>>;
  explicit StateRenderer(PathLists standardPaths = {});
  ~StateRenderer() override;

  const GraphicsState& state() const { return state_; }
  GraphicsState& state() { return state_; }

  /// Call after the last file: blocks still open are reported and closed, so that a world whose end is
  /// missing is rendered with what came.
  void finish();

  std::vector<std::string> searchPath(std::string_view category) const override;
  const Param* variable(std::string_view name) const override;

  // Every request of Renderer.
  void frameBegin(int number) override;
  void frameEnd() override;
  void worldBegin() override;
  void worldEnd() override;
  void attributeBegin() override;
  void attributeEnd() override;
  void transformBegin() override;
  void transformEnd() override;
  void solidBegin(std::string operation) override;
  void solidEnd() override;
  void objectBegin(Handle handle) override;
  void objectEnd() override;
  void objectInstance(Handle handle) override;
  void motionBegin(std::vector<float> times) override;
  void motionEnd() override;
  void resourceBegin() override;
  void resourceEnd() override;
  void format(int xres, int yres, double pixelAspect) override;
  void frameAspectRatio(double aspect) override;
  void screenWindow(double left, double right, double bottom, double top) override;
  void cropWindow(double xmin, double xmax, double ymin, double ymax) override;
  void projection(std::string name, ParamList params) override;
  void clipping(double near, double far) override;
  void clippingPlane(DVec3 point, DVec3 normal) override;
  void depthOfField(double fstop, double focalLength, double focalDistance) override;
  void depthOfField() override;
  void shutter(double open, double close) override;
  void camera(std::string name, ParamList params) override;
  void pixelVariance(double variance) override;
  void pixelSamples(double x, double y) override;
  void pixelFilter(std::string name, double xwidth, double ywidth) override;
  void exposure(double gain, double gamma) override;
  void quantize(std::string type, int one, int min, int max, double dither) override;
  void display(std::string name, std::string type, std::string mode, ParamList params) override;
  void displayChannel(std::string declaration, ParamList params) override;
  void hider(std::string type, ParamList params) override;
  void colorSamples(std::vector<float> nRgb, std::vector<float> rgbN) override;
  void relativeDetail(double detail) override;
  void option(std::string category, ParamList params) override;
  void color(std::span<const float> c) override;
  void opacity(std::span<const float> c) override;
  void textureCoordinates(const std::array<float, 8>& st) override;
  void shader(ShaderKind kind, std::string name, ParamList params) override;
  void lightSource(std::string name, Handle handle, ParamList params) override;
  void areaLightSource(std::string name, Handle handle, ParamList params) override;
  void illuminate(Handle light, bool on) override;
  void shaderLayer(std::string type, std::string name, std::string layer, ParamList params) override;
  void connectShaderLayers(std::string type, std::string layer1, std::string variable1, std::string layer2,
                           std::string variable2) override;
  void shadingRate(double size) override;
  void shadingInterpolation(std::string type) override;
  void matte(bool on) override;
  void bound(const Bound& b) override;
  void detail(const Bound& b) override;
  void detailRange(double offLow, double onLow, double onHigh, double offHigh) override;
  void geometricApproximation(std::string type, double value) override;
  void geometricRepresentation(std::string type) override;
  void orientation(std::string orientation) override;
  void reverseOrientation() override;
  void sides(int n) override;
  void attribute(std::string category, ParamList params) override;
  void basis(BasisArgument u, BasisArgument v) override;
  void trimCurve(TrimCurve curves) override;
  void resource(std::string handle, std::string type, ParamList params) override;
  void identity() override;
  void transform(const DMat4& m) override;
  void concatTransform(const DMat4& m) override;
  void perspective(double fov) override;
  void translate(DVec3 t) override;
  void rotate(double angle, DVec3 axis) override;
  void scale(DVec3 s) override;
  void skew(double angle, DVec3 d1, DVec3 d2) override;
  void coordinateSystem(std::string name) override;
  void scopedCoordinateSystem(std::string name) override;
  void coordSysTransform(std::string name) override;
  void primitive(Primitive p) override;
  void procedural(Procedural p) override;
  void makeTexture(MakeKind kind, MakeTextureArgs args) override;
  void errorHandler(std::string name) override;
  void declare(std::string name, std::string declaration) override;
  void readArchive(std::string name, ParamList params) override;
  void archiveBegin(Handle name, ParamList params) override;
  void archiveEnd() override;
  void archiveRecord(RecordKind kind, std::string text) override;

 protected:
  // Hooks. state() is that of the moment; in onWorldBegin the camera is final and world space is current; in
  // onWorldEnd the world's lights and attributes are still there.
  virtual void onFrameBegin(int /*number*/) {}
  virtual void onFrameEnd() {}
  virtual void onWorldBegin() {}
  virtual void onWorldEnd() {}
  virtual void onPrimitive(const PlacedPrimitive& /*p*/) {}
  virtual void onProcedural(const PlacedProcedural& /*p*/) {}
  virtual void onLight(const LightInstance& /*light*/) {}
  virtual void onSolidBegin(const std::string& /*operation*/) {}
  virtual void onSolidEnd() {}
  virtual void onMakeTexture(MakeKind /*kind*/, const MakeTextureArgs& /*args*/) {}
  /// One instance. The default calls onPrimitive and onProcedural for every shape of the object.
  virtual void onInstance(const RetainedObject& object, const AttributePtr& attributes,
                          const TransformPtr& objectToWorld);

  /// Calls `read` inside an attribute block of its own with `scope` in force. It cannot end what was open
  /// before; what it leaves open is reported and ended. Only inside a world, outside motion and objects.
  void within(const GraphicsState::Scope& scope, const std::function<void()>& read);

  /// Reports only the first time that this message comes up in this renderer.
  void reportOnceHere(RiError code, Severity severity, std::string message);

 private:
  bool optionAllowed(const char* request);
  bool attributeAllowed(const char* request);
  bool motionSample(const std::string& request);
  /// Another key of the motion that `request` has begun: remember it.
  bool laterSample(const char* request) const;
  bool endMovingAttribute(MotionBlock& m);
  ShaderPtr meanShader(const std::vector<ShaderPtr>& keys, const std::vector<double>& weights);
  void setShader(ShaderKind kind, ShaderPtr s);
  void moveLight(const LightInstance& l);
  bool lightKey(const char* request, ShaderKind kind, std::string& name, ParamList& params);
  bool check(Result<void> r);
  void closeBlock(BlockKind kind);
  void applyTransform(TransformRequest request);
  void emit(std::vector<float> times, std::vector<Primitive> samples);
  void addShape(RetainedObject::Shape shape);
  std::optional<Color> toRgb(std::span<const float> c, const char* request);
  ShaderPtr makeShader(ShaderKind kind, std::string name, ParamList params);

  GraphicsState state_;
  PathLists standardPaths_;
  std::optional<MotionBlock> motion_;
  std::shared_ptr<RetainedObject> object_;  // being recorded
  std::map<std::string, std::shared_ptr<const RetainedObject>, std::less<>> objects_;
  std::set<std::string, std::less<>> said_;
  mutable Param frameVariable_;
  /// Attributes saved by Resource, by handle: outside, and in each ResourceBegin block that is open.
  std::vector<std::map<std::string, AttributePtr, std::less<>>> resources_ = {{}};
};

}  // namespace fr::ri
