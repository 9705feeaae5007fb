#include "shading/testing/reference_interpreter.h"

#include <algorithm>
#include <cmath>

#include "shading/kernels.h"

namespace fr {

using ast::Expr;
using ast::ExprKind;
using ast::Stmt;
using ast::StmtKind;

namespace {

using Value = ReferenceValue;

[[noreturn]] void unknown(const std::string& what) {
  throw std::runtime_error("reference interpreter: " + what);
}

Value number(float x) { return Value{1, false, {x}}; }

Value widened(Value v, uint32_t width) {
  if (v.width == width) return v;
  if (v.width != 1 || width != 3) unknown("a triple where a float is needed");
  return Value{3, false, {v.data[0], v.data[0], v.data[0]}};
}

/// One elementary operation.
Value operation(Op op, uint32_t width, const std::vector<Value>& inputs) {
  const Kernel kernel = kernels().op[size_t(op)];
  if (!kernel) unknown(std::string("no kernel for ") + opInfo(op).name);
  alignas(64) float memory[20][3 * kLanePad];
  Operand args[20];
  for (size_t k = 0; k <= inputs.size(); ++k) {
    args[k] = Operand{memory[k], kLanePad, kLanePad - 1};
    const uint32_t n = k == 0 ? width : inputs[k - 1].width;
    for (uint32_t c = 0; c < n; ++c)
      std::fill_n(args[k].comp(c), kLanePad, k == 0 ? 0.0f : inputs[k - 1].data[c]);
  }
  alignas(64) int32_t mask[kLanePad];
  std::fill_n(mask, kLanePad, -1);
  KernelCall c;
  c.arg = args, c.argCount = uint32_t(inputs.size() + 1), c.lanes = kLanePad, c.mask = mask;
  kernel(c);
  Value r{width, false, std::vector<float>(width)};
  for (uint32_t k = 0; k < width; ++k) r.data[k] = args[0].comp(k)[0];
  return r;
}

bool truth(const Value& v) { return v.data[0] != 0.0f; }

Value arithmetic(const std::string& op, Value a, Value b) {
  const uint32_t width = std::max(a.width, b.width);
  if (op == "==" || op == "!=") {
    const bool equal = op == "==";
    if (width == 1) return operation(equal ? Op::eq_f : Op::ne_f, 1, {a, b});
    return operation(equal ? Op::eq_t : Op::ne_t, 1, {widened(a, 3), widened(b, 3)});
  }
  if (op == "<") return operation(Op::lt_f, 1, {a, b});
  if (op == "<=") return operation(Op::le_f, 1, {a, b});
  if (op == ">") return operation(Op::gt_f, 1, {a, b});
  if (op == ">=") return operation(Op::ge_f, 1, {a, b});
  if (op == ".") return operation(Op::dot, 1, {widened(a, 3), widened(b, 3)});
  if (op == "^") return operation(Op::cross, 3, {widened(a, 3), widened(b, 3)});
  const char c = op[0];
  if (width == 1)
    return operation(c == '+'   ? Op::add_f
                     : c == '-' ? Op::sub_f
                     : c == '*' ? Op::mul_f
                                : Op::div_f,
                     1, {a, b});
  if (c == '*' && a.width == 1) std::swap(a, b);
  if ((c == '*' || c == '/') && b.width == 1) return operation(c == '*' ? Op::mul_tf : Op::div_tf, 3, {a, b});
  return operation(c == '+'   ? Op::add_t
                   : c == '-' ? Op::sub_t
                   : c == '*' ? Op::mul_t
                              : Op::div_t,
                   3, {widened(a, 3), widened(b, 3)});
}

uint32_t widthOf(SlType t) { return isTriple(t) ? 3 : t == SlType::kFloat ? 1 : (unknown("a type"), 0); }

/// Element of an array or component of a triple: floor, then the nearest that there is.
size_t indexOf(const Value& v, float index, bool* outside) {
  const size_t count = v.isArray ? v.data.size() / v.width : 3;
  const float f = std::floor(index);
  *outside = !(f >= 0 && f < float(count));
  return size_t(std::clamp(f, 0.0f, float(count - 1)));
}

}  // namespace

ReferenceValue* ReferenceInterpreter::make(ReferenceValue v) {
  storage_.push_back(std::make_unique<ReferenceValue>(std::move(v)));
  return storage_.back().get();
}

ReferenceValue& ReferenceInterpreter::variable(const std::string& name, Scope& scope) {
  for (Scope* s = &scope; s; s = s->parent)
    if (auto it = s->names.find(name); it != s->names.end()) return *it->second;
  unknown("variable " + name);
}

std::map<std::string, ReferenceValue> ReferenceInterpreter::run(
    const std::map<std::string, ReferenceValue>& globals) {
  storage_.clear();
  steps_ = 0;
  const ast::Function& shader = *file_.shaders.at(0).function;
  Scope outer;
  for (const auto& [name, value] : globals) outer.names[name] = make(value);
  for (const ast::Function* f : file_.functions) outer.functions[f->name] = f;
  Scope parameters;
  parameters.parent = &outer;
  for (const ast::Variable& v : shader.formals) {
    declare(v, parameters);
    if (auto it = globals.find(v.name); it != globals.end()) *parameters.names[v.name] = it->second;
  }
  statement(*shader.body, parameters);
  std::map<std::string, ReferenceValue> r;
  for (const auto& [name, value] : outer.names) r[name] = *value;
  for (const auto& [name, value] : parameters.names) r[name] = *value;
  return r;
}

void ReferenceInterpreter::declare(const ast::Variable& v, Scope& scope) {
  Value value{widthOf(v.type), v.isArray, {}};
  const size_t count = v.isArray && v.length ? size_t(v.length->number) : 1;
  value.data.assign(count * value.width, 0.0f);
  if (v.init && v.init->kind == ExprKind::kList) {
    for (size_t i = 0; i < v.init->args.size(); ++i) {
      const Value x = widened(expression(*v.init->args[i], scope), value.width);
      std::copy(x.data.begin(), x.data.end(), value.data.begin() + long(i * value.width));
    }
  } else if (v.init) {
    const Value x = widened(expression(*v.init, scope), value.width);
    for (size_t i = 0; i < count; ++i)
      std::copy(x.data.begin(), x.data.end(), value.data.begin() + long(i * value.width));
  }
  scope.names[v.name] = make(std::move(value));
}

ReferenceInterpreter::Flow ReferenceInterpreter::statement(const Stmt& s, Scope& scope) {
  if (++steps_ > 20'000'000) unknown("endless");
  switch (s.kind) {
    case StmtKind::kEmpty:
      return Flow::kNext;
    case StmtKind::kExpr:
      expression(*s.exprs[0], scope);
      return Flow::kNext;
    case StmtKind::kDeclaration:
      for (const ast::Variable& v : s.variables)
        if (v.isExtern)
          scope.names[v.name] = &variable(v.name, *scope.parent);
        else
          declare(v, scope);
      return Flow::kNext;
    case StmtKind::kFunction:
      scope.functions[s.function->name] = s.function;
      return Flow::kNext;
    case StmtKind::kBlock: {
      Scope inner;
      inner.parent = &scope;
      for (const Stmt* b : s.body)
        if (const Flow f = statement(*b, inner); f != Flow::kNext) return f;
      return Flow::kNext;
    }
    case StmtKind::kIf:
      if (truth(expression(*s.exprs[0], scope))) return statement(*s.body[0], scope);
      return s.body.size() > 1 ? statement(*s.body[1], scope) : Flow::kNext;
    case StmtKind::kWhile:
    case StmtKind::kFor:
      return loop(s, scope);
    case StmtKind::kBreak:
    case StmtKind::kContinue:
      levels_ = s.levels;
      return s.kind == StmtKind::kBreak ? Flow::kBreak : Flow::kContinue;
    case StmtKind::kReturn:
      if (!s.exprs.empty() && s.exprs[0]) returned_ = expression(*s.exprs[0], scope);
      return Flow::kReturn;
    default:
      unknown("a statement");
  }
}

ReferenceInterpreter::Flow ReferenceInterpreter::loop(const Stmt& s, Scope& scope) {
  const bool isFor = s.kind == StmtKind::kFor;
  if (isFor && s.exprs[0]) expression(*s.exprs[0], scope);
  const Expr* const condition = s.exprs[isFor ? 1 : 0];
  while (!condition || truth(expression(*condition, scope))) {
    const Flow f = statement(*s.body[0], scope);
    if (f == Flow::kReturn) return f;
    if (f == Flow::kBreak) return --levels_ > 0 ? f : Flow::kNext;
    if (f == Flow::kContinue && --levels_ > 0) return f;
    if (isFor && s.exprs[2]) expression(*s.exprs[2], scope);
  }
  return Flow::kNext;
}

ReferenceValue ReferenceInterpreter::assign(const Expr& e, Scope& scope) {
  const Expr& target = *e.args[0];
  Value& v = variable(target.text, scope);
  if (target.kind == ExprKind::kName) {
    Value x = expression(*e.args[1], scope);
    if (e.text != "=") x = arithmetic(e.text.substr(0, 1), v, x);
    v.data = widened(x, v.width).data;
    return v;
  }
  const float index = expression(*target.args[0], scope).data[0];
  Value x = expression(*e.args[1], scope);
  bool outside = false;
  const size_t i = indexOf(v, index, &outside);
  const uint32_t width = v.isArray ? v.width : 1;
  Value old{width, false,
            std::vector<float>(v.data.begin() + long(i * width), v.data.begin() + long((i + 1) * width))};
  if (e.text != "=") x = arithmetic(e.text.substr(0, 1), old, x);
  x = widened(x, width);
  if (!outside) std::copy(x.data.begin(), x.data.end(), v.data.begin() + long(i * width));
  return x;
}

ReferenceValue ReferenceInterpreter::expression(const Expr& e, Scope& scope) {
  switch (e.kind) {
    case ExprKind::kNumber:
      return number(float(e.number));
    case ExprKind::kName:
      return variable(e.text, scope);
    case ExprKind::kIndex: {
      const float index = expression(*e.args[0], scope).data[0];
      const Value& v = variable(e.text, scope);
      bool outside = false;
      const size_t i = indexOf(v, index, &outside);
      const uint32_t width = v.isArray ? v.width : 1;
      return {width, false,
              std::vector<float>(v.data.begin() + long(i * width), v.data.begin() + long((i + 1) * width))};
    }
    case ExprKind::kTuple: {
      Value r{3, false, {}};
      for (const Expr* a : e.args) r.data.push_back(expression(*a, scope).data[0]);
      return r;
    }
    case ExprKind::kCast:
      return widened(expression(*e.args[0], scope), widthOf(e.type));
    case ExprKind::kUnary: {
      const Value v = expression(*e.args[0], scope);
      if (e.text == "!") return operation(Op::not_f, 1, {v});
      return operation(v.width == 1 ? Op::neg_f : Op::neg_t, v.width, {v});
    }
    case ExprKind::kBinary: {
      const Value a = expression(*e.args[0], scope);
      if (e.text == "&&" || e.text == "||") {
        const bool left = truth(a);
        if (left == (e.text == "||")) return number(left ? 1.0f : 0.0f);
        return number(truth(expression(*e.args[1], scope)) ? 1.0f : 0.0f);
      }
      return arithmetic(e.text, a, expression(*e.args[1], scope));
    }
    case ExprKind::kTernary: {
      const bool first = truth(expression(*e.args[0], scope));
      return expression(*e.args[first ? 1 : 2], scope);
    }
    case ExprKind::kAssign:
      return assign(e, scope);
    case ExprKind::kCall:
      return call(e, scope);
    default:
      unknown("an expression");
  }
}

ReferenceValue ReferenceInterpreter::call(const Expr& e, Scope& scope) {
  const ast::Function* f = nullptr;
  Scope* home = nullptr;
  for (Scope* s = &scope; s && !f; s = s->parent)
    if (auto it = s->functions.find(e.text); it != s->functions.end()) f = it->second, home = s;
  if (!f) return builtin(e, scope);
  Scope formals;
  formals.parent = home;
  std::vector<std::pair<Value*, Value*>> back;  // copies of elements that are written
  for (size_t i = 0; i < f->formals.size(); ++i) {
    const ast::Variable& v = f->formals[i];
    const Expr& actual = *e.args[i];
    if (v.output || v.isArray) {
      formals.names[v.name] = &variable(actual.text, scope);
    } else {
      formals.names[v.name] = make(widened(expression(actual, scope), widthOf(v.type)));
    }
  }
  returned_ = number(0);
  statement(*f->body, formals);
  if (f->result == SlType::kVoid) return number(0);
  return widened(returned_, widthOf(f->result));
}

ReferenceValue ReferenceInterpreter::builtin(const Expr& e, Scope& scope) {
  const std::string& n = e.text;
  if (n == "setcomp" || n == "setxcomp") {
    Value& v = variable(e.args[0]->text, scope);
    const float index = n == "setcomp" ? expression(*e.args[1], scope).data[0] : 0.0f;
    const float x = expression(*e.args.back(), scope).data[0];
    bool outside = false;
    const size_t i = indexOf(v, index, &outside);
    if (!outside) v.data[i] = x;
    return number(0);
  }
  std::vector<Value> a;
  for (const Expr* x : e.args) a.push_back(expression(*x, scope));
  struct Row {
    const char* name;
    uint32_t first;  // width of the first argument
    Op op;
    uint32_t width;
  };
  static const Row kRows[] = {{"sin", 1, Op::sin, 1},
                              {"cos", 1, Op::cos, 1},
                              {"sqrt", 1, Op::sqrt, 1},
                              {"exp", 1, Op::exp, 1},
                              {"log", 1, Op::log, 1},
                              {"pow", 1, Op::pow, 1},
                              {"mod", 1, Op::mod, 1},
                              {"abs", 1, Op::abs, 1},
                              {"sign", 1, Op::sign, 1},
                              {"floor", 1, Op::floor, 1},
                              {"ceil", 1, Op::ceil, 1},
                              {"round", 1, Op::round, 1},
                              {"min", 1, Op::min_f, 1},
                              {"max", 1, Op::max_f, 1},
                              {"min", 3, Op::min_t, 3},
                              {"max", 3, Op::max_t, 3},
                              {"clamp", 1, Op::clamp_f, 1},
                              {"clamp", 3, Op::clamp_t, 3},
                              {"mix", 1, Op::mix_f, 1},
                              {"mix", 3, Op::mix_t, 3},
                              {"step", 1, Op::step, 1},
                              {"smoothstep", 1, Op::smoothstep, 1},
                              {"length", 3, Op::length, 1},
                              {"distance", 3, Op::distance, 1},
                              {"normalize", 3, Op::normalize, 3},
                              {"reflect", 3, Op::reflect, 3},
                              {"comp", 3, Op::comp_t, 1},
                              {"faceforward", 3, Op::faceforward, 3}};
  for (const Row& r : kRows)
    if (n == r.name && a[0].width == r.first) return operation(r.op, r.width, a);
  if (n == "xcomp" || n == "ycomp" || n == "zcomp") return number(a[0].data[size_t(n[0] - 'x')]);
  if (n == "noise") return operation(a[0].width == 1 ? Op::noise_f_f : Op::noise_f_t, 1, a);
  if (n == "cellnoise") return operation(a[0].width == 1 ? Op::cellnoise_f_f : Op::cellnoise_f_t, 1, a);
  unknown("function " + n);
}

}  // namespace fr
