// RIB that promises more than it holds, or means nothing: one message with its place, no memory, and the rest
// of the scene as if it were not there.
#include <gtest/gtest.h>
#include <sys/resource.h>

#include "ri/reader.h"
#include "scene_cache/scene_builder.h"
#include "scene_cache/skeleton_image.h"

namespace fr::cache {
namespace {

long peakKilobytes() {
  rusage u{};
  getrusage(RUSAGE_SELF, &u);
  return u.ru_maxrss;
}

struct Read {
  size_t objects = 0;
  std::vector<Error> reports;
  std::string all() const {
    std::string s;
    for (const Error& e : reports) s += e.str() + '\n';
    return s;
  }
};

Read read(const std::string& rib) {
  Read result;
  setReportSink([&](const Error& e) { result.reports.push_back(e); });
  const FrameCallback onFrame = [&](Frame&& f) {
    SkeletonImage image(dup(f.skeletonFd()));
    auto s = Skeleton::open(image.bytes(), false);
    EXPECT_TRUE(s.ok()) << s.error().str();
    if (s.ok()) result.objects = s->objects().size();
    return true;
  };
  SceneBuilder builder({}, onFrame, {});
  ri::Reader reader(builder);
  builder.setReader(&reader);
  (void)reader.readBuffer(rib, "t.rib");
  builder.finish();
  setReportSink({});
  return result;
}

struct Case {
  const char* name;
  RiError code;
  const char* rib;  // stands on line 3
};

class HostileRib : public testing::TestWithParam<Case> {};

TEST_P(HostileRib, CostsItselfAlone) {
  [[maybe_unused]] const long before = peakKilobytes();
  const Read r =
      read(std::string("WorldBegin\nSphere 1 -1 1 360\n") + GetParam().rib + "\nDisk 0 1 360\nWorldEnd\n");
  EXPECT_EQ(r.objects, 2u) << r.all();
  ASSERT_GE(r.reports.size(), 1u);
  EXPECT_LE(r.reports.size(), 2u) << r.all();
  EXPECT_EQ(r.reports[0].code, GetParam().code) << r.all();
  EXPECT_EQ(r.reports[0].where.file, "t.rib") << r.all();
  EXPECT_EQ(r.reports[0].where.line, 3) << r.all();
#ifndef __SANITIZE_ADDRESS__
  EXPECT_LT(peakKilobytes() - before, 32 * 1024) << "memory for what never came";
#endif
}

constexpr Case kCases[] = {
    {"PatchMeshCounts", RiError::kConsistency,
     "PatchMesh \"bilinear\" 2147483647 \"nonperiodic\" 2147483647 \"nonperiodic\" \"P\" [0 0 0 1 0 0 0 1 0 "
     "1 1 0]"},
    {"PatchMeshCountsThatWrapAround", RiError::kMissingData,
     "PatchMesh \"bilinear\" 1073741824 \"nonperiodic\" 1073741824 \"nonperiodic\" \"vertex float[16] P\" "
     "[]"},
    {"PatchMeshNegative", RiError::kConsistency,
     "PatchMesh \"bilinear\" -4 \"nonperiodic\" 2 \"nonperiodic\" \"P\" [0 0 0 1 0 0 0 1 0 1 1 0]"},
    {"NuPatchCounts", RiError::kConsistency,
     "NuPatch 2147483647 2147483647 [0 0 1 1] 0 1 2 2 [0 0 1 1] 0 1 \"P\" [0 0 0 1 0 0 0 1 0 1 1 0]"},
    {"NuPatchOrder", RiError::kRange,
     "NuPatch 2 -2147483647 [0 0 1 1] 0 1 2 2 [0 0 1 1] 0 1 \"P\" [0 0 0 1 0 0 0 1 0 1 1 0]"},
    {"PolygonIndices", RiError::kConsistency,
     "PointsPolygons [3] [0 1 2147483647] \"P\" [0 0 0 1 0 0 0 1 0]"},
    {"PolygonIndicesNegative", RiError::kConsistency,
     "PointsPolygons [3] [0 1 -1] \"P\" [0 0 0 1 0 0 0 1 0]"},
    {"PolygonCounts", RiError::kConsistency,
     "PointsPolygons [2147483647 2147483647] [0 1 2] \"P\" [0 0 0 1 0 0 0 1 0]"},
    {"GeneralPolygonCounts", RiError::kConsistency, "GeneralPolygon [2147483647] \"P\" [0 0 0 1 0 0 0 1 0]"},
    {"LoopCounts", RiError::kConsistency,
     "PointsGeneralPolygons [2147483647] [3] [0 1 2] \"P\" [0 0 0 1 0 0 0 1 0]"},
    {"SubdivisionTags", RiError::kConsistency,
     "SubdivisionMesh \"catmull-clark\" [4] [0 1 2 3] [\"crease\"] [2147483647 2147483647] [] [] \"P\" [0 0 "
     "0 1 0 0 1 1 "
     "0 0 1 0]"},
    {"CurvesCounts", RiError::kConsistency,
     "Curves \"linear\" [2147483647] \"nonperiodic\" \"P\" [0 0 0 1 0 0]"},
    {"BlobbyLeaves", RiError::kConsistency, "Blobby 2147483647 [1000 0] [1] [\"\"]"},
    {"BlobbyOperands", RiError::kConsistency, "Blobby 1 [1000 0 0 2147483647 0] [1] [\"\"]"},
    {"BlobbyFloats", RiError::kConsistency, "Blobby 1 [1001 2147483647] [1] [\"\"]"},
    {"ArrayLength", RiError::kBadToken, "Polygon \"vertex float[2147483647] P\" [0 0 0 1 0 0 0 1 0]"},
    {"PositionsThatAreNone", RiError::kConsistency, "Polygon \"vertex float P\" [0 1 2 3]"},
    {"PositionsAsText", RiError::kConsistency, "Polygon \"vertex string P\" [\"a\" \"b\" \"c\" \"d\"]"},
    {"PositionsOfAnotherClass", RiError::kConsistency, "Polygon \"constant point P\" [0 0 0]"},
    {"NoPositions", RiError::kMissingData, "Polygon \"Cs\" [1 0 0 0 1 0 0 0 1]"},
    {"FloatsForIntegers", RiError::kSyntax, "PointsPolygons [3.5] [0 1 2] \"P\" [0 0 0 1 0 0 0 1 0]"},
    {"TrimCurveCounts", RiError::kConsistency,
     "TrimCurve [2147483647] [2] [0 0 1 1] [0] [1] [2] [0 1] [0 1] [1 1]"},
    {"MotionTimes", RiError::kBadMotion, "MotionBegin [1 0]\nTranslate 1 0 0\nTranslate 2 0 0\nMotionEnd"},
    {"NotANumber", RiError::kRange, "Polygon \"P\" [0 0 0 1 nan 0 0 1 0]"},
    {"InfiniteSphere", RiError::kMath, "Sphere 1e400 -1 1 360"},
    {"UnknownObject", RiError::kBadHandle, "ObjectInstance 2147483647"},
    {"UnknownLight", RiError::kBadHandle, "Illuminate 2147483647 1"},
};
INSTANTIATE_TEST_SUITE_P(All, HostileRib, testing::ValuesIn(kCases),
                         [](const auto& one) { return std::string(one.param.name); });

TEST(HostileRibCount, BinaryCountsOfWhatNeverComes) {
  [[maybe_unused]] const long before = peakKilobytes();
  // An array of 2^31 - 1 floats, a string of 2^32 - 1 bytes; both end with the input.
  std::string array = "WorldBegin Points \"P\" ";
  array += "\313\377\377\377\377";
  std::string text = "WorldBegin Surface ";
  text += "\243\377\377\377\377";
  for (const std::string& rib : {array, text}) {
    const Read r = read(rib);
    EXPECT_EQ(r.objects, 0u);
    EXPECT_GE(r.reports.size(), 1u);
  }
#ifndef __SANITIZE_ADDRESS__
  EXPECT_LT(peakKilobytes() - before, 32 * 1024);
#endif
}

TEST(HostileRibCount, OptionsAreLimited) {
  const Read r = read(
      "Format 1000000000 1000000000 1\nPixelSamples 1e9 1e9\nPixelFilter \"box\" 1e9 1e9\nShadingRate 1e-30\n"
      "Clipping 5 1\nCropWindow 7 -3 9 nan\nScreenWindow 1 1 1 1\nShutter 9 1\nExposure nan nan\n"
      "Quantize \"rgba\" 2147483647 -5 3 1e30\nWorldBegin\nSphere 1 -1 1 360\nWorldEnd\n");
  EXPECT_EQ(r.objects, 1u) << r.all();
  EXPECT_GE(r.reports.size(), 5u) << r.all();
}

TEST(HostileRibCount, BlocksWithoutEndOrBegin) {
  std::string deep = "WorldBegin\n";
  for (int i = 0; i < 200000; ++i) deep += "AttributeBegin ";
  Read r = read(deep + "Sphere 1 -1 1 360\n");
  EXPECT_EQ(r.objects, 1u);
  EXPECT_GE(r.reports.size(), 1u);
  std::string ends = "WorldBegin\nSphere 1 -1 1 360\n";
  for (int i = 0; i < 20000; ++i) ends += "AttributeEnd TransformEnd SolidEnd ObjectEnd MotionEnd FrameEnd ";
  r = read(ends + "WorldEnd\n");
  EXPECT_EQ(r.objects, 1u);
  EXPECT_GE(r.reports.size(), 1u);
}

}  // namespace
}  // namespace fr::cache
