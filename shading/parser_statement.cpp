#include "shading/parser_impl.h"

namespace fr {

using namespace ast;

Stmt* Parser::makeStmt(StmtKind kind, const SourcePlace& place) {
  Stmt& s = file_.stmts.emplace_back();
  s.kind = kind;
  s.place = place;
  return &s;
}

Stmt* Parser::block() {
  Stmt* s = makeStmt(StmtKind::kBlock, peek().place);
  Depth depth(this);
  if (!depth.ok) return s;
  const SourcePlace open = peek().place;
  expect("{", "before a block");
  while (!peek().is("}")) {
    if (peek().kind == TokenKind::kEnd) {
      if (!tooDeep_)
        error(peek().place,
              fmt::format("missing '}}': the block that begins in line {} has no end", open.line));
      return s;
    }
    const size_t before = pos_;
    if (Stmt* inner = statement()) s->body.push_back(inner);
    if (pos_ == before) take();
  }
  take();
  return s;
}

Stmt* Parser::statement() {
  Depth depth(this);
  if (!depth.ok) return nullptr;
  const SlToken& t = peek();
  if (t.is("{")) return block();
  if (t.is(";")) {
    take();
    return makeStmt(StmtKind::kEmpty, t.place);
  }
  if (t.is("if")) return ifStatement();
  if (t.is("while") || t.is("for")) return loopStatement();
  if (t.is("break") || t.is("continue") || t.is("return")) return jumpStatement();
  if (t.is("illuminance") || t.is("illuminate") || t.is("solar")) return lightStatement();
  if (t.is("gather")) return gatherStatement();
  if (options_.prelude && t.kind == TokenKind::kIdentifier && t.text == "__ambientlights")
    return lightStatement();

  // The result of a function may be called uniform or varying: it is what comes out.
  SlType type = SlType::kVoid;
  const size_t k = t.is("uniform") || t.is("varying") ? 1 : 0;
  const bool functionFollows =
      typeOf(peek(k), type) && peek(k + 1).kind == TokenKind::kIdentifier && peek(k + 2).is("(");
  if (functionFollows || looksLikeFunction()) {
    SlType result = SlType::kFloat;
    const SourcePlace place = t.place;
    if (k) take();
    if (functionFollows) {
      result = type;
      take();
    }
    if (looksLikeFunction()) {
      Stmt* s = makeStmt(StmtKind::kFunction, place);
      s->function = functionRest(result);
      return s->function ? s : nullptr;
    }
    --pos_;  // a cast in front of a call, as a statement
    return expressionStatement();
  }
  return atDeclaration() ? declaration() : expressionStatement();
}

Stmt* Parser::expressionStatement() {
  Stmt* s = makeStmt(StmtKind::kExpr, peek().place);
  if (peek().is("else")) {
    error(peek().place, "'else' without 'if'");
    take();
    return nullptr;
  }
  if (atIncrement()) {
    incrementError();
    recover();
    return nullptr;
  }
  Expr* e = expression();
  if (!e) {
    recover();
    return nullptr;
  }
  s->exprs.push_back(e);
  if (!expect(";", "after the statement")) recoverInLine();
  return s;
}

Stmt* Parser::ifStatement() {
  Stmt* s = makeStmt(StmtKind::kIf, peek().place);
  take();
  expect("(", "after 'if'");
  s->exprs.push_back(expression());
  if (!s->exprs[0]) {
    recover();
    return nullptr;
  }
  expect(")", "after the condition");
  Stmt* then = statement();
  s->body.push_back(then ? then : makeStmt(StmtKind::kEmpty, s->place));
  if (accept("else")) {
    Stmt* other = statement();
    s->body.push_back(other ? other : makeStmt(StmtKind::kEmpty, s->place));
  }
  return s;
}

/// init; condition; step) of a loop. `declared`: the variables that `for (float i = 0; ...)` brings along, an
/// extension of later compilers. False after an error that was reported; all up to the ')' is skipped.
bool Parser::forHead(Stmt* loop, Stmt** declared) {
  const auto part = [&](std::string_view end, std::string_view where) {
    Expr* e = nullptr;
    if (!peek().is(end) && !(e = expression())) return false;
    loop->exprs.push_back(e);
    return expect(end, where);
  };
  loop->exprs.clear();
  if (atDeclaration()) {
    *declared = declaration();
    loop->exprs.push_back(nullptr);
    if (!*declared) return false;
  } else if (!part(";", "after the first part of 'for'")) {
    return false;
  }
  return part(";", "after the condition of 'for'") && part(")", "before the loop's body");
}

Stmt* Parser::loopStatement() {
  const bool isFor = peek().is("for");
  Stmt* s = makeStmt(isFor ? StmtKind::kFor : StmtKind::kWhile, peek().place);
  take();
  const size_t open = pos_;
  expect("(", isFor ? "after 'for'" : "after 'while'");
  Stmt* declared = nullptr;
  bool good = true;
  if (isFor) {
    good = forHead(s, &declared);
    s->exprs.resize(3);
  } else {
    s->exprs.push_back(expression());
    good = s->exprs[0] && expect(")", "before the loop's body");
  }
  if (!good) skipParentheses(open);
  Stmt* body = statement();
  if (!good && !isFor) return body;
  s->body.push_back(body ? body : makeStmt(StmtKind::kEmpty, s->place));
  if (!declared) return s;
  Stmt* block = makeStmt(StmtKind::kBlock, s->place);
  block->body = {declared, s};
  return block;
}

Stmt* Parser::jumpStatement() {
  const SlToken word = take();
  if (word.text == "return") {
    Stmt* s = makeStmt(StmtKind::kReturn, word.place);
    if (!peek().is(";")) {
      Expr* e = expression();
      if (!e) {
        recover();
        return nullptr;
      }
      s->exprs.push_back(e);
    }
    if (!expect(";", "after 'return'")) recoverInLine();
    return s;
  }
  Stmt* s = makeStmt(word.text == "break" ? StmtKind::kBreak : StmtKind::kContinue, word.place);
  if (peek().kind == TokenKind::kNumber) {
    const SlToken n = take();
    if (n.number >= 1 && n.number <= 1000 && n.number == double(int(n.number))) {
      s->levels = int(n.number);
    } else {
      error(n.place, fmt::format("'{}' takes a whole number of loops from 1", word.text));
    }
  }
  if (!expect(";", fmt::format("after '{}'", word.text))) recover();
  return s;
}

Stmt* Parser::lightStatement() {
  const SlToken word = take();
  const StmtKind kind = word.text == "illuminance"  ? StmtKind::kIlluminance
                        : word.text == "illuminate" ? StmtKind::kIlluminate
                        : word.text == "solar"      ? StmtKind::kSolar
                                                    : StmtKind::kAmbient;
  Stmt* s = makeStmt(kind, word.place);
  expect("(", fmt::format("after '{}'", word.text));
  while (!peek().is(")") && peek().kind != TokenKind::kEnd) {
    Expr* e = expression();
    if (!e) {
      recover();
      return nullptr;
    }
    s->exprs.push_back(e);
    if (!accept(",")) break;
  }
  if (!expect(")", fmt::format("after the arguments of '{}'", word.text))) {
    recover();
    return nullptr;
  }
  Stmt* body = statement();
  s->body.push_back(body ? body : makeStmt(StmtKind::kEmpty, s->place));
  return s;
}

Stmt* Parser::gatherStatement() {
  Stmt* s = makeStmt(StmtKind::kGather, peek().place);
  take();
  expect("(", "after 'gather'");
  while (!peek().is(")") && peek().kind != TokenKind::kEnd) {
    Expr* e = expression();
    if (!e) {
      recover();
      return nullptr;
    }
    s->exprs.push_back(e);
    if (!accept(",")) break;
  }
  expect(")", "after the arguments of 'gather'");
  Stmt* body = statement();
  s->body.push_back(body ? body : makeStmt(StmtKind::kEmpty, s->place));
  if (accept("else")) {
    Stmt* other = statement();
    s->body.push_back(other ? other : makeStmt(StmtKind::kEmpty, s->place));
  }
  return s;
}

}  // namespace fr
