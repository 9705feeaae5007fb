// Turns RI calls into skeletons: one per world.
//
// ri::StateRenderer keeps the graphics state; here the state in force at each primitive becomes records. The
// mapping of attributes stands in attribute_records.h, that of camera and options in frame_records.h.
#pragma once

#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "ri/reader.h"
#include "ri/state_renderer.h"
#include "scene_cache/attribute_records.h"
#include "scene_cache/primitive_run.h"
#include "scene_cache/procedural_programs.h"
#include "scene_cache/procedural_request.h"
#include "scene_cache/scene_loader.h"
#include "scene_cache/screen_extent.h"
#include "scene_cache/skeleton_writer.h"

namespace fr::cache {

/// The ray tracer's stream of files, when it has files of its own (tracer_stream.h). Called at every WorldEnd
/// of the image's stream: adds the tracer's geometry of the same world; nullptr: that world is read over.
class WorldFiller {
 public:
  virtual ~WorldFiller() = default;
  virtual void fill(SkeletonWriter* writer, FrameCounts* counts) = 0;
};

/// Where a builder of the tracer's stream gets its worlds from.
class WorldSource {
 public:
  virtual ~WorldSource() = default;
  /// At WorldBegin: where to add to; nullptr: read the world over.
  virtual std::pair<SkeletonWriter*, FrameCounts*> take() = 0;
  /// At WorldEnd.
  virtual void giveBack() = 0;
};

class SceneBuilder : public ri::StateRenderer {
 public:
  /// Of the image's stream: makes frames. `filler` may be nullptr.
  SceneBuilder(const LoadOptions& options, FrameCallback onFrame, PathLists standardPaths,
               WorldFiller* filler = nullptr);
  /// Of the ray tracer's stream: adds what only the tracer sees to worlds made elsewhere.
  SceneBuilder(const LoadOptions& options, WorldSource* source, PathLists standardPaths);
  ~SceneBuilder() override;

  /// Which renderer sees what is read from now on (RibInput::sides).
  void setSides(uint8_t sides) { sides_ = sides; }
  /// Who reads what procedurals expand to: the reader that feeds this builder, with its inline archives.
  /// Without one they are left out.
  void setReader(ri::Reader* reader) { reader_ = reader; }
  /// True when the callback asked to stop or the error handler "abort" was triggered: everything is read
  /// over.
  bool stopped() const { return stopped_; }
  /// The first system error (no memory), if any: the worlds it hit were not delivered.
  const std::optional<Error>& failure() const { return failure_; }

  void scopedCoordinateSystem(std::string name) override;

 protected:
  void onWorldBegin() override;
  void onWorldEnd() override;
  void onPrimitive(const ri::PlacedPrimitive& p) override;
  void onProcedural(const ri::PlacedProcedural& p) override;
  void onSolidBegin(const std::string& operation) override;
  void onSolidEnd() override;
  void onMakeTexture(ri::MakeKind kind, const ri::MakeTextureArgs& args) override;
  void onInstance(const ri::RetainedObject& object, const ri::AttributePtr& attributes,
                  const ri::TransformPtr& objectToWorld) override;

 private:
  struct World;
  struct OwnWorld;
  /// False between worlds, in frames that are read over, and for common files in the tracer's stream: the
  /// image's stream has added their geometry.
  bool adding() const { return world_ && !(source_ && (sides_ & kForReyes)); }
  /// A procedural of this world that has not been expanded yet.
  struct Waiting {
    std::shared_ptr<const ri::Procedural> source;
    ProceduralRequest request;
    ri::GraphicsState::Scope scope;
    ri::Reader::Place place;
    SourceLocation location;
    uint8_t sides = 0;
  };
  ScreenExtent extentOf(const ri::Transform& objectToWorld, const ri::Bound& bound) const;
  /// RISpec 3.2, "Detail": which samples see geometry made under these attributes. In a transition those with
  /// a low chance see the representation that is left, the others the one that is entered: each sees one,
  /// and shares are the representations' importance. Solids and area lights change in the middle at once.
  Thinning detailThinning(const ri::AttributeState& a) const;
  /// Whether the Bound in force says that no camera ray meets the primitive, and it may wait until it is
  /// known whether others can.
  bool boundedOut(const ri::PlacedPrimitive& p) const;
  /// Whether any shader of the world that is being built can ask for rays.
  bool raysArePossible() const;
  void expandWaiting();
  void expand(const Waiting& p, double detail, bool collect);
  Result<void> expandNow(const Waiting& p, double detail, bool collect);
  Result<void> askProgram(const Waiting& p, ProceduralPrograms::Question question, bool collect);
  /// Adds objects; false when that failed, which was reported. `fixedRate` > 0: a prototype.
  bool add(const ri::PlacedPrimitive& p, float fixedRate);
  struct Retained;
  bool canShare(const ri::RetainedObject& object, const ri::AttributeState& attributes,
                const ri::Transform& objectToWorld) const;
  /// Micropolygons per unit of object space for the prototypes that an instance shows; 0: it has grids of its
  /// own.
  float sharedRate(const Retained& known, const AttributeRecord& attributes,
                   const DMat4& objectToCache) const;
  void addInstance(const ri::RetainedObject& object, const ri::AttributePtr& attributes,
                   const ri::Transform& objectToWorld, Retained* known, float rate);
  /// Adds what was taken together.
  void endRun();
  void addNow(const ri::PlacedPrimitive& p, uint32_t requests);
  void deliver();
  void teapot(const ri::PlacedPrimitive& p);
  void notImplemented(std::string_view request, std::string_view consequence, const SourceLocation& where);

  LoadOptions options_;
  FrameCallback onFrame_;
  ri::Reader* reader_ = nullptr;
  std::deque<Waiting> waiting_;
  std::vector<std::pair<ri::PlacedPrimitive, uint8_t>> outOfView_;  // with their sides
  bool everythingIsSeen_ = false;  // this world has shaders that ask for rays
  ProceduralPrograms programs_;
  WorldFiller* filler_ = nullptr;
  WorldSource* source_ = nullptr;  // not null: the tracer's stream
  uint8_t sides_ = kForReyes | kForTracer;
  PrimitiveRun run_;
  std::unique_ptr<OwnWorld> own_;
  std::unique_ptr<World> world_;  // null outside worlds and in frames that are read over
  int worldsSeen_ = 0;
  bool stopped_ = false;
  std::optional<Error> failure_;
  std::set<std::string, std::less<>> saidNotImplemented_;
};

}  // namespace fr::cache
