// Calls of built-in functions.
#include "shading/lower.h"

namespace fr {

using ast::ExprKind;

namespace {

using Outputs = std::vector<std::pair<uint32_t, const ast::Expr*>>;

/// Optional parameters that a call writes, by operation. Message-like loops write all but their inputs.
bool isOutputPair(Op op, std::string_view name) {
  const auto any = [&](std::initializer_list<std::string_view> words) {
    for (std::string_view w : words)
      if (name == w) return true;
    return false;
  };
  switch (op) {
    case Op::illuminance_begin:
    case Op::illuminance_cone_begin:
      return name.starts_with("light:");
    case Op::gather_begin:
      return name.find(':') != std::string_view::npos ? !name.starts_with("send:")
                                                      : name == "effectivesamples";
    case Op::trace_t:
    case Op::trace_f:
      return name == "transmission";
    case Op::occlusion:
    case Op::indirectdiffuse:
      return any({"environmentdir", "environmentcolor", "occlusion", "irradiance"});
    case Op::texture3d:
      return !any({"filterradius", "filterscale", "coordsystem", "maxdepth", "lerp", "filter", "radius"});
    default:
      return false;
  }
}

}  // namespace

Value Lower::call(const Expr& e, Want want) {
  Call c = resolve(e, want);
  if (c.kind == Call::Kind::kUser) {
    // The scope of a nested function is that of the current expansion of its surroundings.
    for (Scope* s = scope_; s; s = s->parent) {
      auto it = s->functions.find(e.text);
      if (it == s->functions.end()) continue;
      for (const FunctionDef& d : it->second)
        if (d.function == c.user.function) return userCall(d, e, c.result);
    }
  }
  if (c.kind == Call::Kind::kBuiltin) return builtinCall(*c.builtin, e, c.result);
  if (c.kind == Call::Kind::kShadeop) return shadeopCall(*c.shadeop, e);

  // Nothing fits: say why.
  bool userKnown = false;
  for (Scope* s = scope_; s; s = s->parent) userKnown = userKnown || s->functions.count(e.text);
  const auto builtins = findBuiltins(e.text);
  bool argumentsBroken = false;
  for (const Expr* a : e.args)
    if (!isArrayName(*a, nullptr) && typeOf(*a) == SlType::kVoid) argumentsBroken = true;
  if (argumentsBroken || !(userKnown || !builtins.empty())) {
    const size_t before = in_.diagnostics->errorCount();
    for (const Expr* a : e.args)
      if (!isArrayName(*a, nullptr)) expression(*a);
    const bool said = in_.diagnostics->errorCount() != before || !unknown_.empty();
    if (said && (userKnown || !builtins.empty())) return {};
  }
  if (userKnown || !builtins.empty()) {
    std::string hint;
    for (Scope* s = scope_; s && userKnown && hint.empty(); s = s->parent) {
      auto it = s->functions.find(e.text);
      if (it == s->functions.end()) continue;
      const ast::Function& f = *it->second.back().function;
      hint = fmt::format("it is {}(", f.name);
      for (size_t i = 0; i < f.formals.size(); ++i)
        hint += fmt::format("{}{}{}{}", i ? ", " : "", f.formals[i].output ? "output " : "",
                            slTypeName(f.formals[i].type), f.formals[i].isArray ? "[]" : "");
      hint += ")";
    }
    error(e.place, fmt::format("no version of '{}' takes these arguments: {}", e.text, callText(e)), hint);
    return {};
  }
  if (const std::vector<const Shadeop*>& found = shadeops(e.text); !found.empty()) {
    std::string hint = fmt::format("'{}' has", found[0]->path);
    for (const Shadeop* op : found) hint += fmt::format("{} \"{}\"", op == found[0] ? "" : ",", op->text);
    error(e.place, fmt::format("no version of '{}' takes these arguments: {}", e.text, callText(e)), hint);
    return {};
  }
  if (const std::string& why = shadeops_[e.text].error; !why.empty()) {
    error(e.place, fmt::format("'{}' cannot be called: {}", e.text, why), "", RiError::kBadFile);
    return {};
  }
  NearestWord near(e.text);
  for (const Builtin& b : allBuiltins()) near.offer(b.name);
  for (Scope* s = scope_; s; s = s->parent)
    for (const auto& [n, d] : s->functions) near.offer(n);
  error(e.place, fmt::format("unknown function '{}'", e.text), near.hint());
  return {};
}

uint32_t Lower::variableOperand(const Expr& e, Outputs& outputs) {
  if (e.kind != ExprKind::kName && e.kind != ExprKind::kIndex) {
    error(e.place, "a variable is needed here: the function writes it");
    return kNoIndex;
  }
  if (e.kind == ExprKind::kName) {
    Binding* b = writable(e);
    if (!b) return kNoIndex;
    b->isRead = true;
    return b->symbol;
  }
  Value old = indexValue(e);
  if (!old.ok() || !writable(e)) return kNoIndex;
  const uint32_t copy = b_.local("element", old.type);
  b_.assign(copy, old.symbol);
  outputs.push_back({copy, &e});
  return copy;
}

void Lower::storeOutputs(const Outputs& outputs) {
  for (const auto& [symbol, target] : outputs) {
    Binding* b = writable(*target);
    if (!b) continue;
    Value index;
    if (target->kind == ExprKind::kIndex) {
      if (!b->isArray && !isTriple(b->type)) {
        error(target->place, fmt::format("'{}' is not an array", target->text));
        continue;
      }
      index = converted(*target->args[0], SlType::kFloat);
      if (!index.ok()) continue;
    } else if (b->isArray) {
      error(target->place, fmt::format("'{}' is an array", target->text));
      continue;
    }
    store(*target, *b, index, {symbol, b->type});
  }
}

/// The optional "name", value pairs of a call from argument `first` on.
bool Lower::pairs(const Expr& e, size_t first, Op op, std::vector<uint32_t>& operands, Outputs& outputs) {
  const bool loop = (opInfo(op).flags & kOpControl) != 0;
  for (size_t i = first; i < e.args.size(); i += 2) {
    const Expr& nameExpr = *e.args[i];
    Value name = converted(nameExpr, SlType::kString);
    if (!name.ok()) return false;
    const std::string_view text =
        b_.isConstant(name.symbol) ? b_.program.strings[b_.symbol(name.symbol).data] : std::string_view();
    if (text == "source" && (op == Op::shadow_f || op == Op::shadow_t)) {
      // The corners of a light follow, up to four: each becomes a pair.
      for (int corner = 0; corner < 4 && i + 1 < e.args.size() && typeOf(*e.args[i + 1]) != SlType::kString;
           ++corner, ++i) {
        const Value v = converted(*e.args[i + 1], SlType::kPoint);
        if (!v.ok()) return false;
        operands.push_back(b_.constantString(fmt::format("source{}", corner)));
        operands.push_back(v.symbol);
      }
      --i;
      continue;
    }
    if (i + 1 == e.args.size()) {
      error(e.place, fmt::format("the optional parameters of '{}' come in pairs: \"name\", value", e.text));
      return false;
    }
    const Expr& valueExpr = *e.args[i + 1];
    uint32_t operand;
    if (!text.empty() && isOutputPair(op, text)) {
      operand = variableOperand(valueExpr, outputs);
      if (operand == kNoIndex) return false;
      operand |= kArgWritten;
    } else if (isArrayName(valueExpr, nullptr)) {
      Binding* b = find(valueExpr.text, valueExpr.place);
      if (!useGlobal(*b, valueExpr.place, false)) return false;
      operand = read(*b);
    } else {
      Value v = expression(valueExpr);
      if (!v.ok()) return false;
      if (v.type == SlType::kVoid) {
        error(valueExpr.place, "this function has no value");
        return false;
      }
      operand = loop ? kept(v).symbol : v.symbol;
    }
    operands.push_back(name.symbol);
    operands.push_back(operand);
  }
  return true;
}

/// Lowers the arguments as the signature says: inputs in order, outputs as temporaries.
bool Lower::plainInputs(const Builtin& b, const Expr& e, SlType result, std::vector<uint32_t>& inputs,
                        Outputs& outputs) {
  size_t a = 0;
  bool good = true;
  const auto input = [&](const Expr& arg, SlType type) {
    Value v = type == SlType::kVoid ? expression(arg) : converted(arg, type);
    if (v.ok()) inputs.push_back(v.symbol);
    good = good && v.ok();
  };
  for (size_t k = 0; k < b.arguments.size(); ++k) {
    const char c = b.arguments[k];
    if (c == '*') return pairs(e, a, b.op, inputs, outputs) && good;
    const bool repeat = k + 1 < b.arguments.size() && b.arguments[k + 1] == '+';
    do {
      if (a >= e.args.size()) break;
      const Expr& arg = *e.args[a++];
      switch (c) {
        case 'o':
        case 'O': {
          Binding* target = writable(arg);
          if (!target) return false;
          target->isRead = true;  // a result that the caller has no use for is no mistake
          const uint32_t t = b_.temp(c == 'o' ? SlType::kFloat : typeOf(arg));
          outputs.push_back({t, &arg});
          break;
        }
        case '!': {
          const uint32_t v = variableOperand(arg, outputs);
          if (v == kNoIndex) return false;
          inputs.push_back(v);
          break;
        }
        case 'a':
        case 'A':
        case '?':
          if (isArrayName(arg, nullptr)) {
            Binding* v = find(arg.text, arg.place);
            if (!useGlobal(*v, arg.place, false)) return false;
            inputs.push_back(read(*v));
          } else {
            input(arg, SlType::kVoid);
          }
          break;
        case 't': {
          Value v = expression(arg);
          if (v.ok() && v.type == SlType::kFloat) v = convert(v, SlType::kVector, arg.place);
          if (v.ok()) inputs.push_back(v.symbol);
          good = good && v.ok();
          break;
        }
        case 'T':
          input(arg, result);
          break;
        case 'm':
          input(arg, SlType::kMatrix);
          break;
        case 's':
          input(arg, SlType::kString);
          break;
        case 'c':
          input(arg, SlType::kColor);
          break;
        case 'p':
          input(arg, SlType::kPoint);
          break;
        case 'v':
          input(arg, SlType::kVector);
          break;
        case 'n':
          input(arg, SlType::kNormal);
          break;
        default:
          input(arg, SlType::kFloat);
      }
    } while (repeat && a < e.args.size());
    if (repeat) ++k;
  }
  return good;
}

Value Lower::builtinCall(const Builtin& b, const Expr& e, SlType result) {
  if (b.lowering != Lowering::kPlain) return specialCall(b, e, result);
  std::vector<uint32_t> inputs;
  Outputs outputs;
  if (!plainInputs(b, e, result, inputs, outputs)) return {};
  at(e.place);
  // Outputs that are temporaries stand between the result and the inputs; elements of arrays are operands
  // already.
  std::vector<uint32_t> operands;
  for (const auto& [symbol, target] : outputs)
    if (b_.symbol(symbol).storage == Storage::kTemp) operands.push_back(symbol);
  if (operands.empty() && result != SlType::kVoid) {
    const uint32_t r = b_.result(b.op, result, inputs);
    storeOutputs(outputs);
    return {r, result};
  }
  operands.insert(operands.end(), inputs.begin(), inputs.end());
  uint32_t r = b_.constantFloat(0);
  if (result != SlType::kVoid) {
    r = b_.temp(result);
    operands.insert(operands.begin(), r);
  }
  b_.emit(b.op, operands);
  storeOutputs(outputs);
  return {r, result};
}

Value Lower::specialCall(const Builtin& b, const Expr& e, SlType result) {
  std::vector<uint32_t> in;
  Outputs outputs;
  switch (b.lowering) {
    case Lowering::kSpline:
      return splineCall(e, result);
    case Lowering::kTexture:
      return textureCall(b, e, result);
    case Lowering::kTransform:
      return transformCall(b, e, result);
    case Lowering::kIsOutput: {
      const Expr& what = *e.args[0];
      SlType element = SlType::kVoid;
      const bool named =
          what.kind == ExprKind::kName && (isArrayName(what, &element) || typeOf(what) != SlType::kString);
      if (named && !find(what.text, what.place)) return expression(what);  // says that it is unknown
      const Value name =
          named ? Value{b_.constantString(what.text), SlType::kString} : converted(what, SlType::kString);
      if (!name.ok()) return {};
      at(e.place);
      return {b_.result(b.op, result, {name.symbol}), result};
    }
    case Lowering::kArrayLength: {
      const Expr& array = *e.args[0];
      if (array.kind != ExprKind::kName || !isArrayName(array, nullptr)) {
        error(array.place, "an array is needed here");
        return {};
      }
      const Binding* variable = find(array.text, array.place);
      if (!variable) return {};
      return {b_.constantFloat(float(b_.symbol(variable->symbol).arrayLength)), result};
    }
    case Lowering::kGetVar: {
      // getvar(null, "name", v): the shader is this one, and there are no others to be named.
      if (e.args[0]->kind != ExprKind::kName || e.args[0]->text != "null") {
        error(e.args[0]->place, "there are no variables of shaders in this version of the language",
              "write getvar(\"name\", variable)");
        return {};
      }
      Value name = converted(*e.args[1], SlType::kString);
      const uint32_t variable = variableOperand(*e.args[2], outputs);
      if (!name.ok() || variable == kNoIndex) return {};
      at(e.place);
      const uint32_t r = b_.result(b.op, result, {name.symbol, variable});
      storeOutputs(outputs);
      return {r, result};
    }
    default:
      break;
  }
  if (!plainInputs(b, e, result, in, outputs)) return {};
  at(e.place);
  switch (b.lowering) {
    case Lowering::kFoldLeft: {
      uint32_t r = in[0];
      for (size_t i = 1; i < in.size(); ++i) r = b_.result(b.op, result, {r, in[i]});
      return {r, result};
    }
    case Lowering::kComponent:
      return {b_.result(b.op, result, {in[0], b_.constantFloat(b.extra)}), result};
    case Lowering::kSetComponent:
    case Lowering::kSetComp: {
      const SlType t = b_.symbol(in[0]).type;
      const bool matrix = b.op == Op::setcomp_m;
      if (b_.symbol(in[0]).isArray() || (matrix ? t != SlType::kMatrix : !isTriple(t))) {
        error(e.args[0]->place,
              fmt::format("'{}' needs a {} variable", e.text, matrix ? "matrix" : "color or point"));
        return {};
      }
      if (b.lowering == Lowering::kSetComponent) in.insert(in.begin() + 1, b_.constantFloat(b.extra));
      b_.emit(b.op, in);
      storeOutputs(outputs);
      return {b_.constantFloat(0), SlType::kVoid};
    }
    case Lowering::kFaceforward2: {
      Binding* ng = findFrom(&globals_, "Ng", nullptr);
      if (!useGlobal(*ng, e.place, false)) return {};
      in.push_back(ng->symbol);
      return {b_.result(b.op, result, in), result};
    }
    case Lowering::kAreaDefault:
      in.push_back(b_.constantString("shading"));
      return {b_.result(b.op, result, in), result};
    case Lowering::kFresnel2: {
      std::vector<uint32_t> operands;
      for (const auto& o : outputs) operands.push_back(o.first);
      operands.push_back(b_.temp(SlType::kVector));
      operands.push_back(b_.temp(SlType::kVector));
      operands.insert(operands.end(), in.begin(), in.end());
      b_.emit(b.op, operands);
      storeOutputs(outputs);
      return {b_.constantFloat(0), SlType::kVoid};
    }
    case Lowering::kMTransform: {
      // A matrix on points of `from`, for points of `to`: come from `to` first.
      const bool two = in.size() == 3;
      const uint32_t from = two ? in[0] : b_.constantString("current"), to = two ? in[1] : in[0];
      const uint32_t m = b_.result(Op::space_m, result, {to, from});
      return {b_.result(Op::mul_m, result, {m, in.back()}), result};
    }
    case Lowering::kCTransform:
      if (in.size() == 2) in.insert(in.begin(), b_.constantString("rgb"));
      return {b_.result(b.op, result, in), result};
    case Lowering::kAverage: {
      const uint32_t c = b_.result(b.op, SlType::kColor, in);
      storeOutputs(outputs);
      return {b_.result(Op::average_t, result, {c}), result};
    }
    case Lowering::kOcclusionMap:
      warn(e.place, "occlusion maps are not read: rays are traced instead", "", Lint::kNone);
      return {b_.result(b.op, result, {in.begin() + 1, in.end()}), result};
    case Lowering::kPhotonMap: {
      const float zero[3] = {0, 0, 0};
      in.insert(in.begin() + 2, b_.constantFloats(SlType::kNormal, zero));
      return {b_.result(b.op, result, in), result};
    }
    default:
      break;
  }
  return {};
}

Value Lower::transformCall(const Builtin& b, const Expr& e, SlType result) {
  static constexpr Op kBySpace[] = {Op::transform_p, Op::transform_v, Op::transform_n};
  static constexpr Op kByMatrix[] = {Op::transform_pm, Op::transform_vm, Op::transform_nm};
  std::vector<uint32_t> in;
  Outputs outputs;
  if (!plainInputs(b, e, result, in, outputs)) return {};
  at(e.place);
  const uint32_t current = b_.constantString("current");
  const Op bySpace = kBySpace[b.extra], byMatrix = kByMatrix[b.extra];
  if (b.arguments == "st") return {b_.result(bySpace, result, {current, in[0], in[1]}), result};
  if (b.arguments == "sst") return {b_.result(bySpace, result, {in[0], in[1], in[2]}), result};
  if (b.arguments == "mt") return {b_.result(byMatrix, result, {in[0], in[1]}), result};
  const uint32_t p = b_.result(bySpace, result, {in[0], current, in[2]});
  return {b_.result(byMatrix, result, {in[1], p}), result};
}

Value Lower::splineCall(const Expr& e, SlType result) {
  size_t a = 0;
  uint32_t basis = b_.constantString("catmull-rom");
  if (e.args.empty()) {
    error(e.place, "'spline' needs a parameter and at least 4 knots");
    return {};
  }
  if (typeOf(*e.args[0]) == SlType::kString) {
    Value v = converted(*e.args[a++], SlType::kString);
    if (!v.ok()) return {};
    basis = v.symbol;
  }
  SlType element;
  const bool array = a + 2 == e.args.size() && isArrayName(*e.args[a + 1], &element);
  if (!array && e.args.size() < a + 5) {
    error(e.place, "'spline' needs a parameter and at least 4 knots");
    return {};
  }
  Value x = converted(*e.args[a++], SlType::kFloat);
  if (!x.ok()) return {};
  std::vector<uint32_t> in{basis, x.symbol};
  SlType type = result;
  if (array) {
    Binding* b = find(e.args[a]->text, e.args[a]->place);
    in.push_back(read(*b));
    if (element == SlType::kMatrix || element == SlType::kString) {
      error(e.args[a]->place, fmt::format("'spline' does not work on an array of {}", slTypeName(element)));
      return {};
    }
    at(e.place);
    const SlType t = isTriple(element) && isTriple(type) ? type : element;
    return {b_.result(element == SlType::kFloat ? Op::spline_fa : Op::spline_ta, t, in), t};
  }
  // The knots decide: any triple among them makes the spline one.
  for (size_t i = a; i < e.args.size(); ++i) {
    const SlType t = typeOf(*e.args[i]);
    if (isTriple(t) && !isTriple(type)) type = t;
  }
  if (isTriple(result)) {
    bool anyTriple = false;
    for (size_t i = a; i < e.args.size(); ++i)
      anyTriple = anyTriple || isTriple(typeOf(*e.args[i], {result, true}));
    if (!anyTriple) type = SlType::kFloat;
  }
  for (size_t i = a; i < e.args.size(); ++i) {
    Value v = converted(*e.args[i], type);
    if (!v.ok()) return {};
    in.push_back(v.symbol);
  }
  at(e.place);
  return {b_.result(isTriple(type) ? Op::spline_t : Op::spline_f, type, in), type};
}

/// texture(name[channel], coordinates ..., pairs): the coordinates end where a string begins.
Value Lower::textureCall(const Builtin& b, const Expr& e, SlType result) {
  const bool bump = b.extra == 1, texture = e.text == "texture";
  size_t a = 0;
  Value name = converted(*e.args[a++], SlType::kString);
  if (!name.ok()) return {};
  uint32_t channel = b_.constantFloat(0);
  if (e.channel) {
    Value c = converted(*e.args[a++], SlType::kFloat);
    if (!c.ok()) return {};
    channel = c.symbol;
  }
  size_t end = a;
  while (end < e.args.size() && typeOf(*e.args[end]) != SlType::kString) ++end;
  const size_t n = end - a;
  std::vector<uint32_t> in{name.symbol};
  if (!bump) in.push_back(channel);
  const auto triples = [&](size_t count) {
    for (size_t i = 0; i < count; ++i) {
      Value v = converted(*e.args[a++], SlType::kVector);
      if (!v.ok()) return false;
      in.push_back(v.symbol);
    }
    return true;
  };
  const auto floats = [&](size_t count) {
    for (size_t i = 0; i < count; ++i) {
      Value v = converted(*e.args[a++], SlType::kFloat);
      if (!v.ok()) return false;
      in.push_back(v.symbol);
    }
    return true;
  };
  const auto surfaceCoordinates = [&] {
    for (const char* c : {"s", "t"}) {
      Binding* v = findFrom(&globals_, c, nullptr);
      if (!useGlobal(*v, e.place, false)) return false;
      in.push_back(v->symbol);
    }
    return true;
  };
  Op op = b.op;
  const bool color = isTriple(result) && !bump;
  if (bump && (n == 3 || n == 5)) {
    if (!triples(3) || !(n == 5 ? floats(2) : surfaceCoordinates())) return {};
  } else if (bump && n == 11) {
    // Four corners: their middle, filtered by how that moves.
    if (!triples(3) || !floats(8)) return {};
    std::vector<uint32_t> corners(in.end() - 8, in.end());
    in.resize(in.size() - 8);
    at(e.place);
    for (size_t c = 0; c < 2; ++c) {
      uint32_t sum = corners[c];
      for (size_t i = 2; i < 8; i += 2) sum = b_.result(Op::add_f, SlType::kFloat, {sum, corners[i + c]});
      in.push_back(b_.result(Op::mul_f, SlType::kFloat, {sum, b_.constantFloat(0.25f)}));
    }
  } else if (texture && n == 0) {
    if (!surfaceCoordinates()) return {};
  } else if (texture && n == 2) {
    if (!floats(2)) return {};
  } else if (texture && n == 8) {
    op = color ? Op::texture4_t : Op::texture4_f;
    if (!floats(8)) return {};
  } else if (!texture && !bump && (n == 1 || n == 4)) {
    if (n == 4) {
      const bool environment = e.text == "environment";
      op = environment ? (color ? Op::environment4_t : Op::environment4_f)
                       : (color ? Op::shadow4_t : Op::shadow4_f);
    }
    if (!triples(n)) return {};
  } else {
    error(e.place, fmt::format("'{}' does not take {} coordinates", e.text, n),
          texture ? "none, s and t, or four pairs"
          : bump  ? "N, dPdu, dPdv, then none, s and t, or four pairs"
                  : "one or four");
    return {};
  }
  Outputs outputs;
  if (!pairs(e, a, op, in, outputs)) return {};
  at(e.place);
  const uint32_t r = b_.result(op, result, in);
  storeOutputs(outputs);
  return {r, result};
}

}  // namespace fr
