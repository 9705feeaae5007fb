// Calls of functions in shared objects.
#include "shading/lower.h"

namespace fr {

using ast::ExprKind;

const std::vector<const Shadeop*>& Lower::shadeops(const std::string& name) {
  auto [it, fresh] = shadeops_.try_emplace(name);
  if (fresh && in_.shadeopPaths && !in_.shadeopPaths->empty()) {
    Result<std::span<const Shadeop* const>> found = findShadeops(name, *in_.shadeopPaths);
    if (found)
      it->second.overloads.assign(found->begin(), found->end());
    else
      it->second.error = found.error().message;
  }
  return it->second.overloads;
}

/// Price of taking `s` for the call: exact types are free, the conversions of the language cost.
int Lower::shadeopCost(const ShadeopSpec& s, const Expr& e, Want want) {
  constexpr int kImpossible = 1 << 20;
  if (s.arguments.size() != e.args.size()) return kImpossible;
  int cost = 0;
  for (size_t i = 0; i < e.args.size(); ++i) {
    const ShadeopArgument& a = s.arguments[i];
    const Expr& arg = *e.args[i];
    SlType element;
    if (isArrayName(arg, &element) != a.isArray) return kImpossible;
    if (a.isArray) {
      if (element != a.type) return kImpossible;
      const Binding* b = findFrom(scope_, arg.text, nullptr);
      if (a.arrayLength && b->symbol != kNoIndex && b_.symbol(b->symbol).arrayLength != a.arrayLength)
        return kImpossible;
      continue;
    }
    const SlType t = typeOf(arg, {a.type, true});
    if (a.output) {
      if (arg.kind != ExprKind::kName && arg.kind != ExprKind::kIndex) return kImpossible;
      if (t != a.type && !(isTriple(t) && isTriple(a.type)) && t != SlType::kVoid) return kImpossible;
    }
    const int price = conversionCost(t, a.type);
    if (price >= kImpossible) return kImpossible;
    cost += price;
  }
  cost *= 16;
  if (want.type != SlType::kVoid) cost += std::min(conversionCost(s.result, want.type), 8);
  return cost;
}

/// A local variable or output parameter that may be written, of exactly this kind.
bool Lower::isPlainVariable(const Expr& e, SlType type) {
  if (e.kind != ExprKind::kName) return false;
  const Binding* b = findFrom(scope_, e.text, nullptr);
  if (!b || b->isGlobal || b->readOnly || b->symbol == kNoIndex) return false;
  const Storage storage = b_.symbol(b->symbol).storage;
  return (storage == Storage::kLocal || storage == Storage::kOutputParameter) && b->type == type;
}

Value Lower::shadeopCall(const Shadeop& op, const Expr& e) {
  const ShadeopSpec& s = op.spec;
  std::vector<std::pair<uint32_t, const Expr*>> outputs;
  std::vector<uint32_t> operands{kNoIndex, b_.constantString(op.path), b_.constantString(op.name),
                                 b_.constantString(op.text)};
  for (size_t i = 0; i < e.args.size(); ++i) {
    const ShadeopArgument& a = s.arguments[i];
    const Expr& arg = *e.args[i];
    uint32_t operand = kNoIndex;
    if (a.output) {
      operand = variableOperand(arg, outputs);
      if (operand != kNoIndex) operand |= kArgWritten;
    } else if (a.isArray) {
      Binding* b = find(arg.text, arg.place);
      if (!useGlobal(*b, arg.place, false)) return {};
      operand = read(*b);
      // Without `output` in the table every argument is a pointer that may have been written through.
      if (!s.marksOutputs && isPlainVariable(arg, a.type)) operand |= kArgWritten;
    } else if (!s.marksOutputs && isPlainVariable(arg, a.type)) {
      Binding* b = find(arg.text, arg.place);
      b->isWritten = true;
      operand = read(*b) | kArgWritten;
    } else {
      Value v = converted(arg, a.type);
      if (!v.ok()) return {};
      operand = v.symbol;
    }
    if (operand == kNoIndex) return {};
    operands.push_back(b_.constantString(slTypeName(a.type)));
    operands.push_back(operand);
  }
  at(e.place);
  operands[0] = b_.temp(s.result == SlType::kVoid ? SlType::kFloat : s.result);
  b_.emit(Op::dso_call, operands);
  storeOutputs(outputs);
  if (s.result == SlType::kVoid) return {b_.constantFloat(0), SlType::kVoid};
  return {operands[0], s.result};
}

}  // namespace fr
