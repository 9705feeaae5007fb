// Calls of the user's functions: every call is an expansion of the body.
#include "shading/lower.h"

namespace fr {

using ast::ExprKind;
using ast::StmtKind;

namespace {

constexpr size_t kMaxInlineDepth = 64;

void collectAssigned(const ast::Expr* e, bool byCalls, std::set<std::string>& names) {
  if (!e) return;
  if (e->kind == ExprKind::kAssign) names.insert(e->args[0]->text);
  // A variable that stands alone as an argument may be an output of the call.
  if (byCalls && e->kind == ExprKind::kCall)
    for (const ast::Expr* a : e->args)
      if (a->kind == ExprKind::kName) names.insert(a->text);
  for (const ast::Expr* a : e->args) collectAssigned(a, byCalls, names);
}

void collectAssigned(const ast::Stmt* s, bool byCalls, std::set<std::string>& names) {
  for (const ast::Expr* e : s->exprs) collectAssigned(e, byCalls, names);
  for (const ast::Variable& v : s->variables) collectAssigned(v.init, byCalls, names);
  for (const ast::Stmt* b : s->body) collectAssigned(b, byCalls, names);
  if (s->function && s->function->body) collectAssigned(s->function->body, byCalls, names);
}

/// Variables of a function's own.
void collectDeclared(const ast::Stmt& s, std::set<std::string>& names) {
  for (const ast::Variable& v : s.variables)
    if (!v.isExtern) names.insert(v.name);
  for (const ast::Stmt* b : s.body) collectDeclared(*b, names);
}

}  // namespace

const std::set<std::string>& Lower::assignedNames(const ast::Function& f) {
  auto [it, fresh] = assigned_.try_emplace(&f);
  if (fresh && f.body) collectAssigned(f.body, true, it->second);
  return it->second;
}

std::set<std::string> Lower::assignmentTargets(const ast::Function& f) {
  std::set<std::string> names;
  if (f.body) collectAssigned(f.body, false, names);
  return names;
}

/// What a function may change of the variables around it: all that it assigns to but its own.
std::set<std::string> Lower::outerTargets(const ast::Function& f) {
  std::set<std::string> names = assignmentTargets(f), own;
  if (f.body) collectDeclared(*f.body, own);
  for (const ast::Variable& v : f.formals) own.insert(v.name);
  for (const std::string& name : own) names.erase(name);
  return names;
}

/// True when a return stands where code of the same function may follow.
bool Lower::hasEarlyReturn(const Stmt& s, bool tail) {
  switch (s.kind) {
    case StmtKind::kReturn:
      return !tail;
    case StmtKind::kBlock:
      for (size_t i = 0; i < s.body.size(); ++i)
        if (hasEarlyReturn(*s.body[i], tail && i + 1 == s.body.size())) return true;
      return false;
    case StmtKind::kIf:
      for (const Stmt* b : s.body)
        if (hasEarlyReturn(*b, tail)) return true;
      return false;
    default:
      for (const Stmt* b : s.body)
        if (hasEarlyReturn(*b, false)) return true;
      return false;
  }
}

int Lower::returnCount(const Stmt& s) {
  int n = s.kind == StmtKind::kReturn ? 1 : 0;
  for (const Stmt* b : s.body) n += returnCount(*b);
  return n;
}

bool Lower::bindFormal(Scope& scope, const ast::Function& f, const ast::Variable& formal, const Expr& actual,
                       std::vector<std::pair<uint32_t, const Expr*>>& outputs) {
  Binding b;
  b.type = formal.type;
  b.isArray = formal.isArray;
  b.place = formal.place;
  b.isWritten = true;
  b.isRead = true;
  if (formal.output) {
    b.symbol = variableOperand(actual, outputs);
    if (b.symbol == kNoIndex) return false;
  } else if (formal.isArray) {
    Binding* a = find(actual.text, actual.place);
    if (!a || !a->isArray || !useGlobal(*a, actual.place, false)) return false;
    b.symbol = read(*a);
    b.readOnly = "it is a parameter of the function";
  } else {
    Value v = converted(actual, formal.type);
    if (!v.ok()) return false;
    const Symbol& s = b_.symbol(v.symbol);
    const bool changed = assignedNames(f).count(formal.name) != 0;
    const bool fixed =
        s.storage == Storage::kConstant || s.storage == Storage::kTemp || s.storage == Storage::kParameter;
    b.symbol = v.symbol;
    if (!fixed || changed) {
      // The variable may change under the function's feet (or the function changes its copy).
      at(actual.place);
      b.symbol = b_.local(formal.name, formal.type);
      b_.assign(b.symbol, v.symbol);
    }
  }
  if (formal.isArray && formal.length) {
    double n = 0;
    const uint32_t have = b_.symbol(b.symbol).arrayLength;
    if (constantNumber(*formal.length, n) && n != double(have)) {
      error(actual.place, fmt::format("'{}' has {} elements, '{}' wants {}", actual.text, have, f.name, n));
      return false;
    }
  }
  if (scope.variables.count(formal.name)) {
    error(formal.place, fmt::format("two parameters of '{}' are called '{}'", f.name, formal.name));
    return false;
  }
  scope.variables.emplace(formal.name, b);
  return true;
}

Value Lower::userCall(const FunctionDef& def, const Expr& e, SlType result) {
  const ast::Function& f = *def.function;
  if (!f.body) return {};
  for (const Frame* frame : frames_) {
    if (frame->function != &f) continue;
    error(e.place, fmt::format("'{}' calls itself: functions cannot be recursive", f.name));
    return {};
  }
  if (frames_.size() >= kMaxInlineDepth) {
    error(e.place, fmt::format("functions call each other more than {} deep", kMaxInlineDepth), "",
          RiError::kLimit);
    return {};
  }
  const uint32_t firstSymbol = uint32_t(b_.program.symbols.size());
  Scope scope;
  scope.isFunction = true;
  scope.parent = def.scope;
  scope.caller = scope_;
  std::vector<std::pair<uint32_t, const Expr*>> outputs;
  bool good = true;
  for (size_t i = 0; i < f.formals.size(); ++i)
    good = bindFormal(scope, f, f.formals[i], *e.args[i], outputs) && good;
  if (!good) return {};

  Frame frame;
  frame.function = &f;
  frame.firstSymbol = firstSymbol;
  frame.early = hasEarlyReturn(*f.body, true);
  const int returns = returnCount(*f.body);
  frame.direct =
      !frame.early && returns == 1 && !f.body->body.empty() && f.body->body.back()->kind == StmtKind::kReturn;
  if (result != SlType::kVoid && !frame.direct) frame.result = b_.local(f.name, result);
  if (result != SlType::kVoid && returns == 0)
    error(f.place, fmt::format("'{}' has no 'return'", f.name),
          fmt::format("it should return a {}, or be 'void'", slTypeName(result)));
  at(e.place);
  if (frame.early) b_.emit(Op::inline_begin, {});
  pushScope(scope);
  functionBody(f, frame);
  popScope();
  at(e.place);
  if (frame.early) b_.emit(Op::inline_end, {});
  storeOutputs(outputs);
  if (result == SlType::kVoid) return {b_.constantFloat(0), SlType::kVoid};
  if (!frame.direct) return {frame.result, result};
  return frame.value.ok() ? Value{frame.value.symbol, result} : Value{};
}

void Lower::functionBody(const ast::Function& f, Frame& frame) {
  frames_.push_back(&frame);
  // The body's braces share the scope of the parameters' block.
  Scope block;
  pushScope(block);
  for (size_t i = 0; i < f.body->body.size(); ++i) statement(*f.body->body[i], i + 1 == f.body->body.size());
  popScope();
  frames_.pop_back();
}

/// Lowers a function with stand-ins for its arguments, to find its errors. The code is thrown away.
void Lower::check(const ast::Function& f) {
  if (!f.body) return;
  Scope scope;
  scope.isFunction = true;
  scope.parent = &globals_;
  scope.caller = scope_;
  for (const ast::Variable& formal : f.formals) {
    uint32_t length = 0;
    if (formal.isArray) {
      if (formal.length) {
        if (!arrayLength(formal, length)) length = 1;
      } else {
        length = 1024;
      }
    }
    Binding b;
    b.symbol = b_.local(formal.name, formal.type, length);
    b.type = formal.type;
    b.isArray = formal.isArray;
    b.place = formal.place;
    b.isWritten = b.isRead = true;
    scope.variables.emplace(formal.name, b);
  }
  Frame frame;
  frame.function = &f;
  if (f.result != SlType::kVoid) frame.result = b_.local(f.name, f.result);
  if (f.result != SlType::kVoid && returnCount(*f.body) == 0)
    error(f.place, fmt::format("'{}' has no 'return'", f.name),
          fmt::format("it should return a {}, or be 'void'", slTypeName(f.result)));
  lightDepth_ = 1;
  pushScope(scope);
  functionBody(f, frame);
  popScope();
}

void checkFunction(const LowerInput& input, const ast::Function& function) {
  ProgramBuilder scratch;
  Lower(input, scratch, ShaderType::kSurface).check(function);
}

bool lowerShader(const LowerInput& input, const ast::Shader& shader, ProgramBuilder& out) {
  return Lower(input, out, shader.type).shader(shader);
}

}  // namespace fr
