// Messages of the front end, with their places, and the programs of small shaders.
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "shading/builtins.h"
#include "shading/compile.h"
#include "shading/passes.h"

namespace fr {
namespace {

std::string messages(const std::string& source, bool lint = false) {
  Diagnostics d;
  CompileOptions o;
  o.lint = lint ? Lint::kAll : Lint::kNone;
  auto p = compileShaderString(source, o, d, "a.sl");
  EXPECT_EQ(p.ok(), !d.hasErrors());
  std::string r;
  for (const Diagnostic& m : d.all())
    r += fmt::format("{}:{} {}{}\n", m.where.line, m.where.column, m.message,
                     m.hint.empty() ? "" : " (" + m.hint + ")");
  return r;
}

std::string body(const std::string& statements) {
  return "surface a(float K = 1;) {\n" + statements + "\n}\n";
}

ShaderProgram compile(const std::string& source, int optimize = 2) {
  Diagnostics d;
  CompileOptions o;
  o.optimize = optimize;
  auto p = compileShaderString(source, o, d, "a.sl");
  EXPECT_TRUE(p.ok()) << d.str();
  return p.ok() ? *p : ShaderProgram{};
}

int countOps(const ShaderProgram& p, Op op) {
  int n = 0;
  for (const Instruction& in : p.code) n += in.op == op;
  return n;
}

TEST(CompilerMessages, SyntaxErrorsAreAllReportedWithTheirPlaces) {
  EXPECT_EQ(messages("surface a() { Ci = 1 }\n"), "1:22 expected ';' after the statement, found '}'\n");
  EXPECT_EQ(messages(body("  float x = ;\n  Ci = (1, 2);\n  Oi = 1;")),
            "2:13 expected an expression, found ';'\n"
            "3:8 2 values in parentheses: a triple has 3, a matrix 16\n");
  EXPECT_EQ(messages(body("  Ci = 1\n  Oi = 1;")), "2:9 expected ';' after the statement, found 'Oi'\n");
  EXPECT_EQ(messages("surface a() { if (1) { Ci = 1; \n"),
            "1:32 missing '}': the block that begins in line 1 has no end\n");
  EXPECT_EQ(messages("surfce a() { }"),
            "1:1 expected a shader or a function, found 'surfce' (did you mean 'surface'?)\n");
  EXPECT_EQ(messages("float f() { return 1; }"),
            "0:0 there is no shader in this file (a shader begins with surface, light, displacement, volume "
            "or imager)\n");
}

TEST(CompilerMessages, TypeErrors) {
  EXPECT_EQ(messages(body("  float x = Cs;\n  Ci = x;")),
            "2:13 cannot turn a color into a float (take one component with comp(c, 0), or length() or a dot "
            "product)\n");
  EXPECT_EQ(messages(body("  Ci = \"x\" + 1;")),
            "2:12 '+' does not work on a string and a float (join strings with concat())\n");
  EXPECT_EQ(messages(body("  Ci = nosie(P);")), "2:8 unknown function 'nosie' (did you mean 'noise'?)\n");
  EXPECT_EQ(messages(body("  Ci = colour;")), "2:8 unknown variable 'colour'\n");
  EXPECT_EQ(messages(body("  Ci = noise(\"a\");")),
            "2:8 no version of 'noise' takes these arguments: noise(string)\n");
  EXPECT_EQ(messages(body("  dPdu = 1;")),
            "2:3 'dPdu' cannot be changed in a surface shader (copy it into a variable of your own)\n");
  EXPECT_EQ(messages(body("  float a[3] = {1, 2, 3, 4};\n  a[7] = 1;")),
            "2:16 4 values for the 3 elements of 'a'\n3:3 index 7 is outside of 'a', which has 3 elements\n");
  EXPECT_EQ(messages(body("  break;")), "2:3 'break' outside of a loop\n");
  EXPECT_EQ(messages(body("  illuminate (P) { Ci = 1; }")),
            "2:3 'illuminate' does not exist in a surface shader\n");
  EXPECT_EQ(messages("light a() { illuminance (P) { Cl = 1; } }"),
            "1:13 'illuminance' does not exist in a light shader\n");
  EXPECT_EQ(messages("float f(float x) { return f(x); }\nsurface a() { Ci = f(1); }"),
            "1:27 'f' calls itself: functions cannot be recursive\n");
}

TEST(CompilerMessages, VaryingIntoUniformIsAnError) {
  EXPECT_EQ(messages(body("  uniform float x = s;\n  Ci = x;")),
            "2:17 varying value in the uniform variable 'x' (declare the variable 'varying')\n");
  // A local that only ever holds uniform values is uniform in effect.
  EXPECT_EQ(messages(body("  float y = K * 2;\n  uniform float x = y;\n  Ci = x;")), "");
  EXPECT_EQ(messages(body("  uniform float x = random();\n  Ci = x;")), "");
}

TEST(CompilerMessages, LintWarnings) {
  EXPECT_EQ(messages(body("  float x;\n  Ci = K;\n  if (s > .5) Ci = Du(P);"), true),
            "4:20 a vector is used as a color\n"
            "2:9 variable 'x' is never used\n"
            "4:20 the result of 'Du' is undefined where only some points are active\n");
  EXPECT_EQ(messages(body("#pragma nolint\n  float x;\n  Ci = K;"), true), "");
}

TEST(CompilerMessages, LintOfEveryKind) {
  const auto one = [](const std::string& statements) {
    std::string r = messages(body(statements + " Ci = K;"), true);
    return r.substr(0, r.find('\n'));
  };
  EXPECT_EQ(one("float x; x = x + 1; Oi = x;"), "2:14 'x' is used before it has a value");
  EXPECT_EQ(one("float x; x += 1; Oi = x;"), "2:10 'x' is used before it has a value");
  EXPECT_EQ(one("float x = 1; x = 2;"), "2:7 variable 'x' is set but never used");
  EXPECT_EQ(one("vector q = 1; q = P; Oi = q . q;"),
            "2:19 a point is assigned to a vector (they are moved and turned differently by transform())");
  EXPECT_EQ(one("normal q = N; vector w = q; w = q; Oi = w . w;"), "")
      << "normals and vectors are both directions";
  for (const char* call :
       {"Dv(t)", "Deriv(s, t)", "area(P)", "filterstep(.5, s)", "float texture(\"x\", s, t)",
        "float environment(\"x\", N)", "length(calculatenormal(P))"})
    EXPECT_NE(one(std::string("if (s > .5) Oi = ") + call + ";")
                  .find("is undefined where only some points are active"),
              std::string::npos)
        << call;
  EXPECT_EQ(one("if (s > .5) Oi = noise(P);"), "");
  EXPECT_EQ(one("uniform float k = 1; if (s > .5) k = 2; Oi = k;"),
            "2:34 uniform variable 'k' changes where only some points are active");
}

TEST(CompilerMessages, StringsThatDifferFromPointToPoint) {
  const auto warned = [](const std::string& statements) {
    return messages(body(statements + " Ci = K;"), true).find("differs from point to point") !=
           std::string::npos;
  };
  const std::string use = " Oi = n == \"a\" ? 1 : 0;";
  EXPECT_TRUE(warned("string n = \"a\"; if (s > .5) n = \"b\";" + use));
  EXPECT_TRUE(warned("string n = \"a\"; if (s > .5) n = \"b\"; else {" + use + "}"));
  EXPECT_TRUE(warned("string n = s > .5 ? \"a\" : \"b\";" + use));
  EXPECT_TRUE(warned("string l[2] = {\"a\", \"b\"}; string n = l[s * 2];" + use));
  EXPECT_TRUE(warned("string n = format(\"%f\", s);" + use));
  EXPECT_TRUE(warned("string n = \"a\"; while (s > t) { n = \"b\"; t += 1; }" + use));
  // Seen only where it was set; the same for all; of each light.
  EXPECT_FALSE(warned("if (s > .5) { string n = \"a\";" + use + "}"));
  EXPECT_FALSE(warned("string n = \"a\"; if (s > .5) { n = \"b\"; if (K > 1) { n = \"c\"; }" + use + "}"));
  EXPECT_FALSE(warned("string n = \"a\"; if (K > .5) n = \"b\";" + use));
  EXPECT_FALSE(warned("string n = \"a\"; if (s > .5) n = \"b\"; n = \"c\";" + use));
  EXPECT_FALSE(warned("string n = K > 1 ? \"a\" : \"b\";" + use));
  EXPECT_FALSE(warned("string n = \"\"; illuminance(P) { if (lightsource(\"__x\", n) == 1) {" + use + "} }"));
}

TEST(CompilerMessages, HabitsOfOtherLanguages) {
  EXPECT_EQ(messages(body("  float i = 0; i++;\n  --i;\n  Ci = i;")),
            "2:17 '++' does not exist in this language (write x += 1)\n"
            "3:3 '--' does not exist in this language (write x -= 1)\n");
  EXPECT_EQ(messages(body("  float i; for (i = 0; i < 3; i++) Ci = nowhere;")),
            "2:32 '++' does not exist in this language (write x += 1)\n2:41 unknown variable 'nowhere'\n");
  EXPECT_EQ(messages(body("  Ci = 5 % K;")), "2:10 '%' does not exist in this language (write mod(a, b))\n");
  EXPECT_EQ(messages(body("  Ci = K - -K - - 1;")), "");
  EXPECT_EQ(messages(body("  Ci = (color) noise(P);")),
            "2:9 a cast is written without parentheses (write color x)\n");
  EXPECT_EQ(messages("plugin \"x\";\nsurface a() { Ci = y; }"),
            "1:1 plugin \"x\" is not loaded: functions of later versions' plugins are not known\n"
            "2:20 unknown variable 'y'\n");
  EXPECT_EQ(messages("struct s { float x; }\nsurface a() { Ci = 1; }"),
            "1:1 expected a shader or a function, found 'struct' (structures of later versions of the "
            "language are not supported)\n");
}

TEST(CompilerMessages, OneMistakeIsSaidOnce) {
  // A missing semicolon loses neither the next declaration nor the rest of the loop.
  EXPECT_EQ(messages(body("  float x\n  float y = 2;\n  Ci = x + y;")),
            "2:10 expected ';' after the declaration, found 'float'\n");
  EXPECT_EQ(messages(body("  float i; for (i = 0; i < 3 { Ci = nowhere; }\n  Ci = nowhere;")),
            "2:30 expected ';' after the condition of 'for', found '{'\n2:37 unknown variable 'nowhere'\n");
  EXPECT_EQ(messages(body("  while (K < 3 Ci = 1;\n  Ci = elsewhere;")).substr(0, 5), "2:16 ");
}

TEST(CompilerMessages, LevelsOfWarnings) {
  const auto count = [](Lint lint) {
    Diagnostics d;
    CompileOptions o;
    o.lint = lint;
    (void)compileShaderString("surface a(float K) { float unused, x; x += 1; if (s > .5) Ci = Du(x); }", o, d)
        .ok();
    return d.warningCount();
  };
  EXPECT_EQ(count(Lint::kNone), 1u);    // no default
  EXPECT_EQ(count(Lint::kCommon), 3u);  // and: no value, derivative
  EXPECT_EQ(count(Lint::kAll), 5u);     // and: two unused
  // Loops over lights are no conditions: lights look up their maps there.
  Diagnostics d;
  CompileOptions o;
  o.lint = Lint::kAll;
  (void)compileShaderString("light a() { illuminate(P) { Cl = 1 - shadow(\"x\", Ps); } }", o, d).ok();
  (void)compileShaderString(
      "surface a() { uniform float n = 0; Ci = 0; illuminance(P) { uniform float skip = 0;"
      " lightsource(\"__nondiffuse\", skip); n += 1; Ci += Cl * (1 - skip) * n; } }",
      o, d)
      .ok();
  EXPECT_EQ(d.str(), "");
}

TEST(CompilerMessages, AllErrorsInOneRun) {
  const std::string m = messages(
      "float unused(float x) { return nothing; }\nfloat f(float x) { return nowhere; }\n"
      "surface a() {\n uniform float k = s;\n Ci = nosie(P);\n Oi = f(1, 2);\n Cl = 1;\n}");
  for (const char* part : {"nothing", "nowhere", "varying value in the uniform variable 'k'", "nosie",
                           "no version of 'f'", "'Cl' cannot be changed"})
    EXPECT_NE(m.find(part), std::string::npos) << part << "\n" << m;
}

TEST(CompilerMessages, CaretPointsAtTheColumn) {
  Diagnostics d;
  (void)compileShaderString("surface a() {\n\tCi = foo;\n}\n", {}, d, "dir/a.sl").ok();
  EXPECT_EQ(d.str(), "dir/a.sl:2:7: error: unknown variable 'foo'\n  \tCi = foo;\n  \t     ^\n");
}

TEST(Diagnostics, OfLongLinesThePlaceIsShown) {
  Diagnostic d;
  d.where = {"a.sl", 1, 501};
  d.message = "here";
  d.sourceLine = std::string(500, 'a') + "X" + std::string(500, 'b');
  const std::string text = d.str();
  EXPECT_LT(text.size(), 400u);
  // The mark stands under the X.
  const size_t line = text.find("\n") + 1, mark = text.find("\n", line) + 1;
  EXPECT_EQ(text.find('X') - line, text.find('^') - mark);
  d.where.column = 1, d.sourceLine[0] = 'Y';
  EXPECT_NE(d.str().find("  Y"), std::string::npos);
  d.where.column = 1001, d.sourceLine.back() = 'Z';
  EXPECT_NE(d.str().find("Z\n"), std::string::npos);
  d.where.column = 5000;
  EXPECT_EQ(d.str().find('^'), std::string::npos);
}

TEST(Preprocessor, MacrosConditionsAndIncludes) {
  EXPECT_EQ(messages("#ifndef BMRT\n#error no\n#endif\n#if FRANKENRENDER != 1\n#error no\n#endif\n"
                     "#define PART(a, b) \\\n  a##b\n#define TWICE(x) ((x)+(x))\n"
                     "surface a() { float PART(x, y) = TWICE(2); Ci = xy; }\n"),
            "");
  EXPECT_EQ(messages("#include \"nowhere.h\"\nsurface a() { Ci = 1; }").substr(0, 4), "1:1 ");
  EXPECT_EQ(messages("#line 100 \"other.sl\"\nsurface a() { Ci = x; }"), "100:20 unknown variable 'x'\n");
  EXPECT_EQ(messages("surface a()\r\n{\r\n  Ci = x;\r\n}\r\n"), "3:8 unknown variable 'x'\n");
  EXPECT_EQ(messages("surface a()\r{\r  Ci = x;\r}\r"), "3:8 unknown variable 'x'\n");
  std::string bomb = "#define A0 1+1\n";
  for (int i = 1; i < 40; ++i) bomb += fmt::format("#define A{} A{}+A{}\n", i, i - 1, i - 1);
  EXPECT_NE(messages(bomb + "surface a() { Ci = A39; }").find("too much text"), std::string::npos);
}

TEST(Preprocessor, WhatOtherProgramsLeave) {
  EXPECT_EQ(messages("# 100 \"other.sl\" 1 3\nsurface a() { Ci = x; }\n# 5\nsurface b() { Ci = y; }"),
            "100:20 unknown variable 'x'\n5:20 unknown variable 'y'\n");
  // Blanks behind the backslash, lines of DOS.
  EXPECT_EQ(
      messages("#define SUM(a, b) \\  \r\n  ((a) + \\\t\r\n  (b))\r\nsurface a() { Ci = SUM(1, 2); }\r\n"),
      "");
  EXPECT_EQ(messages("#ident \"$Id: a.sl 1.2 $\"\nsurface a() { Ci = x; }"), "2:20 unknown variable 'x'\n");
  EXPECT_EQ(messages("#if 0\ndon't \"look\n#endif\nsurface a() { Ci = 1; }"), "");
  EXPECT_EQ(messages("surface a() { Ci = 1;\n /* \" */ /* open\n }"), "2:10 comment without an end\n");
  EXPECT_EQ(messages("#ifdef A\n#endif\n #if 1\nsurface a() { Ci = 1; }\n").substr(0, 35),
            "3:1 this condition has no #endif\n");
  EXPECT_EQ(messages("#pragma annotation \"grouping\" \\\n \"Ka\"\nsurface a() { Ci = x; }"),
            "3:20 unknown variable 'x'\n");
}

TEST(Preprocessor, IncludedFileIsNamedInMessages) {
  const std::string folder = ::testing::TempDir() + "/slc_include";
  std::filesystem::create_directories(folder);
  std::ofstream(folder + "/part.h") << "float part(float x) {\n  return wrong;\n}\n";
  std::ofstream(folder + "/main.sl") << "#include \"part.h\"\nsurface main() { Ci = part(1) + bad; }\n";
  Diagnostics d;
  (void)compileShaderFile(folder + "/main.sl", {}, d).ok();
  ASSERT_EQ(d.all().size(), 2u) << d.str();
  // Folders as Windows writes them.
  std::ofstream(folder + "/other.sl")
      << "# include \"..\\slc_include\\part.h\"\nsurface other() { Ci = 1; }\n";
  Diagnostics other;
  (void)compileShaderFile(folder + "/other.sl", {}, other).ok();
  EXPECT_EQ(other.str().find("could not find"), std::string::npos) << other.str();
  EXPECT_TRUE(d.all()[0].where.file.ends_with("part.h"));
  EXPECT_EQ(d.all()[0].where.line, 2);
  EXPECT_EQ(d.all()[0].sourceLine, "  return wrong;");
  EXPECT_TRUE(d.all()[0].hint.starts_with("included from ") && d.all()[0].hint.ends_with("main.sl"))
      << d.all()[0].hint;
  EXPECT_EQ(d.all()[1].hint, "");
  EXPECT_TRUE(d.all()[1].where.file.ends_with("main.sl"));
  EXPECT_EQ(d.all()[1].where.column, 33);
  std::ofstream(folder + "/loop.sl") << "#include \"loop.sl\"\n";
  Diagnostics deep;
  EXPECT_FALSE(compileShaderFile(folder + "/loop.sl", {}, deep).ok());
}

TEST(Lowering, PrecedenceFollowsTheSpecification) {
  // Dot binds tighter than *, cross looser than * and tighter than +.
  const ShaderProgram p = compile(body("  vector a = N ^ 2 * I . N + P;\n  Ci = color (a);"), 0);
  std::vector<Op> ops;
  for (const Instruction& in : p.code)
    if (opInfo(in.op).cost >= Cost::kCheap) ops.push_back(in.op);
  EXPECT_EQ(ops, (std::vector<Op>{Op::dot, Op::mul_f, Op::cross, Op::add_t}));
}

TEST(Lowering, OverloadsFollowCastContextAndFirst) {
  EXPECT_EQ(countOps(compile(body("Ci = color noise(P);")), Op::noise_t_t), 1);
  EXPECT_EQ(countOps(compile(body("Ci = noise(s, t);")), Op::noise_t_ff), 1);
  EXPECT_EQ(countOps(compile(body("float x = noise(P, 1); Ci = x;")), Op::noise_f_tf), 1);
  EXPECT_EQ(countOps(compile(body("P += N * noise(P); Ci = 0;")), Op::noise_f_t), 1);
  EXPECT_EQ(countOps(compile(body("Ci = K * texture(\"x\");")), Op::texture_t), 1);
  EXPECT_EQ(countOps(compile(body("float x = texture(\"x\"[2]); Ci = x;")), Op::texture_f), 1);
  EXPECT_EQ(countOps(compile(body("Ci = K * trace(P, I);")), Op::trace_t), 1);
  EXPECT_EQ(countOps(compile(body("float x = trace(P, I); Ci = x;")), Op::trace_f), 1);
  EXPECT_EQ(countOps(compile(body("float x = visibility(P, P + I); Ci = x;")), Op::average_t), 1);
}

TEST(Lowering, UserFunctionsAreInlinedByReference) {
  const ShaderProgram p = compile(
      "void twice(output float x) { x *= 2; }\n"
      "surface a() { float v[2] = {1, 2}; twice(v[1]); float w = u; twice(w); Ci = v[1] + w; }");
  EXPECT_EQ(countOps(p, Op::inline_begin), 0);
  EXPECT_EQ(countOps(p, Op::mul_f), 2);
  EXPECT_EQ(countOps(p, Op::store_f), 1);
}

TEST(Lowering, EarlyReturnsBecomeStructured) {
  const ShaderProgram p =
      compile("float f(float x) { if (x > 1) return 1; return x; }\nsurface a() { Ci = f(u); }");
  EXPECT_EQ(countOps(p, Op::inline_begin), 1);
  EXPECT_EQ(countOps(p, Op::inline_return), 1);
  for (uint32_t i = 0; i < p.code.size(); ++i)
    if (p.code[i].op == Op::inline_return) {
      EXPECT_EQ(p.code[p.code[i].jump].op, Op::inline_end);
    }
  // A return in the last statement needs no marks.
  EXPECT_EQ(
      countOps(
          compile("float f(float x) { if (x > 1) return 1; else return x; }\nsurface a() { Ci = f(u); }"),
          Op::inline_begin),
      0);
}

TEST(Lowering, BreakAndContinueFindTheirLoops) {
  const ShaderProgram p =
      compile(body("float i, j;\nfor (i = 0; i < 3; i += 1) for (j = 0; j < 3; j += 1) {\n"
                   "if (j > u) break 2; if (j > v) continue; Ci += j; }"));
  std::vector<Op> targets;
  for (const Instruction& in : p.code)
    if (in.op == Op::break_loop || in.op == Op::continue_loop) targets.push_back(p.code[in.jump].op);
  EXPECT_EQ(targets, (std::vector<Op>{Op::loop_end, Op::loop_step}));
  EXPECT_EQ(p.code[p.code.back().jump].op, Op::loop_begin);
}

TEST(Uniformity, ControlDecides) {
  const auto classOf = [](const std::string& statements, const char* name) {
    const ShaderProgram p = compile(body(statements), 0);
    for (uint32_t i = 0; i < p.symbols.size(); ++i)
      if (p.symbols[i].storage == Storage::kLocal && p.symbolName(i) == name) return p.symbols[i].isVarying();
    ADD_FAILURE() << name;
    return false;
  };
  EXPECT_FALSE(classOf("float i; for (i = 0; i < 4; i += 1) Ci += i;", "i"));
  EXPECT_TRUE(classOf("float i; for (i = 0; i < 4; i += 1) { Ci += i; if (i > u) break; }", "i"));
  EXPECT_TRUE(classOf("float x = 0; if (u > .5) x = 1; Ci = x;", "x"));
  EXPECT_FALSE(classOf("float x = 0; if (K > .5) x = 1; Ci = x;", "x"));
  EXPECT_TRUE(classOf("float x = 0; illuminance (P) { x += 1; } Ci = x;", "x"));
  EXPECT_TRUE(classOf("float x = 0; while (x < u) x += 1; Ci = x;", "x"));
}

TEST(Analysis, FlagsForTheRenderers) {
  EXPECT_TRUE(compile(body("Oi = Os; Ci = Oi * Cs;")).has(kProgramOpaque));
  EXPECT_TRUE(compile(body("Ci = Cs;")).has(kProgramOpaque));
  EXPECT_FALSE(compile(body("Oi = Os * u; Ci = Cs;")).has(kProgramOpaque));
  EXPECT_FALSE(compile(body("Os = u; Oi = Os; Ci = Cs;")).has(kProgramOpaque));
  EXPECT_TRUE(compile(body("Ci = trace(P, I);")).has(kProgramCanAskRays));
  EXPECT_FALSE(compile(body("Ci = ambient();")).has(kProgramCanAskRays));
  EXPECT_FALSE(compile(body("if (0) Ci = trace(P, I);")).has(kProgramCanAskRays));
  EXPECT_TRUE(compile(body("Ci = ambient();")).has(kProgramUsesLights));
  EXPECT_TRUE(compile("light a(string m = \"\";) { illuminate (P) Cl = 1 - shadow(m, Ps); }")
                  .has(kProgramRaysByMapName));
  EXPECT_TRUE(compile("light a() { Cl = 1; }").has(kProgramAmbientLight));
  EXPECT_EQ(compile(body("Ci = s;")).readsGlobals, globalBit(GlobalId::k_s));
  EXPECT_EQ(compile(body("Ci = s;")).writesGlobals, globalBit(GlobalId::k_Ci));
}

TEST(Optimiser, ConstantsFoldAndDeadCodeGoes) {
  const ShaderProgram p = compile(body("float a = 2 * 3 + 1; float unused = noise(P); Ci = a;"));
  ASSERT_EQ(p.code.size(), 1u) << disassemble(p);
  EXPECT_EQ(p.code[0].op, Op::assign_t);
  EXPECT_EQ(p.floats[p.symbol(p.operands(p.code[0])[1]).data], 7.0f);
  EXPECT_EQ(compile(body("uniform float x = 1 / 0; Ci = x;")).code[0].op, Op::div_f);
}

TEST(Optimiser, SharedRegistersNeverOverlapInOneInstruction) {
  // An operation must not find its result in the place of an input.
  const ShaderProgram p =
      compile(body("Ci = diffuse(normalize(N)) + specular(normalize(N), -normalize(I), .1) * noise(P * 2);"));
  for (const Instruction& in : p.code) {
    const auto o = p.operands(in);
    for (uint32_t w : o)
      for (uint32_t r : o)
        if ((w & kArgWritten) && !(w & kArgRead) && (r & kArgRead)) {
          EXPECT_NE(w & kArgIndex, r & kArgIndex) << disassemble(p);
        }
  }
}

TEST(Builtins, TheTableIsSortedAndItsOperationsExist) {
  const auto all = allBuiltins();
  for (size_t i = 1; i < all.size(); ++i) EXPECT_LE(all[i - 1].name, all[i].name);
  for (const Builtin& b : all) EXPECT_EQ(opByName(opInfo(b.op).name), b.op);
  EXPECT_EQ(findBuiltins("noise").size(), 8u);
  EXPECT_TRUE(findBuiltins("nois").empty());
}

TEST(Language, LoopsDeclareTheirVariable) {
  EXPECT_EQ(messages(body("  float r = 0, i = 7; for (float i = 0; i < 3; i += 1) r += i;\n"
                          "  for (uniform float i = 0; i < 3; i += 1) { r += i; } Ci = r + i;")),
            "");
  EXPECT_EQ(messages(body("  for (float i = 0; i < 3; i += 1) Ci += i;\n  Ci += i;")),
            "3:9 unknown variable 'i'\n");
}

TEST(Language, AtmosphereIsAVolume) {
  EXPECT_EQ(compile("atmosphere a(float d = 1) { Ci = mix(Ci, color 1, d); Oi = Oi; }").type,
            ShaderType::kVolume);
}

TEST(Language, ARareCollection) {
  EXPECT_EQ(messages(R"(
plain(point p) { return xcomp(p); }
color tint(color c; float k) {
  float inner(float z) { extern float k; return z * k; }
  if (k > 2) return color (1, 0, 0);
  return c * inner(3);
}
float sum(float a[]) { return a[0] + a[1]; }
surface t1(float Ka = 1, Kd = .5; string maps[3] = {"a", "b" "c", ""}; uniform float arr[4] = {1, 2, Ka, PI};
           color c = color "hsv" (.5, 1, 1); output varying color aov = 0; point pp = point "world" (1,2,3);
           matrix mm = 1; float __hidden = 0; varying float vv = 0, ww = radians(30))
{
  extern point P;
  float i, j = 2., total;
  uniform float k;
  vector V = normalize(-I);
  point Nf = faceforward(normalize(N), I);
  for (i = 0; i < 4; i += 1) {
    total += arr[i] * noise(P * i) + sum(arr);
    if (mod(i, 2) == 1) continue;
    while (1) { j *= .5; if (j < u) break 2; break; }
  }
  float b = k = 3;
  total += plain(P) + (b += 1);
  float a = total > 1 ? 2 : noise(total, 3);
  color tex = texture(maps[0][1], s, t, "blur", 0.1) + color texture((maps[1])) + color environment("e", V);
  color cn = color noise(P), mixd = mix(cn, tex, a);
  string str = concat("a", maps[1], format("%f", a));
  if (str == "x" && !(a < 3) || b >= 2) printf("hello %p %f\n", P, a);
  normal nn = ntransform("world", N);
  matrix m = matrix "world" 1, m2 = 1/m * translate(m, (1,2,3));
  point q = transform(m2, transform("shader", P + V));
  color lights = 0;
  illuminance("key,-fill", P, Nf, PI/2, "light:__x", b) {
    lights += Cl * (normalize(L) . Nf);
    lightsource("intensity", total);
    if (b > 3) break;
  }
  gather("illuminance", P, V, 0, 4, "surface:Ci", cn, "ray:length", a) { lights += cn; } else { lights -= 1; }
  setxcomp(q, 3); setcomp(lights, 1, 2); setcomp(m, 1, 2, comp(m2, 0, 0));
  float ok = textureinfo("x", "channels", b) + attribute("user:x", a) + option("Format", arr2) + surface("Ka", b);
  float kr, kt; vector R, T;
  fresnel(V, nn, 1.5, kr, kt, R, T);
  fresnel(V, nn, 1.5, kr, kt);
  aov = tint(lights, a) + spline(a, color 0, color 1, color 2, color (1,2,3)) + c * trace(P, V, "bias", .1);
  aov += mixd * (kr + ok) + color (xcomp(q), ycomp(R), zcomp(T));
  float fa[5] = {1, 2, 3, 4, 5};
  Oi = Os; Ci = Oi * aov * spline("bezier", .5, fa) * (Cs . color (1,1,1)) * min(1, 2, kt) * max(s, t, u, v);
  return;
}
)"),
            "41:90 unknown variable 'arr2' (did you mean 'arr'?)\n");
}

}  // namespace
}  // namespace fr
