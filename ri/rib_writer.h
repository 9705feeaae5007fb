// A renderer whose output is RIB: ASCII or binary.
#pragma once

#include <array>
#include <functional>
#include <map>
#include <string>
#include <string_view>
#include <unordered_map>

#include "ri/renderer.h"

namespace fr::ri {

struct RibWriterOptions {
  /// The encoding of RISpec 3.2, Table C.1: about half as large, and read ten times as fast.
  bool binary = false;
  /// ASCII: spaces per level of blocks; lines are broken at `width` columns (0: never).
  int indent = 0, width = 0;
  /// Parameters that came with a bare name are written so (Declare requests go along); else every parameter
  /// has an inline declaration.
  bool keepBareNames = false;
};

/// Every number is written so that reading it again gives the same bits. One request per line. Not
/// thread-safe.
class RibWriter : public Renderer {
 public:
  /// `write` receives the text in pieces of whole requests.
  explicit RibWriter(std::function<void(std::string_view)> write, RibWriterOptions options = {});
  ~RibWriter() override;
  void flush();

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
  void version(double number) override;
  void conditional(std::string_view request, std::string condition) override;

 private:
  // Each appends to the line begun by put(); end() finishes it.
  RibWriter& put(std::string_view request);
  RibWriter& add(double v);
  RibWriter& add(int v);
  RibWriter& add(const std::string& s);
  RibWriter& add(const Handle& h);
  RibWriter& add(const ParamList& params);
  RibWriter& add(const DMat4& m);
  RibWriter& add(const std::vector<float>& v);
  RibWriter& add(const std::vector<double>& v);
  RibWriter& add(const std::vector<int>& v);
  RibWriter& add(const std::vector<std::string>& v);
  void end();
  void space();
  template <class T>
  RibWriter& addArray(const std::vector<T>& v);
  void string(std::string_view s);
  void binaryInteger(int64_t v);
  void binaryFloat(float v);
  void binaryNumber(double v);
  void binaryLength(unsigned char code, size_t n);
  void define(std::string_view text);

  std::function<void(std::string_view)> write_;
  RibWriterOptions options_;
  std::string text_;
  size_t lineBegin_ = 0;
  int depth_ = 0;
  // Binary: definitions go before the request that needs them.
  std::string definitions_;
  std::map<std::string, unsigned char, std::less<>> requestCodes_;
  std::unordered_map<std::string, int> strings_;  // token, or -1: seen once
  int stringTokens_ = 0;
};

}  // namespace fr::ri
