// Types of expressions and the choice among overloads: nothing is emitted here.
#include "shading/lower.h"

namespace fr {

using ast::ExprKind;

namespace {

constexpr int kImpossible = 1 << 20;

SlType letterType(char c) {
  switch (c) {
    case 'm':
      return SlType::kMatrix;
    case 's':
      return SlType::kString;
    case 'c':
      return SlType::kColor;
    case 'p':
      return SlType::kPoint;
    case 'v':
      return SlType::kVector;
    case 'n':
      return SlType::kNormal;
    case 'x':
      return SlType::kVoid;
    default:
      return SlType::kFloat;
  }
}

bool isComparison(const std::string& op) {
  return op == "==" || op == "!=" || op == "<" || op == ">" || op == "<=" || op == ">=";
}

uint16_t wantKey(Want w) { return uint16_t(unsigned(w.type) * 2 + (w.direct ? 1 : 0)); }

}  // namespace

int Lower::conversionCost(SlType from, SlType to) const {
  if (from == to || from == SlType::kVoid) return 0;  // void: an error that was or will be reported
  if (isTriple(from) && isTriple(to)) return from == SlType::kColor || to == SlType::kColor ? 4 : 1;
  if (from == SlType::kFloat && isTriple(to)) return 3;
  if (from == SlType::kFloat && to == SlType::kMatrix) return 5;
  return kImpossible;
}

bool Lower::isArrayName(const Expr& e, SlType* elementType) {
  if (e.kind != ExprKind::kName) return false;
  Binding* b = findFrom(scope_, e.text, nullptr);
  if (!b || !b->isArray) return false;
  if (elementType) *elementType = b->type;
  return true;
}

SlType Lower::typeOf(const Expr& e, Want want) {
  auto& memo = types_[&e];
  for (const auto& [key, type] : memo)
    if (key == wantKey(want)) return type;
  const SlType t = computeType(e, want);
  types_[&e].emplace_back(wantKey(want), t);
  return t;
}

SlType Lower::computeType(const Expr& e, Want want) {
  switch (e.kind) {
    case ExprKind::kNumber:
      return SlType::kFloat;
    case ExprKind::kString:
      return SlType::kString;
    case ExprKind::kName:
    case ExprKind::kIndex: {
      Binding* b = findFrom(scope_, e.text, nullptr);
      if (b && e.kind == ExprKind::kIndex && !b->isArray && isTriple(b->type)) return SlType::kFloat;
      return b ? b->type : SlType::kVoid;
    }
    case ExprKind::kComponent:
      return SlType::kFloat;
    case ExprKind::kCall:
      return resolve(e, want).result;
    case ExprKind::kTuple:
      if (e.args.size() == 16) return SlType::kMatrix;
      return isTriple(want.type) ? want.type : SlType::kVector;
    case ExprKind::kCast:
      return e.type;
    case ExprKind::kUnary:
      return e.text == "!" ? SlType::kFloat : typeOf(*e.args[0], want);
    case ExprKind::kBinary: {
      if (e.text == "&&" || e.text == "||" || e.text == "." || isComparison(e.text)) return SlType::kFloat;
      if (e.text == "^") return SlType::kVector;
      const auto [a, b] = operandTypes(e, want);
      return combine(e, a, b);
    }
    case ExprKind::kTernary: {
      const SlType a = typeOf(*e.args[1], want), b = typeOf(*e.args[2], want);
      return a == SlType::kFloat || a == SlType::kVoid ? b : a;
    }
    case ExprKind::kAssign:
      return typeOf(*e.args[0]);
    case ExprKind::kList:
      return SlType::kVoid;
  }
  return SlType::kVoid;
}

/// Types of the two operands of a binary operator.
std::pair<SlType, SlType> Lower::operandTypes(const Expr& e, Want want) {
  const Want inner{isComparison(e.text) || e.text == "&&" || e.text == "||" ? SlType::kVoid : want.type,
                   false};
  SlType a = typeOf(*e.args[0], inner), b = typeOf(*e.args[1], inner);
  // A bare (x, y, z) is what the other side is.
  const bool tupleA = e.args[0]->kind == ExprKind::kTuple, tupleB = e.args[1]->kind == ExprKind::kTuple;
  if (tupleA && !tupleB && isTriple(b)) a = b;
  if (tupleB && !tupleA && isTriple(a)) b = a;
  return {a, b};
}

SlType Lower::combine(const Expr& e, SlType a, SlType b) {
  if (a == SlType::kVoid) return b;
  if (b == SlType::kVoid) return a;
  if (a == SlType::kMatrix || b == SlType::kMatrix) return SlType::kMatrix;
  if (a == SlType::kFloat) return b;
  if (b == SlType::kFloat) return a;
  if (a == SlType::kColor || b == SlType::kColor) return SlType::kColor;
  if (a == SlType::kPoint || b == SlType::kPoint) {
    if (e.text == "-" && a == b) return SlType::kVector;
    return SlType::kPoint;
  }
  return a == b ? a : SlType::kVector;
}

/// Price of taking `b` for the call; kImpossible when the arguments do not fit. `result`: the type it
/// returns.
int Lower::builtinCost(const Builtin& b, const Expr& e, Want want, SlType& result) {
  if (want.type != SlType::kVoid && !want.direct && !b.contextual) want.type = SlType::kVoid;
  int cost = 0;
  SlType tied = SlType::kVoid;
  size_t a = 0;
  const char* spec = b.arguments.data();
  const char* end = spec + b.arguments.size();
  const size_t count = e.args.size();
  while (spec != end) {
    const char c = *spec;
    if (c == '.') {
      a = count;
      break;
    }
    if (c == '*') {
      if ((count - a) % 2) return kImpossible;
      for (; a < count; a += 2)
        if (typeOf(*e.args[a]) != SlType::kString && typeOf(*e.args[a]) != SlType::kVoid) return kImpossible;
      break;
    }
    const bool repeat = spec + 1 != end && spec[1] == '+';
    do {
      if (a >= count) {
        if (repeat) break;
        return kImpossible;
      }
      const Expr& arg = *e.args[a++];
      SlType element;
      const bool array = isArrayName(arg, &element);
      if (c == 'a' || c == 'A') {
        if (!array || (element == SlType::kFloat) != (c == 'a')) return kImpossible;
        continue;
      }
      if (c == '!' || c == 'o' || c == 'O') {
        if (arg.kind != ExprKind::kName && arg.kind != ExprKind::kIndex) return kImpossible;
        const SlType t = typeOf(arg);
        if (c != '!' && array) return kImpossible;
        if (c == 'o' && t != SlType::kFloat && t != SlType::kVoid) return kImpossible;
        if (c == 'O' && !isTriple(t) && t != SlType::kVoid) return kImpossible;
        continue;
      }
      if (c == '?') continue;
      if (array) return kImpossible;
      if (c == 't' || c == 'T') {
        const SlType t = typeOf(arg, {c == 'T' ? want.type : SlType::kVoid, true});
        if (t == SlType::kMatrix || t == SlType::kString) return kImpossible;
        if (t == SlType::kFloat) cost += 3;
        if (c == 'T' && isTriple(t) && tied == SlType::kVoid) tied = t;
        continue;
      }
      const SlType to = letterType(c);
      const int price = conversionCost(typeOf(arg, {to, true}), to);
      if (price >= kImpossible) return kImpossible;
      cost += price;
    } while (repeat);
    spec += repeat ? 2 : 1;
  }
  if (a != count) return kImpossible;
  const char r = b.result[0];
  if (r == 't') {
    result = isTriple(want.type) ? want.type : SlType::kColor;
  } else if (r == 'T') {
    result = tied != SlType::kVoid ? tied : isTriple(want.type) ? want.type : SlType::kColor;
  } else {
    result = letterType(r);
  }
  cost *= 16;
  if (want.type != SlType::kVoid && result != SlType::kVoid) {
    const int price = conversionCost(result, want.type);
    cost += price >= kImpossible ? 8 : price;
  }
  return cost;
}

int Lower::userCost(const ast::Function& f, const Expr& e, Want want) {
  if (f.formals.size() != e.args.size()) return kImpossible;
  int cost = 0;
  for (size_t i = 0; i < e.args.size(); ++i) {
    const ast::Variable& formal = f.formals[i];
    const Expr& arg = *e.args[i];
    SlType element;
    if (isArrayName(arg, &element) != formal.isArray) return kImpossible;
    if (formal.isArray) {
      if (element != formal.type) return kImpossible;
      continue;
    }
    const SlType t = typeOf(arg, {formal.type, true});
    if (formal.output) {
      if (arg.kind != ExprKind::kName && arg.kind != ExprKind::kIndex) return kImpossible;
      if (t != formal.type && !(isTriple(t) && isTriple(formal.type)) && t != SlType::kVoid)
        return kImpossible;
    }
    const int price = conversionCost(t, formal.type);
    if (price >= kImpossible) return kImpossible;
    cost += price;
  }
  cost *= 16;
  if (want.type != SlType::kVoid) cost += std::min(conversionCost(f.result, want.type), 8);
  return cost;
}

/// texture(maps[1], ...) is channel 1 of a file, unless `maps` is an array: only now is that known.
void Lower::channelOrElement(const Expr& call) {
  if (!call.channel || !isArrayName(*call.args[0], nullptr)) return;
  auto& changed = const_cast<Expr&>(call);
  Expr& name = *changed.args[0];
  name.kind = ExprKind::kIndex;
  name.args = {changed.args[1]};
  changed.args.erase(changed.args.begin() + 1);
  changed.channel = false;
}

Call Lower::resolve(const Expr& e, Want want) {
  channelOrElement(e);
  for (const auto& [key, call] : calls_[&e])
    if (key == wantKey(want)) return call;
  Call best;
  int bestCost = kImpossible;
  for (Scope* s = scope_; s && bestCost >= kImpossible; s = s->parent) {
    auto it = s->functions.find(e.text);
    if (it == s->functions.end()) continue;
    // The user's functions stand behind the prelude's of the same name, and win.
    for (size_t i = it->second.size(); i-- > 0;) {
      const FunctionDef& def = it->second[i];
      int cost = userCost(*def.function, e, want);
      if (cost < bestCost) {
        bestCost = cost;
        best = {Call::Kind::kUser, nullptr, def, def.function->result};
      }
    }
  }
  if (best.kind == Call::Kind::kNone) {
    for (const Builtin& b : findBuiltins(e.text)) {
      SlType result = SlType::kVoid;
      const int cost = builtinCost(b, e, want, result);
      if (cost < bestCost) {
        bestCost = cost;
        best = {Call::Kind::kBuiltin, &b, {}, result};
      }
    }
  }
  if (best.kind == Call::Kind::kNone) {
    for (const Shadeop* op : shadeops(e.text)) {
      const int cost = shadeopCost(op->spec, e, want);
      if (cost < bestCost) {
        bestCost = cost;
        best = {Call::Kind::kShadeop, nullptr, {}, op->spec.result, op};
      }
    }
  }
  calls_[&e].emplace_back(wantKey(want), best);
  return best;
}

std::string Lower::callText(const Expr& e) {
  std::string r = e.text + "(";
  for (size_t i = 0; i < e.args.size(); ++i) {
    SlType t;
    if (i) r += ", ";
    if (isArrayName(*e.args[i], &t)) {
      r += fmt::format("{}[]", slTypeName(t));
    } else {
      t = typeOf(*e.args[i]);
      r += t == SlType::kVoid ? "?" : slTypeName(t);
    }
  }
  return r + ")";
}

}  // namespace fr
