// SceneBuilder: procedural primitives (RISpec 3.2, section 5.6).
//
// They wait until the world ends: then it is known which of them the camera sees, and whether any shader can
// ask for rays. If none can, what is out of view is never opened. Inside a solid they are expanded where they
// stand: their surfaces are part of it.
#include <algorithm>
#include <filesystem>

#include "ri/rib_writer.h"
#include "ri/search_path.h"
#include "scene_cache/building_world.h"

namespace fr::cache {
namespace {

using Kind = ProceduralRequest::Kind;

const char* kindName(Kind k) {
  static constexpr const char* kNames[] = {"DelayedReadArchive", "RunProgram", "DynamicLoad"};
  return kNames[size_t(k)];
}

/// Where the innermost file stands.
std::string folderOf(const ri::Reader::Place& place) {
  for (auto name = place->rbegin(); name != place->rend(); ++name)
    if (name->starts_with('/')) return std::filesystem::path(*name).parent_path().string();
  return ".";
}

}  // namespace

void SceneBuilder::onProcedural(const ri::PlacedProcedural& p) {
  if (!adding() || !p.source) return;
  if (!detailThinning(*p.attributes).seen()) {
    ++world_->counts.otherDetail;
    return;
  }
  if (!reader_) {
    ++world_->counts.dropped;
    return notImplemented("Procedural in this program", "left out", p.location);
  }
  auto request = proceduralRequest(*p.source, *p.attributes);
  if (!request) {
    ++world_->counts.dropped;
    Error e = std::move(request).error();
    e.where = p.location;
    return report(e);
  }
  Waiting w{p.source, std::move(request).value(), state().scope(), reader_->place(), p.location, sides_};
  w.scope.attributes = p.attributes;
  w.scope.ctm = p.objectToWorld;
  if (world_->solids.open()) {
    expand(w, extentOf(*w.scope.ctm, w.request.bound).pixels, true);
  } else {
    waiting_.push_back(std::move(w));
  }
}

ScreenExtent SceneBuilder::extentOf(const ri::Transform& objectToWorld, const ri::Bound& bound) const {
  const SkeletonWriter& w = world_->writer;
  ScreenCamera camera;
  camera.record = w.camera();
  const TransformKeys keys = w.transform(camera.record.worldToCamera);
  camera.worldToCamera = keys.matrices;
  for (int i = 0; i < 2; ++i) camera.filterRadius[i] = double(w.options().filterWidth[i]) / 2;
  ScreenExtent e = screenExtent(camera, objectToWorld.matrices, bound);
  if (e.pixels < double(kRiInfinity)) e.pixels *= state().options().relativeDetail;
  return e;
}

bool SceneBuilder::raysArePossible() const {
  if (!options_.asksRays) return true;
  const auto paths = state().options().searchPaths.find("shader");
  static const std::vector<std::string> none;
  const std::vector<std::string>& folders =
      paths == state().options().searchPaths.end() ? none : paths->second;
  SkeletonWriter& w = world_->writer;
  std::set<StringId> asked;
  for (ShaderId i = 0; i < w.shaderCount(); ++i) {
    const ShaderRecord& s = w.shader(i);
    if ((s.kind == ShaderKind::kLight && (s.lightFlags & kLightShadows) != 0) ||
        (asked.insert(s.name).second && options_.asksRays(std::string(w.string(s.name)), folders)))
      return true;
  }
  return false;
}

Thinning SceneBuilder::detailThinning(const ri::AttributeState& a) const {
  const auto& [offLow, onLow, onHigh, offHigh] = a.detailRange;
  constexpr float kEverything = kRiInfinity;
  if (onLow <= 0 && onHigh >= kEverything) return {};
  const double detail = a.detail ? extentOf(*a.detailSpace, *a.detail).pixels : double(kRiInfinity);
  const auto ramp = [detail](float off, float on) {
    return float(std::clamp((detail - double(off)) / (double(on) - double(off)), 0.0, 1.0));
  };
  Thinning t;
  if (onLow > offLow)
    t.below = 1 - ramp(offLow, onLow);
  else if (onLow > 0 && !(detail > double(onLow)))
    t.below = 1;
  if (offHigh > onHigh && offHigh < kEverything)
    t.above = 1 - ramp(offHigh, onHigh);
  else if (!(detail <= double(offHigh)))
    t.above = 1;
  if (!world_->solids.open() && a.areaLight < 0) return t;
  return t.below <= 0.5f && 0.5f < 1 - t.above ? Thinning{} : Thinning{1, 1};
}

bool SceneBuilder::boundedOut(const ri::PlacedPrimitive& p) const {
  const ri::AttributeState& a = *p.attributes;
  return a.bound && options_.asksRays && !everythingIsSeen_ && (sides_ & kForReyes) && a.areaLight < 0 &&
         !world_->solids.open() && !extentOf(*a.boundSpace, *a.bound).inView;
}

void SceneBuilder::expandWaiting() {
  std::deque<Waiting> outOfView;
  const uint8_t sides = sides_;
  bool& everything = everythingIsSeen_ = false;
  for (;;) {
    while (!waiting_.empty()) {
      Waiting p = std::move(waiting_.front());
      waiting_.pop_front();
      if (stopped_ || failure_ || abortRequested()) continue;
      const ScreenExtent extent = extentOf(*p.scope.ctm, p.request.bound);
      if (everything || extent.inView || p.request.immediate || !(p.sides & kForReyes)) {
        expand(p, extent.pixels, false);
      } else {
        outOfView.push_back(std::move(p));
      }
    }
    if (outOfView.empty() && outOfView_.empty()) break;
    // What is in view is complete: these are all the shaders there will be.
    if (!raysArePossible()) break;
    everything = true;
    waiting_.swap(outOfView);
    for (const auto& [primitive, itsSides] : std::exchange(outOfView_, {})) {
      sides_ = itsSides;
      onPrimitive(primitive);
    }
    sides_ = sides;
  }
  everything = false;
  world_->counts.proceduralsUnopened += outOfView.size();
  world_->counts.outOfBound += outOfView_.size();
  outOfView_.clear();
}

void SceneBuilder::expand(const Waiting& p, double detail, bool collect) {
  const uint8_t sides = std::exchange(sides_, p.sides);
  Result<void> r;
  const auto now = [&] { r = reader_->at(p.place, [&] { return expandNow(p, detail, collect); }); };
  within(p.scope, now);
  sides_ = sides;
  ++world_->counts.procedurals;
  if (r) return;
  ++world_->counts.dropped;
  Error e = std::move(r).error();
  if (e.where.file.empty()) e.where = p.location;
  report(std::move(e).context(
      fmt::format("Procedural \"{}\" \"{}\"", kindName(p.request.kind), p.request.name)));
}

/// REQUIRES the procedural's scope to be in force.
Result<void> SceneBuilder::expandNow(const Waiting& p, double detail, bool collect) {
  const ProceduralRequest& r = p.request;
  if (r.kind == Kind::kArchive) return reader_->readArchive(r.name);
  std::vector<std::string> folders = searchPath("procedural");
  folders.push_back(folderOf(p.place));
  folders.emplace_back(".");
  ProceduralPrograms::Question q;
  q.patience = std::chrono::milliseconds(int64_t(
      std::clamp(double(state().options().values.getFloat("procedural:patience", 120)), 0.0, 1e9) * 1000));
  if (r.kind == Kind::kProgram) {
    q.command = commandWords(r.name);
    if (q.command.empty()) return makeError(RiError::kSyntax, "this is no command");
    if (std::string found = ri::findFile(q.command[0], folders); !found.empty())
      q.command[0] = std::move(found);
    q.text = fmt::format("{} {}\n", float(detail), r.data);
    return askProgram(p, std::move(q), collect);
  }
  std::string file = ri::findFile(r.name, folders);
  if (file.empty()) file = ri::findFile(r.name + ".so", folders);
  if (file.empty()) return makeError(RiError::kNoFile, "it was not found in {}", fmt::join(folders, ":"));
  q.command = {sharedObjectProgram(), file};
  q.text = sharedObjectQuestion(state(), dictionary(), *p.source, detail);
  return askProgram(p, std::move(q), collect);
}

Result<void> SceneBuilder::askProgram(const Waiting& p, ProceduralPrograms::Question question, bool collect) {
  const std::string name = fmt::format("<{}>", p.request.name);
  if (!collect)
    return programs_.ask(question, [&](auto input, auto tables) {
      return reader_->readInput(std::move(input), name, std::move(tables));
    });
  // The whole answer is taken before anything of it is obeyed: what it holds may ask the same program.
  std::string text;
  ri::RibWriter writer([&text](std::string_view part) { text += part; });
  writer.dictionary() = dictionary();
  ri::Reader copier(writer, ri::ReaderOptions::rewriting());
  const Result<void> r = programs_.ask(question, [&](auto input, auto tables) {
    return copier.readInput(std::move(input), name, std::move(tables));
  });
  writer.flush();
  const Result<void> read = reader_->readBuffer(text, name);
  return r ? read : r;
}

}  // namespace fr::cache
