#include "shading/lower.h"

#include <algorithm>
#include <cmath>

#include "shading/builtins.h"

namespace fr {

using ast::ExprKind;
using ast::StmtKind;

namespace {

/// Whether something there may change the variable `name`: an assignment, or a function it is given to.
bool mayWrite(const ast::Expr& e, std::string_view name) {
  const auto isIt = [&](const ast::Expr& target) {
    return (target.kind == ExprKind::kName || target.kind == ExprKind::kIndex) && target.text == name;
  };
  if (e.kind == ExprKind::kAssign && isIt(*e.args[0])) return true;
  if (e.kind == ExprKind::kCall && (e.text.starts_with("set") || findBuiltins(e.text).empty()) &&
      std::any_of(e.args.begin(), e.args.end(), [&](const ast::Expr* a) { return isIt(*a); }))
    return true;
  return std::any_of(e.args.begin(), e.args.end(), [&](const ast::Expr* a) { return mayWrite(*a, name); });
}

bool mayWrite(const ast::Stmt& s, std::string_view name) {
  for (const ast::Expr* e : s.exprs)
    if (e && mayWrite(*e, name)) return true;
  for (const ast::Variable& v : s.variables)
    if (v.init && mayWrite(*v.init, name)) return true;
  return std::any_of(s.body.begin(), s.body.end(),
                     [&](const ast::Stmt* inner) { return inner && mayWrite(*inner, name); });
}

}  // namespace

void Lower::statement(const Stmt& s, bool tail) {
  if (tooBig_) return;
  at(s.place);
  switch (s.kind) {
    case StmtKind::kEmpty:
      break;
    case StmtKind::kExpr:
      expression(*s.exprs[0]);
      break;
    case StmtKind::kDeclaration:
      declaration(s);
      break;
    case StmtKind::kBlock: {
      Scope scope;
      pushScope(scope);
      for (size_t i = 0; i < s.body.size(); ++i) statement(*s.body[i], tail && i + 1 == s.body.size());
      popScope();
      break;
    }
    case StmtKind::kIf:
      ifStatement(s, tail);
      break;
    case StmtKind::kWhile:
    case StmtKind::kFor:
      loop(s);
      break;
    case StmtKind::kBreak:
    case StmtKind::kContinue:
      jump(s);
      break;
    case StmtKind::kReturn:
      returnStatement(s, tail);
      break;
    case StmtKind::kIlluminance:
    case StmtKind::kAmbient:
      illuminance(s);
      break;
    case StmtKind::kIlluminate:
    case StmtKind::kSolar:
      lightStatement(s);
      break;
    case StmtKind::kGather:
      gather(s);
      break;
    case StmtKind::kFunction:
      scope_->functions[s.function->name].push_back({s.function, scope_});
      changedByFunctions_.merge(outerTargets(*s.function));
      break;
  }
}

/// A statement in a scope of its own, for bodies without braces.
void Lower::scoped(const Stmt& s, bool tail) {
  Scope scope;
  pushScope(scope);
  statement(s, tail);
  popScope();
}

bool Lower::constantNumber(const Expr& e, double& v) {
  double a = 0, b = 0;
  switch (e.kind) {
    case ExprKind::kNumber:
      v = e.number;
      return true;
    case ExprKind::kName:
      v = 3.14159265358979323846;
      return e.text == "PI";
    case ExprKind::kUnary:
      if (e.text != "-" || !constantNumber(*e.args[0], a)) return false;
      v = -a;
      return true;
    case ExprKind::kBinary:
      if (!constantNumber(*e.args[0], a) || !constantNumber(*e.args[1], b)) return false;
      if (e.text == "+")
        v = a + b;
      else if (e.text == "-")
        v = a - b;
      else if (e.text == "*")
        v = a * b;
      else if (e.text == "/" && b != 0)
        v = a / b;
      else
        return false;
      return true;
    default:
      return false;
  }
}

bool Lower::arrayLength(const ast::Variable& v, uint32_t& length) {
  double n = 0;
  if (!v.length) {
    if (v.init && v.init->kind == ExprKind::kList && !v.init->args.empty()) {
      n = double(v.init->args.size());
    } else {
      error(v.place, fmt::format("the array '{}' needs a length", v.name));
      return false;
    }
  } else if (!constantNumber(*v.length, n)) {
    error(v.length->place, fmt::format("the length of '{}' must be a constant", v.name));
    return false;
  }
  n = std::floor(n);
  if (!(n >= 1 && n <= double(kMaxArrayLength))) {
    error(v.place,
          fmt::format("the array '{}' has {} elements; 1 to {} are possible", v.name, n, kMaxArrayLength), "",
          RiError::kLimit);
    return false;
  }
  length = uint32_t(n);
  return true;
}

/// Writes the value of a declaration into a variable.
void Lower::initialise(uint32_t symbol, const ast::Variable& v, uint32_t length) {
  if (!v.init) return;
  if (length == 0) {
    if (v.init->kind == ExprKind::kList) {
      error(v.init->place, fmt::format("'{}' is not an array", v.name));
      return;
    }
    Value value = converted(*v.init, v.type);
    at(v.place);
    if (value.ok()) b_.assign(symbol, value.symbol);
    return;
  }
  uint32_t constant;
  if (constantArray(v, length, constant)) {
    b_.assign(symbol, constant);
    return;
  }
  if (v.init->kind != ExprKind::kList) {
    // One value for all elements.
    Value value = converted(*v.init, v.type);
    if (!value.ok()) return;
    Expr target;
    target.kind = ExprKind::kIndex;
    target.place = v.place;
    Binding b;
    b.symbol = symbol;
    b.type = v.type;
    b.isArray = true;
    for (uint32_t i = 0; i < length && !b_.full(); ++i)
      store(target, b, {b_.constantFloat(float(i)), SlType::kFloat}, value);
    return;
  }
  if (v.init->args.size() > length) {
    error(v.init->place,
          fmt::format("{} values for the {} elements of '{}'", v.init->args.size(), length, v.name));
    return;
  }
  Binding b;
  b.symbol = symbol;
  b.type = v.type;
  b.isArray = true;
  Expr target;
  target.kind = ExprKind::kIndex;
  target.place = v.place;
  for (uint32_t i = 0; i < v.init->args.size(); ++i) {
    Value value = converted(*v.init->args[i], v.type);
    if (value.ok()) store(target, b, {b_.constantFloat(float(i)), SlType::kFloat}, value);
  }
}

/// An array whose values are all numbers becomes one constant.
bool Lower::constantArray(const ast::Variable& v, uint32_t length, uint32_t& symbol) {
  const uint32_t width = slTypeFloats(v.type);
  if (!v.init || v.init->kind != ExprKind::kList || width == 0 || v.init->args.size() > length) return false;
  const size_t codeBefore = b_.program.code.size();
  for (const Expr* e : v.init->args) {
    double ignored;
    const Expr* inner = e->kind == ExprKind::kCast && !e->hasSpace ? e->args[0] : e;
    if (inner->kind == ExprKind::kTuple) {
      for (const Expr* c : inner->args)
        if (!constantNumber(*c, ignored)) return false;
    } else if (!constantNumber(*inner, ignored)) {
      return false;
    }
  }
  std::vector<float> values(size_t(width) * length, 0.0f);
  for (size_t i = 0; i < v.init->args.size(); ++i) {
    Value value = converted(*v.init->args[i], v.type);
    if (!value.ok() || !b_.isConstant(value.symbol) || b_.program.code.size() != codeBefore) return false;
    const auto numbers = b_.constantValue(value.symbol);
    std::copy(numbers.begin(), numbers.end(), values.begin() + long(i * width));
  }
  symbol = b_.constantFloats(v.type, values, length);
  return true;
}

void Lower::declaration(const Stmt& s) {
  for (const ast::Variable& v : s.variables) {
    Binding b;
    b.type = v.type;
    b.isArray = v.isArray;
    b.place = v.place;
    if (v.isExtern) {
      // The variable of the surroundings: where the function is written, else where it was called.
      Scope* function = scope_;
      while (function && !function->isFunction) function = function->parent;
      Binding* target = findFrom(scope_, v.name, nullptr);
      if (!target || !target->isLightCopy)
        target = findFrom(function ? function->parent : scope_->parent, v.name, nullptr);
      for (Scope* c = function ? function->caller : nullptr; c && !target;) {
        target = findFrom(c, v.name, nullptr);
        while (c && !c->isFunction) c = c->parent;
        c = c ? c->caller : nullptr;
      }
      if (!target) {
        if (frames_.size() <= 1 && frames_[0]->function && in_.file) {
          bool isShader = false;
          for (const ast::Shader& sh : in_.file->shaders)
            isShader = isShader || sh.function == frames_[0]->function;
          if (!isShader) {
            // Checking a function alone: a shader that calls it may have the variable.
            b.symbol = b_.local(v.name, v.type, v.isArray ? 16 : 0);
            b.isRead = b.isWritten = true;
            define(v.name, b);
            continue;
          }
        }
        error(v.place, fmt::format("there is no variable '{}' outside of this function", v.name),
              unknownNameHint(v.name));
        continue;
      }
      if (!useGlobal(*target, v.place, false)) continue;
      if (target->type != v.type && !(isTriple(target->type) && isTriple(v.type)))
        error(v.place,
              fmt::format("'{}' is a {}, not a {}", v.name, slTypeName(target->type), slTypeName(v.type)));
      b.target = target;
      b.symbol = target->symbol;
      auto [it, fresh] = scope_->variables.emplace(v.name, b);
      if (!fresh) it->second.target = target;
      continue;
    }
    uint32_t length = 0;
    if (v.isArray && !arrayLength(v, length)) length = 1;
    b.symbol = b_.local(v.name, v.type, length);
    if (v.classGiven) {
      b_.program.symbols[b.symbol].declaredClass = 1;
      b_.program.symbols[b.symbol].cls = v.cls;
    }
    b.isLocal = true;
    b.isWritten = v.init != nullptr || v.isArray;
    if (findFrom(scope_->parent, v.name, nullptr) && findFrom(scope_->parent, v.name, nullptr)->isLocal)
      warn(v.place, fmt::format("'{}' hides another variable of that name", v.name));
    at(v.place);
    if (v.init) {
      initialise(b.symbol, v, length);
    } else if (!v.isArray && slTypeFloats(v.type)) {
      // Registers are shared: a variable without a value must still be the same in each run.
      const float zero[16] = {};
      b_.assign(b.symbol, b_.constantFloats(v.type, {zero, slTypeFloats(v.type)}));
    } else if (!v.isArray) {
      b_.assign(b.symbol, b_.constantString(""));
    }
    define(v.name, b);
  }
}

void Lower::ifStatement(const Stmt& s, bool tail) {
  Value c = condition(*s.exprs[0]);
  at(s.place);
  if (c.ok() && b_.isConstant(c.symbol)) {
    // Both sides are checked, one is kept.
    const bool taken = b_.constantValue(c.symbol)[0] != 0;
    const auto dropped = [&](const Stmt& dead) {
      const size_t n = b_.program.code.size();
      scoped(dead, tail);
      b_.program.code.resize(n);
    };
    if (!taken) dropped(*s.body[0]);
    if (taken) scoped(*s.body[0], tail);
    if (s.body.size() > 1) {
      if (taken)
        dropped(*s.body[1]);
      else
        scoped(*s.body[1], tail);
    }
    return;
  }
  const uint32_t condition = c.ok() ? c.symbol : b_.temp(SlType::kFloat);
  b_.emit(Op::if_begin, {condition});
  scoped(*s.body[0], tail);
  if (s.body.size() > 1) {
    at(s.place);
    b_.emit(Op::if_else, {});
    scoped(*s.body[1], tail);
  }
  at(s.place);
  b_.emit(Op::if_end, {});
}

void Lower::loop(const Stmt& s) {
  const bool isFor = s.kind == StmtKind::kFor;
  if (isFor && s.exprs[0]) expression(*s.exprs[0]);
  const Expr* test = isFor ? s.exprs[1] : s.exprs[0];
  at(s.place);
  b_.emit(Op::loop_begin, {});
  Value c = test ? condition(*test) : Value{b_.constantFloat(1), SlType::kFloat};
  at(s.place);
  b_.emit(Op::loop_test, {c.ok() ? c.symbol : b_.constantFloat(0)});
  frames_.back()->loops++;
  scoped(*s.body[0], false);
  frames_.back()->loops--;
  at(s.place);
  b_.emit(Op::loop_step, {});
  if (isFor && s.exprs[2]) expression(*s.exprs[2]);
  at(s.place);
  b_.emit(Op::loop_end, {});
}

void Lower::jump(const Stmt& s) {
  const char* word = s.kind == StmtKind::kBreak ? "break" : "continue";
  if (frames_.back()->loops < s.levels) {
    error(s.place, frames_.back()->loops == 0
                       ? fmt::format("'{}' outside of a loop", word)
                       : fmt::format("'{} {}' inside of {} loops", word, s.levels, frames_.back()->loops));
    return;
  }
  b_.emit(s.kind == StmtKind::kBreak ? Op::break_loop : Op::continue_loop,
          {b_.constantFloat(float(s.levels))});
}

void Lower::returnStatement(const Stmt& s, bool tail) {
  Frame& frame = *frames_.back();
  const bool isShader = frames_.size() == 1 && frame.function->result == SlType::kVoid &&
                        frame.result == kNoIndex && !frame.direct;
  const SlType type = frame.function->result;
  if (s.exprs.empty()) {
    if (type != SlType::kVoid)
      error(s.place, fmt::format("'{}' must return a {}", frame.function->name, slTypeName(type)));
  } else if (type == SlType::kVoid) {
    error(s.exprs[0]->place, isShader
                                 ? "a shader returns no value"
                                 : fmt::format("'{}' is void: it returns no value", frame.function->name));
  } else {
    Value v = converted(*s.exprs[0], type);
    at(s.place);
    if (!v.ok()) return;
    const Storage storage = b_.symbol(v.symbol).storage;
    // A variable of the function's own keeps its value: nobody else knows it.
    const bool own = storage == Storage::kLocal && v.symbol >= frame.firstSymbol;
    if (frame.direct && (storage == Storage::kConstant || storage == Storage::kTemp || own)) {
      frame.value = v;
    } else {
      if (frame.result == kNoIndex) frame.result = b_.local(frame.function->name, type);
      b_.assign(frame.result, v.symbol);
      frame.value = {frame.result, type};
    }
  }
  at(s.place);
  if (!tail && frame.early) b_.emit(Op::inline_return, {});
}

bool Lower::exprPairs(const Stmt& s, size_t first, Op op, std::vector<uint32_t>& operands,
                      std::vector<std::pair<uint32_t, const Expr*>>& outputs) {
  Expr call;
  call.kind = ExprKind::kCall;
  call.place = s.place;
  call.text = op == Op::gather_begin ? "gather" : "illuminance";
  call.args = s.exprs;
  return pairs(call, first, op, operands, outputs);
}

/// Operands of a loop are looked at in every turn, but the shader means their values before the first: what
/// the body may change is copied. (Copies of what never changes are removed later.)
Value Lower::kept(Value v) {
  if (!v.ok()) return v;
  const Storage storage = b_.symbol(v.symbol).storage;
  if (storage == Storage::kConstant || storage == Storage::kTemp || storage == Storage::kParameter ||
      b_.symbol(v.symbol).isArray())
    return v;
  const uint32_t copy = b_.local("?", v.type);
  b_.assign(copy, v.symbol);
  return {copy, v.type};
}

void Lower::illuminance(const Stmt& s) {
  const bool ambient = s.kind == StmtKind::kAmbient;
  if (type_ != ShaderType::kSurface && type_ != ShaderType::kVolume)
    error(s.place, fmt::format("'{}' does not exist in a {} shader", ambient ? "ambient" : "illuminance",
                               shaderTypeName(type_)));
  std::vector<uint32_t> in;
  std::vector<std::pair<uint32_t, const Expr*>> outputs;
  Op op = ambient ? Op::ambient_begin : Op::illuminance_begin;
  size_t a = 0;
  bool good = true;
  const auto take = [&](SlType type) {
    if (a >= s.exprs.size()) return false;
    Value v = kept(converted(*s.exprs[a++], type));
    if (v.ok()) in.push_back(v.symbol);
    return v.ok();
  };
  const auto isString = [&](size_t i) {
    return i < s.exprs.size() && typeOf(*s.exprs[i]) == SlType::kString;
  };
  if (!ambient) {
    if (isString(0) && !(s.exprs.size() > 1 && isString(1))) {
      good = take(SlType::kString);
    } else {
      in.push_back(b_.constantString(""));
    }
  }
  if (a >= s.exprs.size()) {
    error(s.place, "'illuminance' needs a position", "illuminance([category,] P [, axis, angle])");
    good = false;
  } else {
    good = take(SlType::kPoint) && good;
  }
  if (good && a < s.exprs.size() && !isString(a)) {
    op = Op::illuminance_cone_begin;
    if (a + 1 >= s.exprs.size() || isString(a + 1)) {
      error(s.place, "'illuminance' has an axis but no angle", "illuminance([category,] P [, axis, angle])");
      good = false;
    } else {
      good = take(SlType::kVector) && take(SlType::kFloat);
    }
  }
  if (good && !ambient) good = exprPairs(s, a, op, in, outputs);
  if (!good) in.assign(ambient ? 1 : 2, b_.constantFloat(0));
  at(s.place);
  if (good) {
    b_.emit(op, in);
  } else {
    b_.emit(Op::loop_begin, {});  // keeps `break` meaningful while looking for further errors
    b_.emit(Op::loop_test, {in[0]});
  }
  for (const char* name : {"L", "Cl", "Ol"}) {
    Binding* b = findFrom(&globals_, name, nullptr);
    if (type_ == ShaderType::kSurface || type_ == ShaderType::kVolume)
      if (b->symbol == kNoIndex) b->symbol = b_.global(b->global);
  }
  frames_.back()->loops++;
  lightDepth_++;
  storeOutputs(outputs);
  // What the body makes of L, Cl and Ol is its own affair: it works on copies.
  Scope copies;
  pushScope(copies);
  for (const char* name : {"L", "Cl", "Ol"}) {
    const Binding* from = findFrom(&globals_, name, nullptr);
    if (from->symbol == kNoIndex || !mayWrite(*s.body[0], name)) continue;
    Binding b;
    b.type = from->type;
    b.symbol = b_.local(name, b.type);
    b.isRead = b.isWritten = b.isLightCopy = true;
    b_.assign(b.symbol, from->symbol);
    copies.variables.emplace(name, b);
  }
  scoped(*s.body[0], false);
  popScope();
  lightDepth_--;
  frames_.back()->loops--;
  at(s.place);
  if (good) {
    b_.emit(Op::illuminance_end, {});
  } else {
    b_.emit(Op::loop_step, {});
    b_.emit(Op::loop_end, {});
  }
}

void Lower::lightStatement(const Stmt& s) {
  const bool solar = s.kind == StmtKind::kSolar;
  const char* word = solar ? "solar" : "illuminate";
  if (type_ != ShaderType::kLight)
    error(s.place, fmt::format("'{}' does not exist in a {} shader", word, shaderTypeName(type_)));
  std::vector<uint32_t> in;
  bool good = true;
  const size_t n = s.exprs.size();
  if (solar ? (n != 0 && n != 2) : (n != 1 && n != 3)) {
    error(s.place, fmt::format("'{}' does not take {} arguments", word, n),
          solar ? "solar() or solar(axis, angle)" : "illuminate(P) or illuminate(P, axis, angle)");
    good = false;
  }
  for (size_t i = 0; i < n; ++i) {
    const SlType type = !solar && i == 0 ? SlType::kPoint : i + 1 == n ? SlType::kFloat : SlType::kVector;
    Value v = converted(*s.exprs[i], type);
    good = good && v.ok();
    in.push_back(v.symbol);
  }
  at(s.place);
  const Op op = solar ? (n ? Op::solar_cone_begin : Op::solar_begin)
                      : (n > 1 ? Op::illuminate_cone_begin : Op::illuminate_begin);
  if (good) b_.emit(op, in);
  if (type_ == ShaderType::kLight) {
    for (const char* name : {"L", "Cl", "Ol"}) {
      Binding* b = findFrom(&globals_, name, nullptr);
      if (b->symbol == kNoIndex) b->symbol = b_.global(b->global);
    }
  }
  lightDepth_++;
  scoped(*s.body[0], false);
  lightDepth_--;
  at(s.place);
  if (good) b_.emit(solar ? Op::solar_end : Op::illuminate_end, {});
}

void Lower::gather(const Stmt& s) {
  std::vector<uint32_t> in;
  std::vector<std::pair<uint32_t, const Expr*>> outputs;
  bool good = s.exprs.size() >= 5;
  if (!good) {
    error(s.place, "'gather' needs five arguments",
          "gather(category, P, direction, angle, samples [, \"name\", value])");
  } else {
    static constexpr SlType kTypes[] = {SlType::kString, SlType::kPoint, SlType::kVector, SlType::kFloat,
                                        SlType::kFloat};
    for (size_t i = 0; i < 5; ++i) {
      Value v = kept(converted(*s.exprs[i], kTypes[i]));
      good = good && v.ok();
      in.push_back(v.symbol);
    }
    if (good) good = exprPairs(s, 5, Op::gather_begin, in, outputs);
  }
  at(s.place);
  if (good) b_.emit(Op::gather_begin, in);
  frames_.back()->loops++;
  storeOutputs(outputs);
  scoped(*s.body[0], false);
  at(s.place);
  if (good) b_.emit(Op::gather_else, {});
  if (s.body.size() > 1) scoped(*s.body[1], false);
  frames_.back()->loops--;
  at(s.place);
  if (good) b_.emit(Op::gather_end, {});
}

void Lower::parameters(const ast::Function& f) {
  for (const ast::Variable& v : f.formals) {
    uint32_t length = 0;
    if (v.isArray && !arrayLength(v, length)) length = 1;
    Parameter p;
    p.symbol = b_.local(v.name, v.type, length);
    Symbol& symbol = b_.program.symbols[p.symbol];
    symbol.storage = v.output ? Storage::kOutputParameter : Storage::kParameter;
    symbol.cls = v.cls;
    // An output without a class has the class of what is put out.
    symbol.declaredClass = v.output && !v.classGiven ? 0 : 1;
    p.codeBegin = uint32_t(b_.program.code.size());
    at(v.place);
    if (v.init) {
      initialise(p.symbol, v, length);
    } else {
      if (f.body && !v.output)
        warn(v.place, fmt::format("parameter '{}' has no default value; 0 is used", v.name), "", Lint::kNone);
      if (length) {
        const std::vector<float> zero(size_t(slTypeFloats(v.type)) * length, 0.0f);
        if (!zero.empty()) b_.assign(p.symbol, b_.constantFloats(v.type, zero, length));
      } else if (slTypeFloats(v.type)) {
        const float zero[16] = {};
        b_.assign(p.symbol, b_.constantFloats(v.type, {zero, slTypeFloats(v.type)}));
      } else {
        b_.assign(p.symbol, b_.constantString(""));
      }
    }
    p.codeEnd = uint32_t(b_.program.code.size());
    b_.program.parameters.push_back(p);
    Binding b;
    b.symbol = p.symbol;
    b.type = v.type;
    b.isArray = v.isArray;
    b.place = v.place;
    b.isLocal = !v.name.starts_with("__");
    b.isParameter = true;
    b.isWritten = true;
    b.isRead = v.output;
    if (!v.output) b.readOnly = "it is a parameter and not declared 'output'";
    define(v.name, b);
  }
}

/// Parameters that the shader assigns to are variables that begin as the parameters. Not all compilers took
/// that.
void Lower::changedParameters(const ast::Function& f) {
  const std::set<std::string> assigned = assignmentTargets(f);
  for (const ast::Variable& v : f.formals) {
    if (v.output || assigned.count(v.name) == 0 || (v.isArray && v.type == SlType::kString)) continue;
    Binding* parameter = find(v.name, v.place);
    if (!parameter || !parameter->readOnly) continue;
    warn(v.place, fmt::format("parameter '{}' is changed by the shader, but not declared 'output'", v.name),
         "", Lint::kCommon);
    Binding b = *parameter;
    at(v.place);
    b.symbol = b_.local(v.name, v.type, b_.symbol(read(*parameter)).arrayLength);
    b_.assign(b.symbol, parameter->symbol);
    b.readOnly = nullptr, b.isRead = true;
    scope_->variables[v.name] = b;
  }
}

bool Lower::shader(const ast::Shader& shader) {
  const ast::Function& f = *shader.function;
  const size_t errors = in_.diagnostics->errorCount();
  b_.program.type = type_;
  b_.program.name = f.name;
  Scope scope;
  scope.isFunction = true;
  scope.parent = &globals_;
  scope.caller = &globals_;
  Frame frame;
  frame.function = &f;
  frame.early = f.body && hasEarlyReturn(*f.body, true);
  pushScope(scope);
  frames_.push_back(&frame);
  parameters(f);
  frames_.pop_back();
  b_.program.bodyBegin = uint32_t(b_.program.code.size());
  if (f.body) {
    changedParameters(f);
    at(f.place);
    if (frame.early) b_.emit(Op::inline_begin, {});
    functionBody(f, frame);
    at(f.place);
    if (frame.early) b_.emit(Op::inline_end, {});
  }
  popScope();
  return in_.diagnostics->errorCount() == errors && !b_.full();
}

}  // namespace fr
