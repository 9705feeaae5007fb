#include "scene_cache/scene_builder.h"

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>

#include "scene_cache/building_world.h"
#include "scene_cache/frame_records.h"
#include "scene_cache/primitive.h"
#include "scene_cache/teapot.h"

namespace fr::cache {

Frame::~Frame() {
  if (fd_ >= 0) close(fd_);
}

SceneBuilder::SceneBuilder(const LoadOptions& options, FrameCallback onFrame, PathLists standardPaths,
                           WorldFiller* filler)
    : StateRenderer(std::move(standardPaths)),
      options_(options),
      onFrame_(std::move(onFrame)),
      filler_(filler) {}
SceneBuilder::SceneBuilder(const LoadOptions& options, WorldSource* source, PathLists standardPaths)
    : StateRenderer(std::move(standardPaths)), options_(options), source_(source) {}
SceneBuilder::~SceneBuilder() = default;

namespace {

bool isThin(const ri::Primitive& p) {
  return std::holds_alternative<ri::Points>(p) || std::holds_alternative<ri::Curves>(p);
}

}  // namespace

void SceneBuilder::notImplemented(std::string_view request, std::string_view consequence,
                                  const SourceLocation& where) {
  if (!saidNotImplemented_.emplace(request).second) return;
  report({RiError::kUnimplemented, Severity::kWarning, where,
          fmt::format("{} is not implemented; {} (said once)", request, consequence)});
}

// ---- worlds -----------------------------------------------------------------------------------------------

void SceneBuilder::onWorldBegin() {
  if (source_) {
    if (const auto [writer, counts] = source_->take(); writer) {
      const bool mirrored = isMirrored(writer->transform(writer->camera().worldToCamera).matrices.front());
      world_ = std::make_unique<World>(*writer, *counts, state(), mirrored, options_);
    }
    return;
  }
  ++worldsSeen_;
  if (abortRequested()) stopped_ = true;
  const int number = state().inside(ri::BlockKind::kFrame) ? state().frame() : worldsSeen_;
  const bool wanted =
      !options_.frames || (number >= options_.frames->first && number <= options_.frames->second);
  if (stopped_ || failure_ || !wanted) return;
  auto writer = SkeletonWriter::create(options_.scratch);
  if (!writer) {
    failure_ = std::move(writer).error();
    return;
  }
  own_ = std::make_unique<OwnWorld>(std::move(writer).value());
  own_->number = number;
  const ri::TransformPtr camera = state().worldToCamera();
  world_ = std::make_unique<World>(own_->writer, own_->counts, state(),
                                   camera && isMirrored(camera->matrices.front()), options_);
  writeFrameRecords(overridden(state().options(), options_.overrides, options_.defaults), camera, number,
                    world_->records, &own_->writer);
}

void SceneBuilder::onWorldEnd() {
  if (world_) {
    endRun();
    expandWaiting();
    endRun();
    for (const auto& [name, place] : state().namedSpaces())
      if (auto t = state().toWorld(place)) world_->writer.addNamedSpace(name, world_->records.transform(*t));
    world_->counts.lights += world_->records.lightCount();
    if (source_) mergeTracerOptions(state().options(), &world_->writer);
    world_.reset();
  }
  if (source_) return source_->giveBack();
  if (filler_) filler_->fill(own_ ? &own_->writer : nullptr, own_ ? &own_->counts : nullptr);
  if (own_) deliver();
}

void SceneBuilder::deliver() {
  auto fd = own_->writer.finish(options_.checksum);
  const int number = own_->number;
  FrameCounts counts = own_->counts;
  counts.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - own_->start).count();
  own_.reset();  // free what building needed before the frame is rendered
  if (!fd) {
    failure_ = std::move(fd).error();
    return;
  }
  SkeletonHeader header{};
  if (pread(*fd, &header, sizeof(header), 0) != ssize_t(sizeof(header))) header.totalBytes = 0;
  if (!onFrame_(Frame(number, *fd, header.totalBytes, counts))) stopped_ = true;
}

// ---- geometry ---------------------------------------------------------------------------------------------

void SceneBuilder::onPrimitive(const ri::PlacedPrimitive& p) {
  if (!adding() || !p.source || p.source->samples.empty()) return;
  World& w = *world_;
  const ri::MovingPrimitive& source = *p.source;
  const ri::Primitive& primitive = source.samples.front();
  if (const auto* g = std::get_if<ri::Geometry>(&primitive); g && g->type == "teapot") return teapot(p);
  if (!detailThinning(*p.attributes).seen()) {
    ++w.counts.otherDetail;
    return;
  }
  if (boundedOut(p)) {
    outOfView_.emplace_back(p, sides_);
    return;
  }

  if (!w.solids.open() && run_.take(p, sides_)) return;
  endRun();
  if (w.solids.open() || !run_.take(p, sides_)) addNow(p, 1);
}

void SceneBuilder::endRun() {
  if (run_.empty()) return;
  const uint8_t sides = std::exchange(sides_, run_.sides());
  const uint32_t requests = run_.requests();
  addNow(run_.end(), requests);
  sides_ = sides;
}

void SceneBuilder::addNow(const ri::PlacedPrimitive& p, uint32_t requests) {
  World& w = *world_;
  const ObjectId firstObject = w.writer.nextObject();
  if (!add(p, 0)) return;
  w.counts.primitives += requests;
  if (!w.writer.ok() || w.writer.nextObject() == firstObject) return;
  if (p.attributes->areaLight >= 0)
    if (const ShaderId light = w.records.light(p.attributes->areaLight); light != kNone) {
      ShaderRecord& record = w.writer.shader(light);
      if (record.areaLightObject == kNone) record.areaLightObject = firstObject;
    }
}

bool SceneBuilder::add(const ri::PlacedPrimitive& p, float fixedRate) {
  World& w = *world_;
  const ri::MovingPrimitive& source = *p.source;
  const ri::Primitive& primitive = source.samples.front();
  for (const DMat4& m : p.objectToWorld->matrices)
    for (int c = 0; c < 4; ++c)
      if (!std::isfinite(m[c].x + m[c].y + m[c].z + m[c].w)) {
        report({RiError::kMath, Severity::kError, source.location,
                fmt::format("{}: its transformation is not finite; left out", ri::primitiveName(primitive))});
        ++w.counts.dropped;
        return false;
      }

  PrimitiveDesc d;
  d.primitive = &primitive;
  d.counts = source.counts;
  d.uBasis = source.basis->u, d.vBasis = source.basis->v;
  d.steps = {source.basis->uStep, source.basis->vStep};
  d.trimCurve = source.trimCurve.get();
  d.trimOutside = d.trimCurve && p.attributes->values.getString("trimcurve:sense", "inside") == "outside";
  std::vector<const ri::Primitive*> keys;
  if (source.samples.size() > 1) {
    for (const ri::Primitive& s : source.samples) keys.push_back(&s);
    d.keys = keys;
    d.keyTimes = source.times;
  }
  d.transform = w.records.transform(p.objectToWorld);
  if (isThin(primitive)) {
    if (w.solids.open())
      reportOnce("thin solid",
                 {RiError::kBadSolid, Severity::kWarning, source.location,
                  fmt::format("{} bound no solid; rendered as they are", ri::primitiveName(primitive))});
  } else {
    d.solid = w.solids.leaf();
  }
  d.attributes =
      w.records.attributes(w.records.withStrings(p.attributes, ri::paramsOf(primitive)), p.objectToWorld,
                           detailThinning(*p.attributes), d.solid != kNone && w.solids.isSubtracted(d.solid));
  d.sides = fixedRate > 0 ? 0 : sides_;
  d.fixedRate = fixedRate;
  d.surfaceGroup = w.writer.surfaceGroup(d.attributes, d.transform, d.solid);
  d.locationFile = w.writer.intern(source.location.file);
  d.locationLine = uint32_t(std::max(source.location.line, 0));
  d.location = source.location;

  const ObjectId firstObject = w.writer.nextObject();
  const NodeId firstPatch = w.writer.nextRootPatch();
  const uint32_t firstEdge = w.writer.nextEdge();
  auto added = addPrimitive(w.writer, d);
  if (added) return true;
  w.writer.rollBack(firstObject, firstPatch, firstEdge);
  ++w.counts.dropped;
  Error e = std::move(added).error();
  if (e.code == RiError::kUnimplemented) {
    notImplemented(ri::primitiveName(primitive), "left out", source.location);
  } else {
    if (e.where.file.empty()) e.where = source.location;
    const char* name = ri::primitiveName(primitive);
    report(e.message.starts_with(name) ? e : std::move(e).context(name));
  }
  return false;
}

void SceneBuilder::teapot(const ri::PlacedPrimitive& p) {
  endRun();  // before anything is inside its solid
  const SolidBlocks::Whole whole(world_->solids);
  auto bezier = std::make_shared<ri::Basis>();
  bezier->u = bezier->v = ri::namedBasis("bezier").value_or(DMat4(1));
  for (ri::Patch& patch : teapotPatches()) {
    // Variables of the whole teapot that mean something on each patch: the constant ones.
    for (const ri::Param& v : ri::paramsOf(p.source->samples.front()))
      if (v.declaration.storage == ri::StorageClass::kConstant) patch.params.set(v);
    auto source = std::make_shared<ri::MovingPrimitive>();
    source->samples.emplace_back(std::move(patch));
    auto checked = ri::checkPrimitive(source->samples[0], {bezier->uStep, bezier->vStep});
    FR_CHECK(checked.ok());
    source->counts = checked->counts;
    source->basis = bezier;
    source->location = p.source->location;
    onPrimitive({source, p.attributes, p.objectToWorld});
  }
  endRun();
}

void SceneBuilder::onSolidBegin(const std::string& operation) {
  if (!adding()) return;
  endRun();
  if (!world_->solids.begin(operation))
    report({RiError::kBadSolid, Severity::kError, location(),
            "a Solid block in SolidBegin \"primitive\": its surfaces bound the outer solid"});
}

void SceneBuilder::onSolidEnd() {
  if (adding()) world_->solids.end();
}

void SceneBuilder::onMakeTexture(ri::MakeKind kind, const ri::MakeTextureArgs& args) {
  // The image's stream has executed what stands in common files.
  if (stopped_ || failure_ || (source_ && (sides_ & kForReyes))) return;
  // What belongs to a frame that is read over has no pictures.
  if (options_.frames && state().inside(ri::BlockKind::kFrame) &&
      (state().frame() < options_.frames->first || state().frame() > options_.frames->second))
    return;
  if (!options_.makeTexture)
    return notImplemented("Make... in this program", fmt::format("\"{}\" is not written", args.texture),
                          location());
  std::vector<std::string> folders = searchPath("texture");
  folders.insert(folders.end(), options_.overrides.textureFolders.begin(),
                 options_.overrides.textureFolders.end());
  options_.makeTexture(kind, args, folders, location());
}

void SceneBuilder::scopedCoordinateSystem(std::string name) {
  StateRenderer::scopedCoordinateSystem(name);
  // Gone at the end of the block, but the shaders made inside ask for it when they run.
  if (!world_) return;
  if (auto place = state().findSpace(name))
    if (auto t = state().toWorld(*place)) world_->writer.addNamedSpace(name, world_->records.transform(*t));
}

}  // namespace fr::cache
