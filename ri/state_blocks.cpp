// StateRenderer: blocks, transformations, motion, retained objects.
#include <algorithm>
#include <cmath>

#include "ri/state_renderer.h"

namespace fr::ri {

StateRenderer::StateRenderer(PathLists standardPaths) : standardPaths_(std::move(standardPaths)) {
  state_.editOptions().searchPaths = standardPaths_;
}
StateRenderer::~StateRenderer() = default;

void StateRenderer::reportOnceHere(RiError code, Severity severity, std::string message) {
  constexpr size_t kMost = 1000;
  if (said_.size() < kMost && said_.insert(message).second) reportHere(code, severity, std::move(message));
}

bool StateRenderer::check(Result<void> r) {
  if (!r) reportHere(r.error().code, r.error().severity, r.error().message);
  return r.ok();
}

void StateRenderer::finish() {
  if (motion_) motionEnd();
  while (const std::optional<BlockKind> kind = state_.top()) {
    reportHere(RiError::kNesting, Severity::kError,
               fmt::format("the input ends inside a {} block", blockName(*kind)));
    switch (*kind) {
      case BlockKind::kWorld:
        worldEnd();
        break;
      case BlockKind::kFrame:
        frameEnd();
        break;
      case BlockKind::kObject:
        objectEnd();
        break;
      case BlockKind::kSolid:
        solidEnd();
        break;
      default:
        closeBlock(*kind);
        break;
    }
  }
}

void StateRenderer::closeBlock(BlockKind kind) { check(state_.end(kind)); }

void StateRenderer::within(const GraphicsState::Scope& scope, const std::function<void()>& read) {
  if (!check(state_.begin(BlockKind::kAttribute))) return;
  const int depth = state_.depth();
  const size_t floor = state_.raiseFloor();
  state_.setScope(scope);
  read();
  if (motion_) {
    reportHere(RiError::kNesting, Severity::kError, "MotionBegin without MotionEnd");
    motionEnd();
  }
  while (state_.depth() > depth) {
    const BlockKind open = *state_.top();
    reportHere(RiError::kNesting, Severity::kError,
               fmt::format("{}Begin without {}End", blockName(open), blockName(open)));
    switch (open) {
      case BlockKind::kObject:
        objectEnd();
        break;
      case BlockKind::kSolid:
        solidEnd();
        break;
      default:
        closeBlock(open);
        break;
    }
  }
  state_.restoreFloor(floor);
  closeBlock(BlockKind::kAttribute);
}

void StateRenderer::frameBegin(int number) {
  if (!check(state_.begin(BlockKind::kFrame))) return;
  state_.setFrame(number);
  onFrameBegin(number);
}

void StateRenderer::frameEnd() {
  if (state_.inside(BlockKind::kFrame) && !state_.mayEnd(BlockKind::kFrame))
    return closeBlock(BlockKind::kFrame);
  if (state_.inWorld() && state_.inside(BlockKind::kFrame)) {
    reportHere(RiError::kNesting, Severity::kError, "FrameEnd inside a World block; the world ends here");
    worldEnd();
  }
  if (state_.inside(BlockKind::kFrame)) onFrameEnd();
  closeBlock(BlockKind::kFrame);
}

void StateRenderer::worldBegin() {
  if (check(state_.begin(BlockKind::kWorld))) onWorldBegin();
}

void StateRenderer::worldEnd() {
  if (state_.inWorld() && !state_.mayEnd(BlockKind::kWorld)) return closeBlock(BlockKind::kWorld);
  if (motion_) {
    reportHere(RiError::kNesting, Severity::kError, "WorldEnd inside a Motion block; the motion ends here");
    motionEnd();
  }
  if (object_) {
    reportHere(RiError::kNesting, Severity::kError, "WorldEnd inside an Object block; the object ends here");
    objectEnd();
  }
  if (state_.inWorld()) {
    while (*state_.top() != BlockKind::kWorld) {
      const BlockKind open = *state_.top();
      reportHere(RiError::kNesting, Severity::kError,
                 fmt::format("WorldEnd inside a {} block; it ends here", blockName(open)));
      open == BlockKind::kSolid ? solidEnd() : closeBlock(open);
    }
    onWorldEnd();
    // They name lights of this world.
    for (auto& saved : resources_) saved.clear();
  }
  closeBlock(BlockKind::kWorld);
}

void StateRenderer::attributeBegin() { check(state_.begin(BlockKind::kAttribute)); }
void StateRenderer::attributeEnd() { closeBlock(BlockKind::kAttribute); }
void StateRenderer::transformBegin() { check(state_.begin(BlockKind::kTransform)); }
void StateRenderer::transformEnd() { closeBlock(BlockKind::kTransform); }

void StateRenderer::resourceBegin() { resources_.emplace_back(); }
void StateRenderer::resourceEnd() {
  if (resources_.size() == 1)
    return void(check(makeError(RiError::kNesting, "ResourceEnd without ResourceBegin")));
  resources_.pop_back();
}

void StateRenderer::solidBegin(std::string operation) {
  if (operation != "primitive" && operation != "union" && operation != "intersection" &&
      operation != "difference") {
    reportHere(RiError::kBadToken, Severity::kError,
               fmt::format("SolidBegin: \"{}\" is no operation", operation));
    operation = "primitive";
  }
  if (!check(state_.begin(BlockKind::kSolid))) return;
  if (object_) return addShape({RetainedObject::SolidStart{std::move(operation)}, nullptr, location()});
  onSolidBegin(operation);
}

void StateRenderer::solidEnd() {
  if (state_.top() == BlockKind::kSolid && state_.mayEnd(BlockKind::kSolid)) {
    if (object_) {
      addShape({RetainedObject::SolidStop{}, nullptr, location()});
    } else {
      onSolidEnd();
    }
  }
  closeBlock(BlockKind::kSolid);
}

// ---- retained objects ----

void StateRenderer::objectBegin(Handle handle) {
  if (!check(state_.begin(BlockKind::kObject))) return;
  object_ = std::make_shared<RetainedObject>();
  object_->handle = std::move(handle);
}

void StateRenderer::objectEnd() {
  if (object_) {
    std::string name = object_->handle.name;
    objects_.insert_or_assign(std::move(name), std::move(object_));
    object_.reset();
  }
  closeBlock(BlockKind::kObject);
}

void StateRenderer::addShape(RetainedObject::Shape shape) {
  shape.toObject = state_.shareCtm();
  object_->shapes.push_back(std::move(shape));
}

void StateRenderer::objectInstance(Handle handle) {
  const auto it = objects_.find(handle.name);
  if (it == objects_.end()) {
    return reportHere(RiError::kBadHandle, Severity::kError,
                      fmt::format("ObjectInstance: object \"{}\" is not known", handle.name));
  }
  if (object_) {
    // Each level may multiply the number of shapes; no scene needs many.
    constexpr int kDeepest = 8;
    if (it->second->nesting + 1 > kDeepest) {
      return reportHere(RiError::kLimit, Severity::kError,
                        fmt::format("instances are nested deeper than {}", kDeepest));
    }
    object_->nesting = std::max(object_->nesting, it->second->nesting + 1);
    return addShape({it->second, nullptr, location()});
  }
  if (!state_.inWorld()) {
    return reportHere(RiError::kNotPrimitives, Severity::kError,
                      "ObjectInstance outside WorldBegin and WorldEnd");
  }
  onInstance(*it->second, state_.shareAttributes(), state_.shareCtm());
}

void StateRenderer::onInstance(const RetainedObject& object, const AttributePtr& attributes,
                               const TransformPtr& objectToWorld) {
  for (const RetainedObject::Shape& s : object.shapes) {
    auto placed = std::make_shared<const Transform>(concat(*objectToWorld, *s.toObject));
    if (const auto* p = std::get_if<MovingPrimitivePtr>(&s.what)) {
      onPrimitive({*p, attributes, std::move(placed)});
    } else if (const auto* q = std::get_if<std::shared_ptr<const Procedural>>(&s.what)) {
      onProcedural({*q, attributes, std::move(placed), s.location});
    } else if (const auto* o = std::get_if<std::shared_ptr<const RetainedObject>>(&s.what)) {
      onInstance(**o, attributes, placed);
    } else if (const auto* b = std::get_if<RetainedObject::SolidStart>(&s.what)) {
      onSolidBegin(b->operation);
    } else {
      onSolidEnd();
    }
  }
}

// ---- motion ----

void StateRenderer::motionBegin(std::vector<float> times) {
  if (motion_)
    return reportHere(RiError::kNesting, Severity::kError, "MotionBegin inside a Motion block; ignored");
  const bool ascending = std::adjacent_find(times.begin(), times.end(),
                                            [](float a, float b) { return !(a < b); }) == times.end();
  const bool finite = std::all_of(times.begin(), times.end(), [](float t) { return std::isfinite(t); });
  if (times.empty() || !ascending || !finite) {
    reportHere(RiError::kBadMotion, Severity::kError,
               "MotionBegin: the times must ascend; only the first sample is used");
    times.assign(1, 0.f);
  }
  motion_.emplace();
  motion_->times = std::move(times);
  motion_->location = location();
}

// Called by every request that may move. True: act on it as if there were no motion block (there is none, or
// it is the first sample of a request that is not interpolated here).
bool StateRenderer::motionSample(const std::string& request) {
  if (!motion_) return true;
  if (motion_->request.empty()) motion_->request = request;
  if (motion_->request != request) {
    reportHere(RiError::kBadMotion, Severity::kError,
               fmt::format("{} in a motion block of {}; ignored", request, motion_->request));
    return false;
  }
  ++motion_->count;
  return motion_->count == 1;
}

void StateRenderer::motionEnd() {
  if (!motion_) return void(check(makeError(RiError::kNesting, "MotionEnd without MotionBegin")));
  MotionBlock m = std::move(*motion_);
  motion_.reset();
  const size_t n = m.times.size();
  if (m.count != n) {
    reportHere(RiError::kBadMotion, m.count < n ? Severity::kError : Severity::kWarning,
               fmt::format("a motion block with {} times holds {} requests", n, m.count));
  }
  if (m.zooms.size() == m.count) {
    // A camera that zooms is one that stands still and sees everything grow across its line of sight.
    for (const double zoom : m.zooms)
      m.transforms.push_back(
          {TransformRequest::Kind::kScale, {m.zooms.front() / zoom, m.zooms.front() / zoom, 1}});
  }
  if (!m.transforms.empty()) {
    m.transforms.resize(std::min(m.transforms.size(), n));
    m.times.resize(m.transforms.size());
    Result<Transform> t = movingTransform(m.times, m.transforms);
    if (!t) return void(check(t.error()));
    if (m.transforms.front().replaces()) {
      state_.setCtm(std::move(*t));
    } else {
      state_.concatenate(*t);
    }
  } else if (!m.primitives.empty()) {
    m.primitives.resize(std::min(m.primitives.size(), n));
    m.times.resize(m.primitives.size());
    emit(std::move(m.times), std::move(m.primitives));
  } else if (!endMovingAttribute(m) && m.count > 1) {
    reportOnceHere(RiError::kUnimplemented, Severity::kWarning,
                   fmt::format("motion of {} is not rendered; its first sample is used", m.request));
  }
}

// ---- transformations ----

void StateRenderer::applyTransform(TransformRequest request) {
  Result<DMat4> m = request.matrix();
  if (!m) return void(check(m.error()));
  if (motion_) {
    const std::string name = transformRequestName(request.kind);
    motionSample(name);
    if (motion_->request == name) motion_->transforms.push_back(request);
    return;
  }
  if (request.replaces()) {
    state_.setCtm(Transform(*m));
  } else {
    state_.concatenate(Transform(*m));
  }
}

namespace {
using Kind = TransformRequest::Kind;
TransformRequest withMatrix(Kind k, const DMat4& m) {
  TransformRequest r{k, {}};
  for (int i = 0; i < 16; ++i) r.args[size_t(i)] = m[i / 4][i % 4];
  return r;
}
}  // namespace

void StateRenderer::identity() { applyTransform(withMatrix(Kind::kIdentity, DMat4(1))); }
void StateRenderer::transform(const DMat4& m) { applyTransform(withMatrix(Kind::kTransform, m)); }
void StateRenderer::concatTransform(const DMat4& m) { applyTransform(withMatrix(Kind::kConcat, m)); }
void StateRenderer::perspective(double fov) { applyTransform({Kind::kPerspective, {fov}}); }
void StateRenderer::translate(DVec3 t) { applyTransform({Kind::kTranslate, {t.x, t.y, t.z}}); }
void StateRenderer::rotate(double angle, DVec3 a) { applyTransform({Kind::kRotate, {angle, a.x, a.y, a.z}}); }
void StateRenderer::scale(DVec3 s) { applyTransform({Kind::kScale, {s.x, s.y, s.z}}); }
void StateRenderer::skew(double angle, DVec3 a, DVec3 b) {
  applyTransform({Kind::kSkew, {angle, a.x, a.y, a.z, b.x, b.y, b.z}});
}

void StateRenderer::coordinateSystem(std::string name) { state_.nameSpace(std::move(name), false); }
void StateRenderer::scopedCoordinateSystem(std::string name) { state_.nameSpace(std::move(name), true); }

void StateRenderer::coordSysTransform(std::string name) {
  Result<PlacedTransform> space = state_.findSpace(name);
  if (!space) return void(check(space.error()));
  if (!state_.inWorld()) return state_.setCtm(*space->keys);
  Result<TransformPtr> t = state_.toWorld(*space);
  if (!t) return void(check(t.error()));
  state_.setCtm(**t);
}

}  // namespace fr::ri
