#include <algorithm>

#include "shading/lower.h"

namespace fr {

using ast::ExprKind;

Value Lower::expression(const Expr& e, Want want) {
  if (b_.full()) {
    if (!tooBig_)
      error(e.place, fmt::format("the shader becomes larger than {} instructions", kMaxInstructions),
            "functions are expanded where they are called; call them in loops", RiError::kLimit);
    tooBig_ = true;
    return {};
  }
  at(e.place);
  switch (e.kind) {
    case ExprKind::kNumber:
      return {b_.constantFloat(float(e.number)), SlType::kFloat};
    case ExprKind::kString:
      return {b_.constantString(e.text), SlType::kString};
    case ExprKind::kName:
      return nameValue(e);
    case ExprKind::kIndex:
      return indexValue(e);
    case ExprKind::kComponent:
      return componentValue(e);
    case ExprKind::kCall:
      return call(e, want);
    case ExprKind::kTuple:
      return tupleValue(e, typeOf(e, want));
    case ExprKind::kCast:
      return castValue(e);
    case ExprKind::kUnary:
      return unaryValue(e, want);
    case ExprKind::kBinary:
      return binaryValue(e, want);
    case ExprKind::kTernary:
      return ternaryValue(e, want);
    case ExprKind::kAssign:
      return assignValue(e);
    case ExprKind::kList:
      error(e.place, "'{' can only follow '=' in the declaration of an array");
      return {};
  }
  return {};
}

Value Lower::converted(const Expr& e, SlType type) {
  Value v = expression(e, {type, true});
  return convert(v, type, e.place);
}

Value Lower::convert(Value v, SlType type, const SourcePlace& place, bool explicitCast) {
  if (!v.ok() || v.type == type || type == SlType::kVoid) return v;
  at(place);
  if (isTriple(v.type) && isTriple(type)) {
    if (!explicitCast && (v.type == SlType::kColor || type == SlType::kColor))
      warn(place, fmt::format("a {} is used as a {}", slTypeName(v.type), slTypeName(type)));
    return {v.symbol, type};
  }
  if (v.type == SlType::kFloat && isTriple(type)) return {b_.result(Op::splat_t, type, {v.symbol}), type};
  if (v.type == SlType::kFloat && type == SlType::kMatrix)
    return {b_.result(Op::diagonal_m, type, {v.symbol}), type};
  std::string hint;
  if (isTriple(v.type) && type == SlType::kFloat)
    hint = v.type == SlType::kColor ? "take one component with comp(c, 0), or length() or a dot product"
                                    : "take one component with xcomp(), or length()";
  if (v.type == SlType::kVoid) {
    error(place, "this function has no value");
  } else {
    error(place, fmt::format("cannot turn a {} into a {}", slTypeName(v.type), slTypeName(type)), hint);
  }
  return {};
}

Value Lower::condition(const Expr& e) {
  Value v = expression(e, {SlType::kFloat, true});
  if (v.ok() && v.type != SlType::kFloat) {
    error(e.place, fmt::format("a condition must be a float, not a {}", slTypeName(v.type)),
          "compare it with something");
    return {};
  }
  return v;
}

Value Lower::nameValue(const Expr& e) {
  Binding* b = find(e.text, e.place);
  if (!b) {
    unknownVariable(e);
    return {};
  }
  if (!useGlobal(*b, e.place, false)) return {};
  if (b->isArray) {
    error(e.place, fmt::format("'{}' is an array", e.text),
          "write which element is meant: " + e.text + "[i]");
    return {};
  }
  if (b->isLocal && !b->isWritten && !b->isRead)
    warn(e.place, fmt::format("'{}' is used before it has a value", e.text), "", Lint::kCommon);
  const Value v{read(*b), b->type};
  return changedByFunctions_.count(e.text) ? kept(v) : v;
}

/// An extension that later shaders use: `(a + b)[1]`, `Ci[0]`. RSL 3.2 has comp() alone.
Value Lower::componentValue(const Expr& e) {
  Value v = expression(*e.args[0], {SlType::kColor, false});
  Value index = converted(*e.args[1], SlType::kFloat);
  if (!v.ok() || !index.ok()) return {};
  if (!isTriple(v.type)) {
    error(e.place, fmt::format("a {} has no components", slTypeName(v.type)));
    return {};
  }
  at(e.place);
  return {b_.result(Op::comp_t, SlType::kFloat, {v.symbol, index.symbol}), SlType::kFloat};
}

Value Lower::indexValue(const Expr& e) {
  Binding* b = find(e.text, e.place);
  if (!b) {
    unknownVariable(e);
    return {};
  }
  if (!useGlobal(*b, e.place, false)) return {};
  Value index = converted(*e.args[0], SlType::kFloat);
  if (!index.ok()) return {};
  at(e.place);
  if (!b->isArray && isTriple(b->type))
    return {b_.result(Op::comp_t, SlType::kFloat, {read(*b), index.symbol}), SlType::kFloat};
  if (!b->isArray) {
    error(e.place, fmt::format("'{}' is not an array", e.text),
          b->type == SlType::kMatrix ? "elements of a matrix are comp(m, row, column)" : "");
    return {};
  }
  if (b_.isConstant(index.symbol)) {
    const float i = b_.constantValue(index.symbol)[0];
    const uint32_t n = b_.symbol(b->symbol).arrayLength;
    if (i < 0 || i >= float(n))
      error(e.place, fmt::format("index {} is outside of '{}', which has {} elements", i, e.text, n));
  }
  const Op op = b->type == SlType::kFloat    ? Op::load_f
                : isTriple(b->type)          ? Op::load_t
                : b->type == SlType::kMatrix ? Op::load_m
                                             : Op::load_s;
  return {b_.result(op, b->type, {read(*b), index.symbol}), b->type};
}

Value Lower::tupleValue(const Expr& e, SlType type) {
  std::vector<uint32_t> parts;
  for (const Expr* a : e.args) {
    Value v = converted(*a, SlType::kFloat);
    if (!v.ok()) return {};
    parts.push_back(v.symbol);
  }
  at(e.place);
  if (e.args.size() == 16) return {b_.result(Op::make_m, SlType::kMatrix, parts), SlType::kMatrix};
  if (!isTriple(type)) type = SlType::kVector;
  return {b_.result(Op::make_t, type, parts), type};
}

/// Numbers that are meant in `space` become what they are in "current" (colors: "rgb").
Value Lower::toCurrent(SlType type, uint32_t space, Value v) {
  if (!v.ok()) return v;
  if (type == SlType::kColor) {
    if (b_.symbol(space).data == b_.text("rgb")) return v;
    return {b_.result(Op::ctransform, type, {space, b_.constantString("rgb"), v.symbol}), type};
  }
  const uint32_t current = b_.constantString("current");
  if (space == current) return v;
  if (type == SlType::kMatrix) {
    // The matrix takes points of `space` somewhere: come from current first.
    const uint32_t m = b_.result(Op::space_m, type, {current, space});
    return {b_.result(Op::mul_m, type, {m, v.symbol}), type};
  }
  const Op op = type == SlType::kPoint    ? Op::transform_p
                : type == SlType::kNormal ? Op::transform_n
                                          : Op::transform_v;
  return {b_.result(op, type, {space, current, v.symbol}), type};
}

Value Lower::castValue(const Expr& e) {
  const Expr& inner = *e.args[0];
  if (e.hasSpace && !isTriple(e.type) && e.type != SlType::kMatrix) {
    error(e.place, fmt::format("a {} has no coordinate or color space", slTypeName(e.type)));
    return {};
  }
  Value v;
  if (inner.kind == ExprKind::kTuple && inner.args.size() == 3 && isTriple(e.type)) {
    v = tupleValue(inner, e.type);
  } else {
    v = expression(inner, {e.type, true});
    // A cast may take one component's worth out of a color: the mean.
    if (v.ok() && v.type == SlType::kColor && e.type == SlType::kFloat) {
      at(e.place);
      v = {b_.result(Op::average_t, SlType::kFloat, {v.symbol}), SlType::kFloat};
    }
    v = convert(v, e.type, inner.place, true);
  }
  if (!v.ok()) return {};
  at(e.place);
  v.type = e.type;
  return e.hasSpace ? toCurrent(e.type, b_.constantString(e.text), v) : v;
}

Value Lower::unaryValue(const Expr& e, Want want) {
  Value v = e.text == "!" ? condition(*e.args[0]) : expression(*e.args[0], want);
  if (!v.ok()) return {};
  at(e.place);
  if (e.text == "!") return {b_.result(Op::not_f, SlType::kFloat, {v.symbol}), SlType::kFloat};
  if (v.type == SlType::kFloat) return {b_.result(Op::neg_f, v.type, {v.symbol}), v.type};
  if (isTriple(v.type)) return {b_.result(Op::neg_t, v.type, {v.symbol}), v.type};
  error(e.place, fmt::format("'-' does not work on a {}", slTypeName(v.type)));
  return {};
}

Value Lower::binaryValue(const Expr& e, Want want) {
  const std::string& op = e.text;
  if (op == "&&" || op == "||") {
    Value a = condition(*e.args[0]);
    const size_t start = b_.program.code.size();
    Value b = condition(*e.args[1]);
    if (!a.ok() || !b.ok()) return {};
    at(e.place);
    auto& code = b_.program.code;
    const bool effects = std::any_of(code.begin() + long(start), code.end(), [](const Instruction& in) {
      const uint32_t flags = opInfo(in.op).flags;
      return !(flags & (kOpPure | kOpTexture));
    });
    if (effects) {
      // As in C: only points that the left side has not decided evaluate the right side. What has no effects
      // is cheaper for all.
      const std::vector<Instruction> right(code.begin() + long(start), code.end());
      code.resize(start);
      const uint32_t result = b_.local("?", SlType::kFloat);
      const uint32_t decided =
          b_.result(op == "&&" ? Op::ne_f : Op::eq_f, SlType::kFloat, {a.symbol, b_.constantFloat(0)});
      b_.assign(result, b_.constantFloat(op == "&&" ? 0.0f : 1.0f));
      b_.emit(Op::if_begin, {decided});
      code.insert(code.end(), right.begin(), right.end());
      b_.assign(result, b_.result(Op::ne_f, SlType::kFloat, {b.symbol, b_.constantFloat(0)}));
      b_.emit(Op::if_end, {});
      return {result, SlType::kFloat};
    }
    return {b_.result(op == "&&" ? Op::and_f : Op::or_f, SlType::kFloat, {a.symbol, b.symbol}),
            SlType::kFloat};
  }
  const auto [wantA, wantB] = operandTypes(e, want);
  const bool comparison = op != "+" && op != "-" && op != "*" && op != "/" && op != "." && op != "^";
  const bool ordered = op == "<" || op == "<=" || op == ">" || op == ">=";  // of floats alone
  const auto wanted = [&](const Expr& side, SlType natural) {
    if (side.kind == ExprKind::kTuple) return Want{natural, true};
    if (ordered) return Want{SlType::kFloat, false};
    return Want{comparison || op == "." || op == "^" ? SlType::kVoid : want.type, false};
  };
  Value a = expression(*e.args[0], wanted(*e.args[0], wantA));
  Value b = expression(*e.args[1], wanted(*e.args[1], wantB));
  if (!a.ok() || !b.ok()) return {};
  return arithmetic(op, a, b, combine(e, a.type, b.type), e.place);
}

Value Lower::arithmetic(const std::string& op, Value a, Value b, SlType type, const SourcePlace& place) {
  at(place);
  const auto wrong = [&]() -> Value {
    error(place,
          fmt::format("'{}' does not work on a {} and a {}", op, slTypeName(a.type), slTypeName(b.type)),
          type == SlType::kString && op == "+" ? "join strings with concat()" : "");
    return {};
  };
  const bool stringA = a.type == SlType::kString, stringB = b.type == SlType::kString;
  if (a.type == SlType::kVoid || b.type == SlType::kVoid) {
    error(place, "this function has no value");
    return {};
  }
  const bool equality = op == "==" || op == "!=";
  if (equality) {
    const bool eq = op == "==";
    if (stringA != stringB) return wrong();
    if (stringA)
      return {b_.result(eq ? Op::eq_s : Op::ne_s, SlType::kFloat, {a.symbol, b.symbol}), SlType::kFloat};
    if (a.type == SlType::kFloat && b.type == SlType::kFloat)
      return {b_.result(eq ? Op::eq_f : Op::ne_f, SlType::kFloat, {a.symbol, b.symbol}), SlType::kFloat};
    if ((a.type == SlType::kMatrix && isTriple(b.type)) || (b.type == SlType::kMatrix && isTriple(a.type)))
      return wrong();
    a = convert(a, type, place, true);
    b = convert(b, type, place, true);
    if (!a.ok() || !b.ok()) return {};
    const Op o = type == SlType::kMatrix ? (eq ? Op::eq_m : Op::ne_m) : (eq ? Op::eq_t : Op::ne_t);
    return {b_.result(o, SlType::kFloat, {a.symbol, b.symbol}), SlType::kFloat};
  }
  if (stringA || stringB) return wrong();
  if (op[0] == '<' || op[0] == '>') {
    if (a.type != SlType::kFloat || b.type != SlType::kFloat) return wrong();
    const Op o = op == "<" ? Op::lt_f : op == "<=" ? Op::le_f : op == ">" ? Op::gt_f : Op::ge_f;
    return {b_.result(o, SlType::kFloat, {a.symbol, b.symbol}), SlType::kFloat};
  }
  if (op == "." || op == "^") {
    if (a.type == SlType::kMatrix || b.type == SlType::kMatrix) return wrong();
    if (a.type == SlType::kFloat && b.type == SlType::kFloat) {
      error(place, fmt::format("'{}' needs a vector on each side", op),
            op == "." ? "" : "a power is pow(x, y)");
      return {};
    }
    if (a.type == SlType::kFloat) a = convert(a, SlType::kVector, place);
    if (b.type == SlType::kFloat) b = convert(b, SlType::kVector, place);
    if (op == ".") return {b_.result(Op::dot, SlType::kFloat, {a.symbol, b.symbol}), SlType::kFloat};
    return {b_.result(Op::cross, SlType::kVector, {a.symbol, b.symbol}), SlType::kVector};
  }
  const char c = op[0];
  if (type == SlType::kMatrix) {
    if ((c != '*' && c != '/') || isTriple(a.type) || isTriple(b.type)) {
      error(place,
            fmt::format("'{}' does not work on a {} and a {}", op, slTypeName(a.type), slTypeName(b.type)),
            isTriple(a.type) || isTriple(b.type) ? "use transform(m, p)" : "");
      return {};
    }
    if (c == '/' && a.type == SlType::kFloat && b_.isConstant(a.symbol) && b_.constantValue(a.symbol)[0] == 1)
      return {b_.result(Op::inverse_m, type, {b.symbol}), type};
    a = convert(a, type, place);
    b = convert(b, type, place);
    return {b_.result(c == '*' ? Op::mul_m : Op::div_m, type, {a.symbol, b.symbol}), type};
  }
  if (type == SlType::kFloat) {
    const Op o = c == '+' ? Op::add_f : c == '-' ? Op::sub_f : c == '*' ? Op::mul_f : Op::div_f;
    return {b_.result(o, type, {a.symbol, b.symbol}), type};
  }
  if (c == '*' && a.type == SlType::kFloat) std::swap(a, b);
  if ((c == '*' || c == '/') && b.type == SlType::kFloat)
    return {b_.result(c == '*' ? Op::mul_tf : Op::div_tf, type, {a.symbol, b.symbol}), type};
  if (a.type == SlType::kFloat) a = convert(a, type, place);
  if (b.type == SlType::kFloat) b = convert(b, type, place);
  const Op o = c == '+' ? Op::add_t : c == '-' ? Op::sub_t : c == '*' ? Op::mul_t : Op::div_t;
  return {b_.result(o, type, {a.symbol, b.symbol}), type};
}

Value Lower::ternaryValue(const Expr& e, Want want) {
  Value c = condition(*e.args[0]);
  SlType type = typeOf(e, want);
  if (!c.ok() || type == SlType::kVoid) {
    expression(*e.args[1], want);
    expression(*e.args[2], want);
    return {};
  }
  const size_t start = b_.program.code.size();
  Value yes = converted(*e.args[1], type);
  const size_t middle = b_.program.code.size();
  Value no = converted(*e.args[2], type);
  if (!yes.ok() || !no.ok()) return {};
  at(e.place);
  const bool cheap = [&] {
    for (size_t i = start; i < b_.program.code.size(); ++i) {
      const OpInfo& info = opInfo(b_.program.code[i].op);
      if (!(info.flags & kOpPure) || info.cost > Cost::kMath) return false;
    }
    return true;
  }();
  if (cheap) {
    const Op op = type == SlType::kFloat    ? Op::select_f
                  : isTriple(type)          ? Op::select_t
                  : type == SlType::kMatrix ? Op::select_m
                                            : Op::select_s;
    return {b_.result(op, type, {c.symbol, yes.symbol, no.symbol}), type};
  }
  // A branch with effects or a high price runs only for the points that want it.
  const uint32_t result = b_.local("?", type);
  auto& code = b_.program.code;
  std::vector<Instruction> yesCode(code.begin() + long(start), code.begin() + long(middle));
  std::vector<Instruction> noCode(code.begin() + long(middle), code.end());
  code.resize(start);
  b_.emit(Op::if_begin, {c.symbol});
  code.insert(code.end(), yesCode.begin(), yesCode.end());
  b_.assign(result, yes.symbol);
  b_.emit(Op::if_else, {});
  code.insert(code.end(), noCode.begin(), noCode.end());
  b_.assign(result, no.symbol);
  b_.emit(Op::if_end, {});
  return {result, type};
}

void Lower::store(const Expr& target, Binding& b, Value index, Value v) {
  at(target.place);
  if (target.kind == ExprKind::kName) {
    b_.assign(b.symbol, v.symbol);
    return;
  }
  if (!b.isArray) {
    b_.emit(Op::setcomp_t, {b.symbol, index.symbol, v.symbol});
    return;
  }
  const Op op = b.type == SlType::kFloat    ? Op::store_f
                : isTriple(b.type)          ? Op::store_t
                : b.type == SlType::kMatrix ? Op::store_m
                                            : Op::store_s;
  b_.emit(op, {b.symbol, index.symbol, v.symbol});
}

namespace {
/// Points are places; vectors and normals are directions.
bool isPlace(SlType t) { return t == SlType::kPoint; }
}  // namespace

Value Lower::assignValue(const Expr& e) {
  const Expr& target = *e.args[0];
  const Binding* const before = findFrom(scope_, target.text, nullptr);
  const bool written = before && before->isWritten;
  Binding* b = writable(target);
  if (b && target.kind == ExprKind::kName && b->isArray) {
    error(target.place, fmt::format("'{}' is an array: it cannot be assigned as a whole", target.text));
    b = nullptr;
  }
  const bool component = b && target.kind == ExprKind::kIndex && !b->isArray && isTriple(b->type);
  if (b && target.kind == ExprKind::kIndex && !b->isArray && !component) {
    error(target.place, fmt::format("'{}' is not an array", target.text),
          b->type == SlType::kMatrix ? "use setcomp(m, row, column, value)" : "");
    b = nullptr;
  }
  const SlType type = component ? SlType::kFloat : b ? b->type : SlType::kVoid;
  Value index;
  if (target.kind == ExprKind::kIndex) index = converted(*target.args[0], SlType::kFloat);
  if (b) b->isWritten = written;  // not yet: x = x + 1 reads what nobody has set
  if (b && e.text != "=" && target.kind == ExprKind::kName && b->isLocal && !b->isWritten && !b->isRead)
    warn(target.place, fmt::format("'{}' is used before it has a value", target.text), "", Lint::kCommon);
  Value v = expression(*e.args[1], {type, e.text == "="});
  if (b) b->isWritten = true;
  if (b && b->type != v.type && isPlace(b->type) != isPlace(v.type) && isTriple(b->type) &&
      isTriple(v.type) && b->type != SlType::kColor && v.type != SlType::kColor && e.text == "=")
    warn(e.args[1]->place, fmt::format("a {} is assigned to a {}", slTypeName(v.type), slTypeName(b->type)),
         "they are moved and turned differently by transform()");
  if (!b || !v.ok() || (target.kind == ExprKind::kIndex && !index.ok())) return {};
  if (target.kind == ExprKind::kIndex && b_.isConstant(index.symbol)) {
    const float i = b_.constantValue(index.symbol)[0];
    const uint32_t n = component ? 3 : b_.symbol(b->symbol).arrayLength;
    if (i < 0 || i >= float(n))
      error(target.place,
            fmt::format("index {} is outside of '{}', which has {} elements", i, target.text, n));
  }
  if (e.text != "=") {
    Value old{b->symbol, type};
    if (target.kind == ExprKind::kIndex) old = indexValue(target);
    if (!old.ok()) return {};
    Expr shape;
    shape.text = e.text.substr(0, 1);
    v = arithmetic(shape.text, old, v, combine(shape, type, v.type), e.place);
  }
  // point - point and the like give other triples: within arithmetic that is no misuse.
  v = convert(v, type, e.args[1]->place);
  if (!v.ok()) return {};
  store(target, *b, index, v);
  return {target.kind == ExprKind::kName ? b->symbol : v.symbol, type};
}

}  // namespace fr
