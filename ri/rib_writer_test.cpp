#include "ri/rib_writer.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>
#include <unistd.h>

#include <bit>
#include <filesystem>
#include <fstream>
#include <random>

#include "ri/reader.h"
#include "ri/report_capture.h"
#include "ri/rib_file.h"

namespace fr::ri {
namespace {

using Written = std::string;

RibWriterOptions compact() {
  RibWriterOptions o;
  o.keepBareNames = true;
  return o;
}
RibWriterOptions pretty() {
  RibWriterOptions o = compact();
  o.indent = 2, o.width = 60;
  return o;
}
RibWriterOptions binary() {
  RibWriterOptions o = compact();
  o.binary = true;
  return o;
}

Written rewrite(std::string_view rib, RibWriterOptions options) {
  Written out;
  RibWriter w([&](std::string_view s) { out += s; }, options);
  Reader r(w, ReaderOptions::rewriting());
  EXPECT_TRUE(r.readBuffer(rib, "t.rib").ok());
  w.flush();
  return out;
}

/// Random requests with random arguments, the same for the same seed.
class Author {
 public:
  Author(uint64_t seed, Renderer& to) : random_(seed), to_(to) {}

  void write(int requests) {
    for (int i = 0; i < requests; ++i) request();
  }

 private:
  uint64_t below(uint64_t n) { return random_() % n; }
  float real() {
    switch (below(5)) {
      case 0:
        return float(int(below(2000)) - 1000);
      case 1:
        return float(int(below(2000)) - 1000) / 64;
      case 2:
        return -0.0f;
      case 3:
        return 1e38f;
      default:
        for (;;) {
          const float f = std::bit_cast<float>(uint32_t(random_()));
          if (std::isfinite(f)) return f;
        }
    }
  }
  double number() {
    if (below(2) == 0) return double(real());
    for (;;) {
      const double d = std::bit_cast<double>(random_());
      if (std::isfinite(d)) return d;
    }
  }
  int integer() {
    static constexpr int kEdges[] = {0,       1,        -1,       127,        128,        -128,
                                     -129,    32767,    32768,    -32768,     -32769,     8388607,
                                     8388608, -8388608, -8388609, 2147483647, -2147483647};
    return kEdges[below(std::size(kEdges))];
  }
  std::string text(bool any = true) {
    static const std::string kSome[] = {"plastic",          "a", "", "fifteen bytes!!", "sixteen bytes!!!",
                                        "C:\\scenes\\x.rib"};
    if (!any || below(2) == 0) return kSome[below(std::size(kSome))];
    std::string s(below(below(20) == 0 ? 400 : 20), ' ');
    for (char& c : s) c = char(below(256));
    return s;
  }
  template <class T, class F>
  std::vector<T> several(F one, uint64_t n) {
    std::vector<T> v;
    for (uint64_t i = 0; i < n; ++i) v.push_back((this->*one)());
    return v;
  }
  std::string anyText() { return text(); }
  ParamList params() {
    ParamList list;
    const uint64_t n = below(4);
    for (uint64_t i = 0; i < n; ++i) {
      Param p;
      p.name = fmt::format("p{}", below(40));
      p.declaration.storage = StorageClass(below(6));
      p.declaration.type = ValueType(below(9));
      p.declaration.arrayLength = int(1 + below(3));
      p.declaration.isArray = p.declaration.arrayLength > 1;
      const uint64_t values = p.declaration.width() * (1 + below(3));
      if (p.declaration.type == ValueType::kString)
        p.strings = several<std::string>(&Author::anyText, values);
      else if (p.declaration.type == ValueType::kInteger)
        p.ints = several<int>(&Author::integer, values);
      else
        p.floats = several<float>(&Author::real, values);
      list.set(std::move(p));
    }
    return list;
  }
  DMat4 matrix() {
    DMat4 m;
    for (int i = 0; i < 16; ++i) m[i / 4][i % 4] = number();
    return m;
  }

  void request() {
    switch (below(26)) {
      case 0:
        return to_.shader(ShaderKind::kSurface, text(), params());
      case 1:
        return to_.attributeBegin();
      case 2:
        return to_.attributeEnd();
      case 3:
        return to_.concatTransform(matrix());
      case 4:
        return to_.translate({number(), number(), number()});
      case 5:
        return to_.lightSource(text(), {text(), false}, params());
      case 6:
        return to_.lightSource(text(), {fmt::format("{}", below(70000)), true}, params());
      case 7: {
        const std::vector<float> c = several<float>(&Author::real, 3);
        return to_.color(c);
      }
      case 8:
        return to_.option(text(), params());
      case 9:
        return to_.primitive(Sphere{number(), number(), number(), number(), params()});
      case 10:
        return to_.primitive(PointsPolygons{several<int>(&Author::integer, below(9)),
                                            several<int>(&Author::integer, below(9)), params()});
      case 11:
        return to_.motionBegin(several<float>(&Author::real, below(4)));
      case 12:
        return to_.motionEnd();
      case 13:
        return to_.archiveRecord(RecordKind::kComment, " plain");
      case 14:
        return to_.archiveRecord(RecordKind::kStructure, "Scene x \"y\" [");
      case 15:
        ++ifs_;
        return to_.conditional("IfBegin", "$user:x == 'a' && 1");
      case 16:
        if (ifs_ > 0) to_.conditional("Else", {});
        return;
      case 17:
        if (ifs_ > 0) --ifs_, to_.conditional("IfEnd", {});
        return;
      case 18:
        return to_.archiveBegin({text(), false}, {});
      case 19:
        return to_.archiveEnd();
      case 20:
        return to_.readArchive(text(), params());
      case 21: {
        NuPatch n;
        n.nu = integer(), n.uOrder = integer(), n.uKnot = several<float>(&Author::real, below(9));
        n.uMin = real(), n.uMax = real();
        n.nv = integer(), n.vOrder = integer(), n.vKnot = several<float>(&Author::real, below(9));
        n.vMin = real(), n.vMax = real(), n.params = params();
        return to_.primitive(std::move(n));
      }
      case 22: {
        BasisArgument u, v;
        u.name = "bezier", u.step = integer();
        v.matrix = matrix(), v.step = integer();
        return to_.basis(std::move(u), std::move(v));
      }
      case 23: {
        Procedural p;
        p.kind = ProceduralKind::kRunProgram, p.subdivide = "RunProgram", p.data = {text(), text()};
        p.bound = Bound{number(), number(), number(), number(), number(), number()};
        return to_.procedural(std::move(p));
      }
      case 24: {
        SubdivisionMesh m;
        m.scheme = "catmull-clark", m.nverts = {4}, m.verts = {0, 1, 2, 3}, m.tags = {"hole", text()};
        m.nargs = {1, 0, 0, 1}, m.intArgs = {0}, m.floatArgs = {real()}, m.params = params();
        return to_.primitive(std::move(m));
      }
      default:
        return to_.quantize("rgba", integer(), integer(), integer(), number());
    }
  }

  std::mt19937_64 random_;
  Renderer& to_;
  int ifs_ = 0;
};

Written written(uint64_t seed, int requests, RibWriterOptions options) {
  Written out;
  RibWriter w([&](std::string_view s) { out += s; }, options);
  Author(seed, w).write(requests);
  w.flush();
  return out;
}

RC_GTEST_PROP(RibWriter, AllEncodingsSayTheSame, (uint64_t seed, uint8_t size)) {
  const ReportCapture reports;
  const int requests = 1 + size % 100;
  const Written plain = written(seed, requests, compact());
  RC_ASSERT(rewrite(plain, compact()) == plain);
  RC_ASSERT(rewrite(written(seed, requests, pretty()), compact()) == plain);
  const Written coded = written(seed, requests, binary());
  RC_ASSERT(rewrite(coded, compact()) == plain);
  RC_ASSERT(rewrite(coded, binary()) == coded);
  RC_ASSERT(rewrite(rewrite(plain, binary()), pretty()) == rewrite(plain, pretty()));
}

TEST(RibWriter, BinaryIsSmaller) {
  const std::string sphere = "Attribute \"identifier\" \"name\" [\"sphere\"]\nSphere 1.25 -1.25 1.25 360\n";
  std::string rib;
  for (int i = 0; i < 100; ++i) rib += sphere;
  const Written coded = rewrite(rib, binary());
  EXPECT_LT(coded.size(), rib.size() / 2);
  // Table C.1: 0314 code name, 0315 token string; then 0246 code and 0317 token.
  EXPECT_EQ(coded.substr(0, 3), "\314" + std::string(1, 0) + "\231");
  EXPECT_EQ(rewrite(coded, compact()), rewrite(rib, compact()));
}

TEST(RibWriter, WhatNobodyKnowsIsPassedOn) {
  const ReportCapture reports;
  const std::string rib =
      "##RenderMan RIB\n"
      "version 3.04\n"
      "#a comment\n"
      "Declare \"mine\" \"uniform color\"\n"
      "Surface \"s\" \"mine\" [1 0 0] \"unheard\" [1 2 3] \"uniform float inline\" [2]\n"
      "Option \"ours\" \"unheard\" [1 2.5] \"words\" [\"a\" \"b\"]\n"
      "NoSuchRequest 1 [2 3] \"x\"\n"
      "EditBegin \"attribute\" \"string name\" [\"x\"]\n"
      "EditEnd\n"
      "ErrorHandler \"abort\"\n"
      "IfBegin \"$user:quality > 1\"\n"
      "Sides 1\n"
      "ElseIf \"defined(user:x)\"\n"
      "Sides 2\n"
      "Else\n"
      "Matte 1\n"
      "IfEnd\n"
      "ArchiveBegin \"a\"\n"
      "ReadArchive \"$HOME/missing.rib\"\n"
      "ArchiveEnd\n";
  EXPECT_EQ(rewrite(rib, compact()), rib);
  EXPECT_EQ(rewrite(rewrite(rib, binary()), compact()), rib);
  EXPECT_EQ(rewrite(rewrite(rib, pretty()), compact()), rib);
  EXPECT_FALSE(abortRequested());
}

TEST(RibWriter, BlocksAreIndentedAndLongLinesBroken) {
  const Written out = rewrite(
      "WorldBegin\nAttributeBegin\nSides 1\nIfBegin \"1\"\nSides 2\nElse\nMatte "
      "1\nIfEnd\nAttributeEnd\nWorldEnd\n",
      pretty());
  EXPECT_EQ(
      out,
      "WorldBegin\n  AttributeBegin\n    Sides 1\n    IfBegin \"1\"\n      Sides 2\n    Else\n      Matte 1\n"
      "    IfEnd\n  AttributeEnd\nWorldEnd\n");
  std::string many = "Points \"P\" [";
  for (int i = 0; i < 300; ++i) many += "0.125 ";
  const Written lines = rewrite(many + "]", pretty());
  size_t longest = 0, last = 0;
  for (size_t i = lines.find('\n'); i != std::string::npos; last = i, i = lines.find('\n', i + 1))
    longest = std::max(longest, i - last);
  EXPECT_LE(longest, 60u + 10u);
}

TEST(RibFile, GzipReadsBackAndNothingIsLeftOfAFailure) {
  const std::string path =
      fmt::format("{}/rib_file_{}.rib.gz", std::filesystem::temp_directory_path().string(), getpid());
  std::string rib;
  for (int i = 0; i < 50000; ++i) rib += fmt::format("Sides {}\n", 1 + i % 2);
  {
    RibFile file;
    ASSERT_TRUE(file.open(path, true).ok());
    file.write(rib);
    EXPECT_FALSE(std::filesystem::exists(path));
    ASSERT_TRUE(file.finish().ok());
  }
  EXPECT_LT(std::filesystem::file_size(path), rib.size() / 20);
  Written out;
  RibWriter w([&](std::string_view s) { out += s; });
  Reader reader(w);
  EXPECT_TRUE(reader.readFile(path).ok());
  w.flush();
  EXPECT_EQ(out, rib);
  std::filesystem::remove(path);
  {
    RibFile abandoned;
    ASSERT_TRUE(abandoned.open(path, false).ok());
    abandoned.write(rib);
  }
  EXPECT_FALSE(std::filesystem::exists(path));
  RibFile nowhere;
  EXPECT_FALSE(nowhere.open("/no/such/folder/x.rib", false).ok());
  RibFile full;
  ASSERT_TRUE(full.open("/dev/full", false).ok());
  full.write(rib);
  EXPECT_EQ(full.finish().error().code, RiError::kDiskFull);
}

}  // namespace
}  // namespace fr::ri
