// The C binding from a C++ program that links libri.so alone.
#include <gtest/gtest.h>
#include <ri/ri.h>
#include <unistd.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

namespace {

std::vector<std::pair<RtInt, std::string>> errors;
RtVoid remember(RtInt code, RtInt, char* message) { errors.emplace_back(code, message); }

/// A context that writes RIB, and the text that came out.
class CBinding : public testing::Test {
 protected:
  void SetUp() override {
    errors.clear();
    RiErrorHandler(remember);
    file_ =
        (std::filesystem::temp_directory_path() / ("libri_" + std::to_string(getpid()) + ".rib")).string();
    RiBegin(file_.c_str());
  }
  void TearDown() override {
    if (RiGetContext()) RiEnd();
    std::filesystem::remove(file_);
    RiErrorHandler(RiErrorPrint);
  }
  /// Ends the context. Without the two lines of the head.
  std::string rib() {
    RiEnd();
    std::ifstream in(file_);
    std::stringstream text;
    text << in.rdbuf();
    const std::string head = "##RenderMan RIB-Structure 1.1\nversion 3.04\n";
    EXPECT_EQ(text.str().substr(0, head.size()), head);
    return text.str().substr(std::min(head.size(), text.str().size()));
  }
  std::string file_;
};

TEST_F(CBinding, NumbersOfValuesFollowFromThePrimitive) {
  RtPoint p[16] = {};
  RtColor colors[4] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 1, 1}};
  RtFloat flags[2] = {1, 2};
  RtInt nverts[2] = {3, 3}, verts[6] = {0, 1, 2, 2, 3, 0};
  RtString name = "thing";
  RiDeclare("flag", "uniform float");
  RiAttribute("identifier", "name", &name, RI_NULL);
  RiPointsPolygons(2, nverts, verts, RI_P, p, RI_CS, colors, "flag", flags, RI_NULL);
  RiPatch(RI_BICUBIC, RI_P, p, "varying color Cs", colors, RI_NULL);
  RiBasis(RiBSplineBasis, RI_BSPLINESTEP, RiBSplineBasis, RI_BSPLINESTEP);
  RtFloat widths[3] = {0.1f, 0.2f, 0.3f};
  RtInt five[1] = {5};
  RiCurves(RI_CUBIC, 1, five, RI_NONPERIODIC, RI_P, p, RI_WIDTH, widths, RI_NULL);  // 2 segments: 3 widths
  RtFloat radius = 0.3f;
  RiSphere(radius, -radius, radius, 360, RI_NULL);
  const std::string text = rib();
  EXPECT_NE(text.find("PointsPolygons [3 3] [0 1 2 2 3 0] \"P\" [0 0 0 0 0 0 0 0 0 0 0 0] \"Cs\" [1 0 0 0 1 "
                      "0 0 0 1 1 1 1]"),
            std::string::npos)
      << text;
  EXPECT_NE(text.find("\"flag\"\n    [1 2]"), std::string::npos) << text;
  EXPECT_NE(text.find("Basis \"b-spline\" 1 \"b-spline\" 1"), std::string::npos) << text;
  EXPECT_NE(text.find("\"width\" [0.1 0.2 0.3]"), std::string::npos) << text;
  EXPECT_NE(text.find("Sphere 0.3 -0.3 0.3 360"), std::string::npos) << text;
  EXPECT_TRUE(errors.empty()) << errors[0].second;
}

TEST_F(CBinding, HandlesAreCheckedAndNumbered) {
  const RtLightHandle light = RiLightSource(RI_POINTLIGHT, RI_NULL);
  RiIlluminate(light, RI_FALSE);
  const RtObjectHandle object = RiObjectBegin();
  RiSphere(1, -1, 1, 360, RI_NULL);
  RiObjectEnd();
  RiIlluminate(object, RI_TRUE);
  RiObjectInstance(nullptr);
  int other = 0;
  RiObjectInstance(&other);
  ASSERT_EQ(errors.size(), 3u);
  for (const auto& e : errors) EXPECT_EQ(e.first, RIE_BADHANDLE) << e.second;
  EXPECT_EQ(RiLastError, RIE_BADHANDLE);
  EXPECT_NE(rib().find("Illuminate 1 0"), std::string::npos);
}

TEST_F(CBinding, ErrorsNameTheRequestAndTheRestGoesOn) {
  RiSphere(1, -1, 1, 360, "nobody knows", nullptr, RI_NULL);
  RiSurface("matte", "undeclared", &errors, RI_NULL);
  RiPatch("quintic", RI_NULL);
  RiAttributeEnd();
  RtInt nverts[1] = {2}, verts[2] = {0, 1};
  RiPointsPolygons(1, nverts, verts, RI_NULL);
  ASSERT_EQ(errors.size(), 5u);
  EXPECT_EQ(errors[0].first, RIE_BADTOKEN);
  EXPECT_EQ(errors[1].first, RIE_BADTOKEN);
  EXPECT_EQ(errors[2].first, RIE_BADTOKEN);
  EXPECT_EQ(errors[3].first, RIE_NESTING);
  EXPECT_EQ(errors[4].first, RIE_CONSISTENCY);
  EXPECT_NE(errors[2].second.find("RiPatch"), std::string::npos);
  RiEnd();
  RiSides(1);
  EXPECT_EQ(errors.back().first, RIE_NOTSTARTED);
  RiEnd();
  EXPECT_EQ(RiLastError, RIE_NOTSTARTED);
}

TEST_F(CBinding, ContextsAreIndependent) {
  const RtContextHandle first = RiGetContext();
  const std::string second = file_ + ".second.rib";
  RtString binary = "binary";
  RiBegin(second.c_str());
  RiOption("rib", "format", &binary, RI_NULL);
  EXPECT_NE(RiGetContext(), first);
  RiSides(2);
  RiContext(first);
  RiSides(1);
  RiContext(&errors);
  EXPECT_EQ(errors.back().first, RIE_BADHANDLE);
  EXPECT_EQ(rib(), "Sides 1\n");
  EXPECT_EQ(RiGetContext(), nullptr);
  std::ifstream in(second);
  EXPECT_FALSE(in.is_open());  // not ended
}

TEST_F(CBinding, ACommandReadsWhatIsWritten) {
  RiEnd();
  std::filesystem::remove(file_);
  RiBegin(("|cat > '" + file_ + "'").c_str());
  RiSides(1);
  EXPECT_EQ(rib(), "Sides 1\n");
  EXPECT_TRUE(errors.empty());

  RiBegin("|cat > /dev/null; exit 3");
  RiSides(1);
  RiEnd();
  ASSERT_EQ(errors.size(), 1u);
  EXPECT_NE(errors[0].second.find("status 3"), std::string::npos) << errors[0].second;

  // One that ends early kills nobody.
  errors.clear();
  RiBegin("|exit 0");
  for (int i = 0; i < 100000; ++i) RiTranslate(1, 2, RtFloat(i));
  RiEnd();
  ASSERT_EQ(errors.size(), 1u);
  EXPECT_NE(errors[0].second.find("exit 0"), std::string::npos) << errors[0].second;
}

TEST_F(CBinding, TransformPointsKnowsAllSpaces) {
  RiFormat(200, 100, 1);
  RtFloat fov = 90;
  RiProjection(RI_PERSPECTIVE, RI_FOV, &fov, RI_NULL);
  RiClipping(1, 100);  // depths of raster space are floats too
  RiTranslate(0, 0, 10);
  RiWorldBegin();
  RiCoordinateSystem("start");
  RiTranslate(1, 2, 0);
  RtPoint p[2] = {{0, 0, 0}, {1, 0, 0}};
  ASSERT_EQ(RiTransformPoints(RI_CURRENT, RI_WORLD, 2, p), p);
  EXPECT_FLOAT_EQ(p[1][0], 2);
  EXPECT_FLOAT_EQ(p[1][1], 2);
  RiTransformPoints(RI_WORLD, RI_CAMERA, 2, p);
  EXPECT_FLOAT_EQ(p[0][2], 10);
  RiTransformPoints(RI_CAMERA, RI_RASTER, 2, p);
  // fov 90 of the shorter side: 50 pixels at distance 10 are 10 units, from the middle (100, 50), y down.
  EXPECT_NEAR(p[0][0], 105, 1e-4);
  EXPECT_NEAR(p[0][1], 40, 1e-4);
  RiTransformPoints(RI_RASTER, "start", 2, p);
  EXPECT_NEAR(p[1][0], 2, 1e-5);
  RiTransformPoints("start", RI_NDC, 2, p);
  EXPECT_NEAR(p[0][0], 105.0 / 200, 1e-6);
  EXPECT_NEAR(p[0][1], 40.0 / 100, 1e-6);
  EXPECT_TRUE(errors.empty());
  EXPECT_EQ(RiTransformPoints("nowhere", RI_WORLD, 2, p), nullptr);
  EXPECT_EQ(RiLastError, RIE_BADTOKEN);
  RiWorldEnd();
}

RtInt freed = 0;
RtVoid subdivide(RtPointer data, RtFloat) { RiSphere(*static_cast<RtFloat*>(data), -1, 1, 360, RI_NULL); }
RtVoid release(RtPointer) { ++freed; }

TEST_F(CBinding, Procedurals) {
  RtFloat radius = 1.5f;
  RtBound bound = {-1, 1, -1, 1, -1, 1};
  freed = 0;
  RiProcedural(&radius, bound, subdivide, release);
  EXPECT_EQ(freed, 1);
  auto* data = static_cast<RtString*>(std::malloc(2 * sizeof(RtString)));
  data[0] = "generate", data[1] = "7";
  RiProcedural(data, bound, RiProcRunProgram, RiProcFree);
  EXPECT_EQ(rib(),
            "AttributeBegin\n  Sphere 1.5 -1 1 360\nAttributeEnd\n"
            "Procedural \"RunProgram\" [\"generate\" \"7\"] [-1 1 -1 1 -1 1]\n");
}

TEST_F(CBinding, FiltersMotionRecordsAndConditions) {
  RiPixelFilter(RiCatmullRomFilter, 4, 4);
  RiMotionBegin(2, 0.0, 0.5);
  RiTranslate(0, 0, 0);
  RiTranslate(1, 0, 0);
  RiMotionEnd();
  RiArchiveRecord(RI_COMMENT, " %d of %s", 3, "them");
  RiArchiveRecord(RI_VERBATIM, "Sides %d\n", 1);
  RiIfBegin("$user:x == 1", RI_NULL);
  RiElse();
  RiIfEnd();
  RiErrorHandler(RiErrorIgnore);
  EXPECT_EQ(
      rib(),
      "PixelFilter \"catmull-rom\" 4 4\nMotionBegin [0 0.5]\n  Translate 0 0 0\n  Translate 1 0 0\n"
      "MotionEnd\n# 3 of them\nSides 1\nIfBegin \"$user:x == 1\"\nElse\nIfEnd\nErrorHandler \"ignore\"\n");
  EXPECT_EQ(RiBoxFilter(0.2f, 0.2f, 1, 1), 1);
  EXPECT_EQ(RiTriangleFilter(0.5f, 0, 2, 2), 0.5f);
  EXPECT_NEAR(RiGaussianFilter(0.5f, 0, 2, 2), std::exp(-0.5f), 1e-6);
}

std::vector<std::string> records;
RtVoid record(RtToken type, char* format, ...) {
  va_list arguments;
  va_start(arguments, format);
  char text[200];
  std::vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  records.push_back(std::string(type) + ":" + text);
}

TEST(CBindingInProcess, ArchivesCallBackAndConditionsAreObeyed) {
  errors.clear();
  RiErrorHandler(remember);
  const std::string folder = std::filesystem::temp_directory_path().string();
  const std::string archive = folder + "/libri_archive_" + std::to_string(getpid()) + ".rib";
  std::ofstream(archive) << "##Creator us\n# hello\nDeclare \"amount\" \"uniform float\"\n";
  RiBegin(RI_NULL);
  records.clear();
  RiReadArchive(archive.c_str(), record, RI_NULL);
  EXPECT_EQ(records, (std::vector<std::string>{"structure:Creator us", "comment: hello"}));
  RiArchiveBegin("inline", RI_NULL);
  RiBasis(RiBSplineBasis, 1, RiBSplineBasis, 1);
  RiArchiveRecord(RI_STRUCTURE, "inside");
  RiArchiveEnd();
  records.clear();
  RiReadArchive("inline", record, RI_NULL);
  EXPECT_EQ(records, (std::vector<std::string>{"structure:inside"}));
  RtFloat amount = 1;
  RiOption("user", "amount", &amount, RI_NULL);  // declared by the archive
  RiIfBegin("$user:amount > 2", RI_NULL);
  RiSides(17);  // would be an error
  RiElse();
  RiIfBegin("$user:amount == 1", RI_NULL);
  RiReadArchive("inline", record, RI_NULL);
  RiIfEnd();
  RiIfEnd();
  EXPECT_EQ(records.size(), 2u);
  EXPECT_TRUE(errors.empty()) << errors[0].second;
  RiIfEnd();
  RiReadArchive("no such archive", nullptr, RI_NULL);
  ASSERT_EQ(errors.size(), 2u);
  EXPECT_EQ(errors[0].first, RIE_NESTING);
  EXPECT_EQ(errors[1].first, RIE_NOFILE);
  RiEnd();
  std::filesystem::remove(archive);
  RiErrorHandler(RiErrorPrint);
}

}  // namespace
