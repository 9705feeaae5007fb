#include "shading/parser.h"

#include "shading/parser_impl.h"

namespace fr {

using namespace ast;

// ---- tokens and errors ----

const SlToken& Parser::peek(size_t ahead) const {
  return tokens_[std::min(pos_ + ahead, tokens_.size() - 1)];
}

SlToken Parser::take() {
  SlToken t = peek();
  if (pos_ + 1 < tokens_.size()) ++pos_;
  return t;
}

bool Parser::accept(std::string_view s) {
  if (!peek().is(s)) return false;
  take();
  return true;
}

void Parser::error(const SourcePlace& place, std::string message, std::string hint) {
  diagnostics_.add({Severity::kError, RiError::kSyntax, source_.location(place), std::move(message),
                    std::move(hint), source_.line(place)});
}

std::string Parser::found() const {
  const SlToken& t = peek();
  switch (t.kind) {
    case TokenKind::kEnd:
      return "the end of the file";
    case TokenKind::kNumber:
      return "a number";
    case TokenKind::kString:
      return "a string";
    default:
      return "'" + t.text + "'";
  }
}

bool Parser::expect(std::string_view s, std::string_view where) {
  if (accept(s)) return true;
  // A missing ';' is best shown behind the last token.
  SourcePlace place = peek().place;
  if (s == ";" && pos_ > 0 && tokens_[pos_ - 1].place.line != place.line) {
    place = tokens_[pos_ - 1].place;
    place.column += tokens_[pos_ - 1].length;
  }
  error(place, fmt::format("expected '{}' {}, found {}", s, where, found()));
  return false;
}

/// Skips to behind the next ';' of this nesting, or to before a '}' or a word that begins a statement.
void Parser::recover() {
  int depth = 0;
  while (peek().kind != TokenKind::kEnd) {
    const SlToken& t = peek();
    if (t.is("{")) ++depth;
    if (t.is("}")) {
      if (depth == 0) return;
      --depth;
      take();
      if (depth == 0) return;
      continue;
    }
    if (depth == 0 && t.is(";")) {
      take();
      return;
    }
    take();
  }
}

/// After a missing ';': when the next line begins a new statement, go on there.
void Parser::recoverInLine() {
  if (pos_ > 0 && tokens_[pos_ - 1].place.line == peek().place.line) recover();
}

/// After an error in parentheses that open at token `open`: to behind their end, or to before a '{' or '}'.
void Parser::skipParentheses(size_t open) {
  int depth = 0;
  for (size_t i = open; i < pos_; ++i) depth += tokens_[i].is("(") ? 1 : tokens_[i].is(")") ? -1 : 0;
  while (depth > 0 && peek().kind != TokenKind::kEnd && !peek().is("{") && !peek().is("}")) {
    if (peek().is("(")) ++depth;
    if (take().is(")")) --depth;
  }
}

/// C's "++" and "--": two signs without a space where no operand can follow.
bool Parser::atIncrement() const {
  const SlToken &a = peek(), &b = peek(1);
  return (a.is("+") || a.is("-")) && b.is(a.text) && a.place.line == b.place.line &&
         a.place.column + 1 == b.place.column;
}

void Parser::incrementError() {
  const std::string op = peek().text;
  error(peek().place, fmt::format("'{}{}' does not exist in this language", op, op),
        fmt::format("write x {}= 1", op));
}

bool Parser::enter() {
  if (nesting_ < 256) {
    ++nesting_;
    return true;
  }
  if (!tooDeep_) error(peek().place, "nested too deeply (limit 256)");
  tooDeep_ = true;
  pos_ = tokens_.size() - 1;
  return false;
}

// ---- types and declarations ----

bool Parser::typeOf(const SlToken& t, SlType& type) {
  if (t.kind != TokenKind::kKeyword) return false;
  for (int i = 0; i <= int(SlType::kVoid); ++i)
    if (t.text == slTypeName(SlType(i))) {
      type = SlType(i);
      return true;
    }
  return false;
}

bool Parser::atSpecifier() const {
  const SlToken& t = peek();
  return t.is("extern") || t.is("uniform") || t.is("varying") || t.is("output");
}

void Parser::specifiers(Variable& v) {
  for (;;) {
    if (accept("extern")) {
      v.isExtern = true;
    } else if (accept("output")) {
      v.output = true;
    } else if (accept("uniform")) {
      v.cls = SlClass::kUniform;
      v.classGiven = true;
    } else if (accept("varying")) {
      v.cls = SlClass::kVarying;
      v.classGiven = true;
    } else {
      return;
    }
  }
}

void Parser::arraySuffix(Variable& v) {
  if (!accept("[")) return;
  v.isArray = true;
  if (!peek().is("]")) v.length = expression();
  expect("]", "after the array length");
}

Expr* Parser::initializer() {
  if (!peek().is("{")) return expression();
  Expr* e = make(ExprKind::kList, peek().place);
  take();
  while (!peek().is("}") && peek().kind != TokenKind::kEnd) {
    Expr* item = expression();
    if (!item) break;
    e->args.push_back(item);
    if (!accept(",")) break;
  }
  expect("}", "after the array's values");
  return e;
}

bool Parser::variableName(Variable& v) {
  const SlToken& t = peek();
  if (t.kind != TokenKind::kIdentifier) {
    std::string hint;
    if (t.kind == TokenKind::kKeyword)
      hint = "'" + t.text + "' is a word of the language; choose another name";
    error(t.place, fmt::format("expected a variable name, found {}", found()), hint);
    return false;
  }
  v.name = t.text;
  v.place = t.place;
  take();
  arraySuffix(v);
  v.init = nullptr;
  if (accept("=")) {
    v.init = initializer();
    if (!v.init) return false;
  }
  return true;
}

bool Parser::formals(std::vector<Variable>& out) {
  if (!expect("(", "before the parameters")) return false;
  while (!peek().is(")")) {
    if (accept(";")) continue;  // what macros leave that expand to nothing
    Variable group;
    group.cls = SlClass::kUniform;
    specifiers(group);
    if (!typeOf(peek(), group.type) || group.type == SlType::kVoid) {
      error(peek().place, fmt::format("expected a parameter's type, found {}", found()));
      return false;
    }
    take();
    specifiers(group);
    Variable shape = group;
    arraySuffix(shape);
    for (;;) {
      Variable v = shape;
      if (!variableName(v)) return false;
      out.push_back(std::move(v));
      SlType next;
      // A comma separates names of one type, or (C habit) whole parameters.
      const SlToken& after = peek(1);
      const bool newGroup =
          typeOf(after, next) || after.is("uniform") || after.is("varying") || after.is("output");
      if (peek().is(",") && !newGroup) {
        take();
        continue;
      }
      break;
    }
    if (accept(";") || accept(",")) continue;
    if (!peek().is(")")) {
      error(peek().place, fmt::format("expected ',', ';' or ')' after a parameter, found {}", found()));
      return false;
    }
  }
  return expect(")", "after the parameters");
}

/// At a type (or a word before one) that begins the declaration of variables.
bool Parser::atDeclaration() const {
  SlType type;
  const SlToken& next = peek(1);
  return atSpecifier() ||
         (typeOf(peek(), type) && (next.kind == TokenKind::kIdentifier || next.kind == TokenKind::kKeyword ||
                                   next.is("[") || next.is("uniform") || next.is("varying")));
}

Stmt* Parser::declaration() {
  Variable v;
  specifiers(v);
  if (!typeOf(peek(), v.type) || v.type == SlType::kVoid) {
    error(peek().place, fmt::format("expected a type, found {}", found()));
    recover();
    return nullptr;
  }
  take();
  specifiers(v);
  Stmt* s = makeStmt(StmtKind::kDeclaration, peek().place);
  Variable shape = v;
  arraySuffix(shape);
  do {
    Variable one = shape;
    if (!variableName(one)) {
      recover();
      return s;
    }
    s->variables.push_back(std::move(one));
  } while (accept(","));
  if (!expect(";", "after the declaration")) recoverInLine();
  return s;
}

Function* Parser::functionRest(SlType result) {
  file_.functionNodes.emplace_back();
  Function* f = &file_.functionNodes.back();
  f->result = result;
  f->place = peek().place;
  f->name = take().text;
  if (!formals(f->formals)) {
    while (peek().kind != TokenKind::kEnd && !peek().is("{")) take();
  }
  if (!peek().is("{")) {
    error(peek().place, fmt::format("expected '{{' before the body of '{}', found {}", f->name, found()));
    return nullptr;
  }
  f->body = block();
  return f;
}

/// At ID: is this `ID ( ... ) {`, a function without a type?
bool Parser::looksLikeFunction() const {
  if (peek().kind != TokenKind::kIdentifier || !peek(1).is("(")) return false;
  int depth = 0;
  for (size_t i = pos_ + 1; i < tokens_.size(); ++i) {
    if (tokens_[i].is("(")) ++depth;
    if (tokens_[i].is(")") && --depth == 0) return i + 1 < tokens_.size() && tokens_[i + 1].is("{");
    if (tokens_[i].is("{") && depth > 0 && !tokens_[i - 1].is("=")) return false;
  }
  return false;
}

void Parser::file() {
  static constexpr std::pair<std::string_view, ShaderType> kShaderWords[] = {
      {"surface", ShaderType::kSurface},
      {"light", ShaderType::kLight},
      {"displacement", ShaderType::kDisplacement},
      {"volume", ShaderType::kVolume},
      {"imager", ShaderType::kImager},
      {"transformation", ShaderType::kTransformation},
      {"atmosphere", ShaderType::kVolume}};  // as some compilers called it
  while (peek().kind != TokenKind::kEnd) {
    if (accept(";")) continue;
    const size_t before = pos_;
    bool known = false;
    for (const auto& [word, type] : kShaderWords) {
      if (peek().kind > TokenKind::kKeyword || peek().text != word || peek(1).kind != TokenKind::kIdentifier)
        continue;
      known = true;
      take();
      if (Function* f = functionRest(SlType::kVoid)) file_.shaders.push_back({type, f});
      break;
    }
    if (known) continue;
    if (peek().kind == TokenKind::kIdentifier && peek().text == "class" &&
        peek(1).kind == TokenKind::kIdentifier) {
      take();
      classRest();
      continue;
    }
    if (peek().kind == TokenKind::kIdentifier && peek().text == "plugin" &&
        peek(1).kind == TokenKind::kString) {
      diagnostics_.add(
          {Severity::kWarning, RiError::kUnimplemented, source_.location(peek().place),
           fmt::format("plugin \"{}\" is not loaded: functions of later versions' plugins are not known",
                       peek(1).text),
           "", source_.line(peek().place)});
      take(), take();
      continue;
    }
    SlType type = SlType::kFloat;
    Variable ignored;
    specifiers(ignored);
    const bool typed = typeOf(peek(), type);
    if (typed) take();
    if (peek().kind == TokenKind::kIdentifier && peek(1).is("(")) {
      if (Function* f = functionRest(type)) file_.functions.push_back(f);
      continue;
    }
    std::string hint;
    if (peek().kind == TokenKind::kIdentifier && peek(1).kind == TokenKind::kIdentifier) {
      NearestWord near(peek().text);
      for (const auto& [word, t] : kShaderWords) near.offer(word);
      hint = near.hint();
      if (peek().text == "struct") hint = "structures of later versions of the language are not supported";
    } else if (typed) {
      hint = "variables outside of functions and shaders are not part of the language";
    }
    error(peek().place, fmt::format("expected a shader or a function, found {}", found()), hint);
    recover();
    if (peek().is("}")) take();
    if (pos_ == before) take();
  }
}

void parseFile(const std::vector<SlToken>& tokens, const PreprocessedSource& source, Diagnostics& diagnostics,
               const ParserOptions& options, ast::File& out) {
  Parser(tokens, source, diagnostics, options, out).file();
}

}  // namespace fr
