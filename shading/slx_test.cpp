// .slx files, the shader library, the standard shaders, and bad input of every kind.
#include "shading/slx.h"

#include <gtest/gtest.h>

#include <cstring>
#include <filesystem>
#include <fstream>
#include <random>

#include "shading/passes.h"
#include "shading/shader_library.h"
#include "shading/source.h"

namespace fr {
namespace {

namespace fs = std::filesystem;

const char* kShader =
    "surface a(float Ka = 1; point p = point \"world\" (1, 2, 3); float k[2] = {1, 2};) {\n"
    "  float i; color c = 0;\n"
    "  for (i = 0; i < 3; i += 1) { c += color noise(P * i) * k[i]; if (s > i) break; }\n"
    "  illuminance (P, N, PI/2) { c += Cl; }\n"
    "  Oi = Os; Ci = c * Ka + trace(P, I) + color texture(\"x\", s, t, \"blur\", .1);\n}\n";

ShaderProgram program() {
  Diagnostics d;
  auto p = compileShaderString(kShader, {}, d);
  EXPECT_TRUE(p.ok()) << d.str();
  return *p;
}

std::vector<std::string> standardShaders() {
  std::vector<std::string> files;
  for (const auto& e : fs::directory_iterator(std::string(FR_SOURCE_DIR) + "/shaders"))
    if (e.path().extension() == ".sl") files.push_back(e.path().string());
  std::sort(files.begin(), files.end());
  return files;
}

TEST(Slx, RoundTrip) {
  const ShaderProgram p = program();
  const std::string bytes = writeSlx(p);
  auto q = readSlx(bytes);
  ASSERT_TRUE(q.ok()) << q.error().message;
  EXPECT_EQ(disassemble(*q), disassemble(p));
  EXPECT_EQ(q->flags, p.flags);
  EXPECT_EQ(q->readsGlobals, p.readsGlobals);
  EXPECT_EQ(q->sourceHash, p.sourceHash);
  EXPECT_EQ(writeSlx(*q), bytes);
}

TEST(Slx, EveryTruncationAndEveryChangedByteIsAnError) {
  const std::string bytes = writeSlx(program());
  for (size_t n = 0; n < bytes.size(); ++n) EXPECT_FALSE(readSlx({bytes.data(), n}).ok()) << n;
  for (size_t i = 0; i < bytes.size(); ++i) {
    std::string b = bytes;
    b[i] = char(b[i] ^ 0x41);
    EXPECT_FALSE(readSlx(b).ok()) << i;
  }
}

TEST(Slx, DamageBehindAValidChecksumNeverGivesAnInvalidProgram) {
  // Whoever writes the checksum too must still not be able to crash a renderer.
  const std::string bytes = writeSlx(program());
  std::mt19937 random(7);
  int accepted = 0;
  for (int round = 0; round < 20000; ++round) {
    std::string b = bytes;
    const int changes = 1 + int(random() % 3);
    for (int c = 0; c < changes; ++c) {
      const size_t at = 32 + random() % (b.size() - 32);
      b[at] = random() % 2 ? char(random()) : char(b[at] + 1);
    }
    const uint64_t hash = hashBytes(b.data() + 32, b.size() - 32);
    std::memcpy(b.data() + 24, &hash, 8);
    auto p = readSlx(b);
    if (!p.ok()) continue;
    ++accepted;
    EXPECT_TRUE(validate(*p).ok());
    EXPECT_FALSE(disassemble(*p).empty());
  }
  EXPECT_GT(accepted, 0);  // names, numbers: the test does reach the inside
}

TEST(StandardShaders, AllCompileWithoutAnyMessage) {
  const auto files = standardShaders();
  EXPECT_GE(files.size(), 20u);
  for (const std::string& f : files) {
    Diagnostics d;
    auto p = compileShaderFile(f, {}, d);
    EXPECT_TRUE(p.ok()) << d.str();
    EXPECT_EQ(d.str(), "");
    if (p.ok()) {
      EXPECT_EQ(p->name, fs::path(f).stem().string());
    }
  }
}

TEST(StandardShaders, ParametersOfTheSpecification) {
  ShaderLibrary library({{}, std::string(FR_SOURCE_DIR) + "/shaders", {}, false});
  const auto check = [&](const char* shader, const char* parameter, std::vector<float> value) {
    auto p = library.find(shader);
    ASSERT_TRUE(p.ok()) << p.error().message;
    const uint32_t i = (*p)->findParameter(parameter);
    ASSERT_NE(i, kNoIndex) << shader << " " << parameter;
    const uint32_t c = (*p)->parameters[i].defaultConstant;
    ASSERT_NE(c, kNoIndex);
    const Symbol& s = (*p)->symbols[c];
    EXPECT_EQ(std::vector<float>((*p)->floats.begin() + s.data, (*p)->floats.begin() + s.data + s.floats()),
              value);
  };
  check("plastic", "Kd", {.5f});
  check("plastic", "roughness", {.1f});
  check("matte", "Kd", {1});
  check("spotlight", "beamdistribution", {2});
  check("spotlight", "coneangle", {float(3.14159265358979 / 6)});
  check("defaultsurface", "Kd", {.8f});
  check("fog", "background", {0, 0, 0});
  EXPECT_TRUE((*library.find("glass"))->has(kProgramCanAskRays));
  EXPECT_FALSE((*library.find("plastic"))->has(kProgramCanAskRays));
  EXPECT_TRUE((*library.find("plastic"))->has(kProgramOpaque));
}

TEST(ShaderLibrary, FindsCompilesAndNoticesStaleFiles) {
  const std::string folder = ::testing::TempDir() + "/slc_library";
  fs::remove_all(folder);
  fs::create_directories(folder);
  const auto source = [&](const char* text) { std::ofstream(folder + "/mine.sl") << text; };
  source("surface mine(float K = 1;) { Ci = K; }");
  ShaderLibrary::Options options;
  options.folders = {folder};
  options.standardShaders = std::string(FR_SOURCE_DIR) + "/shaders";
  options.writeCompiled = true;
  {
    ShaderLibrary library(options);
    auto p = library.find("mine");
    ASSERT_TRUE(p.ok()) << p.error().message;
    EXPECT_EQ(library.find("mine.slo")->get(), p->get());
    EXPECT_EQ(library.statistics().compiled, 1u);
    EXPECT_TRUE(fs::exists(folder + "/mine.slx"));
    EXPECT_TRUE(library.find("matte").ok());
    // The folders of another machine.
    EXPECT_TRUE(library.find("/usr/somebody/shaders/mine").ok());
    EXPECT_TRUE(library.find("D:\\work\\shaders\\mine.sl").ok());
    EXPECT_FALSE(library.find("/usr/somebody/shaders/nothere").ok());
    auto none = library.find("nothere");
    ASSERT_FALSE(none.ok());
    EXPECT_EQ(none.error().code, RiError::kNoShader);
  }
  {
    ShaderLibrary library(options);
    ASSERT_TRUE(library.find("mine").ok());
    EXPECT_EQ(library.statistics().compiled, 0u);
  }
  source("surface mine(float K = 2;) { Ci = K; }");
  {
    ShaderLibrary library(options);
    auto p = library.find("mine");
    ASSERT_TRUE(p.ok());
    EXPECT_EQ(library.statistics().compiled, 1u);
    EXPECT_EQ((*p)->floats[(*p)->symbols[(*p)->parameters[0].defaultConstant].data], 2.0f);
  }
  fs::remove(folder + "/mine.sl");
  ShaderLibrary library(options);
  EXPECT_TRUE(library.find("mine").ok());  // the compiled file alone is enough
}

TEST(ShaderLibrary, FindsWhatAFileOfAnotherNameDefines) {
  const std::string folder = ::testing::TempDir() + "/slc_library_names";
  fs::remove_all(folder);
  fs::create_directories(folder);
  std::ofstream(folder + "/several.sl")
      << "/* surface third */ /* surface fourth() { Ci = 0; } */ surface first() { Ci = 1; }\n"
         "class\nsecond (float K = 3) { public void surface(output color Ci, Oi) "
         "{ Ci = K; } }\nfloat third (float x) { return x; }\n";
  std::ofstream(folder + "/others.sl") << "/* surface fifth() {} */ surface others() { Ci = 1; }";
  std::ofstream(folder + "/sources.sl") << "surface fifth() { Ci = 1; }";
  std::ofstream(folder + "/Mixed.sl") << "surface Mixed() { Ci = 1; }";
  ShaderLibrary::Options options;
  options.folders = {folder};
  ShaderLibrary library(options);
  auto second = library.find("second");
  ASSERT_TRUE(second.ok()) << second.error().message;
  EXPECT_EQ((*second)->name, "second");
  EXPECT_EQ((*second)->type, ShaderType::kSurface);
  EXPECT_EQ((*library.find("first"))->name, "first");
  EXPECT_EQ((*library.find("fifth"))->name, "fifth") << "not where it stands in a comment";
  EXPECT_EQ((*library.find("mixed"))->name, "Mixed");
  EXPECT_FALSE(library.find("third").ok());
  EXPECT_FALSE(library.find("fourth").ok()) << "not another one of the file";
}

TEST(BadInput, MutatedSourcesNeverCrash) {
  std::vector<std::string> sources{kShader};
  for (const std::string& f : standardShaders()) {
    auto t = readSourceFile(f);
    if (t.ok() && t->find("#include") == std::string::npos) sources.push_back(*t);
  }
  std::mt19937 random(11);
  static constexpr const char* kPieces[] = {
      "(",      ")",         "{",           "}",      ";",        ",",      "[",      "]",
      "color",  "float",     "illuminance", "(P)",    "\"",       "if",     "1e99",   "=",
      "#if",    "#define x", "\\",          "return", "break 2;", "extern", "output", "void",
      "matrix", "?",         ":",           ".",      "^",        "string", "/*",     "gather("};
  for (int round = 0; round < 1500; ++round) {
    std::string t = sources[random() % sources.size()];
    const int changes = 1 + int(random() % 4);
    for (int c = 0; c < changes && !t.empty(); ++c) {
      const size_t at = random() % t.size();
      switch (random() % 4) {
        case 0:
          t.resize(at);
          break;
        case 1:
          t[at] = char(random());
          break;
        case 2:
          t.insert(at, kPieces[random() % std::size(kPieces)]);
          break;
        default:
          t.erase(at, 1 + random() % 20);
      }
    }
    Diagnostics d;
    CompileOptions o;
    o.lint = Lint::kAll;
    auto p = compileShaderString(t, o, d);
    EXPECT_EQ(p.ok(), !d.hasErrors());
    if (p.ok()) {
      EXPECT_TRUE(validate(*p).ok());
    }
    for (const Diagnostic& m : d.all()) EXPECT_NE(m.code, RiError::kBug) << m.str() << t;
  }
}

TEST(BadInput, Limits) {
  const auto failsWith = [](const std::string& source, const char* text) {
    Diagnostics d;
    EXPECT_FALSE(compileShaderString(source, {}, d).ok());
    EXPECT_NE(d.str().find(text), std::string::npos) << d.str().substr(0, 500);
  };
  failsWith("surface a() { Ci = " + std::string(100000, '(') + "1", "nested too deeply");
  failsWith("surface a() { " + std::string(100000, '{'), "nested too deeply");
  failsWith("surface a() { Ci = " + std::string(100000, '-') + "1; }", "nested too deeply");
  std::string sum = "surface a() { Ci = 1";
  for (int i = 0; i < 50000; ++i) sum += "+s";
  failsWith(sum + "; }", "expression too long");
  std::string elses = "surface a() { ";
  for (int i = 0; i < 50000; ++i) elses += "if (s > 1) Ci = 1; else ";
  failsWith(elses + "; }", "nested too deeply");
  failsWith("surface a() { float x[1e9]; Ci = 1; }", "elements");
  // Functions that call the one before eight times.
  std::string tower = "float f0(float x) { return noise(x); }\n";
  for (int i = 1; i < 12; ++i) {
    tower += fmt::format("float f{}(float x) {{ return ", i);
    for (int k = 0; k < 8; ++k) tower += fmt::format("{}f{}(x + {})", k ? " + " : "", i - 1, k);
    tower += "; }\n";
  }
  failsWith(tower + "surface a() { Ci = f11(s); }", "instructions");
  failsWith("#if " + std::string(50000, '(') + "1\n#endif\nsurface a() { Ci = 1; }", "nested too deeply");
}

TEST(BadInput, BrokenPragmaOperators) {
  for (const char* text : {"_Pragma", "_Pragma = 1", "_Pragma()", "_Pragma(a, b)", "_Pragma(\"x)",
                           "_Pragma(1)", "#define A _Pra##gma(\nA", "#define B(x) x\nB(_Pragma)"}) {
    Diagnostics d;
    (void)compileShaderString(std::string("surface a() { Ci = 1;\n") + text + "\n }", {}, d).ok();
  }
}

}  // namespace
}  // namespace fr
