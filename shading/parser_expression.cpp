#include "shading/parser_impl.h"

namespace fr {

using namespace ast;

namespace {

// Level 0 binds least. Within a level operators associate to the left. RISpec 3.2.1 section 13.1: the dot
// product binds tighter than * and /, the cross product looser.
constexpr std::string_view kLevels[][4] = {{"||"},     {"&&"}, {"==", "!="},    {"<", "<=", ">", ">="},
                                           {"+", "-"}, {"^"},  {"*", "/", "%"}, {"."}};
constexpr int kLevelCount = 8;
constexpr uint32_t kMaxDepth = 1000;

bool isTextureCall(std::string_view name) {
  return name == "texture" || name == "environment" || name == "shadow" || name == "bump" ||
         name == "texture3d";
}

}  // namespace

Expr* Parser::make(ExprKind kind, const SourcePlace& place) {
  Expr& e = file_.exprs.emplace_back();
  e.kind = kind;
  e.place = place;
  return &e;
}

Expr* Parser::finish(Expr* e) {
  for (const Expr* a : e->args) e->depth = std::max(e->depth, a->depth + 1);
  if (e->depth <= kMaxDepth) return e;
  error(e->place, fmt::format("expression too long (more than {} operators deep)", kMaxDepth),
        "split it into several statements");
  return nullptr;
}

Expr* Parser::expression() {
  Depth depth(this);
  if (!depth.ok) return nullptr;
  Expr* left = ternary();
  if (!left) return nullptr;
  for (std::string_view op : {"=", "+=", "-=", "*=", "/="}) {
    if (!peek().is(op)) continue;
    const SlToken t = take();
    if (left->kind != ExprKind::kName && left->kind != ExprKind::kIndex) {
      error(left->place, fmt::format("the left side of '{}' must be a variable", op));
      return nullptr;
    }
    Expr* right = expression();
    if (!right) return nullptr;
    Expr* e = make(ExprKind::kAssign, t.place);
    e->text = op;
    e->args = {left, right};
    return finish(e);
  }
  return left;
}

Expr* Parser::ternary() {
  Expr* condition = binary(0);
  if (!condition || !peek().is("?")) return condition;
  Expr* e = make(ExprKind::kTernary, take().place);
  Expr* yes = expression();
  if (!yes || !expect(":", "between the two values of '?'")) return nullptr;
  Depth depth(this);
  if (!depth.ok) return nullptr;
  Expr* no = ternary();
  if (!no) return nullptr;
  e->args = {condition, yes, no};
  return finish(e);
}

Expr* Parser::binary(int level) {
  if (level == kLevelCount) return unary();
  Expr* left = binary(level + 1);
  while (left) {
    bool matched = false;
    for (std::string_view op : kLevels[level]) {
      if (op.empty() || !peek().is(op)) continue;
      if (atIncrement() && (peek(2).is(";") || peek(2).is(")") || peek(2).is("]") || peek(2).is(","))) {
        incrementError();
        return nullptr;
      }
      if (op == "%") error(peek().place, "'%' does not exist in this language", "write mod(a, b)");
      const SlToken t = take();
      Expr* right = binary(level + 1);
      if (!right) return nullptr;
      Expr* e = make(ExprKind::kBinary, t.place);
      e->text = op;
      e->args = {left, right};
      left = finish(e);
      matched = true;
      break;
    }
    if (!matched) break;
  }
  return left;
}

Expr* Parser::unary() {
  Depth depth(this);
  if (!depth.ok) return nullptr;
  if (peek().is("-") || peek().is("!")) {
    const SlToken t = take();
    // The sign binds tighter than the dot product: -a.b is (-a).b.
    Expr* operand = unary();
    if (!operand) return nullptr;
    Expr* e = make(ExprKind::kUnary, t.place);
    e->text = t.text;
    e->args = {operand};
    return finish(e);
  }
  if (peek().is("+")) {
    take();
    return unary();
  }
  return components(primary());
}

/// Brackets behind a value: a component of a color or point.
Expr* Parser::components(Expr* of) {
  while (of && peek().is("[")) {
    Expr* e = make(ExprKind::kComponent, take().place);
    Expr* index = expression();
    if (!index || !expect("]", "after the index")) return nullptr;
    e->args = {of, index};
    of = finish(e);
  }
  return of;
}

Expr* Parser::cast(SlType type) {
  Expr* e = make(ExprKind::kCast, take().place);
  e->type = type;
  if (peek().kind == TokenKind::kString) {
    e->hasSpace = true;
    e->text = take().text;
  }
  // Brackets behind a cast belong to all of it: `vector noise(P)[1]`.
  const bool sign = peek().is("-") || peek().is("+") || peek().is("!");
  Depth depth(this);
  if (!depth.ok) return nullptr;
  Expr* operand = sign ? unary() : primary();
  if (!operand) return nullptr;
  e->args = {operand};
  return finish(e);
}

Expr* Parser::parenthesised() {
  const SlToken open = take();
  if (SlType type; typeOf(peek(), type) && peek(1).is(")")) {
    error(peek().place, "a cast is written without parentheses", fmt::format("write {} x", peek().text));
    return nullptr;
  }
  Expr* first = expression();
  if (!first) return nullptr;
  if (accept(")")) return first;
  Expr* e = make(ExprKind::kTuple, open.place);
  e->args.push_back(first);
  while (accept(",")) {
    Expr* next = expression();
    if (!next) return nullptr;
    e->args.push_back(next);
  }
  if (!expect(")", "after the expression")) return nullptr;
  if (e->args.size() != 3 && e->args.size() != 16) {
    error(open.place, fmt::format("{} values in parentheses: a triple has 3, a matrix 16", e->args.size()));
    return nullptr;
  }
  return finish(e);
}

/// name[channel], where name[i] alone is no element of an array of strings: that is (name[i]) or
/// name[i][channel].
bool Parser::textureName(Expr* call) {
  Expr* name = nullptr;
  if ((peek().kind == TokenKind::kIdentifier || peek().kind == TokenKind::kString) && peek(1).is("[")) {
    const SlToken file = take();
    name = make(file.kind == TokenKind::kString ? ExprKind::kString : ExprKind::kName, file.place);
    name->text = file.text;
  } else {
    name = expression();
  }
  if (!name) return false;
  call->args = {name};
  for (int brackets = 0; peek().is("[") && brackets < 2; ++brackets) {
    take();
    Expr* inside = expression();
    if (!inside || !expect("]", "after the channel")) return false;
    if (call->channel) {
      // A second pair of brackets: the first held an index.
      name->kind = ExprKind::kIndex;
      name->args = {call->args[1]};
      call->args[1] = inside;
    } else {
      call->channel = true;
      call->args.push_back(inside);
    }
    if (name->kind != ExprKind::kName) break;
  }
  return true;
}

bool Parser::arguments(Expr* call) {
  if (!peek().is(")")) {
    do {
      if (call->args.empty() && isTextureCall(call->text)) {
        if (!textureName(call)) return false;
        continue;
      }
      Expr* e = expression();
      if (!e) return false;
      call->args.push_back(e);
    } while (accept(","));
  }
  return expect(")", fmt::format("after the arguments of '{}'", call->text));
}

Expr* Parser::name() {
  const SlToken t = take();
  if (peek().is("(")) {
    take();
    Expr* e = make(ExprKind::kCall, t.place);
    e->text = t.text;
    if (!arguments(e)) return nullptr;
    return finish(e);
  }
  if (peek().is("[")) {
    take();
    Expr* e = make(ExprKind::kIndex, t.place);
    e->text = t.text;
    Expr* index = expression();
    if (!index || !expect("]", "after the index")) return nullptr;
    e->args = {index};
    return finish(e);
  }
  Expr* e = make(ExprKind::kName, t.place);
  e->text = t.text;
  return e;
}

Expr* Parser::primary() {
  const SlToken& t = peek();
  switch (t.kind) {
    case TokenKind::kNumber: {
      Expr* e = make(ExprKind::kNumber, t.place);
      e->number = take().number;
      return e;
    }
    case TokenKind::kString: {
      Expr* e = make(ExprKind::kString, t.place);
      e->text = take().text;
      return e;
    }
    case TokenKind::kIdentifier:
      return name();
    case TokenKind::kPunctuation:
      if (t.is("(")) return parenthesised();
      break;
    case TokenKind::kKeyword: {
      SlType type;
      if (typeOf(t, type) && type != SlType::kVoid) return cast(type);
      // surface("name", v), displacement("name", v): words that are also functions.
      if ((t.text == "surface" || t.text == "displacement") && peek(1).is("(")) return name();
      break;
    }
    case TokenKind::kEnd:
      break;
  }
  if (!tooDeep_) error(t.place, fmt::format("expected an expression, found {}", found()));
  return nullptr;
}

}  // namespace fr
