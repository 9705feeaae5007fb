// Functions of shared objects, from the shader's side.
#include <dlfcn.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "shading/machine_fixture.h"
#include "shading/shadeop_library.h"
#include "shading/shader_library.h"
#include "shading/slx.h"

namespace fr {
namespace {

namespace fs = std::filesystem;

const std::string kFolder = FR_BINARY_DIR "/tests/shadeops/";

struct ShadeopCalls : testing::Test {
  MachineFixture m;
  const ShaderInstance* shader(const std::string& body) {
    m.shadeopPaths = {kFolder + "test_shadeops"};
    return m.shader("surface a(float five = 5; float k[3] = {1, 2, 3};) {" + body + "}").get();
  }
  /// Ci of every point, by component.
  std::vector<float> run(const std::string& body, uint32_t component = 0) {
    const ShaderInstance* s = shader(body);
    EXPECT_TRUE(s) << m.error;
    if (!s) return std::vector<float>(m.count, -1.0f);
    m.run(*s);
    std::vector<float> r;
    for (uint32_t i = 0; i < m.count; ++i) r.push_back(m.Ci(i, component));
    return r;
  }
  static int count(int what) {
    void* const library = dlopen((kFolder + "test_shadeops/test_shadeops.so").c_str(), RTLD_NOW);
    return reinterpret_cast<int (*)(int)>(dlsym(library, "testShadeopCount"))(what);
  }
  std::string errorOf(const std::string& folder, const std::string& body) {
    m.shadeopPaths = {kFolder + folder};
    m.error.clear();
    EXPECT_FALSE(m.shader("surface a() {" + body + "}"));
    return m.error;
  }
};

TEST_F(ShadeopCalls, OverloadsByExactTypesThenByConversion) {
  EXPECT_EQ(run("Ci = color(which(1), which(P), which(Cs));"), std::vector<float>(m.count, 1));
  EXPECT_EQ(run("Ci = color(which(1), which(P), which(Cs));", 1), std::vector<float>(m.count, 2));
  EXPECT_EQ(run("Ci = color(which(1), which(P), which(Cs));", 2), std::vector<float>(m.count, 3));
  EXPECT_EQ(run("Ci = which(\"x\");"), std::vector<float>(m.count, 4));
  EXPECT_EQ(run("Ci = which(matrix 1);"), std::vector<float>(m.count, 6));
  EXPECT_EQ(run("Ci = which(N);"), std::vector<float>(m.count, 2)) << "a normal becomes a point, not a color";
  // argc counts the result.
  EXPECT_EQ(run("Ci = which(u, 7);", 2), std::vector<float>(m.count, 3));
  EXPECT_EQ(run("Ci = which(u, 7);", 1), std::vector<float>(m.count, 7));
  const std::vector<float> u = run("Ci = which(u, 7);");
  for (uint32_t i = 0; i < m.count; ++i) EXPECT_EQ(u[i], m.batch.globals[size_t(GlobalId::k_u)].at(i));
}

TEST_F(ShadeopCalls, OnlyActivePointsAndOnceWhereUniform) {
  int before = count(2);
  run("Ci = 0; if (u > 0.5) Ci = counted(v);");
  uint32_t active = 0;
  for (uint32_t i = 0; i < m.count; ++i) active += m.batch.globals[size_t(GlobalId::k_u)].at(i) > 0.5f;
  EXPECT_EQ(count(2) - before, int(active));
  before = count(2);
  EXPECT_EQ(run("Ci = counted(five);"), std::vector<float>(m.count, 45));
  EXPECT_EQ(count(2) - before, 1);
}

TEST_F(ShadeopCalls, InitDataOncePerThreadUntilTheLastUserIsGone) {
  const int inits = count(0), shutdowns = count(1);
  {
    const ShadeopUser user;
    const ShadeopUser other;
    run("Ci = counted(five);");
    run("Ci = counted(u);");
  }
  EXPECT_LE(count(0) - inits, 1);
  EXPECT_EQ(count(0), count(1)) << "every init has its shutdown";
  EXPECT_GE(count(1) - shutdowns, 1);
  {
    const ShadeopUser user;
    run("Ci = counted(five);");
  }
  EXPECT_EQ(count(0), count(1));
}

TEST_F(ShadeopCalls, ResultsThroughArguments) {
  const std::vector<float> x =
      run("float f = 0; color c = 0; split(P, f, c); Ci = color(f, comp(c, 0), xcomp(P));");
  const std::vector<float> x2 =
      run("float f = 0; color c = 0; split(P, f, c); Ci = color(f, comp(c, 0), xcomp(P));", 2);
  for (uint32_t i = 0; i < m.count; ++i) {
    const float px = m.batch.globals[size_t(GlobalId::k_P)].at(i);
    EXPECT_EQ(x[i], px);
    EXPECT_EQ(x2[i], px) << "predefined variables go by value";
  }
  EXPECT_EQ(run("float f = 3; color c = 2; if (u > 2) split(P, f, c); Ci = f + c;"),
            std::vector<float>(m.count, 5));
  // A copy of a variable that is written is a copy.
  const std::vector<float> y = run("float f = 1; float g = f; color c; split(P, f, c); Ci = g;");
  EXPECT_EQ(y, std::vector<float>(m.count, 1));
}

TEST_F(ShadeopCalls, StringsGrow) {
  EXPECT_EQ(run("string s = twice(\"ab\"); Ci = s == \"abab\" ? 1 : 0;"), std::vector<float>(m.count, 1));
  EXPECT_EQ(run("string s = \"0123456789\"; uniform float i; for (i = 0; i < 8; i += 1) s = twice(s); Ci = "
                "strlen(s);"),
            std::vector<float>(m.count, 2560));
}

TEST_F(ShadeopCalls, Arrays) {
  EXPECT_EQ(run("Ci = total(k);"), std::vector<float>(m.count, 6));
  const std::vector<float> r = run("color c[2] = {color(1, 2, 3), 4}; c[1] = u; Ci = total(c);", 1);
  for (uint32_t i = 0; i < m.count; ++i) EXPECT_EQ(r[i], 2 + m.batch.globals[size_t(GlobalId::k_u)].at(i));
  shader("float q[2] = {1, 2}; Ci = total(q);");
  EXPECT_NE(m.error.find("no version of 'total'"), std::string::npos) << m.error;
}

TEST_F(ShadeopCalls, BatchesInOneCall) {
  const int before = count(2);
  const std::vector<float> r =
      run("float sum = -1; Ci = -2; if (u > 0.5) Ci = scaled(color(1, 2, 3), v, sum, k); Ci += sum;", 2);
  EXPECT_EQ(count(2) - before, 1);
  for (uint32_t i = 0; i < m.count; ++i) {
    const float u = m.batch.globals[size_t(GlobalId::k_u)].at(i),
                v = m.batch.globals[size_t(GlobalId::k_v)].at(i);
    EXPECT_EQ(r[i], u > 0.5f ? 3 * v + 6 : -3) << i;
  }
  EXPECT_EQ(run("float sum; color c = scaled(color(1, 2, 3), five, sum, k); Ci = c * sum;"),
            std::vector<float>(m.count, 30));
}

TEST_F(ShadeopCalls, AnswersOfAllKindsAreSurvived) {
  setReportSink([](const Error&) {});
  EXPECT_EQ(run("Ci = unfit(1);"), std::vector<float>(m.count, 0)) << "NaN becomes 0";
  run("Ci = unfit(11);");
  setReportSink({});
}

TEST_F(ShadeopCalls, WhatIsWrongWithALibraryIsSaid) {
  EXPECT_NE(errorOf("bad_type", "Ci = broken(1);").find("'flot' is not a type"), std::string::npos)
      << m.error;
  EXPECT_NE(errorOf("no_function", "Ci = broken(1);").find("the library has no function 'missing_call'"),
            std::string::npos)
      << m.error;
  EXPECT_NE(errorOf("no_init", "Ci = broken(1);").find("the library has no init function 'missing_init'"),
            std::string::npos)
      << m.error;
  EXPECT_NE(errorOf("no_end", "Ci = broken(1);").find("does not end"), std::string::npos) << m.error;
  EXPECT_NE(errorOf("test_shadeops", "Ci = nowhere(1);").find("unknown function 'nowhere'"),
            std::string::npos);
  EXPECT_NE(errorOf("test_shadeops", "Ci = counted(\"x\");").find("no version of 'counted'"),
            std::string::npos);
  // A file that only looks like a library.
  const fs::path folder = fs::path(testing::TempDir()) / "fake_shadeops";
  fs::create_directories(folder);
  std::ofstream(folder / "fake.so") << "\177ELF" << std::string(100, 'x') << "broken_shadeops" << '\0';
  m.shadeopPaths = {folder.string()};
  EXPECT_FALSE(m.shader("surface a() { Ci = broken(1); }"));
  EXPECT_NE(m.error.find("cannot be opened"), std::string::npos) << m.error;
}

TEST(ShadeopSpecs, Parse) {
  const auto s = parseShadeopSpec(" color  f_1 ( point,float [ 4 ] , output matrix,string, normal[] ) ");
  ASSERT_TRUE(s.ok());
  EXPECT_EQ(s->result, SlType::kColor);
  EXPECT_EQ(s->function, "f_1");
  ASSERT_EQ(s->arguments.size(), 5u);
  EXPECT_EQ(s->arguments[1].arrayLength, 4u);
  EXPECT_TRUE(s->arguments[2].output && s->marksOutputs);
  EXPECT_TRUE(s->arguments[4].isArray);
  EXPECT_TRUE(parseShadeopSpec("void f()").ok());
  EXPECT_TRUE(parseShadeopSpec("void f(void)").ok());
  for (const char* bad :
       {"", "float", "float f", "float f(", "float f(float", "float f(float,)", "f(float)", "float 1f()",
        "float f(void, float)", "float f() x", "float f(float[0])", "float f(float[1e9])",
        "float f(string[2])", "float f(float[-1])", "float f(float[99999999])"})
    EXPECT_FALSE(parseShadeopSpec(bad).ok()) << bad;
}

TEST(ShadeopBinding, CompiledShadersFindTheirLibraryAgain) {
  const fs::path folder = fs::path(testing::TempDir()) / "shadeop_binding";
  fs::remove_all(folder);
  fs::create_directories(folder / "a");
  Diagnostics d;
  CompileOptions o;
  o.shadeopPaths = {kFolder + "test_shadeops"};
  auto p = compileShaderString("surface bound() { Ci = counted(1); }", o, d, "bound.sl");
  ASSERT_TRUE(p.ok()) << d.str();
  ASSERT_TRUE(writeSlxFile((folder / "bound.slx").string(), *p).ok());
  setReportSink([](const Error&) {});
  ShaderLibrary::Options options;
  options.folders = {folder.string()};
  EXPECT_TRUE(ShaderLibrary(options).find("bound").ok()) << "at the place where the compiler found it";
  // Elsewhere: the folders of shaders are searched.
  for (Symbol& s : p->symbols)
    if (s.storage == Storage::kConstant && s.type == SlType::kString && p->strings[s.data].ends_with(".so"))
      p->strings[s.data] = "/nowhere/test_shadeops.so";
  ASSERT_TRUE(writeSlxFile((folder / "bound.slx").string(), *p).ok());
  const auto missing = ShaderLibrary(options).find("bound");
  ASSERT_FALSE(missing.ok());
  EXPECT_NE(
      missing.error().message.find("counted() of the shadeop library 'test_shadeops.so', which is not there"),
      std::string::npos)
      << missing.error().message;
  options.folders.push_back(kFolder + "test_shadeops");
  EXPECT_TRUE(ShaderLibrary(options).find("bound").ok());
  options.folders = {folder.string(), (folder / "a").string()};
  fs::copy_file(kFolder + "no_end/no_end.so", folder / "a" / "test_shadeops.so");
  EXPECT_FALSE(ShaderLibrary(options).find("bound").ok()) << "a library of that name without the function";
  setReportSink({});
}

}  // namespace
}  // namespace fr
