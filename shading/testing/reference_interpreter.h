// A second implementation of the language, for comparison: walks the syntax tree for one point at a time,
// without masks, inlining, registers or passes.
//
// Knows the part of the language that random_program.h writes: floats and triples, arrays, all control flow
// but light and gather loops, functions with outputs, nested functions. Elementary operations are those of
// the virtual machine (kernels_test.cpp compares them with their definitions), so that results can be
// compared bit by bit.
#pragma once

#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "shading/ast.h"

namespace fr {

/// One or three floats; arrays are elements one after the other.
struct ReferenceValue {
  uint32_t width = 1;
  bool isArray = false;
  std::vector<float> data{0.0f};
};

class ReferenceInterpreter {
 public:
  /// The file must have compiled.
  explicit ReferenceInterpreter(const ast::File& file) : file_(file) {}
  /// Runs the first shader. `globals`: values of predefined variables, and of parameters that replace
  /// defaults. Returns all predefined variables and parameters at the end. Throws std::runtime_error at what
  /// it does not know.
  std::map<std::string, ReferenceValue> run(const std::map<std::string, ReferenceValue>& globals);

 private:
  struct Scope {
    Scope* parent = nullptr;
    std::map<std::string, ReferenceValue*> names;
    std::map<std::string, const ast::Function*> functions;
  };
  enum class Flow { kNext, kBreak, kContinue, kReturn };

  Flow statement(const ast::Stmt& s, Scope& scope);
  Flow loop(const ast::Stmt& s, Scope& scope);
  ReferenceValue expression(const ast::Expr& e, Scope& scope);
  ReferenceValue call(const ast::Expr& e, Scope& scope);
  ReferenceValue builtin(const ast::Expr& e, Scope& scope);
  ReferenceValue assign(const ast::Expr& e, Scope& scope);
  void declare(const ast::Variable& v, Scope& scope);
  ReferenceValue& variable(const std::string& name, Scope& scope);
  ReferenceValue* make(ReferenceValue v);

  const ast::File& file_;
  std::vector<std::unique_ptr<ReferenceValue>> storage_;
  int levels_ = 0;  // of the break or continue on its way
  ReferenceValue returned_;
  uint64_t steps_ = 0;
};

}  // namespace fr
