#include <gtest/gtest.h>

#include <cmath>

#include "ri/camera.h"
#include "ri/reader.h"
#include "ri/report_capture.h"
#include "ri/state_renderer.h"

namespace fr::ri {
namespace {

class Scene : public StateRenderer {
 public:
  explicit Scene(PathLists paths = {}) : StateRenderer(std::move(paths)) {}
  void read(std::string_view text) {
    Reader r(*this);
    result = r.readBuffer(text, "t.rib");
    finish();
  }
  const Param* attr(size_t i, const char* name) const { return primitives[i].attributes->values.find(name); }
  DVec3 map(size_t i, DVec3 p, float time = 0) const {
    return transformPoint(primitives[i].objectToWorld->at(time), p);
  }

  ReportCapture reports;
  Result<void> result;
  std::vector<PlacedPrimitive> primitives;
  std::vector<LightInstance> lightsAtEnd;
  std::vector<Camera> cameras;
  std::vector<Options> worldOptions;
  std::string events;
  std::map<std::string, TransformPtr> spaces;

 protected:
  void onFrameBegin(int n) override { events += fmt::format("F{}", n); }
  void onFrameEnd() override { events += "f"; }
  void onWorldBegin() override {
    events += "W";
    cameras.push_back(makeCamera(state().options(), state().worldToCamera()));
    worldOptions.push_back(state().options());
  }
  void onWorldEnd() override {
    events += "w";
    lightsAtEnd = state().lights();
    for (const auto& [name, t] : state().namedSpaces()) spaces[name] = *state().toWorld(t);
  }
  void onPrimitive(const PlacedPrimitive& p) override {
    events += "p";
    primitives.push_back(p);
  }
  void onProcedural(const PlacedProcedural&) override { events += "d"; }
  void onSolidBegin(const std::string& op) override { events += "(" + op.substr(0, 1); }
  void onSolidEnd() override { events += ")"; }
};

void expectNear(const DVec3& a, const DVec3& b) {
  EXPECT_NEAR(a.x, b.x, 1e-12) << "x";
  EXPECT_NEAR(a.y, b.y, 1e-12) << "y";
  EXPECT_NEAR(a.z, b.z, 1e-12) << "z";
}

TEST(State, LastTransformIsAppliedFirst) {
  Scene s;
  s.read("WorldBegin Translate 1 2 3 Scale 2 2 2 Rotate 90 0 0 1 Sphere 1 -1 1 360 WorldEnd");
  ASSERT_EQ(s.primitives.size(), 1u) << s.reports.str();
  expectNear(s.map(0, {1, 0, 0}), {1, 4, 3});  // rotated to +y, scaled to 2, moved
}

TEST(State, MatrixTextIsRowVectors) {
  Scene s;
  s.read("WorldBegin ConcatTransform [1 0 0 0  0 1 0 0  0 0 1 0  5 6 7 1] Sphere 1 -1 1 360 WorldEnd");
  expectNear(s.map(0, {1, 1, 1}), {6, 7, 8});
}

TEST(State, RotationAxesAndSenses) {
  const auto rotated = [](const char* text, DVec3 p) {
    Scene s;
    s.read(std::string("WorldBegin ") + text + " Sphere 1 -1 1 360 WorldEnd");
    return s.map(0, p);
  };
  expectNear(rotated("Rotate 90 1 0 0", {0, 1, 0}), {0, 0, 1});
  expectNear(rotated("Rotate 90 0 1 0", {0, 0, 1}), {1, 0, 0});
  expectNear(rotated("Rotate 90 0 0 1", {1, 0, 0}), {0, 1, 0});
  expectNear(rotated("Rotate 120 1 1 1", {1, 0, 0}), {0, 1, 0});
  expectNear(rotated("Skew 45 0 1 0 1 0 0", {0, 1, 0}), {1, 1, 0});  // y leans 45 degrees towards x
  expectNear(rotated("Skew [45 0 1 0 1 0 0]", {2, 0, 5}), {2, 0, 5});
}

TEST(State, CameraIsWhatStandsBeforeTheWorld) {
  Scene s;
  s.read(
      "Projection \"perspective\" \"fov\" 90 Translate 0 0 5 WorldBegin Translate 0 1 0 Sphere 1 -1 1 360 "
      "WorldEnd");
  ASSERT_EQ(s.cameras.size(), 1u);
  expectNear(s.map(0, {0, 0, 0}), {0, 1, 0});  // object to world holds no camera
  expectNear(transformPoint(s.cameras[0].worldToCamera->at(0), DVec3(0)), {0, 0, 5});
}

TEST(State, TransformInTheWorldKeepsTheCamera) {
  Scene s;
  s.read(
      "Translate 0 0 5 WorldBegin Translate 9 9 9 Transform [1 0 0 0 0 1 0 0 0 0 1 0 0 2 0 1] Sphere 1 -1 1 "
      "360 "
      "Identity Sphere 1 -1 1 360 WorldEnd");
  expectNear(s.map(0, {0, 0, 0}), {0, 2, 0});
  expectNear(s.map(1, {0, 0, 0}), {0, 0, 0});
}

TEST(Camera, PerspectiveByHand) {
  Scene s;
  s.read("Format 640 480 1 Clipping 1 11 Projection \"perspective\" \"fov\" 90 WorldBegin WorldEnd");
  const Camera& c = s.cameras[0];
  EXPECT_TRUE(c.perspective);
  EXPECT_DOUBLE_EQ(c.screenWindow[1], 4.0 / 3);
  expectNear(transformPoint(c.cameraToScreen, DVec3(2, -1, 2)), {1, -0.5, 11.0 / 10 * (1 - 1 / 2.0)});
  expectNear(transformPoint(c.cameraToScreen, DVec3(0, 0, 1)), {0, 0, 0});
  expectNear(transformPoint(c.cameraToScreen, DVec3(0, 0, 11)), {0, 0, 1});
  const DVec3 r = transformPoint(c.cameraToRaster, DVec3(0, 1, 1));
  EXPECT_NEAR(r.x, 320, 1e-9);
  EXPECT_NEAR(r.y, 0, 1e-9);  // up in the world is up in the image: y counts downwards
  EXPECT_NEAR(transformPoint(c.cameraToRaster, DVec3(4.0 / 3, 0, 1)).x, 640, 1e-9);
}

TEST(Camera, OrthographicAndFrameAspect) {
  Scene s;
  s.read("Format 400 400 1 FrameAspectRatio 2 WorldBegin WorldEnd");
  const Camera& c = s.cameras[0];
  EXPECT_FALSE(c.perspective);
  EXPECT_EQ(c.xres, 400);
  EXPECT_EQ(c.yres, 200);
  EXPECT_DOUBLE_EQ(c.screenWindow[0], -2);
  Scene tall;
  tall.read("Format 400 400 1 FrameAspectRatio .5 WorldBegin WorldEnd");
  EXPECT_EQ(tall.cameras[0].xres, 200);
  EXPECT_EQ(tall.cameras[0].yres, 400);
  EXPECT_DOUBLE_EQ(tall.cameras[0].screenWindow[3], 2);
}

TEST(Camera, CropWindowsTileExactly) {
  for (int res : {1, 7, 100, 640}) {
    for (double cut : {0.1, 0.25, 1.0 / 3, 0.5, 0.77}) {
      const PixelRect a = cropPixels({0, cut, 0, 1}, res, 10), b = cropPixels({cut, 1, 0, 1}, res, 10);
      EXPECT_EQ(a.x0, 0);
      EXPECT_EQ(b.x1, res);
      if (res > 1) {
        EXPECT_EQ(a.x1, b.x0) << res << " " << cut;
      }
    }
  }
}

TEST(State, AttributesAreScopedAndShared) {
  Scene s;
  s.read(
      "WorldBegin Color 1 0 0 Sphere 1 -1 1 360 Disk 0 1 360 AttributeBegin Color 0 1 0 Translate 1 0 0 "
      "Sphere 1 -1 1 360 AttributeEnd Sphere 1 -1 1 360 TransformBegin Translate 1 0 0 Color 0 0 1 "
      "TransformEnd "
      "Sphere 1 -1 1 360 WorldEnd");
  ASSERT_EQ(s.primitives.size(), 5u);
  EXPECT_EQ(s.primitives[0].attributes, s.primitives[1].attributes);
  EXPECT_EQ(s.primitives[0].objectToWorld, s.primitives[1].objectToWorld);
  EXPECT_EQ(s.primitives[2].attributes->color, Color(0, 1, 0));
  EXPECT_EQ(s.primitives[3].attributes, s.primitives[0].attributes);
  expectNear(s.map(3, {0, 0, 0}), {0, 0, 0});
  EXPECT_EQ(s.primitives[4].attributes->color, Color(0, 0, 1));  // transform blocks save no colour
  expectNear(s.map(4, {0, 0, 0}), {0, 0, 0});
  EXPECT_EQ(s.primitives[0].attributes->color, Color(1, 0, 0));  // untouched by later changes
}

TEST(State, LightsHandlesAndIlluminate) {
  Scene s;
  s.read(
      "LightSource \"camera\" \"cam\" WorldBegin LightSource \"a\" 1 AttributeBegin LightSource \"b\" "
      "\"bee\" "
      "Illuminate 1 0 Sphere 1 -1 1 360 AttributeEnd Sphere 1 -1 1 360 Illuminate \"bee\" 1 Sphere 1 -1 1 "
      "360 "
      "Illuminate \"none\" 1 WorldEnd");
  using V = std::vector<int>;
  EXPECT_EQ(*s.primitives[0].attributes->lights, (V{0, 2}));
  EXPECT_EQ(*s.primitives[1].attributes->lights, (V{0, 1}));
  EXPECT_EQ(*s.primitives[2].attributes->lights, (V{0, 1, 2}));
  EXPECT_EQ(s.reports.count(RiError::kBadHandle), 1);
  EXPECT_EQ(s.lightsAtEnd.size(), 3u);
  EXPECT_EQ(s.state().lights().size(), 1u);  // those of the world are gone
  EXPECT_EQ(s.lightsAtEnd[0].shader->shaderSpace.base, SpaceBase::kCamera);
  EXPECT_EQ(s.lightsAtEnd[1].shader->shaderSpace.base, SpaceBase::kWorld);
}

TEST(State, AreaLightMarksItsGeometry) {
  Scene s;
  s.read(
      "WorldBegin AttributeBegin Attribute \"light\" \"shadows\" \"on\" AreaLightSource \"x\" 1 Sphere 1 -1 "
      "1 360 "
      "AttributeEnd Sphere 1 -1 1 360 Illuminate 1 1 WorldEnd");
  EXPECT_EQ(s.primitives[0].attributes->areaLight, 0);
  EXPECT_EQ(s.primitives[1].attributes->areaLight, -1);
  EXPECT_EQ(s.lightsAtEnd[0].attributes->values.getString("light:shadows", "off"), "on");
}

TEST(State, FramesAndSeveralWorlds) {
  Scene s;
  s.read(
      "Format 100 100 1 FrameBegin 1 Format 50 50 1 Color 1 0 0 WorldBegin Sphere 1 -1 1 360 WorldEnd "
      "FrameEnd "
      "FrameBegin 2 WorldBegin Sphere 1 -1 1 360 WorldEnd FrameEnd WorldBegin WorldEnd");
  EXPECT_EQ(s.events, "F1WpwfF2WpwfWw");
  EXPECT_EQ(s.cameras[0].xres, 50);
  EXPECT_EQ(s.cameras[1].xres, 100);
  EXPECT_EQ(s.primitives[0].attributes->color, Color(1, 0, 0));
  EXPECT_EQ(s.primitives[1].attributes->color, Color(1, 1, 1));
}

TEST(State, NestingErrorsDoNotLoseTheFrame) {
  Scene s;
  s.read(
      "WorldBegin AttributeEnd AttributeBegin TransformBegin AttributeEnd Sphere 1 -1 1 360 WorldEnd "
      "WorldEnd");
  EXPECT_EQ(s.events, "Wpw");
  EXPECT_EQ(s.state().depth(), 0);
  EXPECT_GE(s.reports.count(RiError::kNesting), 4) << s.reports.str();
}

TEST(State, AWorldWithoutEndIsFinished) {
  Scene s;
  s.read("FrameBegin 3 WorldBegin AttributeBegin SolidBegin \"union\" Sphere 1 -1 1 360");
  EXPECT_EQ(s.events, "F3W(up)wf");
}

TEST(State, OptionsAreFrozenInTheWorld) {
  Scene s;
  s.read("WorldBegin Format 10 10 1 Option \"user\" \"float x\" 2 WorldEnd WorldBegin WorldEnd");
  EXPECT_EQ(s.cameras[1].xres, 640);
  EXPECT_EQ(s.reports.count(RiError::kNotOptions), 1);
  EXPECT_FLOAT_EQ(s.worldOptions[1].values.getFloat("user:x", 0), 2);
}

TEST(State, GeometryOutsideTheWorld) {
  Scene s;
  s.read("Sphere 1 -1 1 360 Sphere 1 -1 1 360 WorldBegin WorldEnd");
  EXPECT_EQ(s.events, "Ww");
  EXPECT_EQ(s.reports.count(RiError::kNotPrimitives), 1);
}

TEST(State, ValuesAndSearchPaths) {
  Scene s(StateRenderer::PathLists{{"shader", {"/std"}}});
  s.read(
      "Option \"searchpath\" \"shader\" [\"a:@\"] Option \"searchpath\" \"string shader\" [\"b:&\"] "
      "WorldBegin "
      "Attribute \"displacementbound\" \"sphere\" .5 \"coordinatesystem\" \"world\" Sphere 1 -1 1 360 "
      "WorldEnd");
  EXPECT_EQ(s.searchPath("shader"), (std::vector<std::string>{"b", "a", "/std"}));
  const NamedValues& v = s.primitives[0].attributes->values;
  EXPECT_FLOAT_EQ(v.getFloat("displacementbound:sphere", 0), 0.5f);
  EXPECT_EQ(v.getString("displacementbound:coordinatesystem", "shader"), "world");
  EXPECT_EQ(v.getInt("trace:maxdepth", 7), 7);
}

TEST(State, ColoursOfOneAndFourNumbersAreMeantWell) {
  Scene s;
  s.read("WorldBegin Color [1 .5 .25 1] Opacity .5 Sphere 1 -1 1 360 Color [1 0] Sphere 1 -1 1 360 WorldEnd");
  ASSERT_EQ(s.primitives.size(), 2u);
  EXPECT_EQ(s.primitives[0].attributes->color, Color(1, .5, .25));
  EXPECT_EQ(s.primitives[0].attributes->opacity, Color(.5));
  EXPECT_EQ(s.primitives[1].attributes->color, Color(1, .5, .25));
  EXPECT_EQ(s.reports.count(RiError::kConsistency), 3);
}

TEST(State, TheLastLayerIsTheShader) {
  Scene s;
  s.read(
      "WorldBegin ShaderLayer \"surface\" \"checker\" \"a\" ShaderLayer \"surface\" \"matte\" \"b\" \"Kd\" "
      ".5 "
      "ConnectShaderLayers \"surface\" \"a\" \"Ci\" \"b\" \"Cs\" Sphere 1 -1 1 360 WorldEnd");
  ASSERT_EQ(s.primitives.size(), 1u);
  EXPECT_EQ(s.primitives[0].attributes->surface->name, "matte");
  EXPECT_FLOAT_EQ(s.primitives[0].attributes->surface->params.getFloat("Kd", 0), 0.5f);
}

TEST(Camera, UnknownProjectionsWithAnAngleArePerspective) {
  Scene s;
  s.read(
      "Projection \"PxrCamera\" \"float fov\" 60 WorldBegin WorldEnd Projection \"fish\" WorldBegin "
      "WorldEnd");
  ASSERT_EQ(s.cameras.size(), 2u);
  EXPECT_TRUE(s.cameras[0].perspective);
  EXPECT_FLOAT_EQ(float(s.cameras[0].fov), 60);
  EXPECT_FALSE(s.cameras[1].perspective);
  EXPECT_EQ(s.reports.count(RiError::kUnimplemented), 2);
}

TEST(State, ConditionsSeeUserAttributes) {
  Scene s;
  s.read(
      "Attribute \"user\" \"int pass\" 2 FrameBegin 5 WorldBegin IfBegin \"$user:pass == 2 && $Frame == 5\" "
      "Sphere 1 -1 1 "
      "360 Else Disk 0 1 360 IfEnd WorldEnd FrameEnd");
  ASSERT_EQ(s.primitives.size(), 1u) << s.reports.str();
  EXPECT_TRUE(std::holds_alternative<Sphere>(s.primitives[0].source->samples[0]));
  // Without its category, as an option too; the attribute wins.
  Scene t;
  t.read(
      "Option \"user\" \"string Pass\" \"Beauty\" \"int level\" 1 WorldBegin Attribute \"user\" \"int "
      "level\" 3 "
      "IfBegin \"$Pass == 'Beauty' && $level > 2\" Sphere 1 -1 1 360 IfEnd WorldEnd");
  EXPECT_EQ(t.primitives.size(), 1u) << t.reports.str();
}

TEST(State, NamedSpaces) {
  Scene s;
  s.read(
      "Translate 0 0 10 CoordinateSystem \"cam10\" WorldBegin AttributeBegin Translate 1 0 0 "
      "CoordinateSystem \"here\" "
      "ScopedCoordinateSystem \"local\" AttributeEnd CoordSysTransform \"here\" Sphere 1 -1 1 360 "
      "CoordSysTransform "
      "\"camera\" Sphere 1 -1 1 360 CoordSysTransform \"local\" CoordSysTransform \"nothing\" "
      "CoordSysTransform "
      "\"cam10\" Sphere 1 -1 1 360 WorldEnd");
  expectNear(s.map(0, {0, 0, 0}), {1, 0, 0});
  expectNear(s.map(1, {0, 0, 0}), {0, 0, -10});
  expectNear(s.map(2, {0, 0, 0}), {0, 0, 0});
  EXPECT_EQ(s.reports.count(RiError::kBadToken), 2) << s.reports.str();
  EXPECT_EQ(s.spaces.count("local"), 0u);
  expectNear(transformPoint(s.spaces["here"]->at(0), DVec3(0)), {1, 0, 0});
}

TEST(Motion, TransformKeys) {
  Scene s;
  s.read(
      "WorldBegin MotionBegin [0 1] Translate 0 0 0 Translate 2 0 0 MotionEnd MotionBegin [.5 1.5] Scale 1 1 "
      "1 Scale "
      "3 1 1 MotionEnd Sphere 1 -1 1 360 WorldEnd");
  const Transform& t = *s.primitives[0].objectToWorld;
  EXPECT_EQ(t.times, (std::vector<float>{0, .5f, 1, 1.5f}));
  expectNear(s.map(0, {1, 0, 0}, 0), {1, 0, 0});
  expectNear(s.map(0, {1, 0, 0}, 1), {2 + 2, 0, 0});
  expectNear(s.map(0, {1, 0, 0}, 1.5f), {2 + 3, 0, 0});
  expectNear(s.map(0, {1, 0, 0}, -5), {1, 0, 0});
  expectNear(s.map(0, {1, 0, 0}, 9), {5, 0, 0});
}

TEST(Motion, RotationKeepsItsSize) {
  Scene s;
  s.read("WorldBegin MotionBegin [0 1] Rotate 0 0 0 1 Rotate 180 0 0 1 MotionEnd Sphere 1 -1 1 360 WorldEnd");
  for (float t = 0; t <= 1; t += 0.03f) EXPECT_NEAR(glm::length(s.map(0, {1, 0, 0}, t)), 1, 0.004) << t;
  expectNear(s.map(0, {1, 0, 0}, 0.5f), {0, 1, 0});
}

TEST(Motion, DeformingPrimitive) {
  Scene s;
  s.read(
      "WorldBegin MotionBegin [0 .5 1] Sphere 1 -1 1 360 Sphere 2 -2 2 360 Sphere 3 -3 3 360 MotionEnd "
      "MotionBegin [0 1] "
      "Polygon \"P\" [0 0 0 1 0 0 0 1 0] Polygon \"P\" [0 0 0 1 0 0 0 1 0 1 1 1] MotionEnd WorldEnd");
  ASSERT_EQ(s.primitives.size(), 1u);
  EXPECT_EQ(s.primitives[0].source->times, (std::vector<float>{0, .5f, 1}));
  ASSERT_EQ(s.primitives[0].source->samples.size(), 3u);
  EXPECT_EQ(std::get<Sphere>(s.primitives[0].source->samples[2]).radius, 3);
  EXPECT_EQ(s.reports.count(RiError::kBadMotion), 1);  // the polygon changes its number of vertices
}

TEST(Motion, MovingCamera) {
  Scene s;
  s.read(
      "MotionBegin [0 1] Translate 0 0 5 Translate 0 0 7 MotionEnd LightSource \"l\" 1 WorldBegin WorldEnd");
  ASSERT_TRUE(s.cameras[0].worldToCamera->isMoving());
  expectNear(transformPoint(s.cameras[0].worldToCamera->at(1), DVec3(0)), {0, 0, 7});
}

// From 90 to 53.13 degrees: what stood at the picture's edge, at 1, goes to 2.
TEST(Motion, AMovingProjectionZooms) {
  Scene s;
  s.read(
      "Shutter 0 1 MotionBegin [0 1] Projection \"perspective\" \"fov\" 90 Projection \"perspective\" "
      "\"fov\" "
      "53.1301024 MotionEnd Translate 0 0 5 WorldBegin WorldEnd");
  EXPECT_TRUE(s.reports.errors.empty()) << s.reports.str();
  ASSERT_EQ(s.cameras.size(), 1u);
  const Camera& c = s.cameras[0];
  EXPECT_NEAR(c.fov, 90, 1e-5);
  ASSERT_TRUE(c.worldToCamera->isMoving());
  for (const float t : {0.0f, 1.0f}) {
    const DVec3 p = transformPoint(c.worldToCamera->at(t), DVec3(5, 0, 0));
    EXPECT_NEAR(p.x / p.z, 1 + t, 1e-5);
    EXPECT_NEAR(p.z, 5, 1e-9);
  }
}

TEST(Motion, AZoomToNowhereIsSaid) {
  for (const char* fov : {"0", "-20", "180", "1e30"}) {
    Scene s;
    s.read(std::string("Shutter 0 1 MotionBegin [0 1] Projection \"perspective\" \"fov\" 90 Projection "
                       "\"perspective\" \"fov\" ") +
           fov + " MotionEnd Translate 0 0 5 WorldBegin WorldEnd");
    EXPECT_EQ(s.reports.count(RiError::kRange), 1) << fov << s.reports.str();
    EXPECT_EQ(s.reports.errors.size(), 1u) << fov << s.reports.str();
    ASSERT_EQ(s.cameras.size(), 1u);
    expectNear(transformPoint(s.cameras[0].worldToCamera->at(1), DVec3(1, 0, 0)), {1, 0, 5});
  }
}

TEST(Motion, DeformationsInAChainAreSaid) {
  Scene s;
  s.read(
      "WorldBegin AttributeBegin Deformation \"a\" Deformation \"b\" AttributeEnd Deformation \"c\" "
      "Deformation \"\" Deformation \"d\" WorldEnd");
  ASSERT_EQ(s.reports.errors.size(), 1u) << s.reports.str();
  EXPECT_EQ(s.reports.errors[0].severity, Severity::kWarning);
}

// Shaded once, so what moves has its mean over the shutter: between keys at 0 and 1, that of 0.25 to 0.75 is
// in the middle; with keys at 0, 0.5 and 1 each end counts an eighth.
TEST(Motion, AttributesHaveTheirMeanOverTheShutter) {
  Scene s;
  s.read(
      "Shutter .25 .75 WorldBegin\n"
      "MotionBegin [0 1] LightSource \"l\" 1 \"float i\" 1 LightSource \"l\" 1 \"float i\" 3 MotionEnd\n"
      "MotionBegin [0 1] Color 0 0 1 Color 1 0 0 MotionEnd\n"
      "MotionBegin [0 0.5 1] Opacity 0 0 0 Opacity 1 1 1 Opacity 0 0 0 MotionEnd\n"
      "MotionBegin [0 1] Surface \"p\" \"float a\" 2 \"string n\" \"x\" Surface \"p\" \"float a\" 4 \"string "
      "n\" "
      "\"x\" MotionEnd\n"
      "MotionBegin [0 1] Bound [-1 1 -1 1 -1 1] Bound [0 2 -1 1 -1 1] MotionEnd\n"
      "Sphere 1 -1 1 360 WorldEnd");
  EXPECT_TRUE(s.reports.errors.empty()) << s.reports.str();
  const AttributeState& a = *s.primitives[0].attributes;
  EXPECT_EQ(a.color, Color(0.5f, 0, 0.5f));
  EXPECT_EQ(a.opacity, Color(0.75f));
  EXPECT_EQ(a.surface->params.find("a")->floats[0], 3);
  EXPECT_EQ(a.surface->params.find("n")->strings[0], "x");
  EXPECT_EQ((*a.bound)[0], -1);
  EXPECT_EQ((*a.bound)[1], 2);
  // Other shaders, or other parameters, in each key: the first.
  Scene t;
  t.read(
      "Shutter 0 1 WorldBegin MotionBegin [0 1] Surface \"p\" \"float a\" 2 Surface \"q\" MotionEnd\n"
      "MotionBegin [0 1] Displacement \"p\" \"float a\" 2 Displacement \"p\" MotionEnd\n"
      "Sphere 1 -1 1 360 WorldEnd");
  EXPECT_EQ(t.reports.count(RiError::kBadMotion), 2);
  EXPECT_EQ(t.primitives[0].attributes->surface->name, "p");
  EXPECT_EQ(t.primitives[0].attributes->displacement->params.find("a")->floats[0], 2);
}

TEST(Motion, WrongBlocks) {
  Scene s;
  s.read(
      "WorldBegin MotionBegin [0 1] Translate 1 0 0 Color 1 0 0 MotionEnd MotionEnd MotionBegin [1 0] "
      "Translate 1 0 0 "
      "Translate 9 0 0 MotionEnd Sphere 1 -1 1 360 MotionBegin [0 1] Sphere 1 -1 1 360 WorldEnd");
  EXPECT_EQ(s.primitives.size(), 2u);
  expectNear(s.map(0, {0, 0, 0}), {2, 0, 0});
  EXPECT_EQ(s.primitives[0].attributes->color, Color(1, 1, 1));
}

TEST(State, AHiderThatIsNotThereIsSaid) {
  Scene s;
  s.read("Hider \"raytrace\" \"int jitter\" 1 Hider \"stochastic\" Hider \"hidden\" WorldBegin WorldEnd");
  EXPECT_TRUE(s.reports.errors.empty()) << s.reports.str();
  Scene t;
  t.read("Hider \"photon\" \"int emit\" 100 WorldBegin WorldEnd");
  ASSERT_EQ(t.reports.errors.size(), 1u) << t.reports.str();
  EXPECT_EQ(t.reports.errors[0].severity, Severity::kWarning);
}

TEST(Resources, AttributesAreSavedAndRestored) {
  Scene s;
  s.read(
      "WorldBegin ResourceBegin AttributeBegin Color 1 0 0 Sides 1 Surface \"plastic\" Translate 1 0 0\n"
      "Resource \"red\" \"attributes\" \"string operation\" \"save\" \"string subset\" [\"shading\"]\n"
      "AttributeEnd\n"
      "AttributeBegin Resource \"red\" \"attributes\" \"operation\" \"restore\" \"subset\" \"shading\"\n"
      "Sphere 1 -1 1 360 AttributeEnd\n"
      "AttributeBegin Resource \"red\" \"attributes\" \"string operation\" [\"restore\"]\n"
      "Sphere 1 -1 1 360 AttributeEnd\n"
      "Sphere 1 -1 1 360 ResourceEnd\n"
      "Resource \"red\" \"attributes\" \"string operation\" \"restore\" Sphere 1 -1 1 360 WorldEnd\n");
  ASSERT_EQ(s.primitives.size(), 4u) << s.reports.str();
  for (const int i : {0, 1}) {
    EXPECT_EQ(s.primitives[size_t(i)].attributes->color, Color(1, 0, 0));
    EXPECT_EQ(s.primitives[size_t(i)].attributes->surface->name, "plastic");
    expectNear(s.map(size_t(i), {0, 0, 0}), {0, 0, 0});  // transformations are no attributes
  }
  EXPECT_EQ(s.primitives[0].attributes->sides, 2);  // is not shading
  EXPECT_EQ(s.primitives[1].attributes->sides, 1);
  EXPECT_EQ(s.primitives[2].attributes->color, Color(1, 1, 1));
  // ResourceEnd forgets what was saved inside.
  EXPECT_EQ(s.primitives[3].attributes->color, Color(1, 1, 1));
  EXPECT_EQ(s.reports.count(RiError::kBadHandle), 1) << s.reports.str();
}

TEST(Objects, InstancesTakeAttributesAndTransformOfTheirPlace) {
  Scene s;
  s.read(
      "ObjectBegin 1 Translate 0 1 0 Color 0 0 1 Sphere 1 -1 1 360 ObjectEnd WorldBegin Color 1 0 0 "
      "Translate 5 0 0 "
      "ObjectInstance 1 Translate 5 0 0 ObjectInstance \"1\" ObjectInstance 2 WorldEnd");
  ASSERT_EQ(s.primitives.size(), 2u) << s.reports.str();
  expectNear(s.map(0, {0, 0, 0}), {5, 1, 0});
  expectNear(s.map(1, {0, 0, 0}), {10, 1, 0});
  EXPECT_EQ(s.primitives[0].source, s.primitives[1].source);
  EXPECT_EQ(s.primitives[0].attributes->color, Color(1, 0, 0));
  EXPECT_EQ(s.reports.count(RiError::kBadHandle), 1);
}

TEST(Objects, NestedInstancesMultiplyOnlySoFar) {
  std::string text = "ObjectBegin 0 Sphere 1 -1 1 360 ObjectEnd\n";
  for (int i = 1; i < 40; ++i) {
    text += fmt::format("ObjectBegin {}", i);
    for (int k = 0; k < 2; ++k) text += fmt::format(" Translate 1 0 0 ObjectInstance {}", i - 1);
    text += " ObjectEnd\n";
  }
  Scene s;
  s.read(text + "WorldBegin ObjectInstance 3 ObjectInstance 39 WorldEnd");
  EXPECT_GE(s.primitives.size(), 8u);
  EXPECT_LE(s.primitives.size(), 1000u);
  EXPECT_EQ(s.events.substr(0, 2), "Wp");
}

TEST(State, BasisAndTrimTravelWithThePrimitive) {
  Scene s;
  s.read(
      "WorldBegin Basis \"b-spline\" 1 \"bezier\" 3 TrimCurve [1] [2] [0 0 1 1] [0] [1] [2] [0 1] [0 1] [1 "
      "1] "
      "NuPatch 2 2 [0 0 1 1] 0 1 2 2 [0 0 1 1] 0 1 \"P\" [0 0 0 1 0 0 0 1 0 1 1 0] Sphere 1 -1 1 360 "
      "Basis \"strange\" 1 \"bezier\" 3 WorldEnd");
  ASSERT_EQ(s.primitives.size(), 2u) << s.reports.str();
  EXPECT_EQ(s.primitives[0].source->basis->uStep, 1);
  EXPECT_EQ(s.primitives[0].source->basis->u, *namedBasis("b-spline"));
  EXPECT_NE(s.primitives[0].source->trimCurve, nullptr);
  EXPECT_EQ(s.primitives[1].source->trimCurve, nullptr);
  EXPECT_EQ(s.reports.count(RiError::kBadToken), 1);
}

TEST(State, Orientation) {
  Scene s;
  s.read(
      "WorldBegin Sphere 1 -1 1 360 Scale 1 1 -1 Sphere 1 -1 1 360 Orientation \"rh\" Sphere 1 -1 1 360 "
      "Orientation "
      "\"lh\" Sphere 1 -1 1 360 ReverseOrientation Sphere 1 -1 1 360 Orientation \"inside\" Sphere 1 -1 1 "
      "360 WorldEnd");
  const bool want[] = {false, false, false, true, false, true};
  for (size_t i = 0; i < 6; ++i) EXPECT_EQ(s.primitives[i].attributes->reversed, want[i]) << i;
}

TEST(State, DisplaysReplaceAndAdd) {
  Scene s;
  s.read(
      "Display \"a\" \"file\" \"rgb\" Display \"b\" \"file\" \"rgba\" Display \"+c\" \"file\" \"z\" "
      "WorldBegin WorldEnd");
  ASSERT_EQ(s.worldOptions[0].displays.size(), 2u);
  EXPECT_EQ(s.worldOptions[0].displays[0].name, "b");
  EXPECT_EQ(s.worldOptions[0].displays[1].name, "c");
}

TEST(State, ColorSamples) {
  Scene s;
  s.read("ColorSamples [.3 .6 .1] [1 1 1] WorldBegin Color .5 Sphere 1 -1 1 360 Color 1 0 0 WorldEnd");
  ASSERT_EQ(s.primitives.size(), 1u);
  EXPECT_NEAR(s.primitives[0].attributes->color.y, 0.3f, 1e-6);
  EXPECT_EQ(s.reports.count(RiError::kConsistency), 1);
}

TEST(State, BadPrimitivesAreDroppedWithTheirPlace) {
  Scene s;
  s.read("WorldBegin\nPolygon \"s\" [0 1 2]\n  Patch \"bilinear\" \"P\" [1 2 3]\nSphere 1 -1 1 360 WorldEnd");
  EXPECT_EQ(s.primitives.size(), 1u);
  EXPECT_EQ(s.reports.count(RiError::kMissingData), 1);
  ASSERT_EQ(s.reports.count(RiError::kConsistency), 1);
  EXPECT_EQ(s.reports.errors[1].where.str(), "t.rib:3:3");
  EXPECT_EQ(s.primitives[0].source->location.str(), "t.rib:4:1");
}

TEST(State, SingularAndSenselessTransforms) {
  Scene s;
  s.read(
      "Scale 0 1 1 WorldBegin Rotate 30 0 0 0 Skew 90 1 0 0 0 1 0 CoordSysTransform \"camera\" Translate nan "
      "0 0 Sphere "
      "1 -1 1 360 WorldEnd");
  EXPECT_EQ(s.primitives.size(), 1u);
  EXPECT_GE(s.reports.errors.size(), 4u) << s.reports.str();
}

}  // namespace
}  // namespace fr::ri
