// Classes of later versions of the language: members and methods around what used to be a shader's body. A
// class is read as the shader of its pipeline methods: members are variables of the body, methods are
// functions in it, and the body calls those that the renderer would have called, in its order.
#include <algorithm>

#include "shading/parser_impl.h"

namespace fr {

using namespace ast;

namespace {

struct PipelineMethod {
  std::string_view name;
  std::vector<std::string_view> variables;  // what the renderer hands over
};
const std::vector<PipelineMethod>& pipeline() {
  static const auto& all = *new std::vector<PipelineMethod>{{"construct", {}},
                                                            {"begin", {}},
                                                            {"displacement", {"P", "N"}},
                                                            {"opacity", {"Oi"}},
                                                            {"prelighting", {"Ci", "Oi"}},
                                                            {"lighting", {"Ci", "Oi"}},
                                                            {"postlighting", {"Ci", "Oi"}},
                                                            {"surface", {"Ci", "Oi"}},
                                                            {"volume", {"Ci", "Oi"}},
                                                            {"light", {"L", "Cl"}}};
  return all;
}
std::string nameInBody(std::string_view method) { return "__" + std::string(method); }

}  // namespace

/// A shader's method: what it is handed over under the name of the predefined variable is that variable.
void Parser::method(Stmt* body, SlType result) {
  const auto& all = pipeline();
  const auto known =
      std::find_if(all.begin(), all.end(), [&](const auto& m) { return m.name == peek().text; });
  Stmt* s = makeStmt(StmtKind::kFunction, peek().place);
  s->function = functionRest(result);
  if (!s->function) return;
  body->body.push_back(s);
  if (known == all.end()) return;
  // Other methods may still call it by its own name.
  Function& f = file_.functionNodes.emplace_back(*s->function);
  Stmt* inBody = makeStmt(StmtKind::kFunction, s->place);
  inBody->function = &f;
  body->body.push_back(inBody);
  f.name = nameInBody(f.name);
  if (std::ranges::equal(f.formals, known->variables, {}, &Variable::name)) f.formals.clear();
}

/// Calls `method`, if the class has it, with the predefined variables if it gave them names of its own.
bool Parser::callMethod(Stmt* body, std::string_view method) {
  const auto& all = pipeline();
  const auto known = std::find_if(all.begin(), all.end(), [&](const auto& m) { return m.name == method; });
  const std::string name = nameInBody(method);
  const auto found = std::find_if(body->body.begin(), body->body.end(), [&](const Stmt* s) {
    return s->kind == StmtKind::kFunction && s->function->name == name;
  });
  if (found == body->body.end()) return false;
  const Function& f = *(*found)->function;
  Expr* call = make(ExprKind::kCall, f.place);
  call->text = name;
  for (size_t i = 0; i < f.formals.size() && i < known->variables.size(); ++i) {
    Expr* variable = make(ExprKind::kName, f.place);
    variable->text = known->variables[i];
    call->args.push_back(variable);
  }
  Stmt* s = makeStmt(StmtKind::kExpr, f.place);
  s->exprs.push_back(finish(call));
  if (s->exprs[0]) body->body.push_back(s);
  return true;
}

void Parser::member(Stmt* body) {
  bool constant = false;
  while (peek().text == "public" || peek().text == "private" || peek().text == "constant")
    constant |= take().text == "constant";
  Variable specified;
  const size_t begin = pos_;
  specifiers(specified);
  SlType type = SlType::kVoid;
  const bool typed = typeOf(peek(), type);
  if (typed && peek(1).kind == TokenKind::kIdentifier && peek(2).is("(")) {
    take();
    return method(body, type);
  }
  if (looksLikeFunction()) return method(body, SlType::kFloat);
  if (!typed) {
    const bool isObject = peek().kind == TokenKind::kIdentifier && peek(1).kind == TokenKind::kIdentifier;
    error(peek().place, fmt::format("expected a variable or a method of the class, found {}", this->found()),
          isObject ? "variables that hold shaders or structures are not supported" : "");
    return recover();
  }
  pos_ = begin;
  Stmt* s = declaration();
  if (!s) return;
  for (Variable& v : s->variables)
    if (constant) v.cls = SlClass::kUniform, v.classGiven = true;
  body->body.push_back(s);
}

/// At the name behind "class".
void Parser::classRest() {
  file_.functionNodes.emplace_back();
  Function* f = &file_.functionNodes.back();
  f->result = SlType::kVoid;
  f->place = peek().place;
  f->name = take().text;
  if (!formals(f->formals))
    while (peek().kind != TokenKind::kEnd && !peek().is("{")) take();
  Stmt* body = makeStmt(StmtKind::kBlock, peek().place);
  f->body = body;
  expect("{", fmt::format("before the body of '{}'", f->name));
  while (!peek().is("}") && peek().kind != TokenKind::kEnd) {
    if (accept(";")) continue;
    const size_t before = pos_;
    member(body);
    if (pos_ == before) take();
  }
  expect("}", fmt::format("behind the methods of '{}'", f->name));
  const auto has = [&](std::string_view method) {
    return std::any_of(body->body.begin(), body->body.end(), [&](const Stmt* s) {
      return s->kind == StmtKind::kFunction && s->function->name == nameInBody(method);
    });
  };
  ShaderType type = ShaderType::kSurface;
  const bool isSurface =
      has("surface") || has("lighting") || has("prelighting") || has("postlighting") || has("opacity");
  if (has("light"))
    type = ShaderType::kLight;
  else if (!isSurface && has("volume"))
    type = ShaderType::kVolume;
  else if (!isSurface && has("displacement"))
    type = ShaderType::kDisplacement;
  else if (!isSurface)
    error(f->place, fmt::format("class '{}' has no method that makes it a shader", f->name),
          "surface, lighting, displacement, volume or light; shaders for other shaders are not supported");
  for (const char* first : {"construct", "begin"}) callMethod(body, first);
  if (type == ShaderType::kLight) {
    callMethod(body, "light");
  } else if (type == ShaderType::kVolume) {
    callMethod(body, "volume");
  } else {
    callMethod(body, "displacement");
    if (type == ShaderType::kSurface) {
      callMethod(body, "opacity"), callMethod(body, "prelighting");
      callMethod(body, has("lighting") ? "lighting" : "surface"), callMethod(body, "postlighting");
    }
  }
  file_.shaders.push_back({type, f});
}

}  // namespace fr
