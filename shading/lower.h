// From the syntax tree to the IR: names, types, overloads and inlining in one pass over each shader.
//
// Private to the lower_*.cpp files and compile.cpp.
#pragma once

#include <set>
#include <unordered_map>

#include "shading/ast.h"
#include "shading/builder.h"
#include "shading/builtins.h"
#include "shading/lexer.h"
#include "shading/shadeop_library.h"

namespace fr {

/// What the files of one compilation contain, and where messages go.
struct LowerInput {
  const PreprocessedSource* source = nullptr;
  const ast::File* file = nullptr;
  const ast::File* prelude = nullptr;
  Diagnostics* diagnostics = nullptr;
  const NoLintLines* noLint = nullptr;
  Lint lint = Lint::kNone;
  const std::vector<std::string>* shadeopPaths = nullptr;  // folders of shared objects with functions
};

/// Compiles one shader; nothing when there were errors (which are in the diagnostics). The program is
/// complete but for classes, jumps, flags and default constants (compile.cpp runs those passes).
bool lowerShader(const LowerInput& input, const ast::Shader& shader, ProgramBuilder& out);
/// Checks a function that no shader calls.
void checkFunction(const LowerInput& input, const ast::Function& function);

struct Value {
  uint32_t symbol = kNoIndex;  // kNoIndex: an error was reported
  SlType type = SlType::kFloat;
  bool ok() const { return symbol != kNoIndex; }
};

/// What the surroundings of an expression expect.
struct Want {
  SlType type = SlType::kVoid;  // kVoid: nothing
  bool direct = true;           // false: operators stand between
};

struct Scope;

struct Binding {
  uint32_t symbol = kNoIndex;
  SlType type = SlType::kFloat;
  bool isArray = false;
  bool isConstantPi = false;
  const char* readOnly = nullptr;  // why it must not be written
  bool isGlobal = false;
  GlobalId global = GlobalId::kCount;
  SourcePlace place;
  bool isLocal = false;
  bool isLightCopy = false;  // L, Cl or Ol inside an illuminance that changes it
  bool isParameter = false;  // of the shader
  bool isRead = false;
  bool isWritten = false;
  Binding* target = nullptr;  // extern: the variable itself
};

struct FunctionDef {
  const ast::Function* function = nullptr;
  Scope* scope = nullptr;  // where it is defined
};

struct Scope {
  Scope* parent = nullptr;
  Scope* caller = nullptr;  // function scopes: where it was called from
  bool isFunction = false;
  std::unordered_map<std::string, Binding> variables;
  std::unordered_map<std::string, std::vector<FunctionDef>> functions;
};

/// Result of overload resolution.
struct Call {
  enum class Kind { kNone, kUser, kBuiltin, kShadeop } kind = Kind::kNone;
  const Builtin* builtin = nullptr;
  FunctionDef user;
  SlType result = SlType::kVoid;
  const Shadeop* shadeop = nullptr;
};

class Lower {
 public:
  Lower(const LowerInput& input, ProgramBuilder& builder, ShaderType type);
  bool shader(const ast::Shader& shader);
  void check(const ast::Function& function);

 private:
  using Expr = ast::Expr;
  using Stmt = ast::Stmt;

  /// An inlined function (or the shader itself) that is being lowered.
  struct Frame {
    const ast::Function* function = nullptr;
    uint32_t result = kNoIndex;
    Value value;                      // result of a function whose one return is its last statement
    bool direct = false;              // `value` is used
    bool early = false;               // needs inline_return
    uint32_t firstSymbol = kNoIndex;  // symbols from here on belong to this expansion
    int loops = 0;
  };

  // lower_scope.cpp
  void error(const SourcePlace& place, std::string message, std::string hint = {},
             RiError code = RiError::kSyntax);
  /// Given at `level` and above.
  void warn(const SourcePlace& place, std::string message, std::string hint = {}, Lint level = Lint::kAll);
  void at(const SourcePlace& place);
  Binding* find(const std::string& name, const SourcePlace& place);
  Binding* findFrom(Scope* from, const std::string& name, bool* crossed);
  void define(const std::string& name, Binding b);
  void pushScope(Scope& s);
  void popScope();
  void bindGlobals();
  bool useGlobal(Binding& b, const SourcePlace& place, bool write);
  Binding* writable(const Expr& e);
  uint32_t read(Binding& b);
  std::string unknownNameHint(const std::string& name) const;
  void unknownVariable(const Expr& e);

  // lower_type.cpp
  SlType typeOf(const Expr& e, Want want = {});
  SlType computeType(const Expr& e, Want want);
  SlType combine(const Expr& e, SlType a, SlType b);
  std::pair<SlType, SlType> operandTypes(const Expr& e, Want want);
  void channelOrElement(const Expr& call);
  Call resolve(const Expr& e, Want want);
  int conversionCost(SlType from, SlType to) const;
  int builtinCost(const Builtin& b, const Expr& e, Want want, SlType& result);
  int userCost(const ast::Function& f, const Expr& e, Want want);
  int shadeopCost(const ShadeopSpec& s, const Expr& e, Want want);
  const std::vector<const Shadeop*>& shadeops(const std::string& name);
  bool isArrayName(const Expr& e, SlType* elementType);
  std::string callText(const Expr& e);

  // lower_expression.cpp
  Value expression(const Expr& e, Want want = {});
  Value converted(const Expr& e, SlType type);  // lowered and converted
  Value convert(Value v, SlType type, const SourcePlace& place, bool explicitCast = false);
  Value condition(const Expr& e);
  Value nameValue(const Expr& e);
  Value componentValue(const ast::Expr& e);
  Value indexValue(const Expr& e);
  Value castValue(const Expr& e);
  Value tupleValue(const Expr& e, SlType type);
  Value unaryValue(const Expr& e, Want want);
  Value binaryValue(const Expr& e, Want want);
  Value arithmetic(const std::string& op, Value a, Value b, SlType type, const SourcePlace& place);
  Value ternaryValue(const Expr& e, Want want);
  Value assignValue(const Expr& e);
  void store(const Expr& target, Binding& b, Value index, Value v);
  Value toCurrent(SlType type, uint32_t space, Value v);

  // lower_call.cpp
  Value call(const Expr& e, Want want);
  Value builtinCall(const Builtin& b, const Expr& e, SlType result);
  bool plainInputs(const Builtin& b, const Expr& e, SlType result, std::vector<uint32_t>& inputs,
                   std::vector<std::pair<uint32_t, const Expr*>>& outputs);
  bool pairs(const Expr& e, size_t first, Op op, std::vector<uint32_t>& operands,
             std::vector<std::pair<uint32_t, const Expr*>>& outputs);
  void storeOutputs(const std::vector<std::pair<uint32_t, const Expr*>>& outputs);
  Value specialCall(const Builtin& b, const Expr& e, SlType result);
  Value textureCall(const Builtin& b, const Expr& e, SlType result);
  Value splineCall(const Expr& e, SlType result);
  Value transformCall(const Builtin& b, const Expr& e, SlType result);
  /// A symbol to be read and written for any variable or array; element targets are copied back by
  /// storeOutputs.
  uint32_t variableOperand(const Expr& e, std::vector<std::pair<uint32_t, const Expr*>>& outputs);

  // lower_shadeop.cpp
  Value shadeopCall(const Shadeop& op, const Expr& e);
  bool isPlainVariable(const Expr& e, SlType type);

  // lower_inline.cpp
  Value userCall(const FunctionDef& def, const Expr& e, SlType result);
  bool bindFormal(Scope& scope, const ast::Function& f, const ast::Variable& formal, const Expr& actual,
                  std::vector<std::pair<uint32_t, const Expr*>>& outputs);
  void functionBody(const ast::Function& f, Frame& frame);
  static bool hasEarlyReturn(const Stmt& s, bool tail);
  static int returnCount(const Stmt& s);
  const std::set<std::string>& assignedNames(const ast::Function& f);
  static std::set<std::string> assignmentTargets(const ast::Function& f);
  static std::set<std::string> outerTargets(const ast::Function& f);

  // lower_statement.cpp
  void statement(const Stmt& s, bool tail);
  void declaration(const Stmt& s);
  void ifStatement(const Stmt& s, bool tail);
  void loop(const Stmt& s);
  void jump(const Stmt& s);
  void returnStatement(const Stmt& s, bool tail);
  void illuminance(const Stmt& s);
  void lightStatement(const Stmt& s);
  void gather(const Stmt& s);
  Value kept(Value v);
  void scoped(const Stmt& s, bool tail);
  void changedParameters(const ast::Function& f);
  void parameters(const ast::Function& f);
  bool arrayLength(const ast::Variable& v, uint32_t& length);
  bool constantNumber(const Expr& e, double& v);
  void initialise(uint32_t symbol, const ast::Variable& v, uint32_t length);
  bool constantArray(const ast::Variable& v, uint32_t length, uint32_t& symbol);
  bool exprPairs(const Stmt& s, size_t first, Op op, std::vector<uint32_t>& operands,
                 std::vector<std::pair<uint32_t, const Expr*>>& outputs);

  const LowerInput& in_;
  ProgramBuilder& b_;
  ShaderType type_;
  Scope globals_;
  Scope* scope_ = &globals_;
  std::vector<Frame*> frames_;
  int lightDepth_ = 0;
  bool tooBig_ = false;
  std::unordered_map<const Expr*, std::vector<std::pair<uint16_t, SlType>>> types_;
  std::unordered_map<const Expr*, std::vector<std::pair<uint16_t, Call>>> calls_;
  std::unordered_map<const ast::Function*, std::set<std::string>> assigned_;
  std::set<std::string> unknown_;  // variables that were reported
  /// Variables around functions that these assign to: an operand is what they are when it is read, whatever a
  /// call to the right of it does.
  std::set<std::string> changedByFunctions_;
  struct FoundShadeops {
    std::vector<const Shadeop*> overloads;
    std::string error;  // what is wrong with the library
  };
  std::unordered_map<std::string, FoundShadeops> shadeops_;
};

}  // namespace fr
