#include <gtest/gtest.h>

#include <cmath>

#include "ri/reader.h"
#include "scene_cache/frame_records.h"
#include "scene_cache/scene_builder.h"
#include "scene_cache/skeleton_image.h"

namespace fr::cache {
namespace {

struct BuiltFrame {
  int number;
  FrameCounts counts;
  SkeletonImage image;
  Skeleton skeleton;
};

struct Built {
  std::vector<BuiltFrame> frames;
  std::vector<Error> reports;
  size_t count(RiError code) const {
    size_t n = 0;
    for (const Error& e : reports) n += e.code == code;
    return n;
  }
};

Built build(const std::string& rib, const LoadOptions& options = {}) {
  Built b;
  setReportSink([&](const Error& e) { b.reports.push_back(e); });
  const FrameCallback onFrame = [&](Frame&& f) {
    SkeletonImage image(dup(f.skeletonFd()));
    auto s = Skeleton::open(image.bytes(), options.checksum);
    EXPECT_TRUE(s.ok()) << s.error().str();
    if (s.ok()) b.frames.push_back({f.number(), f.counts(), std::move(image), *s});
    return true;
  };
  SceneBuilder builder(options, onFrame, {});
  ri::Reader reader(builder);
  builder.setReader(&reader);
  EXPECT_TRUE(reader.readBuffer(rib, "test.rib").ok());
  builder.finish();
  setReportSink({});
  return b;
}

/// One world around `body`, after `options`.
std::string world(const std::string& options, const std::string& body) {
  return options + "\nWorldBegin\n" + body + "\nWorldEnd\n";
}

const AttributeRecord& stateOf(const Skeleton& s, size_t object = 0) {
  return s.attributes()[s.objects()[object].attributes];
}

const std::string kSphere = "Sphere 1 -1 1 360\n";

// ---- camera
// --------------------------------------------------------------------------------------------------------

TEST(SceneBuilder, CameraDefaults) {
  Built b = build(world("", kSphere));
  ASSERT_EQ(b.frames.size(), 1u);
  const CameraRecord& c = b.frames[0].skeleton.camera();
  EXPECT_EQ(c.resolution[0], 640);
  EXPECT_EQ(c.resolution[1], 480);
  EXPECT_EQ(c.projection, ProjectionType::kOrthographic);
  EXPECT_FLOAT_EQ(c.screenWindow[1], 4.0f / 3);
  EXPECT_FLOAT_EQ(c.screenWindow[3], 1);
  EXPECT_EQ(c.cropPixels[0], 0);
  EXPECT_EQ(c.cropPixels[1], 639);
  EXPECT_EQ(c.cropPixels[3], 479);
  EXPECT_GE(c.dof[0], kRiInfinity) << "pinhole";
  EXPECT_EQ(b.frames[0].skeleton.header().cacheOrigin, DVec3(0));
  const OptionsRecord& o = b.frames[0].skeleton.options();
  EXPECT_EQ(b.frames[0].skeleton.string(o.filter), "gaussian");
  EXPECT_EQ(o.pixelSamples[0], 2);
  EXPECT_EQ(o.quantizeRgba[2], 255);
  EXPECT_EQ(o.maxRayLevel, 4);
}

TEST(SceneBuilder, CameraOfAScene) {
  Built b =
      build(world("Format 200 400 1  Projection \"perspective\" \"fov\" [30]  Clipping 0.5 500\n"
                  "Shutter 0 0.5 CropWindow 0.25 0.75 0 0.5  Translate 0 0 5  Rotate 90 0 1 0",
                  "Translate 1 2 3 " + kSphere));
  ASSERT_EQ(b.frames.size(), 1u);
  const Skeleton& s = b.frames[0].skeleton;
  const CameraRecord& c = s.camera();
  EXPECT_EQ(c.projection, ProjectionType::kPerspective);
  EXPECT_FLOAT_EQ(c.fov, 30);
  EXPECT_FLOAT_EQ(c.screenWindow[1], 1) << "the shorter side is 1";
  EXPECT_FLOAT_EQ(c.screenWindow[3], 2);
  EXPECT_FLOAT_EQ(c.clipping[0], 0.5f);
  EXPECT_FLOAT_EQ(c.shutter[1], 0.5f);
  EXPECT_EQ(c.cropPixels[0], 50);
  EXPECT_EQ(c.cropPixels[1], 149);
  EXPECT_EQ(c.cropPixels[2], 0);
  EXPECT_EQ(c.cropPixels[3], 199);
  // World origin to camera space: rotation leaves it, translation puts it 5 in front.
  EXPECT_EQ(DVec3(s.worldToCamera(0)[3]), DVec3(0, 0, 5));
  // World z lies in the image plane after a quarter turn about y; x is the third row vector of [c 0 -s; s 0
  // c].
  EXPECT_NEAR(std::abs((s.worldToCamera(0) * DVec4(0, 0, 1, 0)).x), 1, 1e-12);
  const DMat4 toWorld = s.toWorld(s.objects()[0].transform, 0);
  EXPECT_EQ(DVec3(toWorld[3]), DVec3(1, 2, 3)) << "object to world leaves the camera out";
}

TEST(SceneBuilder, CropsThatShareASideShareNoPixel) {
  for (const double cut : {0.1, 0.25, 1.0 / 3, 0.4999, 0.75, 0.9}) {
    Built b = build(world(fmt::format("Format 101 77 1 CropWindow 0 {:.17g} 0 1", cut), kSphere) +
                    world(fmt::format("CropWindow {:.17g} 1 0 1", cut), kSphere));
    ASSERT_EQ(b.frames.size(), 2u);
    EXPECT_EQ(b.frames[0].skeleton.camera().cropPixels[1] + 1, b.frames[1].skeleton.camera().cropPixels[0])
        << cut;
  }
}

TEST(SceneBuilder, CommandLineWins) {
  LoadOptions o;
  o.overrides.resolution = {{64, 32}};
  o.overrides.crop = {{0, 0.5, 0, 1}};
  o.overrides.pixelSamples = {{4, 8}};
  o.overrides.shadingRate = 5.0f;
  o.overrides.displays = {{"x.exr", "openexr", "rgba"}};
  Built b = build(
      world("Format 100 100 1 PixelSamples 1 1 Display \"a\" \"file\" \"rgb\" Display \"+b\" \"file\" \"z\"",
            "ShadingRate 2 " + kSphere),
      o);
  ASSERT_EQ(b.frames.size(), 1u);
  const Skeleton& s = b.frames[0].skeleton;
  EXPECT_EQ(s.camera().resolution[0], 64);
  EXPECT_EQ(s.camera().cropPixels[1], 31);
  EXPECT_EQ(s.options().pixelSamples[1], 8);
  EXPECT_EQ(stateOf(s).shadingRate, 5);
  ASSERT_EQ(s.displays(s.options().displays).size(), 1u);
  EXPECT_EQ(s.string(s.displays(s.options().displays)[0].type), "openexr");
}

TEST(SceneBuilder, DisplaysQuantizeAndOptions) {
  Built b =
      build(world("Quantize \"rgba\" 65535 0 65535 0.25  Exposure 2 2.2\n"
                  "Display \"a.tif\" \"file\" \"rgba\"\n"
                  "Display \"+z.exr\" \"zfile\" \"z\" \"string compression\" [\"zip\"]\n"
                  "Option \"user\" \"float level\" [7] Option \"trace\" \"int maxdepth\" [9]\n"
                  "Option \"searchpath\" \"string shader\" [\"/a:/b\"]  Hider \"hidden\" \"int jitter\" [0]\n"
                  "Imager \"background\" \"color bgcolor\" [0 0 1]",
                  kSphere));
  ASSERT_EQ(b.frames.size(), 1u);
  const Skeleton& s = b.frames[0].skeleton;
  const auto displays = s.displays(s.options().displays);
  ASSERT_EQ(displays.size(), 2u);
  EXPECT_EQ(displays[0].quantize[0], 65535);
  EXPECT_EQ(displays[0].quantize[3], 0.25f);
  EXPECT_EQ(displays[1].quantize[0], 0);
  EXPECT_FLOAT_EQ(displays[0].exposure[1], 2.2f);
  EXPECT_EQ(s.string(displays[1].name), "z.exr");
  EXPECT_NE(s.find(displays[1].params, "compression"), nullptr);
  const ParamRecord* level = s.find(s.options().options, "user:level");
  ASSERT_NE(level, nullptr);
  EXPECT_EQ(s.floats(*level)[0], 7);
  EXPECT_EQ(s.options().maxRayLevel, 9);
  EXPECT_EQ(s.string(s.searchPaths()[0]), "/a:/b");
  EXPECT_NE(s.find(s.options().hiderParams, "jitter"), nullptr);
  ASSERT_NE(s.options().imager, kNone);
  EXPECT_EQ(s.shaders()[s.options().imager].kind, ShaderKind::kImager);
}

TEST(SceneBuilder, LevelsAreOneOfThreeWords) {
  EXPECT_TRUE(build(world("Option \"trace\" \"levels\" [\"off\"]", kSphere)).reports.empty());
  const Built b = build(world("Option \"trace\" \"string levels\" [\"sometimes\"]", kSphere));
  ASSERT_EQ(b.reports.size(), 1u);
  EXPECT_EQ(b.reports[0].code, RiError::kRange);
  EXPECT_EQ(build(world("Option \"trace\" \"levels\" [0]", kSphere)).reports.size(), 1u);
}

TEST(SceneBuilder, CacheOriginFollowsTheCameraOnALattice) {
  Built b = build(world("Projection \"perspective\" Translate -100000 0 0", kSphere) +
                  world("Clipping 0.01 100 Translate 0.01 0 0", kSphere));
  ASSERT_EQ(b.frames.size(), 2u);
  const DVec3 far = b.frames[0].skeleton.header().cacheOrigin;
  EXPECT_LE(std::abs(far.x - 100000), 32);
  EXPECT_EQ(std::fmod(far.x, 64), 0);
  // Precision at the near plane: half a lattice step in floats against the distance of the plane.
  const DMat4 look = [] {
    DMat4 m(1);
    m[3].x = -1234.567;
    return m;
  }();
  for (const double near : {0.001, 0.1, 10.0}) {
    const double left = std::abs(chooseCacheOrigin(look, near).x - 1234.567);
    EXPECT_LE(left * 0x1p-24, near * 0x1p-17) << near;
  }
  EXPECT_EQ(chooseCacheOrigin(DMat4(0), 1), DVec3(0));
}

// ---- attributes
// ----------------------------------------------------------------------------------------------------

TEST(SceneBuilder, Attributes) {
  Built b = build(world("",
                        "Color 1 0.5 0 Opacity 0.2 0.3 0.4 ShadingRate 4 Sides 1 Matte 1\n"
                        "ShadingInterpolation \"smooth\" TextureCoordinates 0 0 2 0 0 2 2 2\n"
                        "Attribute \"identifier\" \"string name\" [\"ball\"]\n"
                        "Attribute \"render\" \"float patch_multiplier\" [0.25]\n"
                        "Attribute \"trace\" \"float bias\" [0.02] \"int displacements\" [0]\n"
                        "Attribute \"grouping\" \"string membership\" [\"a,b\"]\n"
                        "Attribute \"user\" \"float x\" [3] \"string tag\" [\"t\"]\n" +
                            kSphere));
  ASSERT_EQ(b.frames.size(), 1u);
  const Skeleton& s = b.frames[0].skeleton;
  const AttributeRecord& a = stateOf(s);
  EXPECT_EQ(a.color, Color(1, 0.5, 0));
  EXPECT_FLOAT_EQ(a.opacity.z, 0.4f);
  EXPECT_EQ(a.shadingRate, 4);
  EXPECT_EQ(a.sides, 1u);
  EXPECT_EQ(a.flags & (kMatte | kSmoothShading | kRayDisplacements), uint32_t(kMatte | kSmoothShading));
  EXPECT_EQ(a.textureCoordinates[2], 2);
  EXPECT_EQ(s.string(a.name), "ball");
  EXPECT_EQ(s.string(a.groups), "a,b");
  EXPECT_EQ(a.patchMultiplier, 0.25f);
  EXPECT_EQ(a.bias, 0.02f);
  const ParamRecord* tag = s.find(a.attributes, "user:tag");
  ASSERT_NE(tag, nullptr);
  EXPECT_EQ(s.string(s.strings(*tag)[0]), "t");
  EXPECT_EQ(a.surface, kNone);
}

TEST(SceneBuilder, AttributeDefaults) {
  Built b = build(world("", kSphere));
  const AttributeRecord& a = stateOf(b.frames[0].skeleton);
  EXPECT_EQ(a.visibility, 7u);
  EXPECT_EQ(a.castsShadows, CastsShadows::kOs);
  EXPECT_EQ(a.flags, uint32_t(kRayDisplacements));
  EXPECT_EQ(a.sides, 2u);
  EXPECT_EQ(a.patchMultiplier, -1);
  EXPECT_EQ(a.bias, -1);
  EXPECT_EQ(a.displacementBound, 0);
  EXPECT_EQ(a.lights.count, 0u);
}

TEST(SceneBuilder, VisibilityInBothDialects) {
  struct Case {
    const char* rib;
    uint32_t bits;
    CastsShadows shadows;
  };
  const Case cases[] = {
      {"Attribute \"render\" \"int visibility\" [5]", 5, CastsShadows::kOs},
      {"Attribute \"render\" \"string casts_shadows\" [\"none\"]", 3, CastsShadows::kNever},
      {"Attribute \"render\" \"string casts_shadows\" [\"opaque\"]", 7, CastsShadows::kOpaque},
      {"Attribute \"render\" \"string casts_shadows\" [\"shade\"]", 7, CastsShadows::kShade},
      {"Attribute \"visibility\" \"int camera\" [0]", 6, CastsShadows::kOs},
      {"Attribute \"visibility\" \"int specular\" [0] \"int diffuse\" [0]", 5, CastsShadows::kOs},
      {"Attribute \"visibility\" \"int specular\" [0] \"int diffuse\" [1]", 7, CastsShadows::kOs},
      {"Attribute \"visibility\" \"int trace\" [0]", 5, CastsShadows::kOs},
      {"Attribute \"visibility\" \"int transmission\" [0]", 3, CastsShadows::kOs},
      {"Attribute \"visibility\" \"transmission\" [0]", 3, CastsShadows::kOs},
      {"Attribute \"visibility\" \"transmission\" 0 \"trace\" 1", 3, CastsShadows::kOs},
      {"Attribute \"visibility\" \"transmission\" [\"opaque\"]", 7, CastsShadows::kOpaque},
      {"Attribute \"visibility\" \"string transmission\" [\"transparent\"]", 3, CastsShadows::kOs},
      {"Attribute \"visibility\" \"string transmission\" [\"opaque\"]", 7, CastsShadows::kOpaque},
      {"Attribute \"visibility\" \"string transmission\" [\"shader\"]", 7, CastsShadows::kShade},
      {"Attribute \"shade\" \"string transmissionhitmode\" [\"shader\"]", 7, CastsShadows::kShade},
      {"Attribute \"shade\" \"string transmissionhitmode\" [\"primitive\"]", 7, CastsShadows::kOs},
  };
  for (const Case& c : cases) {
    Built b = build(world("", std::string(c.rib) + "\n" + kSphere));
    ASSERT_EQ(b.frames.size(), 1u) << c.rib;
    const AttributeRecord& a = stateOf(b.frames[0].skeleton);
    EXPECT_EQ(a.visibility, c.bits) << c.rib;
    EXPECT_EQ(a.castsShadows, c.shadows) << c.rib;
    EXPECT_TRUE(b.reports.empty()) << c.rib << b.reports[0].str();
  }
}

TEST(SceneBuilder, DisplacementBoundInWorldUnits) {
  const auto bound = [](const std::string& rib) {
    Built b = build(world("Scale 100 100 100", rib + kSphere));
    return stateOf(b.frames[0].skeleton).displacementBound;
  };
  const std::string shader = "Displacement \"bumpy\"\n";
  EXPECT_EQ(bound("Attribute \"displacementbound\" \"float sphere\" [0.5]"), 0) << "nothing displaces";
  EXPECT_NEAR(
      bound(shader + "Attribute \"displacementbound\" \"float sphere\" [0.5] \"string coordinatesystem\" "
                     "[\"object\"] Scale 1 4 2 Rotate 30 1 1 1 "),
      2, 1e-5);
  EXPECT_NEAR(bound("Scale 3 3 3 " + shader +
                    "Attribute \"displacementbound\" \"float sphere\" [0.5] "
                    "\"string coordinatesystem\" [\"shader\"] Scale 10 10 10 "),
              1.5, 1e-5);
  EXPECT_NEAR(bound(shader + "Attribute \"displacementbound\" \"float sphere\" [0.5] "
                             "\"string coordinatesystem\" [\"world\"] Scale 10 10 10 "),
              0.5, 1e-6);
  EXPECT_NEAR(bound(shader + "TransformBegin Scale 2 2 2 CoordinateSystem \"mine\" TransformEnd "
                             "Attribute \"displacementbound\" \"float sphere\" [0.5] "
                             "\"string coordinatesystem\" [\"mine\"] Scale 10 10 10 "),
              1, 1e-6);
  EXPECT_NEAR(bound(shader + "Attribute \"displacementbound\" \"float sphere\" [50] "
                             "\"string coordinatesystem\" [\"camera\"] "),
              0.5, 1e-6)
      << "the camera scales by 100";
}

TEST(SceneBuilder, LargestStretchIsTheLargestSingularValue) {
  DMat4 m(1);
  m[0] = DVec4(1, 0, 0, 0), m[1] = DVec4(1, 1, 0, 0);  // shear: golden ratio
  EXPECT_NEAR(largestStretch(m), (1 + std::sqrt(5.0)) / 2, 1e-9);
  EXPECT_EQ(largestStretch(DMat4(0)), 0);
}

// ---- orientation
// ---------------------------------------------------------------------------------------------------

TEST(SceneBuilder, OrientationAgainstHandedness) {
  struct Case {
    const char *camera, *object;
    bool reverse;  // in camera space
    bool reverseInCache;
  };
  const char *none = "", *mirror = "Scale -1 1 1 ";
  const Case cases[] = {
      // A sphere's dPdu x dPdv points outwards in object space, and "outside" must leave it so.
      {none, "", false, false},
      {none, "Orientation \"inside\" ", true, true},
      {none, "ReverseOrientation ", true, true},
      {none, "ReverseOrientation ReverseOrientation ", false, false},
      {none, "Orientation \"lh\" ", false, false},
      {none, "Orientation \"rh\" ", true, true},
      {none, "Rotate 180 0 1 0 Scale 2 3 4 ", false, false},
      // Mirrored on the way to the world: the product turns, the outside does not.
      {none, "Scale -1 1 1 ", true, true},
      {none, "Scale -1 -1 1 ", false, false},
      {none, "Scale -1 1 1 Scale 1 1 -1 ", false, false},
      {none, "Scale -1 1 1 Orientation \"outside\" ", true, true},
      {none, "Scale -1 1 1 Orientation \"inside\" ", false, false},
      {none, "Scale 1 1 -1 Orientation \"lh\" ", false, false},
      {none, "Scale 1 1 -1 Orientation \"rh\" ", true, true},
      {none, "Scale 1 -1 1 ReverseOrientation ", false, false},
      // Mirrored camera (right-handed worlds): the same object still shows its outside.
      {mirror, "", true, false},
      {mirror, "Scale 1 1 -1 ", false, true},
      {mirror, "Orientation \"inside\" ", false, true},
      {mirror, "Orientation \"lh\" ", false, true},
      {mirror, "Orientation \"rh\" ", true, false},
  };
  for (const Case& c : cases) {
    Built b = build(world(c.camera, std::string(c.object) + kSphere));
    ASSERT_EQ(b.frames.size(), 1u);
    const uint32_t flags = stateOf(b.frames[0].skeleton).flags;
    EXPECT_EQ((flags & kReverseOrientation) != 0, c.reverse) << c.camera << "| " << c.object;
    EXPECT_EQ((flags & kReverseInCacheSpace) != 0, c.reverseInCache) << c.camera << "| " << c.object;
  }
}

// ---- shaders and lights
// --------------------------------------------------------------------------------------------

TEST(SceneBuilder, ShadersKeepTheirSpace) {
  Built b =
      build(world("",
                  "Translate 1 0 0 Surface \"plastic\" \"float Ks\" [0.25] \"color specularcolor\" [1 0 0]\n"
                  "Displacement \"bumpy\" Atmosphere \"fog\" Interior \"smoke\" Translate 5 0 0 " +
                      kSphere + kSphere));
  const Skeleton& s = b.frames[0].skeleton;
  ASSERT_EQ(s.objects().size(), 2u);
  EXPECT_EQ(s.objects()[0].attributes, s.objects()[1].attributes);
  const AttributeRecord& a = stateOf(s);
  ASSERT_NE(a.surface, kNone);
  const ShaderRecord& surface = s.shaders()[a.surface];
  EXPECT_EQ(s.string(surface.name), "plastic");
  EXPECT_EQ(s.toWorld(surface.transform, 0)[3].x, 1);
  EXPECT_EQ(s.toWorld(s.objects()[0].transform, 0)[3].x, 6);
  ASSERT_NE(s.find(surface.params, "Ks"), nullptr);
  EXPECT_EQ(s.shaders()[a.displacement].kind, ShaderKind::kDisplacement);
  EXPECT_EQ(s.shaders()[a.atmosphere].kind, ShaderKind::kVolume);
  EXPECT_EQ(s.shaders()[a.interior].kind, ShaderKind::kVolume);
  EXPECT_EQ(a.exterior, kNone);
}

TEST(SceneBuilder, LightsAreOnWhereTheyAreDeclared) {
  Built b = build(world("Translate 0 0 5 LightSource \"ambientlight\" 1",
                        "Attribute \"light\" \"string shadows\" [\"on\"] \"int nsamples\" [4]\n"
                        "Translate 0 9 0 LightSource \"pointlight\" \"key\" \"float intensity\" [30]\n"
                        "Attribute \"light\" \"string shadows\" [\"off\"]\n" +
                            kSphere + "AttributeBegin Illuminate 1 0 " + kSphere +
                            "AttributeEnd\n"
                            "AttributeBegin LightSource \"spotlight\" 3 " +
                            kSphere + "AttributeEnd\n" + kSphere + "Illuminate 3 1 " + kSphere));
  const Skeleton& s = b.frames[0].skeleton;
  ASSERT_EQ(s.objects().size(), 5u);
  const auto names = [&](size_t object) {
    std::string all;
    for (const ShaderId id : s.lightList(stateOf(s, object).lights))
      all += std::string(s.string(s.shaders()[id].name)) + " ";
    return all;
  };
  EXPECT_EQ(names(0), "ambientlight pointlight ");
  EXPECT_EQ(names(1), "pointlight ");
  EXPECT_EQ(names(2), "ambientlight pointlight spotlight ");
  EXPECT_EQ(names(3), "ambientlight pointlight ");
  EXPECT_EQ(names(4), "ambientlight pointlight spotlight ");
  const ShaderRecord& key = s.shaders()[s.lightList(stateOf(s, 1).lights)[0]];
  EXPECT_EQ(s.string(key.handle), "key");
  EXPECT_EQ(key.lightFlags, kLightShadows);
  EXPECT_EQ(key.lightSamples, 4u);
  EXPECT_EQ(s.toWorld(key.transform, 0)[3].y, 9);
  ASSERT_NE(key.attributes, kNone);
  const ShaderRecord& ambient = s.shaders()[s.lightList(stateOf(s, 0).lights)[0]];
  EXPECT_EQ(ambient.lightFlags, 0u);
  // Declared in camera space at (0,0,5): that is the world's origin.
  EXPECT_EQ(DVec3(s.toWorld(ambient.transform, 0)[3]), DVec3(0));
}

TEST(SceneBuilder, AreaLightKnowsItsFirstObject) {
  Built b = build(world("", "AttributeBegin AreaLightSource \"arealight\" 7 " + kSphere + kSphere +
                                "AttributeEnd\n"
                                "Illuminate 7 1 " +
                                kSphere));
  const Skeleton& s = b.frames[0].skeleton;
  ASSERT_EQ(s.objects().size(), 3u);
  const auto lights = s.lightList(stateOf(s, 2).lights);
  ASSERT_EQ(lights.size(), 1u);
  EXPECT_EQ(s.shaders()[lights[0]].areaLightObject, 0u);
  EXPECT_EQ(stateOf(s, 0).areaLight, lights[0] + 1);
  EXPECT_EQ(stateOf(s, 1).areaLight, lights[0] + 1);
  EXPECT_EQ(stateOf(s, 2).areaLight, 0u);
  EXPECT_EQ(b.count(RiError::kUnimplemented), 0u);
}

TEST(SceneBuilder, NamedSpaces) {
  Built b = build(world("Translate 0 0 5 CoordinateSystem \"eye\"",
                        "TransformBegin Translate 1 0 0 CoordinateSystem \"a\" TransformEnd\n"
                        "AttributeBegin Translate 2 0 0 ScopedCoordinateSystem \"b\" AttributeEnd " +
                            kSphere));
  const Skeleton& s = b.frames[0].skeleton;
  std::map<std::string, double> x;
  for (const NamedSpaceRecord& n : s.namedSpaces())
    x[std::string(s.string(n.name))] = s.toWorld(n.transform, 0)[3].x;
  ASSERT_TRUE(x.count("a") && x.count("b") && x.count("eye"));
  EXPECT_EQ(x["a"], 1);
  EXPECT_EQ(x["b"], 2);
}

// ---- worlds, sides, errors
// -----------------------------------------------------------------------------------------

TEST(SceneBuilder, SeveralWorldsInAFile) {
  const std::string frames = "FrameBegin 3 Format 10 10 1 WorldBegin " + kSphere +
                             "WorldEnd FrameEnd\n"
                             "FrameBegin 5 WorldBegin " +
                             kSphere + kSphere + "WorldEnd FrameEnd\n";
  Built b = build(frames);
  ASSERT_EQ(b.frames.size(), 2u);
  EXPECT_EQ(b.frames[0].number, 3);
  EXPECT_EQ(b.frames[0].skeleton.camera().resolution[0], 10);
  EXPECT_EQ(b.frames[1].number, 5);
  EXPECT_EQ(b.frames[1].skeleton.camera().resolution[0], 640) << "FrameEnd restores the options";
  EXPECT_EQ(b.frames[1].skeleton.objects().size(), 2u);
  LoadOptions only;
  only.frames = {{4, 9}};
  Built c = build(frames, only);
  ASSERT_EQ(c.frames.size(), 1u);
  EXPECT_EQ(c.frames[0].number, 5);
  EXPECT_EQ(c.frames[0].skeleton.options().frameNumber, 5);
}

// Exporters write a bound for everything: what stands still is not made larger by it, and its instances
// share.
TEST(SceneBuilder, ABoundDisplacesOnlyBySurfacesThatMove) {
  const std::string rib =
      world("Option \"searchpath\" \"shader\" [\"here\"]",
            "Attribute \"displacementbound\" \"float sphere\" [0.5] ObjectBegin 1 " + kSphere +
                "ObjectEnd\nSurface \"still\" ObjectInstance 1 Translate 1 0 0 ObjectInstance 1\n"
                "Surface \"swell\" " +
                kSphere);
  LoadOptions options;
  options.movesPoints = [](const std::string& name, const std::vector<std::string>& folders) {
    EXPECT_EQ(folders, std::vector<std::string>{"here"});
    return name == "swell";
  };
  Built b = build(rib, options);
  const Skeleton& s = b.frames.at(0).skeleton;
  ASSERT_EQ(s.objects().size(), 4u) << "the second instance shows a prototype";
  EXPECT_EQ(stateOf(s, 0).displacement, kNone);
  EXPECT_EQ(stateOf(s, 0).displacementBound, 0);
  EXPECT_EQ(stateOf(s, 3).displacement, stateOf(s, 3).surface);
  EXPECT_GT(stateOf(s, 3).displacementBound, 0);
  // Nobody knows: all may move.
  Built unknown = build(rib);
  const Skeleton& t = unknown.frames.at(0).skeleton;
  ASSERT_EQ(t.objects().size(), 3u);
  EXPECT_EQ(stateOf(t, 0).displacement, stateOf(t, 0).surface);
}

TEST(SceneBuilder, InstancesAreReplayed) {
  Built b =
      build(world("", "ObjectBegin 1 " + kSphere +
                          "ObjectEnd\n"
                          "Translate 1 0 0 ObjectInstance 1 Translate 1 0 0 Color 1 0 0 ObjectInstance 1"));
  const Skeleton& s = b.frames[0].skeleton;
  ASSERT_EQ(s.objects().size(), 3u) << "the second one shows a prototype";
  EXPECT_EQ(s.objects()[2].prototype, 1u);
  EXPECT_EQ(s.toWorld(s.objects()[2].transform, 0)[3].x, 2);
  EXPECT_EQ(stateOf(s, 2).color, Color(1, 0, 0));
  EXPECT_EQ(s.objects()[0].source.offset, s.objects()[2].source.offset) << "equal content is stored once";
  EXPECT_EQ(b.frames[0].counts.instances, 2u);
  EXPECT_EQ(b.frames[0].counts.sharedInstances, 1u);
}

TEST(SceneBuilder, MovingTransformsKeepTheirKeys) {
  Built b =
      build(world("Shutter 0 1", "MotionBegin [0 1] Translate 0 0 0 Translate 4 0 0 MotionEnd " + kSphere));
  const Skeleton& s = b.frames[0].skeleton;
  const TransformId t = s.objects()[0].transform;
  EXPECT_EQ(s.transforms()[t].times.count, 2u);
  EXPECT_EQ(s.toWorld(t, 0.25f)[3].x, 1);
}

TEST(SceneBuilder, WhatIsMissingIsSaidOncePerKind) {
  const std::string cow = "Geometry \"cow\"\n";
  Built b = build(world("", cow + cow + kSphere));
  ASSERT_EQ(b.frames.size(), 1u);
  EXPECT_EQ(b.frames[0].skeleton.objects().size(), 1u);
  EXPECT_EQ(b.count(RiError::kUnimplemented), 1u);
  for (const Error& e : b.reports) EXPECT_GT(e.where.line, 0) << e.str();
  EXPECT_EQ(b.frames[0].counts.dropped, 2u);
}

TEST(SceneBuilder, InlineArchivesCanBeDelayed) {
  Built b = build(
      "ArchiveBegin \"ball\" Translate 0 1 0 Color 0 1 0 " + kSphere + "ArchiveEnd\n" +
      world("", "Translate 1 0 0 Procedural \"DelayedReadArchive\" [\"ball\"] [-1 1 -1 1 -1 1] " + kSphere));
  ASSERT_EQ(b.frames.size(), 1u);
  const Skeleton& s = b.frames[0].skeleton;
  ASSERT_EQ(s.objects().size(), 2u);
  EXPECT_EQ(DVec3(s.toWorld(s.objects()[0].transform, 0)[3]), DVec3(1, 0, 0))
      << "the archive's state ends with it";
  EXPECT_EQ(stateOf(s, 0).color, Color(1));
  EXPECT_EQ(DVec3(s.toWorld(s.objects()[1].transform, 0)[3]), DVec3(1, 1, 0));
  EXPECT_EQ(stateOf(s, 1).color, Color(0, 1, 0));
  Built missing =
      build(world("", "Procedural \"DelayedReadArchive\" [\"nowhere.rib\"] [-1 1 -1 1 -1 1] " + kSphere));
  ASSERT_EQ(missing.frames.size(), 1u);
  EXPECT_EQ(missing.frames[0].skeleton.objects().size(), 1u);
  EXPECT_EQ(missing.count(RiError::kNoFile), 1u);
}

// ---- Detail and Bound
// --------------------------------------------------------------------------------------------------------

/// One unit is 50 pixels.
const std::string kFlatCamera = "Format 100 100 1\nScreenWindow -1 1 -1 1\nTranslate 0 0 5\n";

/// Names of the objects, in order.
std::string namesOf(const Skeleton& s) {
  std::string all;
  for (const ObjectRecord& o : s.objects())
    all += std::string(s.string(s.attributes()[o.attributes].name)) + " ";
  return all;
}

std::string named(const std::string& name) {
  return "Attribute \"identifier\" \"string name\" \"" + name + "\"\n" + kSphere;
}

TEST(SceneBuilder, DetailSharesTheSamplesOfATransition) {
  // Three representations of one model; the ramps between them are 100 to 200 and 1000 to 2000 pixels.
  const auto shown = [](double side, const std::string& head = {}) {
    const std::string box = fmt::format("Detail [0 {0} 0 {0} 0 0.1]\n", side / 50);
    Built b = build(world(head + kFlatCamera, box + "DetailRange 0 0 100 200\n" + named("coarse") +
                                                  "DetailRange [100 200 1000 2000]\n" + named("middle") +
                                                  "DetailRange 1000 2000 1e38 1e38\n" + named("fine")));
    EXPECT_TRUE(b.reports.empty());
    const Skeleton& s = b.frames.at(0).skeleton;
    EXPECT_EQ(b.frames.at(0).counts.otherDetail + s.objects().size(), 3u) << side;
    // Name, and the chances of the samples that see it.
    std::string all;
    for (const ObjectRecord& o : s.objects()) {
      const AttributeRecord& a = s.attributes()[o.attributes];
      all += fmt::format("{} {:.2f}-{:.2f} ", s.string(a.name), a.thinning[0], 1 - a.thinning[1]);
    }
    return all;
  };
  EXPECT_EQ(shown(1), "coarse 0.00-1.00 ");
  EXPECT_EQ(shown(std::sqrt(125.0)), "coarse 0.00-0.75 middle 0.75-1.00 ");
  EXPECT_EQ(shown(std::sqrt(180.0)), "coarse 0.00-0.20 middle 0.20-1.00 ");
  EXPECT_EQ(shown(std::sqrt(500.0)), "middle 0.00-1.00 ");
  EXPECT_EQ(shown(std::sqrt(1100.0)), "middle 0.00-0.90 fine 0.90-1.00 ");
  EXPECT_EQ(shown(std::sqrt(3000.0)), "fine 0.00-1.00 ");
  EXPECT_EQ(shown(std::sqrt(3000.0), "RelativeDetail 0.5\n"), "middle 0.00-0.50 fine 0.50-1.00 ");
  EXPECT_EQ(shown(std::sqrt(1501.0), "RelativeDetail 0.05\n"), "coarse 0.00-1.00 ");
  EXPECT_EQ(shown(10000), "fine 0.00-1.00 ") << "larger than the picture";
  // What is one thing as a whole changes at once: parts of solids, area lights.
  Built b = build(world(
      kFlatCamera, "Detail [0 .25 0 .24 0 .1]\nDetailRange 0 0 100 200\nSolidBegin \"primitive\"\n" +
                       named("coarse") + "DetailRange 100 200 1e38 1e38\n" + named("fine") + "SolidEnd\n"));
  EXPECT_EQ(namesOf(b.frames.at(0).skeleton), "fine ");
}

TEST(SceneBuilder, DetailIsMeasuredWhereItIsSaid) {
  // The bound is 50 pixels wide under the transformation in force at Detail, not at the sphere.
  Built b =
      build(world(kFlatCamera, "Detail [0 1 0 1 0 1]\nDetailRange 0 0 2499 2499\nScale .1 .1 .1\n" +
                                   named("small") + "DetailRange 2499 2499 1e38 1e38\n" + named("large")));
  EXPECT_EQ(namesOf(b.frames.at(0).skeleton), "large ");
  // Without Detail it is infinite, and at the boundary of two ranges without ramps one of them holds.
  b = build(world(kFlatCamera, "DetailRange 0 0 100 100\n" + named("some") +
                                   "DetailRange 100 100 1e38 1e38\n" + named("infinite") +
                                   "Detail [0 1 0 1 0 1]\nDetailRange 0 0 2500 2500\n" + named("below") +
                                   "DetailRange 2500 2500 1e38 1e38\n" + named("above")));
  EXPECT_EQ(namesOf(b.frames.at(0).skeleton), "infinite below ");
  // Behind a perspective camera it is what it would be in front.
  b = build(world("Format 100 100 1\nProjection \"perspective\" \"fov\" 90\n",
                  "TransformBegin\nTranslate 0 0 -2\nDetail [-.1 .1 -.1 .1 -.1 0]\nTransformEnd\n"
                  "DetailRange 0 0 24 24\n" +
                      named("less") + "DetailRange 24 24 26 26\n" + named("five squared")));
  EXPECT_EQ(namesOf(b.frames.at(0).skeleton), "five squared ");
}

TEST(SceneBuilder, DetailHoldsForInstancesAndProcedurals) {
  const std::string detail = "Detail [0 1 0 1 0 1]\n";
  Built b = build("ArchiveBegin \"ball\" " + kSphere + "ArchiveEnd\n" +
                  world(kFlatCamera, "ObjectBegin 1\n" + kSphere + "ObjectEnd\n" + detail +
                                         "DetailRange 0 0 9 9\nObjectInstance 1\nProcedural "
                                         "\"DelayedReadArchive\" [\"ball\"] [-1 1 -1 1 -1 1]\n"
                                         "DetailRange 9 9 1e38 1e38\nObjectInstance 1\n"));
  EXPECT_EQ(b.frames.at(0).skeleton.objects().size(), 1u);
  EXPECT_EQ(b.frames.at(0).counts.otherDetail, 2u);
}

TEST(SceneBuilder, WhatItsBoundPutsOutOfViewWaitsForRays) {
  const std::string body = "AttributeBegin\nTranslate 3 0 0\nBound [-1 1 -1 1 -1 1]\n" + named("right") +
                           "AttributeEnd\nAttributeBegin\nBound [-1 1 -1 1 -1 1]\n" + named("middle") +
                           "Surface \"mirror\"\n" + named("mirror") + "AttributeEnd\n";
  LoadOptions noRays;
  noRays.asksRays = [](const std::string&, const auto&) { return false; };
  Built b = build(world(kFlatCamera, body), noRays);
  EXPECT_EQ(namesOf(b.frames.at(0).skeleton), "middle mirror ");
  EXPECT_EQ(b.frames.at(0).counts.outOfBound, 1u);
  LoadOptions rays;
  rays.asksRays = [](const std::string& name, const auto&) { return name == "mirror"; };
  b = build(world(kFlatCamera, body), rays);
  EXPECT_EQ(namesOf(b.frames.at(0).skeleton), "middle mirror right ");
  b = build(world(kFlatCamera, body));
  EXPECT_EQ(namesOf(b.frames.at(0).skeleton), "right middle mirror ");
}

TEST(SceneBuilder, AWorldWithoutEndIsRenderedWithWhatCame) {
  Built b = build("Format 8 8 1 WorldBegin AttributeBegin " + kSphere);
  ASSERT_EQ(b.frames.size(), 1u);
  EXPECT_EQ(b.frames[0].skeleton.objects().size(), 1u);
  EXPECT_FALSE(b.reports.empty());
}

TEST(SceneBuilder, LocationsAreKept) {
  Built b = build(world("", "\n\n" + kSphere));
  const Skeleton& s = b.frames[0].skeleton;
  EXPECT_EQ(s.string(s.objects()[0].locationFile), "test.rib");
  EXPECT_EQ(s.objects()[0].locationLine, 5u);
}

}  // namespace
}  // namespace fr::cache
