#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cstring>
#include <memory>
#include <set>

#include "ri/param_list.h"
#include "scene_cache/cache.h"
#include "scene_cache/motion.h"
#include "scene_cache/skeleton_image.h"
#include "scene_cache/skeleton_writer.h"
#include "scene_cache/solids.h"

namespace fr::cache {
namespace {

CameraRecord camera() {
  CameraRecord c{};
  c.fov = 45;
  c.projection = ProjectionType::kPerspective;
  const float window[] = {-1, 1, -1, 1}, crop[] = {0, 1, 0, 1};
  std::copy_n(window, 4, c.screenWindow);
  std::copy_n(crop, 4, c.cropWindow);
  c.resolution[0] = c.resolution[1] = 16;
  c.cropPixels[1] = c.cropPixels[3] = 15;
  c.pixelAspect = c.frameAspect = 1;
  c.clipping[0] = 0.1f, c.clipping[1] = 100;
  c.dof[0] = kRiInfinity;
  return c;
}

OptionsRecord options(SkeletonWriter& w) {
  OptionsRecord o{};
  o.pixelSamples[0] = o.pixelSamples[1] = 2;
  o.filterWidth[0] = o.filterWidth[1] = 2;
  o.filter = w.intern("gaussian");
  o.hider = w.intern("hidden");
  o.imager = kNone;
  return o;
}

AttributeRecord attributes(ShaderId surface) {
  AttributeRecord a{};
  a.color = a.opacity = Color(1);
  a.shadingRate = 1;
  a.patchMultiplier = a.bias = -1;
  a.sides = 2;
  a.surface = surface;
  a.displacement = a.atmosphere = a.interior = a.exterior = kNone;
  return a;
}

/// A small scene that has something in every table.
Result<int> makeScene(bool checksum = true) {
  auto made = SkeletonWriter::create();
  if (!made) return std::move(made).error();
  SkeletonWriter& w = *made;
  CameraRecord c = camera();
  c.worldToCamera = w.addTransform({{0}, {DMat4(1)}});
  OptionsRecord o = options(w);

  DMat4 moved(1);
  moved[3] = DVec4(1, 2, 3, 1);
  const TransformId t = w.addTransform({{0, 1}, {DMat4(1), moved}});
  ri::ParamList shaderParams;
  ri::Param ka;
  ka.name = "Ka";
  ka.floats = {0.5f};
  shaderParams.set(ka);
  ShaderRecord s{};
  s.name = w.intern("plastic");
  s.kind = ShaderKind::kSurface;
  s.transform = t;
  s.params = w.addParams(shaderParams);
  s.areaLightObject = s.attributes = kNone;
  const ShaderId surface = w.addShader(s);
  s.kind = ShaderKind::kLight;
  s.name = w.intern("pointlight");
  const ShaderId light = w.addShader(s);
  s.kind = ShaderKind::kImager;
  o.imager = w.addShader(s);

  AttributeRecord a = attributes(surface);
  a.lights = w.addLightList(std::array{light});
  const StringId names[] = {w.intern("one"), w.intern("two")};
  const ParamRecord attribute = w.makeStringParam("user:name", ParamClass::kUniform, 2, names);
  a.attributes = w.addParams({&attribute, 1});
  const AttributeId state = w.addAttributes(a);

  DisplayRecord d{};
  d.name = w.intern("a.exr"), d.type = w.intern("file"), d.mode = w.intern("rgba");
  o.displays = w.addDisplays({&d, 1});
  w.setCamera(c);
  w.setOptions(o);
  w.setCacheOrigin({1, 2, 3});
  w.addNamedSpace("here", t);
  w.setSearchPaths(std::array<StringId, 5>{0, 0, 0, 0, w.intern("/tmp")});

  ObjectRecord ob{};
  ob.type = PrimitiveType::kSphere;
  ob.sides = 3;
  ob.keyCount = 1;
  ob.attributes = state;
  ob.transform = t;
  ob.patchCount = 2;
  w.addSolid({SolidOperation::kDifference, kNone, 1, 0});
  ob.solidPlus1 = 1 + w.addSolid({SolidOperation::kPrimitive, 0, 1, 0});
  const float source[] = {1, -1, 1, 360};
  ob.source = w.addBlob(std::as_bytes(std::span(source)));
  const float st[] = {0, 0, 1, 0, 0, 1, 1, 1};
  const ParamRecord primvar = w.makeFloatParam("st", ParamClass::kVarying, ParamType::kFloat, 2, st);
  ob.primvars = w.addParams({&primvar, 1});
  const ObjectId object = w.addObject(ob);
  const uint32_t edge = w.addEdges(std::vector<EdgeRecord>(8));
  w.addRootPatch({object, 0, edge, 0, {}});
  w.addRootPatch({object, 1, kNone, 0, {}});
  return w.finish(checksum);
}

/// Reads everything that an id can lead to; the sum keeps the reads.
uint64_t walk(const Skeleton& s) {
  uint64_t sum = 0;
  const auto use = [&](std::span<const ParamRecord> params) {
    for (const ParamRecord& p : params) {
      sum += s.string(p.name).size();
      for (float f : s.floats(p)) sum += f > 0;
      for (int32_t i : s.integers(p)) sum += i > 0;
      for (StringId id : s.strings(p)) sum += s.string(id).size();
    }
  };
  const auto useShader = [&](ShaderId id) {
    if (id == kNone) return;
    const ShaderRecord& r = s.shaders()[id];
    sum += s.string(r.name).size() + s.string(r.handle).size();
    use(s.params(r.params));
    sum += s.toCache(r.transform, 0.5f)[3].x > 0;
    if (r.areaLightObject != kNone) sum += s.objects()[r.areaLightObject].patchCount;
    if (r.attributes != kNone) sum += s.attributes()[r.attributes].sides;
  };
  for (const AttributeRecord& a : s.attributes()) {
    for (const ShaderId id : {a.surface, a.displacement, a.atmosphere, a.interior, a.exterior}) useShader(id);
    for (const ShaderId id : s.lightList(a.lights)) useShader(id);
    use(s.params(a.attributes));
    sum += s.string(a.name).size() + s.string(a.groups).size();
  }
  for (const ObjectRecord& o : s.objects()) {
    sum += s.attributes()[o.attributes].sides + (s.toCache(o.transform, 0.25f)[0].x > 0);
    use(s.params(o.primvars));
    for (size_t i = 0; i < o.source.count; ++i) sum += uint64_t(s.bytes()[o.source.offset + i]);
    for (uint32_t i = 0; i < o.patchCount; ++i) sum += s.rootPatches()[o.firstPatch + i].face;
    sum += s.string(o.locationFile).size();
  }
  const SolidForest forest(s);
  std::vector<uint32_t> memory;
  SolidState state(forest, memory);
  for (const ObjectRecord& o : s.objects())
    if (solidOf(o) != kNone) sum += state.toggle(solidOf(o)) + forest.treeOf(solidOf(o));
  for (const RootPatchRecord& p : s.rootPatches()) {
    sum += s.objects()[p.object].keyCount;
    if (p.firstEdge != kNone)
      for (uint32_t e = 0; e < 8; ++e) sum += s.rootPatches()[s.edges()[p.firstEdge + e].owner].face;
  }
  for (const NamedSpaceRecord& n : s.namedSpaces())
    sum += s.string(n.name).size() + (s.toWorld(n.transform, 1)[0].x > 0);
  for (const DisplayRecord& d : s.displays(s.options().displays))
    use(s.params(d.params)), sum += s.string(d.mode).size();
  useShader(s.options().imager);
  use(s.params(s.options().options));
  use(s.params(s.options().hiderParams));
  for (const StringId id : s.searchPaths()) sum += s.string(id).size();
  sum += s.cacheToCamera(0)[3].x > 0;
  return sum;
}

TEST(Skeleton, RoundTrip) {
  auto fd = makeScene();
  ASSERT_TRUE(fd.ok()) << fd.error().str();
  SkeletonImage image(*fd);
  auto opened = Skeleton::open(image.bytes(), true);
  ASSERT_TRUE(opened.ok()) << opened.error().str();
  const Skeleton& s = *opened;
  EXPECT_EQ(s.header().totalBytes, image.bytes().size());
  ASSERT_EQ(s.objects().size(), 1u);
  const ObjectRecord& o = s.objects()[0];
  EXPECT_EQ(o.patchCount, 2u);
  ASSERT_EQ(s.params(o.primvars).size(), 1u);
  EXPECT_EQ(s.string(s.params(o.primvars)[0].name), "st");
  EXPECT_EQ(s.floats(s.params(o.primvars)[0])[2], 1.0f);
  const AttributeRecord& a = s.attributes()[o.attributes];
  EXPECT_EQ(s.string(s.shaders()[a.surface].name), "plastic");
  const ParamRecord* ka = s.find(s.shaders()[a.surface].params, "Ka");
  ASSERT_NE(ka, nullptr);
  EXPECT_EQ(s.floats(*ka)[0], 0.5f);
  EXPECT_EQ(s.find(s.shaders()[a.surface].params, "Kb"), nullptr);
  const ParamRecord* user = s.find(a.attributes, "user:name");
  ASSERT_NE(user, nullptr);
  EXPECT_EQ(s.string(s.strings(*user)[1]), "two");
  EXPECT_TRUE(s.floats(*user).empty());
  EXPECT_EQ(s.lightList(a.lights).size(), 1u);
  EXPECT_EQ(s.string(s.displays(s.options().displays)[0].name), "a.exr");
  EXPECT_EQ(s.string(s.searchPaths()[4]), "/tmp");
  EXPECT_EQ(s.toWorld(o.transform, 0.5f)[3], DVec4(0.5, 1, 1.5, 1));
  EXPECT_EQ(s.toCache(o.transform, 1.0f)[3], DVec4(0, 0, 0, 1));
  EXPECT_EQ(s.cacheToCamera(0)[3], DVec4(1, 2, 3, 1));
  EXPECT_GT(walk(s), 0u);
}

TEST(Skeleton, SealedAgainstChange) {
  auto fd = makeScene(false);
  ASSERT_TRUE(fd.ok());
  EXPECT_EQ(fcntl(*fd, F_GET_SEALS) & (F_SEAL_SHRINK | F_SEAL_WRITE), F_SEAL_SHRINK | F_SEAL_WRITE);
  EXPECT_EQ(mmap(nullptr, 4096, PROT_READ | PROT_WRITE, MAP_SHARED, *fd, 0), MAP_FAILED);
  // Nor by opening the file anew.
  const int again = open(fmt::format("/proc/self/fd/{}", *fd).c_str(), O_RDWR);
  if (again >= 0) {
    EXPECT_EQ(mmap(nullptr, 4096, PROT_READ | PROT_WRITE, MAP_SHARED, again, 0), MAP_FAILED);
    EXPECT_NE(ftruncate(again, 0), 0);
    EXPECT_NE(pwrite(again, "x", 1, 0), 1);
    close(again);
  }
  close(*fd);
}

TEST(Skeleton, EqualContentIsStoredOnce) {
  auto made = SkeletonWriter::create();
  ASSERT_TRUE(made.ok());
  SkeletonWriter& w = *made;
  const std::vector<float> big(1000, 2.0f);
  const Range first = w.addArray(std::span<const float>(big));
  const uint64_t bytes = w.bytesWritten();
  const Range second = w.addArray(std::span<const float>(big));
  EXPECT_EQ(first.offset, second.offset);
  EXPECT_EQ(second.count, 1000u);
  EXPECT_EQ(w.bytesWritten(), bytes);
  EXPECT_EQ(w.intern("x"), w.intern("x"));
  EXPECT_EQ(w.intern(""), 0u);
  EXPECT_EQ(w.addTransform({{0}, {DMat4(2)}}), w.addTransform({{0}, {DMat4(2)}}));
  EXPECT_NE(w.addTransform({{0}, {DMat4(2)}}), w.addTransform({{0}, {DMat4(3)}}));
  EXPECT_EQ(w.addAttributes(attributes(kNone)), w.addAttributes(attributes(kNone)));
  AttributeRecord red = attributes(kNone);
  red.color = Color(1, 0, 0);
  EXPECT_NE(w.addAttributes(red), w.addAttributes(attributes(kNone)));
  ShaderRecord s{};
  s.kind = ShaderKind::kSurface;
  EXPECT_EQ(w.addShader(s), w.addShader(s));
  s.kind = ShaderKind::kLight;
  EXPECT_NE(w.addShader(s), w.addShader(s)) << "two equal lights shine twice";
  const ParamRecord p = w.makeFloatParam("a", ParamClass::kUniform, ParamType::kFloat, 1, std::array{1.0f});
  EXPECT_EQ(w.addParams({&p, 1}).first, w.addParams({&p, 1}).first);
}

TEST(Skeleton, RollBackForgetsAHalfMadePrimitive) {
  auto made = SkeletonWriter::create();
  ASSERT_TRUE(made.ok());
  SkeletonWriter& w = *made;
  w.addObject({});
  const auto o = w.nextObject(), p = w.nextRootPatch(), e = w.nextEdge();
  w.addObject({}), w.addRootPatch({}), w.addEdges(std::vector<EdgeRecord>(8));
  w.rollBack(o, p, e);
  EXPECT_EQ(w.nextObject(), 1u);
  EXPECT_EQ(w.nextRootPatch(), 0u);
  EXPECT_EQ(w.nextEdge(), 0u);
}

TEST(Skeleton, RefusesOtherVersionsByName) {
  auto fd = makeScene();
  SkeletonImage image(*fd);
  image.header().version = kFormatVersion + 7;
  auto r = Skeleton::open(image.bytes(), false);
  ASSERT_FALSE(r.ok());
  EXPECT_EQ(r.error().code, RiError::kVersion);
  EXPECT_NE(r.error().message.find(std::to_string(kFormatVersion + 7)), std::string::npos);
  EXPECT_NE(r.error().message.find("reads version " + std::to_string(kFormatVersion)), std::string::npos);
  image.header().version = kFormatVersion;
  image.header().layout ^= 1;
  EXPECT_EQ(Skeleton::open(image.bytes(), false).error().code, RiError::kVersion);
  image.header().layout ^= 1;
  image.header().byteOrder = 0x04030201;
  EXPECT_EQ(Skeleton::open(image.bytes(), false).error().code, RiError::kVersion);
}

TEST(Skeleton, RefusesEveryTruncation) {
  auto fd = makeScene();
  SkeletonImage whole(*fd);
  for (size_t n = 0; n < whole.bytes().size(); ++n) {
    SkeletonImage part(whole.bytes().first(n));
    EXPECT_FALSE(Skeleton::open(part.bytes(), false).ok()) << n;
  }
}

TEST(Skeleton, ChecksumFindsEveryFlippedBit) {
  auto fd = makeScene();
  SkeletonImage image(*fd);
  for (size_t i = sizeof(SkeletonHeader); i < image.bytes().size(); ++i) {
    image.bytes()[i] ^= std::byte(1 << (i % 8));
    EXPECT_FALSE(Skeleton::open(image.bytes(), true).ok()) << i;
    image.bytes()[i] ^= std::byte(1 << (i % 8));
  }
  EXPECT_TRUE(Skeleton::open(image.bytes(), true).ok());
}

TEST(Skeleton, DamageIsRefusedOrHarmless) {
  auto fd = makeScene();
  SkeletonImage image(*fd);
  const auto bytes = image.bytes();
  size_t refused = 0, accepted = 0;
  uint64_t sum = 0;
  const auto check = [&] {
    auto r = Skeleton::open(bytes, false);
    if (r.ok()) {
      sum += walk(*r);
      ++accepted;
    } else {
      ASSERT_FALSE(r.error().message.empty());
      ++refused;
    }
  };
  for (size_t i = 0; i < bytes.size(); ++i) {
    const std::byte was = bytes[i];
    for (int bit = 0; bit < 8; ++bit) {
      bytes[i] = was ^ std::byte(1 << bit);
      check();
    }
    for (const int value : {0x00, 0x7f, 0x80, 0xff}) {
      bytes[i] = std::byte(value);
      check();
    }
    bytes[i] = was;
  }
  // Whole words too: what single bytes cannot reach (counts that overflow when multiplied).
  for (size_t i = 0; i + 8 <= bytes.size(); i += 4) {
    uint64_t was;
    std::memcpy(&was, &bytes[i], 8);
    for (const uint64_t value : {uint64_t(0), ~uint64_t(0), uint64_t(1) << 63, uint64_t(1) << 60, was + 1,
                                 was - 1, uint64_t(0xffffffff), was << 32, uint64_t(bytes.size())}) {
      std::memcpy(&bytes[i], &value, 8);
      check();
    }
    std::memcpy(&bytes[i], &was, 8);
  }
  EXPECT_TRUE(Skeleton::open(bytes, true).ok());
  EXPECT_GT(refused, accepted / 4);
  EXPECT_GT(accepted, 0u);
  EXPECT_GT(sum, 0u);
}

TEST(Motion, TurnsWithoutShrinking) {
  DMat4 quarter(1);
  quarter[0] = DVec4(0, 1, 0, 0), quarter[1] = DVec4(-1, 0, 0, 0);
  quarter[3] = DVec4(4, 0, 0, 1);
  const float times[] = {0, 1};
  const DMat4 keys[] = {DMat4(1), quarter};
  const DMat4 half = interpolateMotion(times, keys, 0.5f);
  EXPECT_NEAR(half[0].x, std::sqrt(0.5), 1e-12);
  EXPECT_NEAR(half[0].y, std::sqrt(0.5), 1e-12);
  EXPECT_NEAR(half[3].x, 2, 1e-12);
  EXPECT_EQ(interpolateMotion(times, keys, -1), keys[0]);
  EXPECT_EQ(interpolateMotion(times, keys, 2), keys[1]);
}

TEST(Motion, MirroredKeysKeepTheirHandedness) {
  DMat4 mirror(1);
  mirror[0].x = -2;
  DMat4 turned(1);
  turned[0] = DVec4(0, -2, 0, 0), turned[1] = DVec4(-1, 0, 0, 0);
  const float times[] = {0, 1};
  const DMat4 keys[] = {mirror, turned};
  for (const float t : {0.0f, 0.25f, 0.5f, 0.75f, 1.0f})
    EXPECT_NEAR(glm::determinant(DMat3(interpolateMotion(times, keys, t))), -2, 1e-9) << t;
}

TEST(Motion, SingularKeysAreBlended) {
  DMat4 flat(1);
  flat[2].z = 0;
  const float times[] = {0, 2};
  const DMat4 keys[] = {flat, DMat4(2)};
  EXPECT_EQ(interpolateMotion(times, keys, 1)[0].x, 1.5);
}

}  // namespace
}  // namespace fr::cache
