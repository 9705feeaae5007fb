#include "ri/graphics_state.h"

#include <algorithm>
#include <atomic>

namespace fr::ri {
namespace {

// Before anyone writes to an object that only we hold now, whatever other threads did with their copies of
// the pointer is over.
void acquireSoleOwnership() { std::atomic_thread_fence(std::memory_order_acquire); }

DMat4 rows(std::array<double, 16> a) {
  DMat4 m;
  for (int i = 0; i < 16; ++i) m[i / 4][i % 4] = a[size_t(i)];
  return m;
}

TransformPtr identityTransform() {
  static const TransformPtr& t = *new TransformPtr(std::make_shared<const Transform>());
  return t;
}

}  // namespace

const Param* NamedValues::find(std::string_view category, std::string_view name) const {
  return find(fmt::format("{}:{}", category, name));
}
const Param* NamedValues::find(std::string_view categoryAndName) const {
  const auto it = map_->find(categoryAndName);
  return it == map_->end() ? nullptr : &it->second;
}
void NamedValues::set(std::string_view category, Param p) {
  if (map_.use_count() > 1) {
    map_ = std::make_shared<Map>(*map_);
  } else {
    acquireSoleOwnership();
  }
  std::string key = fmt::format("{}:{}", category, p.name);
  map_->insert_or_assign(std::move(key), std::move(p));
}
float NamedValues::getFloat(std::string_view n, float otherwise) const {
  const Param* p = find(n);
  return p ? toFloat(*p, otherwise) : otherwise;
}
int NamedValues::getInt(std::string_view n, int otherwise) const {
  const Param* p = find(n);
  return p ? toInt(*p, otherwise) : otherwise;
}
std::string NamedValues::getString(std::string_view n, std::string_view otherwise) const {
  const Param* p = find(n);
  return p && !p->strings.empty() ? p->strings[0] : std::string(otherwise);
}
Color NamedValues::getColor(std::string_view n, const Color& otherwise) const {
  const Param* p = find(n);
  return p ? toColor(*p, otherwise) : otherwise;
}

std::optional<DMat4> namedBasis(std::string_view name) {
  if (name == "bezier") return rows({-1, 3, -3, 1, 3, -6, 3, 0, -3, 3, 0, 0, 1, 0, 0, 0});
  if (name == "b-spline") {
    return rows({-1. / 6, 3. / 6, -3. / 6, 1. / 6, 3. / 6, -6. / 6, 3. / 6, 0, -3. / 6, 0, 3. / 6, 0, 1. / 6,
                 4. / 6, 1. / 6, 0});
  }
  if (name == "catmull-rom") return rows({-.5, 1.5, -1.5, .5, 1, -2.5, 2, -.5, -.5, 0, .5, 0, 0, 1, 0, 0});
  if (name == "hermite") return rows({2, 1, -2, 1, -3, -2, 3, -1, 0, 1, 0, 0, 1, 0, 0, 0});
  if (name == "power") return DMat4(1);
  return std::nullopt;
}

AttributeState::AttributeState() {
  static const std::shared_ptr<const Basis>& bezier = *[] {
    return new std::shared_ptr<const Basis>(
        std::make_shared<const Basis>(Basis{*namedBasis("bezier"), *namedBasis("bezier"), 3, 3}));
  }();
  basis = bezier;
}

const char* blockName(BlockKind k) {
  static constexpr const char* kNames[] = {"Frame", "World",  "Attribute", "Transform",
                                           "Solid", "Object", "Motion",    "Resource"};
  return kNames[size_t(k)];
}

GraphicsState::GraphicsState()
    : attributes_(std::make_shared<AttributeState>()),
      ctm_(identityTransform()),
      worldToCamera_(identityTransform()),
      scopedSpaces_(std::make_shared<SpaceMap>()) {}

bool GraphicsState::inside(BlockKind kind) const {
  return std::any_of(stack_.begin(), stack_.end(), [&](const Saved& s) { return s.kind == kind; });
}

bool GraphicsState::mayEnd(BlockKind kind) const {
  return std::any_of(stack_.begin() + ptrdiff_t(std::min(floor_, stack_.size())), stack_.end(),
                     [&](const Saved& s) { return s.kind == kind; });
}

void GraphicsState::setScope(const Scope& scope) {
  // Nobody writes to a state that someone else holds: editAttributes() copies it first.
  attributes_ = std::const_pointer_cast<AttributeState>(scope.attributes);
  ctm_ = scope.ctm;
  scopedSpaces_ = scope.scopedSpaces;
}

std::optional<BlockKind> GraphicsState::top() const {
  if (stack_.empty()) return std::nullopt;
  return stack_.back().kind;
}

Result<void> GraphicsState::begin(BlockKind kind) {
  const auto within = [&](BlockKind outer) {
    return makeError(RiError::kNesting, "{}Begin inside a {} block", blockName(kind), blockName(outer));
  };
  constexpr size_t kDeepest = 100000;  // a file of nothing but openings must not eat the memory
  if (stack_.size() >= kDeepest)
    return makeError(RiError::kLimit, "blocks are nested deeper than {}", kDeepest);
  if (kind == BlockKind::kFrame || kind == BlockKind::kWorld) {
    if (inWorld()) return within(BlockKind::kWorld);
    if (kind == BlockKind::kFrame && inside(BlockKind::kFrame)) return within(BlockKind::kFrame);
    if (inside(BlockKind::kObject)) return within(BlockKind::kObject);
  }
  if (kind == BlockKind::kObject && inside(BlockKind::kObject)) return within(BlockKind::kObject);

  Saved s;
  s.kind = kind;
  s.ctm = ctm_;
  if (kind != BlockKind::kTransform) {
    s.attributes = attributes_;
    s.scopedSpaces = scopedSpaces_;
  }
  if (kind == BlockKind::kFrame) s.options = std::make_unique<Options>(options_);
  s.lights = lights_.size();
  stack_.push_back(std::move(s));
  if (kind == BlockKind::kWorld) {
    worldToCamera_ = ctm_;
    ctm_ = identityTransform();
  }
  if (kind == BlockKind::kObject) ctm_ = identityTransform();
  return {};
}

void GraphicsState::pop() {
  Saved& s = stack_.back();
  ctm_ = std::move(s.ctm);
  if (s.attributes) {
    attributes_ = std::const_pointer_cast<AttributeState>(s.attributes);
    s.attributes.reset();
    scopedSpaces_ = std::move(s.scopedSpaces);
  }
  if (s.options) options_ = std::move(*s.options);
  if (s.kind == BlockKind::kWorld || s.kind == BlockKind::kFrame) {
    // The lights and the spaces of the world go with it.
    lights_.resize(s.lights);
    std::erase_if(lightHandles_, [&](const auto& h) { return h.second >= int(s.lights); });
    std::erase_if(spaces_, [](const auto& n) { return n.second.base == SpaceBase::kWorld; });
  }
  if (s.kind == BlockKind::kWorld) worldToCamera_ = identityTransform();
  stack_.pop_back();
}

Result<void> GraphicsState::end(BlockKind kind) {
  if (!inside(kind))
    return makeError(RiError::kNesting, "{}End without {}Begin", blockName(kind), blockName(kind));
  if (!mayEnd(kind))
    return makeError(RiError::kNesting, "{}End for a block that was open before; ignored", blockName(kind));
  if (stack_.back().kind == kind) {
    pop();
    return {};
  }
  // The end of something large closes what was forgotten inside; the end of something small is ignored.
  const bool large = kind == BlockKind::kFrame || kind == BlockKind::kWorld || kind == BlockKind::kObject;
  const BlockKind open = stack_.back().kind;
  if (!large) {
    return makeError(RiError::kNesting, "{}End inside a {} block; ignored", blockName(kind), blockName(open));
  }
  while (stack_.back().kind != kind) pop();
  pop();
  return {};
}

AttributeState& GraphicsState::editAttributes() {
  if (attributes_.use_count() > 1) {
    attributes_ = std::make_shared<AttributeState>(*attributes_);
  } else {
    acquireSoleOwnership();
  }
  return *attributes_;
}

void GraphicsState::concatenate(const Transform& t) { setCtm(concat(*ctm_, t)); }

void GraphicsState::setProjection(std::string name, ParamList params) {
  options_.projection = std::move(name);
  options_.projectionParams = std::move(params);
  options_.screenTransform = ctm_;
  ctm_ = identityTransform();
}

const LightInstance& GraphicsState::addLight(Handle handle, bool isArea, ShaderPtr shader) {
  LightInstance l;
  l.index = int(lights_.size());
  l.handle = std::move(handle);
  l.isArea = isArea;
  l.shader = std::move(shader);
  l.attributes = attributes_;
  lightHandles_.insert_or_assign(l.handle.name, l.index);
  lights_.push_back(std::move(l));
  illuminate(lights_.back().index, true);
  if (isArea) editAttributes().areaLight = lights_.back().index;
  return lights_.back();
}

const LightInstance* GraphicsState::findLight(const Handle& handle) const {
  const auto it = lightHandles_.find(handle.name);
  return it == lightHandles_.end() ? nullptr : &lights_[size_t(it->second)];
}

void GraphicsState::illuminate(int light, bool on) {
  const std::vector<int>& now = *attributes_->lights;
  const auto at = std::lower_bound(now.begin(), now.end(), light);
  const bool isOn = at != now.end() && *at == light;
  if (isOn == on) return;
  auto changed = std::make_shared<std::vector<int>>(now);
  if (on) {
    changed->insert(changed->begin() + (at - now.begin()), light);
  } else {
    changed->erase(changed->begin() + (at - now.begin()));
  }
  editAttributes().lights = std::move(changed);
}

void GraphicsState::nameSpace(std::string name, bool scoped) {
  if (!scoped) {
    spaces_.insert_or_assign(std::move(name), place());
    return;
  }
  auto changed = std::make_shared<SpaceMap>(*scopedSpaces_);
  changed->insert_or_assign(std::move(name), place());
  scopedSpaces_ = std::move(changed);
}

Result<PlacedTransform> GraphicsState::findSpace(std::string_view name) const {
  if (const auto it = scopedSpaces_->find(name); it != scopedSpaces_->end()) return it->second;
  if (const auto it = spaces_.find(name); it != spaces_.end()) return it->second;
  if (name == "world" && inWorld()) return PlacedTransform{identityTransform(), SpaceBase::kWorld};
  if (name == "world") return PlacedTransform{ctm_, SpaceBase::kCamera};  // where the world would begin now
  if (name == "camera" || name == "eye") return PlacedTransform{identityTransform(), SpaceBase::kCamera};
  if (name == "object" || name == "shader" || name == "current") return place();
  return makeError(RiError::kBadToken, "coordinate system \"{}\" is not known", name);
}

std::map<std::string, PlacedTransform, std::less<>> GraphicsState::namedSpaces() const {
  SpaceMap all = *scopedSpaces_;
  all.insert(spaces_.begin(), spaces_.end());
  return all;
}

Result<TransformPtr> GraphicsState::toWorld(const PlacedTransform& t) const {
  if (t.base == SpaceBase::kWorld) return t.keys;
  Result<Transform> cameraToWorld = inverse(*worldToCamera_);
  if (!cameraToWorld) return cameraToWorld.error();
  return std::make_shared<const Transform>(concat(*cameraToWorld, *t.keys));
}

}  // namespace fr::ri
