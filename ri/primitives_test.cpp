#include "ri/primitives.h"

#include <gtest/gtest.h>
#include <rapidcheck.h>

#include "ri/renderer.h"

namespace fr::ri {
namespace {

Param floats(const char* token, size_t n) {
  const ParsedToken t = *parseToken(token);
  const Dictionary d;
  return {std::string(t.name),
          t.declaration ? *t.declaration : *d.find(t.name),
          std::vector<float>(n, 0.f),
          {},
          {}};
}

PatchMesh mesh(bool bicubic, int nu, bool up, int nv, bool vp) {
  PatchMesh m;
  m.bicubic = bicubic;
  m.nu = nu;
  m.uPeriodic = up;
  m.nv = nv;
  m.vPeriodic = vp;
  return m;
}

TEST(Counts, PatchMesh) {
  const auto bilinear = expectedCounts(mesh(false, 5, false, 4, true), {});
  ASSERT_TRUE(bilinear.ok());
  EXPECT_EQ(bilinear->uniform, 4u * 4);
  EXPECT_EQ(bilinear->varying, 5u * 4);
  EXPECT_EQ(bilinear->vertex, 20u);
  const auto bezier = expectedCounts(mesh(true, 7, false, 6, true), {3, 3});
  ASSERT_TRUE(bezier.ok());
  EXPECT_EQ(bezier->uniform, 2u * 2);
  EXPECT_EQ(bezier->varying, 3u * 2);
  EXPECT_EQ(bezier->vertex, 42u);
  const auto spline = expectedCounts(mesh(true, 6, false, 5, true), {1, 1});
  ASSERT_TRUE(spline.ok());
  EXPECT_EQ(spline->uniform, 3u * 5);
  EXPECT_EQ(spline->varying, 4u * 5);
  EXPECT_EQ(expectedCounts(mesh(true, 6, false, 4, false), {3, 3}).error().code, RiError::kConsistency);
  EXPECT_FALSE(expectedCounts(mesh(true, -4, true, 4, false), {3, 3}).ok());
  EXPECT_FALSE(expectedCounts(mesh(false, 0, true, 2, false), {3, 3}).ok());
  EXPECT_TRUE(expectedCounts(mesh(false, 2000000000, false, 2000000000, false), {}).ok());  // no overflow
}

TEST(Counts, Curves) {
  Curves c;
  c.cubic = true;
  c.nverts = {4, 7};
  const auto n = expectedCounts(c, {3, 3});
  ASSERT_TRUE(n.ok());
  EXPECT_EQ(n->uniform, 2u);
  EXPECT_EQ(n->varying, 2u + 3);
  EXPECT_EQ(n->vertex, 11u);
  c.nverts = {5};
  EXPECT_FALSE(expectedCounts(c, {3, 3}).ok());
  EXPECT_EQ(expectedCounts(c, {1, 1})->varying, 3u);
  c.cubic = false;
  c.periodic = true;
  EXPECT_EQ(expectedCounts(c, {})->varying, 5u);
}

TEST(Counts, NuPatch) {
  NuPatch n;
  n.nu = 4, n.uOrder = 3, n.uKnot = {0, 0, 0, 1, 2, 2, 2}, n.uMin = 0, n.uMax = 2;
  n.nv = 2, n.vOrder = 2, n.vKnot = {0, 0, 1, 1}, n.vMin = 0, n.vMax = 1;
  const auto c = expectedCounts(n, {});
  ASSERT_TRUE(c.ok()) << c.error().message;
  EXPECT_EQ(c->uniform, 2u);
  EXPECT_EQ(c->varying, 3u * 2);
  EXPECT_EQ(c->vertex, 8u);
  n.uKnot[3] = 5;
  EXPECT_EQ(expectedCounts(n, {}).error().code, RiError::kRange);
  n.uKnot.pop_back();
  EXPECT_EQ(expectedCounts(n, {}).error().code, RiError::kConsistency);
}

PointsPolygons twoTriangles() {
  PointsPolygons p;
  p.nverts = {3, 3};
  p.verts = {0, 1, 2, 2, 1, 3};
  p.params.set(floats("P", 12));
  return p;
}

TEST(Check, WhatHoldsNothingIsNoError) {
  Points none;
  none.params.set(floats("P", 0));
  Curves bald;
  bald.params.set(floats("P", 0));
  PointsPolygons faceless;
  faceless.params.set(floats("P", 0));
  for (Primitive p : {Primitive(none), Primitive(bald), Primitive(faceless)}) {
    const auto c = checkPrimitive(p, {});
    ASSERT_FALSE(c.ok());
    EXPECT_EQ(c.error().severity, Severity::kWarning) << c.error().message;
  }
  // Faces, or points, that are not said are an error.
  PointsPolygons lost = twoTriangles();
  lost.params = {};
  lost.params.set(floats("P", 0));
  for (Primitive p : {Primitive(lost), Primitive(Points())}) {
    const auto c = checkPrimitive(p, {});
    ASSERT_FALSE(c.ok());
    EXPECT_EQ(c.error().severity, Severity::kError) << c.error().message;
  }
}

TEST(Check, IndexedMesh) {
  Primitive p = twoTriangles();
  auto c = checkPrimitive(p, {});
  ASSERT_TRUE(c.ok());
  EXPECT_EQ(c->counts.vertex, 4u);
  EXPECT_EQ(c->counts.faceVarying, 6u);
  EXPECT_EQ(c->counts.uniform, 2u);

  auto more = twoTriangles();
  more.params.set(floats("P", 15));  // a point that no face uses
  more.params.set(floats("N", 15));
  p = more;
  c = checkPrimitive(p, {});
  ASSERT_TRUE(c.ok());
  EXPECT_TRUE(c->complaints.empty());

  auto few = twoTriangles();
  few.params.set(floats("P", 9));
  p = few;
  c = checkPrimitive(p, {});
  ASSERT_FALSE(c.ok());
  EXPECT_EQ(c.error().code, RiError::kConsistency);
  EXPECT_NE(c.error().message.find('9'), std::string::npos);
  EXPECT_NE(c.error().message.find("12"), std::string::npos);

  auto negative = twoTriangles();
  negative.verts[2] = -1;
  p = negative;
  EXPECT_FALSE(checkPrimitive(p, {}).ok());
  auto uneven = twoTriangles();
  uneven.nverts[1] = 4;
  p = uneven;
  EXPECT_FALSE(checkPrimitive(p, {}).ok());
}

TEST(Check, MissingPositions) {
  auto m = twoTriangles();
  m.params = {};
  Primitive p = m;
  const auto c = checkPrimitive(p, {});
  ASSERT_FALSE(c.ok());
  EXPECT_EQ(c.error().code, RiError::kMissingData);
}

TEST(Check, WrongVariableIsDroppedAlone) {
  Sphere s;
  s.params.set(floats("varying float s", 3));
  s.params.set(floats("Cs", 12));
  s.params.set(floats("uniform color tint", 3));
  Primitive p = s;
  const auto c = checkPrimitive(p, {});
  ASSERT_TRUE(c.ok());
  ASSERT_EQ(c->complaints.size(), 1u);
  EXPECT_EQ(c->complaints[0].code, RiError::kConsistency);
  EXPECT_EQ(paramsOf(p).size(), 2u);
  EXPECT_FALSE(paramsOf(p).has("s"));
}

TEST(Check, AVariableOfTheWrongClassTakesTheOneThatFitsAndSaysSo) {
  const auto check = [](const char* token, size_t n, const char* name) {
    PointsPolygons s;
    s.nverts = {3, 3};
    s.verts = {0, 1, 2, 0, 2, 3};
    s.params.set(floats("P", 12));
    s.params.set(floats(token, n));
    Primitive p = s;
    const Result<PrimitiveCheck> c = checkPrimitive(p, {});
    if (!c || c->complaints.size() != 1) return std::string("no complaint");
    const Param* found = paramsOf(p).find(name);
    return std::string(found ? found->declaration.str() : "dropped");
  };
  EXPECT_EQ(check("varying float[2] st", 12, "st"), "facevarying float[2]");
  EXPECT_EQ(check("facevarying normal N", 12, "N"), "varying normal");
  EXPECT_EQ(check("varying color Cs", 3, "Cs"), "constant color") << "one colour for all";
  EXPECT_EQ(check("vertex float heat", 2, "heat"), "uniform float");
  EXPECT_EQ(check("vertex float heat", 5, "heat"), "dropped");
  EXPECT_EQ(check("varying float[2] st", 11, "st"), "dropped");
}

// `"float[2] st"` with a value a vertex: no class is "uniform", which does not fit and is not meant.
TEST(Check, StandardVariablesWithoutAClassTakeTheOneThatFits) {
  const auto classOf = [](const char* token, size_t n, const char* name) {
    PointsPolygons s;
    s.nverts = {3, 3};
    s.verts = {0, 1, 2, 0, 2, 3};
    s.params.set(floats("P", 12));
    s.params.set(floats(token, n));
    Primitive p = s;
    EXPECT_TRUE(checkPrimitive(p, {}).ok());
    const Param* found = paramsOf(p).find(name);
    return found ? std::string(found->declaration.str()) : "dropped";
  };
  EXPECT_EQ(classOf("float[2] st", 8, "st"), "varying float[2]");
  EXPECT_EQ(classOf("float[2] st", 12, "st"), "facevarying float[2]");
  EXPECT_EQ(classOf("color Cs", 12, "Cs"), "varying color");
  EXPECT_EQ(classOf("color Cs", 6, "Cs"), "uniform color") << "one a face is what the words say";
  EXPECT_EQ(classOf("color Cs", 9, "Cs"), "dropped");
  EXPECT_EQ(classOf("float mine", 4, "mine"), "varying float");
  PointsPolygons s;
  s.nverts = {3};
  s.verts = {0, 1, 2};
  s.params.set(floats("point P", 9));
  Primitive p = s;
  EXPECT_TRUE(checkPrimitive(p, {}).ok());
}

TEST(Check, SubdivisionTags) {
  SubdivisionMesh m;
  m.scheme = "catmull-clark";
  m.nverts = {4};
  m.verts = {0, 1, 2, 3};
  m.params.set(floats("P", 12));
  m.tags = {"crease"};
  m.nargs = {2, 1};
  m.intArgs = {0, 1};
  m.floatArgs = {2};
  Primitive p = m;
  EXPECT_TRUE(checkPrimitive(p, {}).ok());
  m.intArgs = {0};
  p = m;
  EXPECT_FALSE(checkPrimitive(p, {}).ok());
  m.nargs = {2147483647, 2147483647};
  p = m;
  EXPECT_FALSE(checkPrimitive(p, {}).ok());
}

TEST(Declaration, Parsing) {
  EXPECT_EQ(parseDeclaration("varying float[2]")->str(), "varying float[2]");
  EXPECT_EQ(parseDeclaration("Color")->str(), "uniform color");
  EXPECT_EQ(parseDeclaration("vertex hpoint")->width(), 4u);
  EXPECT_EQ(parseDeclaration("constant matrix [ 3 ]")->width(), 48u);
  EXPECT_EQ(parseDeclaration("int")->str(), "uniform integer");
  for (const char* bad :
       {"", "float x", "varying", "float[0]", "float[-1]", "float[99999999999]", "float[2", "flaot"}) {
    EXPECT_FALSE(parseDeclaration(bad).ok()) << bad;
  }
  const auto t = parseToken("facevarying float[2] st");
  ASSERT_TRUE(t.ok());
  EXPECT_EQ(t->name, "st");
  EXPECT_EQ(t->declaration->storage, StorageClass::kFaceVarying);
  const auto c = parseToken("uniform color tints[4]");
  EXPECT_EQ(c->name, "tints");
  EXPECT_EQ(c->declaration->str(), "uniform color[4]");
  EXPECT_FALSE(parseToken("float[2] x[2]").ok());
  EXPECT_FALSE(parseToken("Ka")->declaration.has_value());
  EXPECT_FALSE(parseToken("float a b").ok());
}

TEST(TrimCurves, ArrayLengths) {
  TrimCurve t;
  t.ncurves = {1};
  t.order = {2};
  t.knot = {0, 0, 1, 2, 2};
  t.min = {0};
  t.max = {2};
  t.n = {3};
  t.u = t.v = t.w = {0, 1, 0};
  EXPECT_TRUE(checkTrimCurve(t).ok());
  t.w.pop_back();
  EXPECT_EQ(checkTrimCurve(t).error().code, RiError::kConsistency);
  t.ncurves = {2};
  EXPECT_FALSE(checkTrimCurve(t).ok());
}

// No choice of counts makes the check read out of an array or agree with an impossible mesh.
TEST(Check, AnyTopologyIsSafe) {
  rc::check([](const std::vector<int>& nverts, const std::vector<int>& verts, uint8_t points) {
    PointsPolygons m;
    m.nverts = nverts;
    m.verts = verts;
    m.params.set(floats("P", points));
    Primitive p = m;
    const auto c = checkPrimitive(p, {});
    if (!c) return;
    const auto& checked = std::get<PointsPolygons>(p);
    for (int v : checked.verts) RC_ASSERT(v >= 0 && uint64_t(v) < c->counts.vertex);
    RC_ASSERT(c->counts.vertex * 3 == paramsOf(p).find("P")->floats.size());
  });
}

}  // namespace
}  // namespace fr::ri
