// Branches that a parameter decides, as in `if (texturename != "")` or `if (Kr > 0)`: the same for all that
// an instance shades.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "shading/ir.h"

namespace fr {

struct ShaderValue;

/// A comparison of a parameter with a constant.
struct ParameterTest {
  uint32_t instruction = 0;
  uint32_t parameter = 0;
  uint32_t constant = 0;  // symbol
  bool turned = false;    // the constant comes first
};
/// At most 64 of them, of parameters of which `fixed`(symbol) holds: nobody gives them other values than the
/// instance has.
std::vector<ParameterTest> findParameterTests(const ShaderProgram& program,
                                              const std::function<bool(uint32_t symbol)>& fixed);
/// One bit a test: it holds for these values.
uint64_t parameterTestResults(const ShaderProgram& program, const std::vector<ParameterTest>& tests,
                              const std::vector<ShaderValue>& values);
/// The program with the results in the place of the tests. What they switch off becomes `nop`: instructions
/// stay where they are, since seeds of random numbers are made of their places. Flags stay, too: what kind of
/// light a shader is does not depend on values.
ShaderProgram decideParameterTests(const ShaderProgram& program, const std::vector<ParameterTest>& tests,
                                   uint64_t results);

}  // namespace fr
