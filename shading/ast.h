// Syntax tree of an RSL file. Nodes live in the Ast's arenas; every pointer inside is to a node of the same
// Ast.
#pragma once

#include <deque>
#include <string>
#include <vector>

#include "shading/ir.h"
#include "shading/source.h"

namespace fr::ast {

enum class ExprKind : uint8_t {
  kNumber,
  kString,
  kName,
  kIndex,      // name[args0]
  kCall,       // name(args)
  kTuple,      // (3 or 16 args)
  kCast,       // type [text = space] args0
  kUnary,      // text args0
  kBinary,     // args0 text args1
  kTernary,    // args0 ? args1 : args2
  kAssign,     // args0 text args1
  kList,       // { args }: array initialisers only
  kComponent,  // args0 [ args1 ]: component of a triple that is no plain variable
};

struct Expr {
  ExprKind kind = ExprKind::kNumber;
  SlType type = SlType::kVoid;  // kCast
  bool hasSpace = false;        // kCast
  bool channel = false;         // kCall: args[0][args[1]] is texture channel syntax; args[1] is the channel
  SourcePlace place;
  double number = 0;
  std::string text;  // name, string, operator, space
  std::vector<Expr*> args;
  uint32_t depth = 1;
};

struct Variable {
  SlType type = SlType::kFloat;
  SlClass cls = SlClass::kVarying;
  bool classGiven = false;
  bool output = false;
  bool isExtern = false;
  bool isArray = false;
  Expr* length = nullptr;  // null in `a[]`
  Expr* init = nullptr;
  std::string name;
  SourcePlace place;
};

struct Stmt;

struct Function {
  SlType result = SlType::kFloat;
  std::string name;
  SourcePlace place;
  std::vector<Variable> formals;
  Stmt* body = nullptr;
};

enum class StmtKind : uint8_t {
  kEmpty,
  kExpr,
  kDeclaration,
  kBlock,
  kIf,
  kWhile,
  kFor,
  kBreak,
  kContinue,
  kReturn,
  kIlluminance,  // exprs: the arguments
  kAmbient,      // __ambientlights(P), prelude only
  kIlluminate,
  kSolar,
  kGather,
  kFunction,
};

struct Stmt {
  StmtKind kind = StmtKind::kEmpty;
  SourcePlace place;
  std::vector<Expr*> exprs;         // condition, value, init/condition/step of kFor (may be null), arguments
  std::vector<Variable> variables;  // kDeclaration
  std::vector<Stmt*> body;          // kBlock: all; kIf: then [else]; loops: body; kGather: hit [else]
  Function* function = nullptr;     // kFunction
  int levels = 1;                   // kBreak, kContinue
};

struct Shader {
  ShaderType type = ShaderType::kSurface;
  Function* function = nullptr;
};

struct File {
  std::vector<Function*> functions;
  std::vector<Shader> shaders;
  std::deque<Expr> exprs;
  std::deque<Stmt> stmts;
  std::deque<Function> functionNodes;
};

}  // namespace fr::ast
