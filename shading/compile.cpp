#include "shading/compile.h"

#include <filesystem>

#include "shading/lower.h"
#include "shading/parser.h"
#include "shading/passes.h"

namespace fr {
namespace {

/// All functions that some shader of the file calls, directly or not.
void collectCalls(const ast::Expr* e, std::set<std::string>& names) {
  if (!e) return;
  if (e->kind == ast::ExprKind::kCall) names.insert(e->text);
  for (const ast::Expr* a : e->args) collectCalls(a, names);
}

void collectCalls(const ast::Stmt* s, std::set<std::string>& names) {
  for (const ast::Expr* e : s->exprs) collectCalls(e, names);
  for (const ast::Variable& v : s->variables) {
    collectCalls(v.init, names);
    collectCalls(v.length, names);
  }
  for (const ast::Stmt* b : s->body) collectCalls(b, names);
  if (s->function && s->function->body) collectCalls(s->function->body, names);
}

std::set<std::string> reachableFunctions(const ast::File& file) {
  std::set<std::string> reached;
  std::vector<const ast::Function*> todo;
  for (const ast::Shader& s : file.shaders) todo.push_back(s.function);
  while (!todo.empty()) {
    const ast::Function* f = todo.back();
    todo.pop_back();
    std::set<std::string> names;
    if (f->body) collectCalls(f->body, names);
    for (const ast::Variable& v : f->formals) collectCalls(v.init, names);
    for (const std::string& n : names) {
      if (!reached.insert(n).second) continue;
      for (const ast::Function* g : file.functions)
        if (g->name == n) todo.push_back(g);
    }
  }
  return reached;
}

Result<void> finish(ShaderProgram& p, const CompileOptions& options, const PassContext& context) {
  if (options.optimize >= 1) {
    // Copies open the way for dead code and the other way round.
    for (int i = 0; i < 2; ++i) {
      removeDeadCode(p);
      propagateCopies(p);
    }
    removeDeadCode(p);
  }
  const size_t errors = context.diagnostics->errorCount();
  const std::vector<bool> varying = inferUniformity(p, context);
  if (context.diagnostics->errorCount() != errors) return makeError(RiError::kSyntax, "uniform and varying");
  extractConstantDefaults(p);
  if (options.optimize >= 1) {
    // Primitive variables may make any parameter varying later, and with it the control that depends on it.
    ShaderProgram widest = p;
    for (const Parameter& parameter : widest.parameters)
      if (Symbol& s = widest.symbols[parameter.symbol]; s.type != SlType::kString) s.cls = SlClass::kVarying;
    Diagnostics unheard;  // what is only then an error or worth a hint
    PassContext quiet = context;
    quiet.lint = Lint::kNone;
    quiet.diagnostics = &unheard;
    mergeAssignments(p, inferUniformity(widest, quiet));
    removeDeadCode(p);
  }
  if (Result<void> r = resolveJumps(p); !r) return r;
  if (options.optimize >= 2) shareRegisters(p);
  compact(p);
  if (Result<void> r = resolveJumps(p); !r) return r;
  analyze(p);
  return validate(p);
}

uint64_t hashOf(const PreprocessedSource& source, const CompileOptions& options) {
  std::string text = source.text;
  text += fmt::format("|{}|{}", kCompilerVersion, options.optimize);
  return hashBytes(text.data(), text.size());
}

}  // namespace

static Result<std::vector<ShaderProgram>> compileSource(const std::string& fileName, const std::string& text,
                                                        const CompileOptions& options,
                                                        PreprocessedSource& source,
                                                        Diagnostics& diagnostics) {
  const std::string what = fmt::format("cannot compile '{}'", fileName);
  PreprocessOptions preprocessing;
  preprocessing.includePaths = options.includePaths;
  preprocessing.defines = options.defines;
  const bool complete = preprocess(fileName, text, preprocessing, source, diagnostics);
  // What there is of the text still tells of further errors, unless an #include is missing: then all is
  // unknown.
  if (!complete) return diagnostics.firstError(what);
  const uint64_t hash = hashOf(source, options);
  const size_t fileCount = source.files.size();

  NoLintLines noLint;
  ast::File file, prelude;
  parseFile(tokenize(source, diagnostics, noLint), source, diagnostics, {}, file);

  // The prelude is one more file of the same source, so that its places have names too.
  PreprocessedSource preludeText;
  preludeText.text = preludeSource();
  preludeText.files = {{"<prelude>", preludeText.text, 0}};
  for (size_t i = 0, line = 1; i < preludeText.text.size();) {
    preludeText.runs.push_back({uint32_t(i), {uint32_t(fileCount), uint32_t(line++), 1}});
    i = preludeText.text.find('\n', i);
    i = i == std::string::npos ? preludeText.text.size() : i + 1;
  }
  source.files.push_back(preludeText.files[0]);
  NoLintLines ignored;
  parseFile(tokenize(preludeText, diagnostics, ignored), source, diagnostics, {true}, prelude);

  const LowerInput input{
      &source, &file, &prelude, &diagnostics, &noLint, options.lint, &options.shadeopPaths};
  if (file.shaders.empty() && !diagnostics.hasErrors())
    diagnostics.add({Severity::kError,
                     RiError::kSyntax,
                     {fileName, 0, 0},
                     "there is no shader in this file",
                     "a shader begins with surface, light, displacement, volume or imager",
                     ""});
  const PassContext context{&source, &diagnostics, &noLint, options.lint};
  std::vector<ShaderProgram> programs;
  for (const ast::Shader& shader : file.shaders) {
    ProgramBuilder builder;
    if (!lowerShader(input, shader, builder)) {
      // There may be uniform variables with varying values too.
      if (resolveJumps(builder.program)) (void)inferUniformity(builder.program, context);
      continue;
    }
    ShaderProgram& p = builder.program;
    for (const SourceFile& f : source.files) {
      p.files.push_back(f.name);
      p.fileHashes.push_back(f.hash);
    }
    p.sourceHash = hash;
    const size_t errors = diagnostics.errorCount();
    if (Result<void> r = finish(p, options, context); !r) {
      // Every reason but a broken rule of the language is a fault of the compiler or a limit.
      if (diagnostics.errorCount() == errors)
        diagnostics.add({Severity::kError,
                         r.error().code == RiError::kLimit ? RiError::kLimit : RiError::kBug,
                         {fileName, 0, 0},
                         fmt::format("shader '{}': {}", p.name, r.error().message),
                         "",
                         ""});
      continue;
    }
    programs.push_back(std::move(p));
  }
  const std::set<std::string> reached = reachableFunctions(file);
  for (const ast::Function* f : file.functions)
    if (!reached.count(f->name) || diagnostics.hasErrors()) checkFunction(input, *f);
  if (diagnostics.hasErrors()) return diagnostics.firstError(what);
  return programs;
}

Result<std::vector<ShaderProgram>> compileShaders(const std::string& fileName, const std::string& text,
                                                  const CompileOptions& options, Diagnostics& diagnostics) {
  PreprocessedSource source;
  const size_t before = diagnostics.all().size();
  auto programs = compileSource(fileName, text, options, source, diagnostics);
  // Messages about an included file say how it came in.
  diagnostics.edit(before, [&](Diagnostic& d) {
    if (d.hint.find("included from ") != std::string::npos) return;
    for (const SourceFile& f : source.files)
      if (f.name == d.where.file && !f.includedFrom.empty())
        d.hint += (d.hint.empty() ? "" : "; ") + f.includedFrom;
  });
  return programs;
}

Result<ShaderProgram> compileShaderFile(const std::string& path, const CompileOptions& options,
                                        Diagnostics& diagnostics, std::string_view name) {
  Result<std::string> text = readSourceFile(path);
  if (!text) {
    diagnostics.add({Severity::kError, text.error().code, {path, 0, 0}, text.error().message, "", ""});
    return std::move(text).error();
  }
  auto programs = compileShaders(path, *text, options, diagnostics);
  if (!programs) return std::move(programs).error();
  const std::string stem = std::filesystem::path(path).stem().string();
  for (ShaderProgram& p : *programs)
    if (p.name == (name.empty() ? std::string_view(stem) : name)) return std::move(p);
  if (!name.empty()) return makeError(RiError::kNoShader, "{} defines no shader '{}'", path, name);
  return std::move(programs->front());
}

Result<ShaderProgram> compileShaderString(const std::string& source, const CompileOptions& options,
                                          Diagnostics& diagnostics, const std::string& fileName) {
  auto programs = compileShaders(fileName, source, options, diagnostics);
  if (!programs) return std::move(programs).error();
  return std::move(programs->front());
}

}  // namespace fr
