#include "reyes/test_scene.h"

#include <gtest/gtest.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>

#include "scene_cache/trim.h"

namespace fr {
namespace {
reyes::TestScene* current = nullptr;
}

// ---- scene cache
// ------------------------------------------------------------------------------------------------

namespace cache {

struct SceneCache::Impl {
  reyes::TestScene* scene;
  void* map = nullptr;
  size_t size = 0;
  ~Impl() { ::munmap(map, size); }
};

SceneCache::SceneCache() = default;
SceneCache::~SceneCache() = default;

Result<std::unique_ptr<SceneCache>> SceneCache::create(int fd, const std::string&) {
  std::unique_ptr<SceneCache> c(new SceneCache);
  c->impl_ = std::make_unique<Impl>();
  c->impl_->scene = current;
  struct stat info {};
  ::fstat(fd, &info);
  c->impl_->size = size_t(info.st_size);
  c->impl_->map = ::mmap(nullptr, size_t(info.st_size), PROT_READ, MAP_SHARED, fd, 0);
  auto s = Skeleton::open({static_cast<const std::byte*>(c->impl_->map), c->impl_->size}, false);
  if (!s) return s.error();
  c->skeleton_ = *s;
  return c;
}

ResolvedNode SceneCache::resolve(NodeId id) {
  reyes::TestScene& s = *impl_->scene;
  ++s.resolved;
  const auto& n = s.nodes[id];
  ResolvedNode r;
  if (n.grid) {
    r.state = NodeState::kGrid;
    r.grid = &n.record;
  } else {
    r.state = NodeState::kSplit;
    r.children[0] = n.children[0], r.children[1] = n.children[1];
  }
  return r;
}
const PatchNode& SceneCache::node(NodeId id) const { return impl_->scene->nodes[id].node; }
const ObjectRecord& SceneCache::objectOf(NodeId id) const {
  return skeleton_.objects()[impl_->scene->nodes[id].object];
}
// Nothing is trimmed here.
PatchTrim SceneCache::trimOf(NodeId) const { return {}; }
bool TrimTest::removed(double, double) const { return false; }
GridView SceneCache::view(const GridRecord& g) const {
  const reyes::TestGrid* grid = impl_->scene->nodes[g.node].grid;
  static_assert(sizeof(Vec3) == 3 * sizeof(float));
  return {&g, &grid->positions[0].x, nullptr, grid->indices.empty() ? nullptr : grid->indices.data()};
}

}  // namespace cache

// ---- shading
// ----------------------------------------------------------------------------------------------------

struct ShadingSystem::Impl {
  cache::SceneCache* cache;
};
// NOLINTNEXTLINE(performance-unnecessary-value-param): the signature of the class this stands in for
ShadingSystem::ShadingSystem(cache::SceneCache& cache, Options) : impl_(new Impl{&cache}) {}
ShadingSystem::~ShadingSystem() = default;
bool ShadingSystem::canAskRays() const {
  for (const auto& s : current->surfaces)
    if (s.rayRounds > 0) return true;
  return false;
}
bool ShadingSystem::isOpaque(cache::AttributeId a) const { return current->surfaces[a].opaque; }
int ShadingSystem::outputComponents(std::string_view) const { return 0; }
bool ShadingSystem::runImager(size_t, const float*, const float*, float* const[3], float* const[3], float*) {
  return false;
}

struct ShadeTask::Impl {
  ShadePoints points;
  std::vector<float> values[6];
  int round = 0;
  const reyes::TestSurface* surface = nullptr;
};
ShadeTask::ShadeTask(ShadingSystem&) : impl_(new Impl) {}
ShadeTask::~ShadeTask() = default;
void ShadeTask::begin(const ShadePoints& points) {
  impl_->points = points;
  impl_->round = 0;
  ++current->shaded;
  const auto& node = current->nodes[points.grid->node];
  impl_->surface = &current->surfaces[current->patches[node.node.root].surface];
  for (auto& v : impl_->values) v.resize(points.count);
  for (size_t i = 0; i < points.count; ++i) {
    const bool grid = points.topology == ShadePoints::Topology::kGrid;
    const Color c = impl_->surface->color(node.grid->positions[grid ? points.vertexOf(i) : i]);
    for (int k = 0; k < 3; ++k) {
      impl_->values[k][i] = c[k] * impl_->surface->opacity[k];
      impl_->values[3 + k][i] = impl_->surface->opacity[k];
    }
  }
}
ShadeTask::Status ShadeTask::run() {
  return impl_->round++ < impl_->surface->rayRounds ? Status::kNeedsRays : Status::kDone;
}
uint32_t ShadeTask::rayCount() const { return uint32_t(impl_->points.count); }
void ShadeTask::writeRays(RayQuery& q) const {
  q.kind = RayKind::kHitTest, q.count = rayCount(), q.level = 1;
  for (uint32_t i = 0; i < q.count; ++i) q.seed[i] = impl_->points.gridSeed + i;
}
void ShadeTask::readAnswers(const RayQuery& q) {
  for (uint32_t i = 0; i < q.count; ++i) impl_->values[1][i] += q.hitDistance[i];
}
void ShadeTask::missAll() {}
const float* ShadeTask::color(int c) const { return impl_->values[c].data(); }
const float* ShadeTask::opacity(int c) const { return impl_->values[3 + c].data(); }
const float* ShadeTask::output(std::string_view name, int c) const {
  return name == "Cs" ? impl_->values[c].data() : nullptr;
}

// ---- the scene
// --------------------------------------------------------------------------------------------------

namespace reyes {

TestScene::TestScene(int width, int height) {
  camera.projection = cache::ProjectionType::kOrthographic;
  camera.fov = 90;
  camera.resolution[0] = width, camera.resolution[1] = height;
  camera.screenWindow[1] = float(width), camera.screenWindow[2] = -float(height);
  camera.cropWindow[1] = camera.cropWindow[3] = 1;
  camera.cropPixels[1] = width - 1, camera.cropPixels[3] = height - 1;
  camera.pixelAspect = 1, camera.frameAspect = float(width) / float(height);
  camera.clipping[0] = 0.1f, camera.clipping[1] = 1000;
  camera.dof[0] = kRiInfinity;
  current = this;
}
TestScene::~TestScene() {
  cache_.reset();
  current = nullptr;
}

void TestScene::setPerspective(float fov) {
  camera.projection = cache::ProjectionType::kPerspective;
  camera.fov = fov;
  const float w = float(camera.resolution[0]), h = float(camera.resolution[1]), s = std::min(w, h);
  const float window[4] = {-w / s, w / s, -h / s, h / s};
  std::copy_n(window, 4, camera.screenWindow);
}

uint32_t TestScene::addSurface(TestSurface s) {
  surfaces.push_back(std::move(s));
  return uint32_t(surfaces.size() - 1);
}
void TestScene::addPatch(uint32_t surface, std::vector<TestGrid> grids) {
  patches.push_back({surface, std::move(grids)});
}
void TestScene::addQuad(uint32_t surface, Vec3 p00, Vec3 p10, Vec3 p01, Vec3 p11, int nu, int nv) {
  TestGrid g{nu, nv, {}, {}};
  for (int j = 0; j <= nv; ++j)
    for (int i = 0; i <= nu; ++i) {
      const float u = float(i) / float(nu), v = float(j) / float(nv);
      g.positions.push_back((1 - v) * ((1 - u) * p00 + u * p10) + v * ((1 - u) * p01 + u * p11));
    }
  addPatch(surface, {std::move(g)});
}
void TestScene::addRasterRect(uint32_t surface, float x0, float y0, float x1, float y1, float z, int nu,
                              int nv) {
  addQuad(surface, {x0, -y0, z}, {x1, -y0, z}, {x0, -y1, z}, {x1, -y1, z}, nu, nv);
}

void TestScene::makeNode(cache::NodeId id, uint32_t root, const std::vector<uint32_t>& grids, int depth,
                         uint32_t iu) {
  Node& n = nodes[id];
  n.object = root;
  n.node.root = root, n.node.iu = iu, n.node.iv = 0, n.node.du = uint8_t(depth), n.node.dv = 0;
  for (uint32_t g : grids)
    for (const Vec3& p : patches[root].grids[g].positions)
      if (isFinite(p)) n.node.bound.extend(p);
  if (grids.size() == 1) {
    n.grid = &patches[root].grids[grids[0]];
    n.record = {};
    n.record.node = id;
    n.record.keyCount = 1;
    n.record.kind = n.grid->nu > 0 ? cache::GridKind::kGrid : cache::GridKind::kMeshlet;
    const bool grid = n.grid->nu > 0;
    n.record.nu = uint16_t(grid ? n.grid->nu : int(n.grid->positions.size()));
    n.record.nv = uint16_t(grid ? n.grid->nv : int(n.grid->indices.size() / 3));
    n.record.rowStride = uint32_t(n.record.nu) + 1;
    n.record.bound = n.node.bound;
    return;
  }
  const size_t half = grids.size() / 2;
  const auto first = cache::NodeId(nodes.size());
  nodes[id].children[0] = first, nodes[id].children[1] = first + 1;
  nodes.emplace_back(), nodes.emplace_back();
  makeNode(first, root, {grids.begin(), grids.begin() + ptrdiff_t(half)}, depth + 1, 2 * iu);
  makeNode(first + 1, root, {grids.begin() + ptrdiff_t(half), grids.end()}, depth + 1, 2 * iu + 1);
}

cache::SceneCache& TestScene::cache() {
  if (cache_) return *cache_;
  using namespace fr::cache;
  nodes.clear();
  nodes.resize(patches.size());
  for (uint32_t p = 0; p < patches.size(); ++p) {
    std::vector<uint32_t> all;
    for (uint32_t g = 0; g < patches[p].grids.size(); ++g) all.push_back(g);
    makeNode(p, p, all, 0, 0);
  }
  auto writer = SkeletonWriter::create();
  SkeletonWriter& w = *writer;
  OptionsRecord o{};
  std::copy_n(pixelSamples, 2, o.pixelSamples);
  std::copy_n(filterWidth, 2, o.filterWidth);
  o.filter = w.intern(filter);
  o.hider = w.intern("hidden");
  o.imager = kNone;
  o.exposure[0] = o.exposure[1] = 1;
  const int32_t jitterValue[] = {jitter ? 1 : 0};
  const ParamRecord hider = w.makeIntegerParam("jitter", ParamClass::kUniform, 1, jitterValue);
  o.hiderParams = w.addParams({&hider, 1});
  if (!displayName.empty()) {
    DisplayRecord d{};
    d.name = w.intern(displayName), d.type = w.intern(displayType), d.mode = w.intern(displayMode);
    d.exposure[0] = d.exposure[1] = 1;
    o.displays = w.addDisplays({&d, 1});
  }
  const TransformId identity = w.addTransform({{0}, {DMat4(1.0)}});
  camera.worldToCamera = identity;
  w.setCamera(camera);
  w.setOptions(o);
  std::vector<AttributeId> ids;
  for (size_t i = 0; i < surfaces.size(); ++i) {
    AttributeRecord a{};
    a.surface = a.displacement = a.atmosphere = a.interior = a.exterior = kNone;
    a.shadingRate = 1 + float(i);  // so that no two are the same state
    a.flags = (surfaces[i].matte ? kMatte : 0u) | (surfaces[i].smooth ? kSmoothShading : 0u) |
              (surfaces[i].reverse ? kReverseOrientation : 0u);
    a.sides = surfaces[i].sides;
    a.visibility = kVisibleCamera;
    ids.push_back(w.addAttributes(a));
    EXPECT_EQ(ids.back(), i);
  }
  for (uint32_t p = 0; p < patches.size(); ++p) {
    ObjectRecord ob{};
    ob.type = PrimitiveType::kBilinearPatches;
    ob.sides = kForReyes;
    ob.keyCount = 1;
    ob.attributes = ids[patches[p].surface];
    ob.transform = identity;
    ob.firstPatch = p, ob.patchCount = 1;
    ob.bound = nodes[p].node.bound;
    const ObjectId object = w.addObject(ob);
    RootPatchRecord r{};
    r.object = object, r.firstEdge = kNone, r.bound = ob.bound;
    w.addRootPatch(r);
  }
  auto fd = w.finish();
  EXPECT_TRUE(fd) << fd.error().str();
  auto made = SceneCache::create(*fd);
  ::close(*fd);
  EXPECT_TRUE(made) << made.error().str();
  cache_ = std::move(*made);
  return *cache_;
}

double TestScene::Image::mean(int c) const {
  double sum = 0;
  for (float v : channels[size_t(c)]) sum += double(v);
  return sum / double(channels[size_t(c)].size());
}

TestScene::Image TestScene::render(const RenderOptions& asked, RayOracleService* oracle) {
  cache::SceneCache& c = cache();
  ShadingSystem shading(c, {});
  Image image;
  const PixelRect crop{camera.cropPixels[0], camera.cropPixels[2], camera.cropPixels[1] + 1,
                       camera.cropPixels[3] + 1};
  image.width = crop.width(), image.height = crop.height();
  RenderOptions options = asked;
  options.writeDisplays = !displayName.empty();
  options.pixels = [&](const FilmTile& t) {
    if (image.channels.empty())
      image.channels.resize(t.channels.size(), std::vector<float>(size_t(crop.area()), -1.0f));
    size_t i = 0;
    for (int y = t.rect.y0; y < t.rect.y1; ++y)
      for (int x = t.rect.x0; x < t.rect.x1; ++x, ++i)
        for (size_t k = 0; k < t.channels.size(); ++k)
          image.channels[k][size_t(y - crop.y0) * size_t(crop.width()) + size_t(x - crop.x0)] =
              t.channels[k][i];
  };
  auto r = renderFrame(c, shading, oracle, options);
  EXPECT_TRUE(r) << r.error().str();
  if (r) image.statistics = *r;
  return image;
}

}  // namespace reyes
}  // namespace fr
