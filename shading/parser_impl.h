// Private to parser.cpp, parser_statement.cpp and parser_expression.cpp.
#pragma once

#include "shading/parser.h"

namespace fr {

class Parser {
 public:
  Parser(const std::vector<SlToken>& tokens, const PreprocessedSource& source, Diagnostics& diagnostics,
         const ParserOptions& options, ast::File& file)
      : tokens_(tokens), source_(source), diagnostics_(diagnostics), options_(options), file_(file) {}
  void file();

 private:
  struct Depth {
    Parser* p;
    bool ok;
    explicit Depth(Parser* parser) : p(parser), ok(parser->enter()) {}
    ~Depth() {
      if (ok) --p->nesting_;
    }
  };

  const SlToken& peek(size_t ahead = 0) const;
  SlToken take();
  bool accept(std::string_view s);
  bool expect(std::string_view s, std::string_view where);
  void error(const SourcePlace& place, std::string message, std::string hint = {});
  std::string found() const;
  bool atIncrement() const;
  void incrementError();
  void recover();
  void recoverInLine();
  void skipParentheses(size_t open);
  bool enter();

  static bool typeOf(const SlToken& t, SlType& type);
  bool atSpecifier() const;
  void specifiers(ast::Variable& v);
  void arraySuffix(ast::Variable& v);
  bool variableName(ast::Variable& v);
  bool formals(std::vector<ast::Variable>& out);
  bool atDeclaration() const;
  ast::Stmt* declaration();
  ast::Function* functionRest(SlType result);
  bool looksLikeFunction() const;

  void classRest();
  void member(ast::Stmt* body);
  void method(ast::Stmt* body, SlType result);
  bool callMethod(ast::Stmt* body, std::string_view method);

  ast::Stmt* block();
  ast::Stmt* statement();
  ast::Stmt* ifStatement();
  ast::Stmt* loopStatement();
  bool forHead(ast::Stmt* loop, ast::Stmt** declared);
  ast::Stmt* jumpStatement();
  ast::Stmt* lightStatement();
  ast::Stmt* expressionStatement();
  ast::Stmt* gatherStatement();

  // Expressions return null after an error that was reported.
  ast::Expr* expression();
  ast::Expr* ternary();
  ast::Expr* binary(int level);
  ast::Expr* unary();
  ast::Expr* primary();
  ast::Expr* components(ast::Expr* of);
  ast::Expr* cast(SlType type);
  ast::Expr* parenthesised();
  ast::Expr* name();
  ast::Expr* initializer();
  bool arguments(ast::Expr* call);
  bool textureName(ast::Expr* call);

  ast::Expr* make(ast::ExprKind kind, const SourcePlace& place);
  ast::Expr* finish(ast::Expr* e);  // sets the depth; null if too deep
  ast::Stmt* makeStmt(ast::StmtKind kind, const SourcePlace& place);

  const std::vector<SlToken>& tokens_;
  const PreprocessedSource& source_;
  Diagnostics& diagnostics_;
  ParserOptions options_;
  ast::File& file_;
  size_t pos_ = 0;
  int nesting_ = 0;
  bool tooDeep_ = false;
};

}  // namespace fr
