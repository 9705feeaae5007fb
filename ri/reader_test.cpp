#include "ri/reader.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>

#include "ri/condition.h"
#include "ri/report_capture.h"
#include "ri/request_parser.h"
#include "ri/rib_writer.h"
#include "ri/search_path.h"
#include "ri/state_renderer.h"

namespace fr::ri {
namespace {

struct Parsed {
  std::string rib;
  ReportCapture reports;
  Result<void> result;
};

// What the requests of `text` become when they are written again.
std::unique_ptr<Parsed> parse(std::string_view text, ReaderOptions options = {}) {
  auto p = std::make_unique<Parsed>();
  RibWriter w([&](std::string_view s) { p->rib += s; });
  Reader r(w, std::move(options));
  p->result = r.readBuffer(text, "t.rib");
  w.flush();
  return p;
}

std::string bytes(std::initializer_list<int> b) {
  std::string s;
  for (int i : b) s += char(i);
  return s;
}

TEST(Reader, ValuesWithAndWithoutBrackets) {
  const auto p = parse(
      "Sphere 1 -1 1 360\nSphere [1 -1 1 360]\nSurface \"matte\" \"Ka\" .5 \"Kd\" [.25]\n"
      "Surface \"paintedplastic\" \"texturename\" \"a.tx\"\nColor 1 0 0\nColor [1 0 0]\nScreenWindow [-1 1 "
      "-1 1]\n"
      "Hyperboloid 0 0 0 1 1 1 360\nHyperboloid [0 0 0 1 1 1 360]\nQuantize \"rgba\" [255 0 255 0.5]\n"
      "version \"3.03\"");
  EXPECT_EQ(
      p->rib,
      "Sphere 1 -1 1 360\nSphere 1 -1 1 360\n"
      "Surface \"matte\" \"uniform float Ka\" [0.5] \"uniform float Kd\" [0.25]\n"
      "Surface \"paintedplastic\" \"uniform string texturename\" [\"a.tx\"]\nColor [1 0 0]\nColor [1 0 0]\n"
      "ScreenWindow -1 1 -1 1\nHyperboloid 0 0 0 1 1 1 360\nHyperboloid 0 0 0 1 1 1 360\n"
      "Quantize \"rgba\" 255 0 255 0.5\nversion 3.03\n");
  EXPECT_TRUE(p->reports.errors.empty()) << p->reports.str();
}

TEST(Reader, InlineDeclarationOverridesDeclare) {
  const auto p = parse(
      "Declare \"x\" \"uniform color\"\nSurface \"s\" \"x\" [1 2 3]\nSurface \"s\" \"varying float[2] x\" [1 "
      "2]\n"
      "Surface \"s\" \"x\" [4 5 6]");
  EXPECT_EQ(p->rib,
            "Declare \"x\" \"uniform color\"\nSurface \"s\" \"uniform color x\" [1 2 3]\n"
            "Surface \"s\" \"varying float[2] x\" [1 2]\nSurface \"s\" \"uniform color x\" [4 5 6]\n");
  EXPECT_TRUE(p->reports.errors.empty()) << p->reports.str();
}

TEST(Reader, BuiltInNamesOfOptionsAndAttributes) {
  const auto p = parse(
      "Option \"limits\" \"bucketsize\" [16 16]\nAttribute \"displacementbound\" \"sphere\" .1 "
      "\"coordinatesystem\" \"shader\"\nAttribute \"render\" \"patch_multiplier\" 1");
  EXPECT_EQ(p->rib,
            "Option \"limits\" \"uniform integer[2] bucketsize\" [16 16]\nAttribute \"displacementbound\" "
            "\"uniform float sphere\" [0.1] \"uniform string coordinatesystem\" [\"shader\"]\n"
            "Attribute \"render\" \"uniform float patch_multiplier\" [1]\n");
  EXPECT_TRUE(p->reports.errors.empty()) << p->reports.str();
}

TEST(Reader, NumbersThatMakeNoWholeValueAreLeftOut) {
  const auto p = parse("LightSource \"distantlight\" 3 \"from\" [0 1 0 7] \"to\" [0 0 0]");
  EXPECT_EQ(p->rib,
            "LightSource \"distantlight\" 3 \"uniform point from\" [0 1 0] \"uniform point to\" [0 0 0]\n");
  EXPECT_EQ(p->reports.count(RiError::kConsistency), 1) << p->reports.str();
}

TEST(Reader, UnknownRequestIsSkippedAndSaidOnce) {
  const auto p = parse("Foo \"a\" [1 2 \"x\"] 7\nSides 1\nFoo\nSides 2");
  EXPECT_EQ(p->rib, "Sides 1\nSides 2\n");
  ASSERT_EQ(p->reports.errors.size(), 1u) << p->reports.str();
  EXPECT_EQ(p->reports.errors[0].code, RiError::kBadToken);
  EXPECT_EQ(p->reports.errors[0].severity, Severity::kWarning);
}

TEST(Reader, UndeclaredShaderParameterTakesItsTypeFromItsValue) {
  const auto p = parse(
      "Surface \"s\" \"what\" [1 2] # two\n \"Ka\" 1 \"that\" \"z\" \"these\" [\"a\" \"b\"] \"Kd\" 2\n"
      "Attribute \"user\" \"x\" 5");
  EXPECT_EQ(p->rib,
            "Surface \"s\" \"uniform float[2] what\" [1 2] \"uniform float Ka\" [1] \"uniform string that\" "
            "[\"z\"] \"uniform string[2] these\" [\"a\" \"b\"] \"uniform float Kd\" [2]\n"
            "Attribute \"user\" \"uniform float x\" [5]\n");
  EXPECT_TRUE(p->reports.errors.empty()) << p->reports.str();
}

TEST(Reader, UndeclaredParameterCostsOnlyItself) {
  const auto p = parse(
      "Attribute \"dice\" \"what\" [1 2] \"binary\" 1\nSphere 1 -1 1 360 \"that\" [1 2]\n"
      "Surface \"s\" \"mixed\" [1 \"a\" 2] \"none\" [] \"Kd\" 2");
  EXPECT_EQ(p->rib,
            "Attribute \"dice\" \"uniform integer binary\" [1]\nSphere 1 -1 1 360\nSurface \"s\" \"uniform "
            "float Kd\" [2]\n");
  EXPECT_EQ(p->reports.count(RiError::kBadToken), 4) << p->reports.str();
}

TEST(Reader, WrongValueCostsOnlyTheParameter) {
  const auto p = parse(
      "Surface \"s\" \"Ka\" \"text\" \"Kd\" [1 \"x\" 2] \"Ks\" 3 \"specularcolor\" [1 2] \"roughness\" 4");
  EXPECT_EQ(p->rib, "Surface \"s\" \"uniform float Ks\" [3] \"uniform float roughness\" [4]\n");
  EXPECT_EQ(p->reports.count(RiError::kSyntax), 2) << p->reports.str();
  EXPECT_EQ(p->reports.count(RiError::kConsistency), 1);
}

TEST(Reader, BadRequestIsSkippedWithItsPlace) {
  const auto p = parse("Sides 1\n  Translate 1 2\nSides 2\nFormat \"x\" 1 1\nSides 1 7 8\nSides 2");
  EXPECT_EQ(p->rib, "Sides 1\nSides 2\nSides 1\nSides 2\n");
  ASSERT_EQ(p->reports.errors.size(), 3u) << p->reports.str();
  EXPECT_EQ(p->reports.errors[0].where.str(), "t.rib:3:1");  // where the third number is missing
  EXPECT_EQ(p->reports.errors[1].where.str(), "t.rib:4:8");
  EXPECT_EQ(p->reports.errors[2].severity, Severity::kWarning);
}

TEST(Reader, RubbishBetweenRequests) {
  const auto p = parse("1 2 \"x\" ] Sides 1 . Sides 2 12ab Sides 1");
  EXPECT_EQ(p->rib, "Sides 1\nSides 2\nSides 1\n");
  EXPECT_EQ(p->reports.count(RiError::kSyntax), 3) << p->reports.str();
}

TEST(Reader, EndlessRubbishIsReportedBriefly) {
  std::string text;
  for (int i = 0; i < 5000; ++i) text += fmt::format("Foo{} 1\nSides x{}\n", i, i);
  const auto p = parse(text);
  EXPECT_LT(p->reports.errors.size(), 450u);
}

TEST(Reader, LineEndsOfAllSystems) {
  const std::string text = "##RenderMan RIB\nSides 1 # one\nColor 1 1 1\n";
  std::string want = parse(text)->rib;
  for (const char* nl : {"\r\n", "\r"}) {
    std::string other;
    for (char c : text) c == '\n' ? other += nl : other += c;
    EXPECT_EQ(parse(other)->rib, want);
  }
  EXPECT_EQ(want, "##RenderMan RIB\nSides 1\nColor [1 1 1]\n");
}

TEST(Reader, StructureCommentsStayInOrder) {
  const auto p = parse(
      "Surface \"s\" \"Ka\" 1\n##Shaders s\nSides 1\nPointsPolygons [3]\n##inside\n[0 1 2] \"P\" "
      "[0 0 0 1 0 0 0 1 0]\nSides 2");
  EXPECT_EQ(p->rib,
            "Surface \"s\" \"uniform float Ka\" [1]\n##Shaders s\nSides 1\nPointsPolygons [3] [0 1 2] "
            "\"vertex point P\" "
            "[0 0 0 1 0 0 0 1 0]\n##inside\nSides 2\n");
}

TEST(Reader, StringAndIntegerHandles) {
  const auto p = parse(
      "LightSource \"l\" 1 \"intensity\" 2\nLightSource \"l\" \"key\" \"intensity\" 2\nIlluminate "
      "\"key\" 0\nIlluminate 1 1\nObjectBegin \"o\"\nObjectEnd\nObjectInstance \"o\"\nAreaLightSource \"\"");
  EXPECT_EQ(p->rib,
            "LightSource \"l\" 1 \"uniform float intensity\" [2]\nLightSource \"l\" \"key\" \"uniform float "
            "intensity\" [2]\nIlluminate \"key\" 0\nIlluminate 1 1\nObjectBegin "
            "\"o\"\nObjectEnd\nObjectInstance \"o\"\n"
            "AreaLightSource \"\" \"\"\n");
  EXPECT_TRUE(p->reports.errors.empty()) << p->reports.str();
}

// Every request once, with its arguments; written, read again and written again it must not change, and no
// request that the reader knows may be missing here.
const char* const kEverything = R"(##RenderMan RIB-Structure 1.1
version 3.03
ErrorHandler "print"
Declare "foo" "varying color"
Option "searchpath" "shader" ["a:b"]
Format 320 240 1
FrameAspectRatio 1.5
ScreenWindow -1 1 -1 1
CropWindow 0 .5 0 .5
Clipping .1 1000
ClippingPlane 0 0 1 0 0 1
DepthOfField 2.8 .05 3
DepthOfField
Shutter 0 1
PixelVariance .01
PixelSamples 3 3
PixelFilter "gaussian" 2 2
Exposure 1 2.2
Imager "background" "bgcolor" [0 0 1]
Quantize "rgba" 255 0 255 .5
Display "+a.tif" "file" "rgba" "quantize" [0 255 0 255]
DisplayChannel "varying color Ci" "string filter" "box"
Hider "hidden" "jitter" 0
ColorSamples [.3 .3 .3] [1 1 1]
RelativeDetail 1
Camera "main" "float shutteropening" 1
FrameBegin 1
Projection "perspective" "fov" 45
WorldBegin
AttributeBegin
TransformBegin
Color [1 0 0]
Opacity [1 1 1]
TextureCoordinates [0 0 1 0 0 1 1 1]
LightSource "pointlight" 1 "from" [0 0 0]
AreaLightSource "arealight" 2
Illuminate 1 1
Surface "matte"
Displacement "bumpy"
Atmosphere "fog"
Interior "a"
Exterior "b"
Deformation "c"
ShaderLayer "surface" "matte" "base"
ConnectShaderLayers "surface" "a" "b" "c" "d"
ShadingRate 1
ShadingInterpolation "smooth"
Matte 1
Bound [-1 1 -1 1 -1 1]
Detail [-1 1 -1 1 -1 1]
DetailRange 0 10 20 30
GeometricApproximation "flatness" .5
GeometricRepresentation "primitive"
Orientation "lh"
ReverseOrientation
Sides 1
Attribute "identifier" "name" "ball"
Basis "b-spline" 1 [1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1] 4
TrimCurve [1] [2] [0 0 1 1] [0] [1] [2] [0 1] [0 1] [1 1]
ResourceBegin
Resource "r" "attributes" "string operation" "save"
ResourceEnd
Identity
Transform [1 0 0 0 0 1 0 0 0 0 1 0 1 2 3 1]
ConcatTransform [1 0 0 0 0 1 0 0 0 0 1 0 1 2 3 1]
Perspective 40
Translate 1 2 3
Rotate 90 0 0 1
Scale 1 2 3
Skew 45 1 0 0 0 1 0
CoordinateSystem "here"
ScopedCoordinateSystem "there"
CoordSysTransform "here"
TransformEnd
Polygon "P" [0 0 0 1 0 0 0 1 0]
GeneralPolygon [3] "P" [0 0 0 1 0 0 0 1 0]
PointsPolygons [3] [0 1 2] "P" [0 0 0 1 0 0 0 1 0]
PointsGeneralPolygons [1] [3] [0 1 2] "P" [0 0 0 1 0 0 0 1 0]
Patch "bilinear" "P" [0 0 0 1 0 0 0 1 0 1 1 0]
PatchMesh "bilinear" 2 "nonperiodic" 2 "nonperiodic" "Pz" [1 2 3 4]
NuPatch 2 2 [0 0 1 1] 0 1 2 2 [0 0 1 1] 0 1 "Pw" [0 0 0 1 1 0 0 1 0 1 0 1 1 1 0 1]
SubdivisionMesh "catmull-clark" [4] [0 1 2 3] ["interpolateboundary"] [0 0] [] [] "P" [0 0 0 1 0 0 1 1 0 0 1 0]
HierarchicalSubdivisionMesh "catmull-clark" [4] [0 1 2 3] ["creasemethod"] [0 0 1] [] [] ["normal"] "P" [0 0 0 1 0 0 1 1 0 0 1 0]
Sphere 1 -1 1 360
Cone 1 1 360
Cylinder 1 -1 1 360
Hyperboloid 0 0 0 1 1 1 360
Paraboloid 1 0 1 360
Disk 0 1 360
Torus 1 .25 0 360 360
Points "P" [0 0 0]
Curves "linear" [2] "nonperiodic" "P" [0 0 0 1 1 1] "constantwidth" .1
Blobby 1 [1001 0] [1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1] [""]
Geometry "teapot"
Procedural "DelayedReadArchive" ["x.rib"] [-1 1 -1 1 -1 1]
Procedural2 "a" "b" "float x" 1
SolidBegin "union"
SolidEnd
ObjectBegin 1
ObjectEnd
ObjectInstance 1
MotionBegin [0 1]
Translate 0 0 0
Translate 1 0 0
MotionEnd
AttributeEnd
WorldEnd
FrameEnd
MakeTexture "a" "b" "black" "black" "box" 1 1
MakeBump "a" "b" "black" "black" "box" 1 1
MakeLatLongEnvironment "a" "b" "box" 1 1
MakeCubeFaceEnvironment "a" "b" "c" "d" "e" "f" "g" 90 "box" 1 1
MakeShadow "a" "b"
MakeOcclusion ["a" "b"] "c"
MakeBrickMap ["a"] "c"
ArchiveRecord "comment" "hello"
ReadArchive "x.rib"
ArchiveBegin "inline"
Sides 2
ArchiveEnd
IfBegin "1 == 1"
ElseIf "1 == 1"
Else
IfEnd
EditBegin "x"
EditEnd
VolumePixelSamples 1 1
System "true"
)";

TEST(Reader, EveryRequestSurvivesWritingAndReading) {
  ReaderOptions o;
  o.expandArchives = false;
  o.keepComments = true;
  const auto first = parse(kEverything, o);
  for (const Error& e : first->reports.errors) EXPECT_EQ(e.code, RiError::kUnimplemented) << e.str();
  const auto second = parse(first->rib, o);
  EXPECT_EQ(first->rib, second->rib);
  EXPECT_TRUE(second->reports.errors.empty()) << second->reports.str();
  const std::set<std::string_view> silent = {"version", "IfBegin",      "ElseIf",  "Else",
                                             "IfEnd",   "EditBegin",    "EditEnd", "VolumePixelSamples",
                                             "System",  "ArchiveRecord"};
  for (std::string_view name : requestNames()) {
    const std::string line = "\n" + std::string(name);
    const bool there = std::string_view(kEverything).find(line + " ") != std::string_view::npos ||
                       std::string_view(kEverything).find(line + "\n") != std::string_view::npos;
    EXPECT_TRUE(there) << name << " is not tried";
    if (silent.count(name)) continue;
    const bool written =
        first->rib.find(line + " ") != std::string::npos || first->rib.find(line + "\n") != std::string::npos;
    EXPECT_TRUE(written) << name << " is lost";
  }
}

TEST(Reader, BinaryGivesTheSameRequests) {
  const std::string name = bytes({0314, 1, 0226}) + "Sphere";
  const std::string binary = name + bytes({0246, 1, 0200, 2, 0200, 0376}) + bytes({0244, 0x40, 0, 0, 0}) +
                             bytes({0201, 1, 0x68}) + bytes({0315, 0, 0222}) + "Ka" + "Surface" +
                             bytes({0225}) + "matte" + bytes({0317, 0, 0310, 1, 0x3f, 0, 0, 0});
  const auto p = parse(binary);
  EXPECT_EQ(p->rib, parse("Sphere 2 -2 2 360\nSurface \"matte\" \"Ka\" [.5]")->rib) << p->reports.str();
  // An array of floats is no array of integers.
  const auto q = parse("PointsPolygons " + bytes({0310, 1, 0x40, 0x40, 0, 0}) + " [0 1 2]\nSides 1");
  EXPECT_EQ(q->rib, "Sides 1\n");
  EXPECT_EQ(q->reports.count(RiError::kSyntax), 1) << q->reports.str();
}

TEST(Reader, TruncatedAtEveryByte) {
  const std::string text = kEverything;
  for (size_t n = 0; n < text.size(); ++n) {
    const auto p = parse(std::string_view(text).substr(0, n));
    ASSERT_TRUE(p->result.ok());
  }
}

TEST(Reader, NonFiniteNumbersAreReported) {
  const auto p = parse("Points \"P\" [0 nan 1 1 inf 2]");
  EXPECT_EQ(p->reports.count(RiError::kMath), 1) << p->reports.str();
}

TEST(Reader, AStringThatEndsInABackslashIsSaidAtItsStart) {
  const auto p = parse("Sides 1\nOption \"searchpath\" \"texture\" [\"C:\\tex\\\"]\nSides 2\n");
  EXPECT_EQ(p->rib,
            "Sides 1\nOption \"searchpath\" \"uniform string texture\" [\"C:\\\\tex\\\\\"]\nSides 2\n");
  ASSERT_EQ(p->reports.errors.size(), 1u) << p->reports.str();
  EXPECT_EQ(p->reports.errors[0].where.line, 2);
  EXPECT_EQ(p->reports.errors[0].where.column, 32);
}

TEST(Reader, AStringAmongNumbersIsNotTakenForTheNextOne) {
  const auto p = parse("Surface \"s\" \"float Ka\" [\"C:\\a\\\" 1] \"string map\" \"ok\"\n");
  EXPECT_EQ(p->rib, "Surface \"s\" \"uniform string map\" [\"ok\"]\n");
  EXPECT_EQ(p->reports.errors.size(), 1u) << p->reports.str();
}

TEST(Reader, LightsWithoutAHandle) {
  StateRenderer state;
  ReportCapture reports;
  Reader r(state);
  ASSERT_TRUE(
      r.readBuffer("WorldBegin LightSource \"distantlight\"\nLightSource \"pointlight\" \"intensity\" 5 "
                   "\"from\" [1 2 3]\nLightSource \"spotlight\" \"key\" \"intensity\" [7]\n")
          .ok());
  const auto& lights = state.state().lights();
  ASSERT_EQ(lights.size(), 3u);
  EXPECT_EQ(lights[1].shader->params.getFloat("intensity", 0), 5);
  EXPECT_TRUE(lights[1].shader->params.has("from"));
  EXPECT_EQ(lights[2].handle.name, "key");
  EXPECT_EQ(reports.count(RiError::kMissingData), 2) << reports.str();
}

TEST(Reader, CommasAreBlanksAndSaidOnce) {
  const auto p = parse("Translate 1, 2,3\nColor [1,0,0]\nSides 1\n");
  EXPECT_EQ(p->rib, "Translate 1 2 3\nColor [1 0 0]\nSides 1\n");
  EXPECT_EQ(p->reports.errors.size(), 1u) << p->reports.str();
}

TEST(Reader, InlineArchives) {
  const auto p = parse(
      "ArchiveBegin \"a\"\nSides 1\nArchiveBegin \"b\"\nSides 2\nArchiveEnd\nReadArchive \"b\"\nArchiveEnd\n"
      "ReadArchive \"a\"\nColor 1 1 1\nReadArchive \"a\"");
  EXPECT_EQ(p->rib, "Sides 1\nSides 2\nColor [1 1 1]\nSides 1\nSides 2\n");
  EXPECT_TRUE(p->reports.errors.empty()) << p->reports.str();
}

TEST(Reader, VariablesInStrings) {
  StateRenderer state;
  ReportCapture reports;
  Reader r(state);
  ASSERT_TRUE(
      r.readBuffer("Option \"user\" \"string shot\" [\"s12\"] \"int take\" [3]\n"
                   "Display \"$user:shot.exr\" \"file\" \"rgba\"\n"
                   "Option \"ribparse\" \"varsubst\" [\"$\"]\n"
                   "Attribute \"identifier\" \"name\" [\"a$user:shot\"]\nFrameBegin 7\n"
                   "Display \"+${user:shot}_$Frame.t${user:take}.exr\" \"file\" \"rgba\"\n"
                   "IfBegin \"$user:shot == 's12'\"\nDisplay \"+$nothing:at:all\" \"file\" \"z\"\nIfEnd\n"
                   "Option \"ribparse\" \"varsubst\" [\"\"]\nDisplay \"+$Frame\" \"file\" \"a\"\n")
          .ok());
  EXPECT_EQ(state.state().attributes().values.getString("identifier:name", ""), "as12");
  const auto& d = state.state().options().displays;
  ASSERT_EQ(d.size(), 4u);
  EXPECT_EQ(d[0].name, "$user:shot.exr");
  EXPECT_EQ(d[1].name, "s12_7.t3.exr");
  EXPECT_EQ(d[2].name, "$nothing:at:all");
  EXPECT_EQ(d[3].name, "$Frame");
  EXPECT_EQ(reports.count(RiError::kBadToken), 1) << reports.str();
}

TEST(Reader, PlacesInsideInlineArchives) {
  const auto p = parse("\nArchiveBegin \"a\"\nSides 1\nTranslate 1\nArchiveEnd\nReadArchive \"a\"\n");
  ASSERT_EQ(p->reports.errors.size(), 1u) << p->reports.str();
  EXPECT_EQ(p->reports.errors[0].where.line, 5);  // the end of the archive, where the number is missing
}

TEST(Reader, EmptyAndUnendedArchives) {
  EXPECT_EQ(parse("ArchiveBegin \"a\" ArchiveEnd ReadArchive \"a\" Sides 1")->rib, "Sides 1\n");
  const auto p = parse("Sides 1 ArchiveBegin \"a\" Sides 2");
  EXPECT_EQ(p->rib, "Sides 1\n");
  EXPECT_EQ(p->reports.count(RiError::kNesting), 1);
  EXPECT_EQ(parse("ArchiveEnd")->reports.count(RiError::kNesting), 1);
}

TEST(Reader, ArchiveThatReadsItself) {
  const auto p = parse("ArchiveBegin \"a\" Sides 1 ReadArchive \"a\" ArchiveEnd ReadArchive \"a\"");
  EXPECT_FALSE(p->result.ok());
  EXPECT_EQ(p->result.error().code, RiError::kLimit);
}

class Folder {
 public:
  Folder() {
    char name[] = "/tmp/fr_ri_testXXXXXX";
    path = ::mkdtemp(name);
  }
  ~Folder() { std::filesystem::remove_all(path); }
  void write(const std::string& name, const std::string& text) const {
    std::filesystem::create_directories((std::filesystem::path(path) / name).parent_path());
    std::ofstream(path + "/" + name) << text;
  }
  std::string path;
};

TEST(Reader, ArchiveFilesLoopsAndMissingOnes) {
  const Folder f;
  f.write("main.rib", "Sides 1\nReadArchive \"sub/one.rib\"\nReadArchive \"none.rib\"\nSides 2\n");
  f.write("moved.rib",
          "ReadArchive \"/of/another/machine/two.rib\"\nReadArchive \"C:\\\\scenes\\\\two.rib\"\n");
  f.write("two.rib", "Sides 2\n");
  f.write("sub/one.rib", "Color 1 0 0\n");
  f.write("loop.rib", "Sides 1\nReadArchive \"./loop.rib\"\n");
  ReportCapture reports;
  std::string rib;
  RibWriter w([&](std::string_view s) { rib += s; });
  Reader r(w);
  EXPECT_TRUE(r.readFile(f.path + "/main.rib").ok());
  w.flush();
  EXPECT_EQ(rib, "Sides 1\nColor [1 0 0]\nSides 2\n");
  EXPECT_EQ(reports.count(RiError::kNoFile), 1);
  const auto loop = r.readFile(f.path + "/loop.rib");
  ASSERT_FALSE(loop.ok());
  EXPECT_EQ(loop.error().code, RiError::kLimit);
  const auto none = r.readFile(f.path + "/nowhere.rib");
  ASSERT_FALSE(none.ok());
  EXPECT_EQ(none.error().code, RiError::kNoFile);
  EXPECT_TRUE(r.readFile(f.path + "/main.rib").ok());  // usable after errors
  w.flush();
  rib.clear();
  EXPECT_TRUE(r.readFile(f.path + "/moved.rib").ok());
  w.flush();
  EXPECT_EQ(rib, "Sides 2\nSides 2\n");
}

TEST(Reader, DeepArchivesStop) {
  std::string text;
  for (int i = 0; i < 100; ++i)
    text += fmt::format("ArchiveBegin \"a{}\" ReadArchive \"a{}\" ArchiveEnd\n", i, i + 1);
  const auto p = parse(text + "ReadArchive \"a0\"");
  ASSERT_FALSE(p->result.ok());
  EXPECT_EQ(p->result.error().code, RiError::kLimit);
}

TEST(Reader, ErrorHandlerAbortStops) {
  const auto p = parse("ErrorHandler \"abort\"\nSides 1\nTranslate 1\nSides 2");
  EXPECT_EQ(p->rib, "ErrorHandler \"abort\"\nSides 1\n");
  EXPECT_FALSE(p->result.ok());
}

TEST(Reader, DescriptorEndsAtMarker) {
  int fds[2];
  ASSERT_EQ(::pipe(fds), 0);
  const std::string text = "Sides 1\n\377Sides 2\n";
  ASSERT_EQ(::write(fds[1], text.data(), text.size()), ssize_t(text.size()));
  ReportCapture reports;
  std::string rib;
  RibWriter w([&](std::string_view s) { rib += s; });
  Reader r(w);
  EXPECT_TRUE(r.readDescriptor(fds[0], "program").ok());  // the pipe is still open: the marker ended it
  ::close(fds[1]);
  EXPECT_TRUE(r.readDescriptor(fds[0], "program").ok());
  ::close(fds[0]);
  w.flush();
  EXPECT_EQ(rib, "Sides 1\n");
}

TEST(Reader, NothingIsAwaitedBehindTheMarker) {
  // Whatever stands last in an answer: its reader must not wait for more than the program will say.
  for (const char* last :
       {"", "Sides 1", "Color [1 0 0]\n", "Translate 1 2 3", "Declare \"a\" \"uniform string\"",
        "Procedural \"DelayedReadArchive\" [\"a\\n\"] [0 1 0 1 0 1]",
        "PointsPolygons [3] [0 1 2] \"P\" [0 0 0 1 0 0 0 1 0]", "# nothing\n"}) {
    int fds[2];
    ASSERT_EQ(::pipe(fds), 0);
    const std::string text = std::string(last) + "\377";
    ASSERT_EQ(::write(fds[1], text.data(), text.size()), ssize_t(text.size()));
    ::alarm(20);  // the test fails by dying if it waits
    NullRenderer nothing;
    Reader r(nothing);
    ReportCapture reports;
    EXPECT_TRUE(r.readDescriptor(fds[0], "program").ok());
    EXPECT_EQ(reports.str(), "") << last;
    ::alarm(0);
    ::close(fds[0]), ::close(fds[1]);
  }
}

TEST(Reader, ConditionalRib) {
  const auto p = parse(
      "IfBegin \"1 > 2\" Sides 1 IfBegin \"1\" Sides 1 IfEnd ElseIf \"2 == 2\" Sides 2 IfBegin \"0\" Sides 1 "
      "Else "
      "Color 1 1 1 IfEnd Else Sides 1 IfEnd Matte 1");
  EXPECT_EQ(p->rib, "Sides 2\nColor [1 1 1]\nMatte 1\n");
  EXPECT_EQ(parse("IfBegin \"1\" Sides 1")->reports.count(RiError::kNesting), 1);
  EXPECT_EQ(parse("Else")->reports.count(RiError::kNesting), 1);
  EXPECT_EQ(parse("IfBegin \"1 +\" Sides 1 IfEnd Sides 2")->rib, "Sides 2\n");
}

TEST(Condition, Expressions) {
  const Param three{"x", {StorageClass::kUniform, ValueType::kInteger, 1, false}, {}, {3}, {}};
  const Param name{"n", {StorageClass::kUniform, ValueType::kString, 1, false}, {}, {}, {"beauty_pass"}};
  const VariableLookup lookup = [&](std::string_view n) -> const Param* {
    return n == "user:x" ? &three : n == "n" ? &name : nullptr;
  };
  const auto is = [&](const char* text) {
    const Result<bool> r = evaluateCondition(text, lookup);
    EXPECT_TRUE(r.ok()) << text;
    return r.ok() && *r;
  };
  EXPECT_TRUE(is("$user:x == 3"));
  EXPECT_TRUE(is("${user:x} + 1 == 2 * 2 && !($user:x < 3)"));
  EXPECT_TRUE(is("$n == 'beauty_pass'"));
  EXPECT_TRUE(is("$n =~ 'beauty*'"));
  EXPECT_FALSE(is("$n =~ '*shadow*'"));
  EXPECT_TRUE(is("defined(user:x) && !defined(user:y)"));
  EXPECT_TRUE(is("$user:y == 0"));
  EXPECT_TRUE(is("-1 < 0 || 1/0"));
  EXPECT_FALSE(evaluateCondition("(1", lookup).ok());
  EXPECT_FALSE(evaluateCondition("", lookup).ok());
  EXPECT_FALSE(evaluateCondition(std::string(100000, '('), lookup).ok());
  EXPECT_FALSE(evaluateCondition(std::string(100000, '!') + "1", lookup).ok());
}

TEST(SearchPath, FilesInOtherCasesComeLast) {
  const std::filesystem::path folder = std::filesystem::path(::testing::TempDir()) / "fr_other_case";
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder / "Wood.rib");  // no file
  const auto make = [&](const char* name) { std::ofstream(folder / name) << "Sides 1\n"; };
  const auto find = [&](const char* name) {
    bool moved = false;
    const std::string found = findMovedFile(name, {"/no/such/folder", folder.string()}, moved);
    return std::filesystem::path(found).filename().string() + (moved ? " moved" : "");
  };
  make("TREE.rib"), make("Tree.RIB");
  // As if read long ago: what was read is kept until the folder changes.
  const auto age = [&] {
    std::filesystem::last_write_time(folder,
                                     std::filesystem::file_time_type::clock::now() - std::chrono::hours(1));
  };
  age();
  EXPECT_EQ(find("Tree.RIB"), "Tree.RIB");
  EXPECT_EQ(find("C:\\trees\\Tree.RIB"), "Tree.RIB moved");
  EXPECT_EQ(find("tree.rib"), "TREE.rib moved");
  EXPECT_EQ(find("wood.rib"), "");
  make("WOOD.RIB");
  EXPECT_EQ(find("wood.rib"), "WOOD.RIB moved");
  make("wood.RIB");  // soon after: within one tick of the clock, perhaps
  std::filesystem::remove(folder / "WOOD.RIB");
  EXPECT_EQ(find("wood.rib"), "wood.RIB moved");
  std::filesystem::remove_all(folder);
}

TEST(SearchPath, ListsAndPlaceholders) {
  using V = std::vector<std::string>;
  EXPECT_EQ(parseSearchPath("a:b;c", {}, {}), (V{"a", "b", "c"}));
  EXPECT_EQ(parseSearchPath("a:&:@", {"p", "q"}, {"s"}), (V{"a", "p", "q", "s"}));
  EXPECT_EQ(parseSearchPath("C:/x:D:\\y", {}, {}), (V{"C:/x", "D:\\y"}));
  ::setenv("FR_TEST_DIR", "/here", 1);
  EXPECT_EQ(parseSearchPath("$FR_TEST_DIR/a:${FR_TEST_DIR}b", {}, {}), (V{"/here/a", "/hereb"}));
}

}  // namespace
}  // namespace fr::ri
