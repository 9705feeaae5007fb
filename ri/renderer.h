// The RI as one C++ interface: one virtual function per request (RISpec 3.2 and the extensions that real
// files use). The RIB reader and the C API call it; the scene builder, the RIB writer and a plain checker
// implement it.
//
// Arguments are passed by value where an implementation may want to keep them: callers move.
// Matrices are the 16 numbers of the text, which have the same bytes in GLM (see base/math.h).
// Not thread-safe; one caller at a time. Implementations report() errors and go on: no request may throw.
#pragma once

#include <array>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "base/error.h"
#include "base/math.h"
#include "ri/declaration.h"
#include "ri/param_list.h"
#include "ri/primitives.h"

namespace fr::ri {

/// Name of a light, object or archive: an integer or a string in RIB. 1 and "1" are the same handle.
struct Handle {
  std::string name;
  bool isInteger = false;
  bool operator==(const Handle& o) const { return name == o.name; }
};

enum class ShaderKind : uint8_t {
  kSurface,
  kDisplacement,
  kAtmosphere,
  kInterior,
  kExterior,
  kDeformation,
  kLight,
  kAreaLight,
  kImager
};
/// Name of the request, e.g. "Surface".
const char* shaderKindName(ShaderKind k);

enum class FilterKind : uint8_t {
  kBox,
  kTriangle,
  kCatmullRom,
  kSinc,
  kGaussian,
  kMitchell,
  kDisk,
  kBessel,
  kSeparableCatmullRom,
  kBlackmanHarris,
  kLanczos
};
const char* filterName(FilterKind f);
std::optional<FilterKind> filterFromName(std::string_view name);

/// One direction of Basis: a named basis or 16 numbers, and its step.
struct BasisArgument {
  std::string name;  // empty: `matrix` was given
  DMat4 matrix{1};
  int step = 3;
};

/// NURBS loops in (u,v); all arrays as in the request (RISpec 3.2, section 5.2.3 "Trim curves").
struct TrimCurve {
  std::vector<int> ncurves, order;
  std::vector<float> knot, min, max;
  std::vector<int> n;
  std::vector<float> u, v, w;
  bool operator==(const TrimCurve&) const = default;
};
/// kConsistency with the numbers when the arrays do not fit each other; kRange for a bad order or interval.
Result<void> checkTrimCurve(const TrimCurve& t);

enum class ProceduralKind : uint8_t { kDelayedReadArchive, kRunProgram, kDynamicLoad, kProcedural2, kOther };
struct Procedural {
  ProceduralKind kind = ProceduralKind::kOther;
  std::string subdivide;          ///< name of the subdivide function as given
  std::string boundFunction;      ///< Procedural2 only
  std::vector<std::string> data;  ///< file; program and its data; DSO and its data
  std::optional<Bound> bound;     ///< object space; none for Procedural2
  ParamList params;               ///< Procedural2 only
};

/// Make* requests: files in, file out. `wrap` and `filter` are empty where the request has none.
struct MakeTextureArgs {
  std::vector<std::string> pictures;
  std::string texture;
  std::string sWrap, tWrap, filter;
  double sWidth = 1, tWidth = 1;
  double fov = 90;  ///< cube faces only
  ParamList params;
};
enum class MakeKind : uint8_t {
  kTexture,
  kBump,
  kLatLongEnvironment,
  kCubeFaceEnvironment,
  kShadow,
  kOcclusion,
  kBrickMap
};

enum class RecordKind : uint8_t { kComment, kStructure, kVerbatim };

/// Tells where in the input the request being served stands.
class Locator {
 public:
  virtual ~Locator() = default;
  virtual SourceLocation location() const = 0;
};

class Renderer {
 public:
  virtual ~Renderer() = default;

  /// Place of the current request; unknown when the caller is no file.
  SourceLocation location() const { return locator_ ? locator_->location() : SourceLocation{}; }
  /// Set by whoever feeds the renderer; returns the previous one, to be put back (archives nest).
  const Locator* setLocator(const Locator* l) { return std::exchange(locator_, l); }
  /// The declarations in force, shared by all callers of this renderer.
  Dictionary& dictionary() { return dictionary_; }
  const Dictionary& dictionary() const { return dictionary_; }

  // What the caller needs to know of the renderer's state.

  /// Current list of folders of Option "searchpath" `category`, for ReadArchive; empty = the caller's
  /// default.
  virtual std::vector<std::string> searchPath(std::string_view category) const;
  /// Value of a variable of conditional RIB: "user:x", "Frame" or another "category:name"; nullptr if unset.
  virtual const Param* variable(std::string_view name) const;

  // Blocks
  virtual void frameBegin(int number) = 0;
  virtual void frameEnd() = 0;
  virtual void worldBegin() = 0;
  virtual void worldEnd() = 0;
  virtual void attributeBegin() = 0;
  virtual void attributeEnd() = 0;
  virtual void transformBegin() = 0;
  virtual void transformEnd() = 0;
  virtual void solidBegin(std::string operation) = 0;
  virtual void solidEnd() = 0;
  virtual void objectBegin(Handle handle) = 0;
  virtual void objectEnd() = 0;
  virtual void objectInstance(Handle handle) = 0;
  virtual void motionBegin(std::vector<float> times) = 0;
  virtual void motionEnd() = 0;
  virtual void resourceBegin() = 0;
  virtual void resourceEnd() = 0;

  // Options
  virtual void format(int xres, int yres, double pixelAspect) = 0;
  virtual void frameAspectRatio(double aspect) = 0;
  virtual void screenWindow(double left, double right, double bottom, double top) = 0;
  virtual void cropWindow(double xmin, double xmax, double ymin, double ymax) = 0;
  /// Empty name: no projection (identity).
  virtual void projection(std::string name, ParamList params) = 0;
  virtual void clipping(double near, double far) = 0;
  virtual void clippingPlane(DVec3 point, DVec3 normal) = 0;
  /// No argument: pinhole camera.
  virtual void depthOfField(double fstop, double focalLength, double focalDistance) = 0;
  virtual void depthOfField() = 0;
  virtual void shutter(double open, double close) = 0;
  virtual void camera(std::string name, ParamList params) = 0;
  virtual void pixelVariance(double variance) = 0;
  virtual void pixelSamples(double x, double y) = 0;
  virtual void pixelFilter(std::string name, double xwidth, double ywidth) = 0;
  virtual void exposure(double gain, double gamma) = 0;
  virtual void quantize(std::string type, int one, int min, int max, double dither) = 0;
  /// `name` as given, with its leading "+" if it has one.
  virtual void display(std::string name, std::string type, std::string mode, ParamList params) = 0;
  virtual void displayChannel(std::string declaration, ParamList params) = 0;
  virtual void hider(std::string type, ParamList params) = 0;
  virtual void colorSamples(std::vector<float> nRgb, std::vector<float> rgbN) = 0;
  virtual void relativeDetail(double detail) = 0;
  virtual void option(std::string category, ParamList params) = 0;

  // Attributes
  /// As many numbers as the current ColorSamples says, usually 3.
  virtual void color(std::span<const float> c) = 0;
  virtual void opacity(std::span<const float> c) = 0;
  virtual void textureCoordinates(const std::array<float, 8>& st) = 0;
  /// All shader requests but lights, Imager included; an empty name or "null" takes the shader away.
  virtual void shader(ShaderKind kind, std::string name, ParamList params) = 0;
  virtual void lightSource(std::string name, Handle handle, ParamList params) = 0;
  virtual void areaLightSource(std::string name, Handle handle, ParamList params) = 0;
  virtual void illuminate(Handle light, bool on) = 0;
  virtual void shaderLayer(std::string type, std::string name, std::string layer, ParamList params) = 0;
  virtual void connectShaderLayers(std::string type, std::string layer1, std::string variable1,
                                   std::string layer2, std::string variable2) = 0;
  virtual void shadingRate(double size) = 0;
  virtual void shadingInterpolation(std::string type) = 0;
  virtual void matte(bool on) = 0;
  virtual void bound(const Bound& b) = 0;
  virtual void detail(const Bound& b) = 0;
  virtual void detailRange(double offLow, double onLow, double onHigh, double offHigh) = 0;
  virtual void geometricApproximation(std::string type, double value) = 0;
  virtual void geometricRepresentation(std::string type) = 0;
  virtual void orientation(std::string orientation) = 0;
  virtual void reverseOrientation() = 0;
  virtual void sides(int n) = 0;
  virtual void attribute(std::string category, ParamList params) = 0;
  virtual void basis(BasisArgument u, BasisArgument v) = 0;
  virtual void trimCurve(TrimCurve curves) = 0;
  virtual void resource(std::string handle, std::string type, ParamList params) = 0;

  // Transformations; angles in degrees
  virtual void identity() = 0;
  virtual void transform(const DMat4& m) = 0;
  virtual void concatTransform(const DMat4& m) = 0;
  virtual void perspective(double fov) = 0;
  virtual void translate(DVec3 t) = 0;
  virtual void rotate(double angle, DVec3 axis) = 0;
  virtual void scale(DVec3 s) = 0;
  virtual void skew(double angle, DVec3 d1, DVec3 d2) = 0;
  virtual void coordinateSystem(std::string name) = 0;
  virtual void scopedCoordinateSystem(std::string name) = 0;
  virtual void coordSysTransform(std::string name) = 0;

  // Geometry
  virtual void primitive(Primitive p) = 0;
  virtual void procedural(Procedural p) = 0;

  // Files and the rest
  virtual void makeTexture(MakeKind kind, MakeTextureArgs args) = 0;
  virtual void errorHandler(std::string name) = 0;
  /// Called after dictionary() has taken the declaration.
  virtual void declare(std::string name, std::string declaration) = 0;
  /// The reader expands archives itself and calls these only when it was told not to.
  virtual void readArchive(std::string name, ParamList params) = 0;
  virtual void archiveBegin(Handle name, ParamList params) = 0;
  virtual void archiveEnd() = 0;
  /// Comments: "##" structure hints always, plain ones only when the reader was asked to pass them.
  /// `text` is without the leading "#" signs.
  virtual void archiveRecord(RecordKind kind, std::string text) = 0;
  /// Version of the RIB that is being read.
  virtual void version(double number) { (void)number; }
  /// "IfBegin", "ElseIf", "Else", "IfEnd" with the condition of the first two; only when the reader passes
  /// everything through.
  virtual void conditional(std::string_view request, std::string condition) {
    (void)request, (void)condition;
  }

 protected:
  /// Reports at the current request's place.
  void reportHere(RiError code, Severity severity, std::string message) const;

 private:
  const Locator* locator_ = nullptr;
  Dictionary dictionary_;
};

/// Does nothing: for checking a file (the reader reports what it finds) and as a base of partial renderers.
class NullRenderer : public Renderer {
 public:
  void frameBegin(int) override {}
  void frameEnd() override {}
  void worldBegin() override {}
  void worldEnd() override {}
  void attributeBegin() override {}
  void attributeEnd() override {}
  void transformBegin() override {}
  void transformEnd() override {}
  void solidBegin(std::string) override {}
  void solidEnd() override {}
  void objectBegin(Handle) override {}
  void objectEnd() override {}
  void objectInstance(Handle) override {}
  void motionBegin(std::vector<float>) override {}
  void motionEnd() override {}
  void resourceBegin() override {}
  void resourceEnd() override {}
  void format(int, int, double) override {}
  void frameAspectRatio(double) override {}
  void screenWindow(double, double, double, double) override {}
  void cropWindow(double, double, double, double) override {}
  void projection(std::string, ParamList) override {}
  void clipping(double, double) override {}
  void clippingPlane(DVec3, DVec3) override {}
  void depthOfField(double, double, double) override {}
  void depthOfField() override {}
  void shutter(double, double) override {}
  void camera(std::string, ParamList) override {}
  void pixelVariance(double) override {}
  void pixelSamples(double, double) override {}
  void pixelFilter(std::string, double, double) override {}
  void exposure(double, double) override {}
  void quantize(std::string, int, int, int, double) override {}
  void display(std::string, std::string, std::string, ParamList) override {}
  void displayChannel(std::string, ParamList) override {}
  void hider(std::string, ParamList) override {}
  void colorSamples(std::vector<float>, std::vector<float>) override {}
  void relativeDetail(double) override {}
  void option(std::string, ParamList) override {}
  void color(std::span<const float>) override {}
  void opacity(std::span<const float>) override {}
  void textureCoordinates(const std::array<float, 8>&) override {}
  void shader(ShaderKind, std::string, ParamList) override {}
  void lightSource(std::string, Handle, ParamList) override {}
  void areaLightSource(std::string, Handle, ParamList) override {}
  void illuminate(Handle, bool) override {}
  void shaderLayer(std::string, std::string, std::string, ParamList) override {}
  void connectShaderLayers(std::string, std::string, std::string, std::string, std::string) override {}
  void shadingRate(double) override {}
  void shadingInterpolation(std::string) override {}
  void matte(bool) override {}
  void bound(const Bound&) override {}
  void detail(const Bound&) override {}
  void detailRange(double, double, double, double) override {}
  void geometricApproximation(std::string, double) override {}
  void geometricRepresentation(std::string) override {}
  void orientation(std::string) override {}
  void reverseOrientation() override {}
  void sides(int) override {}
  void attribute(std::string, ParamList) override {}
  void basis(BasisArgument, BasisArgument) override {}
  void trimCurve(TrimCurve) override {}
  void resource(std::string, std::string, ParamList) override {}
  void identity() override {}
  void transform(const DMat4&) override {}
  void concatTransform(const DMat4&) override {}
  void perspective(double) override {}
  void translate(DVec3) override {}
  void rotate(double, DVec3) override {}
  void scale(DVec3) override {}
  void skew(double, DVec3, DVec3) override {}
  void coordinateSystem(std::string) override {}
  void scopedCoordinateSystem(std::string) override {}
  void coordSysTransform(std::string) override {}
  void primitive(Primitive) override {}
  void procedural(Procedural) override {}
  void makeTexture(MakeKind, MakeTextureArgs) override {}
  void errorHandler(std::string) override {}
  void declare(std::string, std::string) override {}
  void readArchive(std::string, ParamList) override {}
  void archiveBegin(Handle, ParamList) override {}
  void archiveEnd() override {}
  void archiveRecord(RecordKind, std::string) override {}
};

}  // namespace fr::ri
