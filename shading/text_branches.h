// Branches that a text parameter decides, as in `if (texturename != "")`: the same for all that an instance
// shades.
#pragma once

#include <cstdint>
#include <vector>

#include "shading/ir.h"

namespace fr {

struct ShaderValue;

/// A comparison of a text parameter, which nobody can write to, with a constant.
struct TextTest {
  uint32_t instruction = 0;
  uint32_t parameter = 0;
  uint32_t text = 0;  // index into strings
  bool equal = false;
};
/// At most 64 of them.
std::vector<TextTest> findTextTests(const ShaderProgram& program);
/// One bit a test: it holds for these parameter values.
uint64_t textTestResults(const ShaderProgram& program, const std::vector<TextTest>& tests,
                         const std::vector<ShaderValue>& values);
/// The program with the results in the place of the tests. What they switch off becomes `nop`: instructions
/// stay where they are, since seeds of random numbers are made of their places. Flags stay, too: what kind of
/// light a shader is does not depend on values.
ShaderProgram decideTextTests(const ShaderProgram& program, const std::vector<TextTest>& tests,
                              uint64_t results);

}  // namespace fr
