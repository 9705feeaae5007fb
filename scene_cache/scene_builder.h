// Turns RI calls into skeletons: one per world.
//
// ri::StateRenderer keeps the graphics state; here the state in force at each primitive becomes records. The
// mapping of attributes stands in attribute_records.h, that of camera and options in frame_records.h.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <set>
#include <string>

#include "ri/state_renderer.h"
#include "scene_cache/attribute_records.h"
#include "scene_cache/scene_loader.h"
#include "scene_cache/skeleton_writer.h"

namespace fr::cache {

class SceneBuilder : public ri::StateRenderer {
 public:
  SceneBuilder(const LoadOptions& options, FrameCallback onFrame, PathLists standardPaths);
  ~SceneBuilder() override;

  /// Which renderer sees what is read from now on (RibInput::sides).
  void setSides(uint8_t sides) { sides_ = sides; }
  /// How the archives of procedurals are read; without it they are left out. The function is called in the
  /// midst of a request, with the state of the procedural in force.
  void setArchiveReader(std::function<Result<void>(const std::string&)> f) { readArchive_ = std::move(f); }
  /// True when the callback asked to stop or the error handler "abort" was triggered: everything is read
  /// over.
  bool stopped() const { return stopped_; }
  /// The first system error (no memory), if any: the worlds it hit were not delivered.
  const std::optional<Error>& failure() const { return failure_; }

  // Requests about the image mean nothing in a file for the ray tracer alone: the image is made by REYES.
  void format(int xres, int yres, double pixelAspect) override;
  void frameAspectRatio(double aspect) override;
  void screenWindow(double left, double right, double bottom, double top) override;
  void cropWindow(double xmin, double xmax, double ymin, double ymax) override;
  void projection(std::string name, ri::ParamList params) override;
  void clipping(double near, double far) override;
  void depthOfField(double fstop, double focalLength, double focalDistance) override;
  void depthOfField() override;
  void pixelVariance(double variance) override;
  void pixelSamples(double x, double y) override;
  void pixelFilter(std::string name, double xwidth, double ywidth) override;
  void exposure(double gain, double gamma) override;
  void quantize(std::string type, int one, int min, int max, double dither) override;
  void display(std::string name, std::string type, std::string mode, ri::ParamList params) override;
  void hider(std::string type, ri::ParamList params) override;
  void scopedCoordinateSystem(std::string name) override;

 protected:
  void onWorldBegin() override;
  void onWorldEnd() override;
  void onPrimitive(const ri::PlacedPrimitive& p) override;
  void onProcedural(const ri::PlacedProcedural& p) override;
  void onLight(const ri::LightInstance& light) override;
  void onSolidBegin(const std::string& operation) override;
  void onMakeTexture(ri::MakeKind kind, const ri::MakeTextureArgs& args) override;
  void onInstance(const ri::RetainedObject& object, const ri::AttributePtr& attributes,
                  const ri::TransformPtr& objectToWorld) override;

 private:
  struct World;
  void teapot(const ri::PlacedPrimitive& p);
  bool imageOption(const char* request);
  void notImplemented(std::string_view request, std::string_view consequence, const SourceLocation& where);

  LoadOptions options_;
  FrameCallback onFrame_;
  std::function<Result<void>(const std::string&)> readArchive_;
  uint8_t sides_ = kForReyes | kForTracer;
  std::unique_ptr<World> world_;  // null outside worlds and in frames that are read over
  int worldsSeen_ = 0;
  bool stopped_ = false;
  std::optional<Error> failure_;
  std::set<std::string, std::less<>> saidNotImplemented_;
};

}  // namespace fr::cache
