#include "tracer/testing/analytic_scene.h"

#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numbers>

#include "scene_cache/trim.h"

namespace fr {
namespace testing {

using namespace cache;

Vec3 analyticPoint(const AnalyticShape& s, double u, double v) {
  const double phi = 2 * std::numbers::pi * u;
  switch (s.kind) {
    case AnalyticShape::kPlane:
      return Vec3(DVec3(s.center) + (2 * u - 1) * DVec3(s.axisU) + (2 * v - 1) * DVec3(s.axisV));
    case AnalyticShape::kTorus: {
      const double theta = 2 * std::numbers::pi * v, r = s.radius + s.tube * std::cos(theta);
      return Vec3(DVec3(s.center) + DVec3(r * std::cos(phi), r * std::sin(phi), s.tube * std::sin(theta)));
    }
    default: {
      const double theta = std::numbers::pi * (v - 0.5), r = s.radius;
      return Vec3(DVec3(s.center) + r * DVec3(std::cos(theta) * std::cos(phi),
                                              std::cos(theta) * std::sin(phi), std::sin(theta)));
    }
  }
}

Vec3 analyticNormal(const AnalyticShape& s, double u, double v) {
  const double phi = 2 * std::numbers::pi * u;
  if (s.kind == AnalyticShape::kPlane)
    return Vec3(glm::normalize(glm::cross(DVec3(s.axisU), DVec3(s.axisV))));
  const double theta =
      s.kind == AnalyticShape::kTorus ? 2 * std::numbers::pi * v : std::numbers::pi * (v - 0.5);
  return Vec3(DVec3(std::cos(theta) * std::cos(phi), std::cos(theta) * std::sin(phi), std::sin(theta)));
}

AnalyticScene::AnalyticScene() { strings_.push_back(""); }

StringId AnalyticScene::intern(const std::string& s) {
  for (size_t i = 0; i < strings_.size(); ++i)
    if (strings_[i] == s) return StringId(i);
  strings_.push_back(s);
  return StringId(strings_.size() - 1);
}

ObjectId AnalyticScene::add(const AnalyticShape& shape, const AnalyticLook& look) {
  const ObjectId id = ObjectId(objects_.size());
  ShaderRecord shader{};
  shader.name = intern(look.shader);
  shader.areaLightObject = shader.attributes = kNone;
  AttributeRecord a{};
  a.color = look.color, a.opacity = look.opacity;
  a.shadingRate = 1;
  a.patchMultiplier = look.patchMultiplier;
  a.flags = shape.inward ? uint32_t(kReverseOrientation) : 0u;
  a.sides = look.sides;
  a.visibility = look.visibility;
  a.castsShadows = look.castsShadows;
  a.surface = ShaderId(shaders_.size());
  a.displacement = a.atmosphere = a.interior = a.exterior = kNone;
  a.bias = look.bias;
  shaders_.push_back(shader);
  ObjectRecord o{};
  o.type = shape.kind == AnalyticShape::kMeshSphere ? PrimitiveType::kMeshlets : PrimitiveType::kSphere;
  o.sides = uint8_t(kForReyes | (look.forTracer ? kForTracer : 0));
  o.keyCount = 1;
  o.attributes = AttributeId(attributes_.size());
  attributes_.push_back(a);
  o.surfaceGroup = shape.group != kNone ? shape.group : 1000 + id;
  o.firstPatch = NodeId(roots_.size());
  o.patchCount = shape.patchesU * shape.patchesV;
  for (uint32_t f = 0; f < o.patchCount; ++f) roots_.push_back({id, f, kNone, 0, {}});
  objects_.push_back(o);
  shapes_.push_back(shape);
  return id;
}

}  // namespace testing

namespace cache {

using testing::AnalyticShape;

// ---- the skeleton's reader, trusting
// ---------------------------------------------------------------------------

namespace {
template <class T>
std::span<const T> table(std::span<const std::byte> b, Range r) {
  return {reinterpret_cast<const T*>(b.data() + r.offset), size_t(r.count)};
}
}  // namespace

Result<Skeleton> Skeleton::open(std::span<const std::byte> bytes, bool) {
  Skeleton s;
  s.bytes_ = bytes;
  s.header_ = reinterpret_cast<const SkeletonHeader*>(bytes.data());
  return s;
}
std::span<const ParamRecord> Skeleton::params(Slice) const { return {}; }
std::span<const ShaderRecord> Skeleton::shaders() const {
  return table<ShaderRecord>(bytes_, header_->shaders);
}
std::span<const AttributeRecord> Skeleton::attributes() const {
  return table<AttributeRecord>(bytes_, header_->attributes);
}
std::span<const ObjectRecord> Skeleton::objects() const {
  return table<ObjectRecord>(bytes_, header_->objects);
}
std::span<const RootPatchRecord> Skeleton::rootPatches() const {
  return table<RootPatchRecord>(bytes_, header_->rootPatches);
}
std::span<const SolidRecord> Skeleton::solids() const { return {}; }
DMat4 Skeleton::placement(const ObjectRecord&) const { return DMat4(1); }
// A camera without a transformation sees everything.
std::span<const TransformRecord> Skeleton::transforms() const { return {}; }
const CameraRecord& Skeleton::camera() const {
  static const CameraRecord camera{};
  return camera;
}
DMat4 Skeleton::cacheToCamera(float) const { return DMat4(1); }
const OptionsRecord& Skeleton::options() const { return table<OptionsRecord>(bytes_, header_->options)[0]; }
std::string_view Skeleton::string(StringId id) const {
  const StringRecord r = table<StringRecord>(bytes_, header_->strings)[id];
  return {reinterpret_cast<const char*>(bytes_.data() + r.offset), r.size};
}
const ParamRecord* Skeleton::find(Slice, std::string_view) const { return nullptr; }
std::span<const StringId> Skeleton::strings(const ParamRecord&) const { return {}; }

// ---- the cache
// -----------------------------------------------------------------------------------------------

struct SceneCache::Impl {
  Segments fds;
  std::span<std::byte> skeleton, nodes, arena;
  std::span<PatchNode> node;
  std::span<const AnalyticShape> shapes;
  Segments owned;

  static std::span<std::byte> map(int fd) {
    struct stat st {};
    FR_CHECK(fstat(fd, &st) == 0);
    void* p = mmap(nullptr, size_t(st.st_size), PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    FR_CHECK(p != MAP_FAILED);
    return {static_cast<std::byte*>(p), size_t(st.st_size)};
  }
  void open() {
    skeleton = map(fds.skeleton), nodes = map(fds.nodes), arena = map(fds.arena);
    node = {reinterpret_cast<PatchNode*>(nodes.data()), nodes.size() / sizeof(PatchNode)};
    const auto* h = reinterpret_cast<const SkeletonHeader*>(skeleton.data());
    shapes = table<AnalyticShape>(skeleton, h->edges);  // this scene has no edges: its shapes stand there
  }
  ~Impl() {
    for (auto s : {skeleton, nodes, arena}) munmap(s.data(), s.size());
    for (int fd : {fds.skeleton, fds.nodes, fds.arena}) close(fd);
  }
};

SceneCache::SceneCache() : impl_(std::make_unique<Impl>()) {}
SceneCache::~SceneCache() = default;

Result<std::unique_ptr<SceneCache>> SceneCache::attach(const Segments& fds, bool, const std::string&) {
  std::unique_ptr<SceneCache> c(new SceneCache);
  c->impl_->fds = {dup(fds.skeleton), dup(fds.nodes), dup(fds.arena)};
  c->impl_->open();
  c->skeleton_ = Skeleton::open(c->impl_->skeleton, false).value();
  return c;
}
CacheStatistics SceneCache::statistics() const { return {}; }
SceneCache::Segments SceneCache::segments() const { return impl_->fds; }
const PatchNode& SceneCache::node(NodeId id) const { return impl_->node[id]; }
uint32_t SceneCache::nodeCount() const { return uint32_t(impl_->node.size()); }
const RootPatchRecord& SceneCache::rootOf(NodeId id) const { return skeleton_.rootPatches()[id]; }
const ObjectRecord& SceneCache::objectOf(NodeId id) const { return skeleton_.objects()[rootOf(id).object]; }
const AttributeRecord& SceneCache::attributesOf(NodeId id) const {
  return skeleton_.attributes()[objectOf(id).attributes];
}
std::span<const std::byte> SceneCache::arena() const { return impl_->arena; }

ResolvedNode SceneCache::peek(NodeId id) const {
  ResolvedNode r;
  const uint64_t state = impl_->node[id].state.load(std::memory_order_acquire);
  r.state = NodeState(state & 3);
  r.grid = reinterpret_cast<const GridRecord*>(impl_->arena.data() + (state >> 2));
  return r;
}
ResolvedNode SceneCache::resolve(NodeId id) { return peek(id); }

// Nothing is trimmed here.
PatchTrim SceneCache::trimOf(NodeId) const { return {}; }
bool TrimTest::removed(double, double) const { return false; }
GridView SceneCache::view(const GridRecord& g) const {
  GridView v;
  v.record = &g;
  v.positions = reinterpret_cast<const float*>(impl_->arena.data() + g.positions);
  v.indices = g.indices ? reinterpret_cast<const uint8_t*>(impl_->arena.data() + g.indices) : nullptr;
  return v;
}

void SceneCache::evaluateSurface(NodeId id, size_t n, const uint32_t* cell, const float* u, const float* v,
                                 const SurfaceOut& out) const {
  const ObjectId object = rootOf(id).object;
  const AnalyticShape& s = impl_->shapes[object];
  const float sign = s.inward ? -1.0f : 1.0f;
  for (size_t i = 0; i < n; ++i) {
    double wu, wv;
    testing::wholeParameters(*this, id, cell ? cell[i] : 0, u[i], v[i], &wu, &wv);
    Vec3 P = testing::analyticPoint(s, wu, wv), N = sign * testing::analyticNormal(s, wu, wv);
    if (s.kind == AnalyticShape::kMeshSphere) {  // a polygon mesh is its facets
      const GridView view = this->view(*peek(id).grid);
      Vec3 corner[3];
      for (int c = 0; c < 3; ++c)
        for (int k = 0; k < 3; ++k)
          corner[c][k] = view.positions[3 * view.indices[3 * cell[i] + uint32_t(c)] + k];
      P = (1 - u[i] - v[i]) * corner[0] + u[i] * corner[1] + v[i] * corner[2];
      const Vec3 ng = glm::cross(corner[1] - corner[0], corner[2] - corner[0]);
      if (glm::length(ng) > 0) N = sign * glm::normalize(ng);
    }
    for (int c = 0; c < 3; ++c) {
      if (out.P[c]) out.P[c][i] = P[c];
      if (out.N[c]) out.N[c][i] = N[c];
      if (out.Ng[c]) out.Ng[c][i] = N[c];
    }
  }
}

void SceneCache::evaluateDiced(NodeId id, size_t n, const uint32_t* cell, const float* u, const float* v,
                               const SurfaceOut& out) const {
  const GridView view = this->view(*peek(id).grid);
  const GridRecord& g = *view.record;
  const auto at = [&](uint32_t k) {
    return Vec3(view.positions[3 * k], view.positions[3 * k + 1], view.positions[3 * k + 2]);
  };
  SurfaceOut rest = out;
  for (auto& p : rest.P) p = nullptr;
  evaluateSurface(id, n, cell, u, v, rest);
  for (size_t i = 0; i < n; ++i) {
    Vec3 P;
    if (g.kind == GridKind::kMeshlet) {
      const uint8_t* t = view.indices + 3 * cell[i];
      P = (1 - u[i] - v[i]) * at(t[0]) + u[i] * at(t[1]) + v[i] * at(t[2]);
    } else {
      const float x = u[i] * g.nu, y = v[i] * g.nv;
      const uint32_t cx = uint32_t(std::clamp(int(x), 0, g.nu - 1)),
                     cy = uint32_t(std::clamp(int(y), 0, g.nv - 1));
      const float fx = x - float(cx), fy = y - float(cy);
      const uint32_t k = cy * g.rowStride + cx;
      P = (1 - fy) * ((1 - fx) * at(k) + fx * at(k + 1)) +
          fy * ((1 - fx) * at(k + g.rowStride) + fx * at(k + g.rowStride + 1));
    }
    for (int c = 0; c < 3; ++c)
      if (out.P[c]) out.P[c][i] = P[c];
  }
}

bool SceneCache::evaluatePrimvar(NodeId, const ParamRecord&, size_t, const uint32_t*, const float*,
                                 const float*, float* const*) const {
  return false;
}

}  // namespace cache

namespace testing {

const AnalyticShape& shapeOf(const SceneCache& cache, ObjectId object) {
  const auto& h = cache.skeleton().header();
  return table<AnalyticShape>(cache.skeleton().bytes(), h.edges)[object];
}

namespace {
/// Parameters within one patch of a meshlet's triangle corner.
void cornerParameters(uint32_t cells, uint32_t cell, int corner, double* u, double* v) {
  const uint32_t quad = cell / 2, x = quad % cells, y = quad / cells;
  static constexpr int kX[2][3] = {{0, 1, 1}, {0, 1, 0}}, kY[2][3] = {{0, 0, 1}, {0, 1, 1}};
  *u = double(x + uint32_t(kX[cell & 1][corner])) / cells;
  *v = double(y + uint32_t(kY[cell & 1][corner])) / cells;
}
}  // namespace

void wholeParameters(const SceneCache& cache, NodeId node, uint32_t cell, float u, float v, double* wu,
                     double* wv) {
  const RootPatchRecord& root = cache.rootOf(node);
  const AnalyticShape& s = shapeOf(cache, root.object);
  double pu = u, pv = v;
  if (s.kind == AnalyticShape::kMeshSphere) {
    pu = pv = 0;
    const double w[3] = {1.0 - double(u) - double(v), u, v};
    for (int c = 0; c < 3; ++c) {
      double cu, cv;
      cornerParameters(s.cells, cell, c, &cu, &cv);
      pu += w[c] * cu, pv += w[c] * cv;
    }
  }
  *wu = (root.face % s.patchesU + pu) / s.patchesU;
  *wv = (root.face / s.patchesU + pv) / s.patchesV;
}

namespace {

/// Distance of p to the shape.
double distanceTo(const AnalyticShape& s, const Vec3& p) {
  const DVec3 d = DVec3(p) - DVec3(s.center);
  switch (s.kind) {
    case AnalyticShape::kPlane:
      return 0;
    case AnalyticShape::kTorus:
      return std::abs(std::hypot(std::hypot(d.x, d.y) - s.radius, d.z) - s.tube);
    default:
      return std::abs(glm::length(d) - s.radius);
  }
}

struct Bytes {
  std::vector<std::byte> data;
  uint64_t reserve(size_t size, size_t align) {
    data.resize((data.size() + align - 1) / align * align);
    const uint64_t at = data.size();
    data.resize(at + size);
    return at;
  }
  template <class T>
  Range add(const std::vector<T>& v) {
    const uint64_t at = reserve(v.size() * sizeof(T), alignof(T) < 64 ? 64 : alignof(T));
    if (!v.empty()) std::memcpy(data.data() + at, v.data(), v.size() * sizeof(T));
    return {at, v.size()};
  }
  int memfd(const char* name) {
    const int fd = memfd_create(name, MFD_CLOEXEC);
    FR_CHECK(fd >= 0);
    reserve(64, 4096);
    FR_CHECK(write(fd, data.data(), data.size()) == ssize_t(data.size()));
    return fd;
  }
};

uint64_t diceInto(Bytes& arena, NodeId node, const AnalyticShape& s, uint32_t face) {
  const uint32_t n = s.cells, side = n + 1;
  const bool mesh = s.kind == AnalyticShape::kMeshSphere;
  const uint64_t at = arena.reserve(sizeof(GridRecord), 64);
  GridRecord g{};
  g.node = node;
  g.kind = mesh ? GridKind::kMeshlet : GridKind::kGrid;
  g.nu = uint16_t(mesh ? side * side : n), g.nv = uint16_t(mesh ? n * n * 2 : n);
  g.rowStride = side;
  const bool moves = s.motion != Vec3(0);
  g.keyBytes = (side * side * 12 + kPositionAlign - 1) / kPositionAlign * kPositionAlign;
  g.keyCount = moves ? 2 : 1;
  g.positions = arena.reserve(g.keyCount * g.keyBytes + 24, kPositionAlign);
  std::vector<Vec3> p(side * side);
  for (uint32_t y = 0; y < side; ++y)
    for (uint32_t x = 0; x < side; ++x)
      p[y * side + x] = analyticPoint(s, (face % s.patchesU + double(x) / n) / s.patchesU,
                                      (face / s.patchesU + double(y) / n) / s.patchesV);
  std::memcpy(arena.data.data() + g.positions, p.data(), p.size() * 12);
  if (moves) {
    std::vector<Vec3> moved = p;
    for (Vec3& q : moved) q += s.motion;
    std::memcpy(arena.data.data() + g.positions + g.keyBytes, moved.data(), moved.size() * 12);
  }
  for (const Vec3& q : p) g.bound.extend(q);
  for (uint32_t y = 0; y < n; ++y)
    for (uint32_t x = 0; x < n; ++x)
      g.cellSize = std::max({g.cellSize, glm::distance(p[y * side + x], p[(y + 1) * side + x + 1]),
                             glm::distance(p[y * side + x + 1], p[(y + 1) * side + x])});
  if (mesh) {
    std::vector<uint8_t> index;
    for (uint32_t t = 0; t < g.nv; ++t)
      for (int c = 0; c < 3; ++c) {
        double cu, cv;
        cornerParameters(n, t, c, &cu, &cv);
        index.push_back(uint8_t(std::lround(cv * n) * side + std::lround(cu * n)));
      }
    g.indices = arena.reserve(index.size(), 16);
    std::memcpy(arena.data.data() + g.indices, index.data(), index.size());
    g.levels = 1;
  } else {
    for (uint32_t k = 1, level = 0; k <= n && n % k == 0 && level < kLevels; k *= 2, ++level) {
      g.levels = uint8_t(level + 1);
      for (uint32_t y = 0; y < n; y += k)
        for (uint32_t x = 0; x < n; x += k)
          for (int q = 0; q < 25; ++q) {
            const float fx = float(q % 5) / 4, fy = float(q / 5) / 4;
            const uint32_t i = y * side + x;
            const Vec3 c = (1 - fy) * ((1 - fx) * p[i] + fx * p[i + k]) +
                           fy * ((1 - fx) * p[i + k * side] + fx * p[i + k * side + k]);
            g.deviation[level] = std::max(g.deviation[level], float(distanceTo(s, c)));
          }
    }
  }
  std::memcpy(arena.data.data() + at, &g, sizeof g);
  return at;
}

}  // namespace

std::unique_ptr<SceneCache> AnalyticScene::finish() {
  Bytes arena, skeleton;
  arena.reserve(64, 64);
  std::vector<PatchNode> nodes(roots_.size());
  for (size_t i = 0; i < roots_.size(); ++i) {
    const uint64_t at = diceInto(arena, NodeId(i), shapes_[roots_[i].object], roots_[i].face);
    nodes[i].state = at << 2 | uint64_t(NodeState::kGrid);
    nodes[i].root = uint32_t(i);
  }
  skeleton.reserve(sizeof(SkeletonHeader), 64);
  SkeletonHeader h{};
  std::vector<StringRecord> strings;
  for (const std::string& s : strings_) {
    const uint64_t at = skeleton.reserve(s.size(), 1);
    std::memcpy(skeleton.data.data() + at, s.data(), s.size());
    strings.push_back({at, uint32_t(s.size()), 0});
  }
  h.strings = skeleton.add(strings);
  h.objects = skeleton.add(objects_);
  h.attributes = skeleton.add(attributes_);
  h.shaders = skeleton.add(shaders_);
  h.rootPatches = skeleton.add(roots_);
  h.edges = skeleton.add(shapes_);
  OptionsRecord options{};
  options.maxRayLevel = maxRayLevel_;
  h.options = skeleton.add(std::vector{options});
  std::memcpy(skeleton.data.data(), &h, sizeof h);
  const SceneCache::Segments fds{skeleton.memfd("skeleton"),
                                 [&] {
                                   const int fd = memfd_create("nodes", MFD_CLOEXEC);
                                   const size_t bytes = nodes.size() * sizeof(PatchNode);
                                   FR_CHECK(write(fd, nodes.data(), bytes) == ssize_t(bytes));
                                   return fd;
                                 }(),
                                 arena.memfd("arena")};
  auto cache = std::move(SceneCache::attach(fds, false)).value();
  for (int fd : {fds.skeleton, fds.nodes, fds.arena}) close(fd);
  return cache;
}

}  // namespace testing
}  // namespace fr
