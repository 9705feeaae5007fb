// The C preprocessor: Boost.Wave, whose heavy headers stay in this file.
#define XXH_INLINE_ALL
#include <xxhash.h>

#include <algorithm>
#include <cstring>
#include <exception>
#include <filesystem>
#include <fstream>
#include <map>

#include "shading/source.h"

#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wall"
#pragma GCC diagnostic ignored "-Wextra"
#pragma GCC diagnostic ignored "-Wpedantic"
#pragma GCC diagnostic ignored "-Wshadow"
#pragma GCC diagnostic ignored "-Wconversion"
#pragma GCC diagnostic ignored "-Woverloaded-virtual"
#pragma GCC diagnostic ignored "-Wnon-virtual-dtor"
#include <boost/wave.hpp>
#include <boost/wave/cpplexer/cpp_lex_iterator.hpp>
#include <boost/wave/cpplexer/cpp_lex_token.hpp>
#pragma GCC diagnostic pop

namespace fr {

uint64_t hashBytes(const void* data, size_t size) { return XXH3_64bits(data, size); }

Result<std::string> readSourceFile(const std::string& path) {
  std::error_code ec;
  const auto status = std::filesystem::status(path, ec);
  if (ec || !std::filesystem::exists(status)) return makeError(RiError::kNoFile, "cannot find '{}'", path);
  if (!std::filesystem::is_regular_file(status))
    return makeError(RiError::kNoFile, "'{}' is not a file", path);
  const auto size = std::filesystem::file_size(path, ec);
  if (ec) return makeError(RiError::kNoFile, "cannot read '{}'", path);
  if (size > (16u << 20)) return makeError(RiError::kLimit, "'{}' is larger than 16 MB", path);
  std::ifstream in(path, std::ios::binary);
  std::string text(size, '\0');
  if (!in.read(text.data(), std::streamsize(size)))
    return makeError(RiError::kNoFile, "cannot read '{}'", path);
  return text;
}

SourcePlace PreprocessedSource::placeOf(size_t offset) const {
  auto it = std::upper_bound(runs.begin(), runs.end(), offset,
                             [](size_t o, const SourceRun& r) { return o < r.offset; });
  if (it == runs.begin()) return {};
  --it;
  SourcePlace p = it->place;
  p.column += uint32_t(offset - it->offset);
  return p;
}

SourceLocation PreprocessedSource::location(const SourcePlace& place) const {
  if (place.line == 0) return {files.empty() ? "" : files[0].name, 0, 0};
  return {place.file < files.size() ? files[place.file].name : "", int(place.line), int(place.column)};
}

std::string PreprocessedSource::line(const SourcePlace& place) const {
  if (place.file >= files.size() || place.line == 0) return {};
  const std::string& t = files[place.file].text;
  size_t begin = 0;
  for (uint32_t i = 1; i < place.line; ++i) {
    begin = t.find('\n', begin);
    if (begin == std::string::npos) return {};
    ++begin;
  }
  std::string r = t.substr(begin, t.find('\n', begin) - begin);
  if (r.size() > 400) r.resize(400);
  return r;
}

namespace {

/// What one run shares with the input policy and the hooks, which Wave constructs by itself.
struct RunState {
  PreprocessedSource* out;
  Diagnostics* diagnostics;
  const PreprocessOptions* options;
  size_t expansions = 0;
  bool stopped = false;  // by an error that was reported
  std::map<std::string, uint32_t> fileIndex;
  std::vector<std::string> includeChain;

  uint32_t fileOf(const std::string& name) {
    auto it = fileIndex.find(name);
    if (it != fileIndex.end()) return it->second;
    // Wave writes one file's name in several ways (relative, absolute, with "./").
    std::error_code ec;
    const std::string canonical =
        std::filesystem::weakly_canonical(std::filesystem::absolute(name, ec), ec).string();
    if (!ec) {
      it = fileIndex.find(canonical);
      if (it != fileIndex.end()) return fileIndex.emplace(name, it->second).first->second;
    }
    const uint32_t i = uint32_t(out->files.size());
    if (!ec) fileIndex.emplace(canonical, i);
    if (i >= 4095) return 4094;
    out->files.push_back({name, "", 0});
    fileIndex.emplace(name, i);
    return i;
  }
  void add(Severity severity, RiError code, const std::string& file, size_t line, size_t column,
           std::string message, const std::string& hint = {}) {
    Diagnostic d;
    d.severity = severity;
    d.code = code;
    const SourcePlace place{fileOf(file), uint32_t(line), uint32_t(column)};
    d.where = out->location(place);
    d.sourceLine = out->line(place);
    d.message = std::move(message);
    d.hint = chain();
    if (!hint.empty()) d.hint = hint + (d.hint.empty() ? "" : "; ") + d.hint;
    diagnostics->add(std::move(d));
  }
  void addOpenComment(const std::string& file);
  void addOpenCondition(const std::string& file);
  std::string chain() const {
    std::string r;
    for (size_t i = includeChain.size(); i-- > 1;)
      r += (r.empty() ? "included from " : ", from ") + includeChain[i - 1];
    return r;
  }
};
thread_local RunState* tRun = nullptr;

struct LimitReached : std::exception {};

/// `# 12 "file" flags`, which compilers' own preprocessors leave, is `#line 12 "file"`; `#ident "version"` is
/// nothing. Folders of #include are separated by '/', whatever the system on which they were written.
std::string withLineDirectives(const std::string& t) {
  std::string r;
  r.reserve(t.size());
  for (size_t i = 0; i < t.size();) {
    const size_t end = std::min(t.find('\n', i), t.size());
    const size_t sign = t.find_first_not_of(" \t", i);
    const size_t number = sign < end && t[sign] == '#' ? t.find_first_not_of(" \t", sign + 1) : end;
    if (number < end && t[number] >= '0' && t[number] <= '9') {
      const std::string_view line(t.data() + number, end - number);
      const size_t quote = line.rfind('"');
      r += "#line ";
      r += quote == std::string_view::npos ? line : line.substr(0, quote + 1);
    } else if (number < end && t.compare(number, 7, "include") == 0) {
      std::string line = t.substr(i, end - i);
      std::replace(line.begin(), line.end(), '\\', '/');
      r += line;
    } else if (number >= end ||
               !(t.compare(number, 6, "ident ") == 0 || t.compare(number, 5, "sccs ") == 0)) {
      r.append(t, i, end - i);
    }
    if (end < t.size()) r += '\n';
    i = end + 1;
  }
  return r;
}

/// Where the comment begins that has no end: offset, or npos.
size_t openComment(std::string_view t) {
  for (size_t i = 0; i + 1 < t.size(); ++i) {
    if (t[i] == '"') {
      for (++i; i < t.size() && t[i] != '"' && t[i] != '\n'; ++i)
        if (t[i] == '\\') ++i;
    } else if (t[i] == '/' && t[i + 1] == '/') {
      i = std::min(t.find('\n', i), t.size());
    } else if (t[i] == '/' && t[i + 1] == '*') {
      const size_t end = t.find("*/", i + 2);
      if (end == std::string_view::npos) return i;
      i = end + 1;
    }
  }
  return std::string_view::npos;
}

/// The line of the last #if, #ifdef or #ifndef without an #endif; 0: there is none.
size_t openCondition(std::string_view t) {
  std::vector<size_t> open;
  size_t line = 1;
  for (size_t i = 0; i < t.size(); ++line) {
    const size_t end = std::min(t.find('\n', i), t.size());
    std::string_view text = t.substr(i, end - i);
    const size_t sign = text.find_first_not_of(" \t");
    if (sign != std::string_view::npos && text[sign] == '#') {
      text.remove_prefix(std::min(text.find_first_not_of(" \t", sign + 1), text.size()));
      if (text.substr(0, 2) == "if") open.push_back(line);
      if (text.substr(0, 5) == "endif" && !open.empty()) open.pop_back();
    }
    i = end + 1;
  }
  return open.empty() ? 0 : open.back();
}

/// Line ends become '\n', the last line gets one; a backslash before blanks at the end of a line continues it
/// as well. Bytes that are neither text nor part of a string or comment are Wave's to complain about.
std::string normalised(std::string t) {
  std::string r;
  r.reserve(t.size() + 1);
  for (size_t i = 0; i < t.size(); ++i) {
    if (t[i] == '\r') {
      if (i + 1 < t.size() && t[i + 1] == '\n') continue;
      r += '\n';
    } else if (t[i] == '\0') {
      r += ' ';
    } else if (t[i] == '\\') {
      // Blanks up to the end of the line go.
      size_t next = i + 1;
      while (next < t.size() && (t[next] == ' ' || t[next] == '\t')) ++next;
      r += '\\';
      if (next < t.size() && (t[next] == '\n' || t[next] == '\r')) i = next - 1;
    } else {
      r += t[i];
    }
  }
  if (r.starts_with("\xef\xbb\xbf")) r.erase(0, 3);
  if (r.empty() || r.back() != '\n') r += '\n';
  return withLineDirectives(r);
}

/// Wave's words without the severity in front, which is said anyway.
std::string withoutSeverity(std::string text) {
  for (const char* prefix : {"fatal error: ", "error: ", "warning: ", "remark: "})
    if (text.starts_with(prefix)) return text.substr(std::strlen(prefix));
  return text;
}

/// Wave parses #if by recursion: a line of a thousand parentheses must not reach it.
bool conditionsAreShallow(const std::string& t) {
  size_t i = 0;
  while (i < t.size()) {
    size_t end = i;
    while ((end = t.find('\n', end)) != std::string::npos && end > 0 && t[end - 1] == '\\') ++end;
    if (end == std::string::npos) end = t.size();
    const size_t first = t.find_first_not_of(" \t", i);
    if (first < end && t[first] == '#') {
      const size_t deep = size_t(std::count_if(t.begin() + long(first), t.begin() + long(end), [](char c) {
        return c == '(' || c == '!' || c == '~' || c == '-' || c == '+' || c == '?';
      }));
      const size_t word = t.find_first_not_of(" \t", first + 1);
      if (deep > 500 && word < end && (t.compare(word, 2, "if") == 0 || t.compare(word, 4, "elif") == 0))
        return false;
    }
    i = end + 1;
  }
  return true;
}

void RunState::addOpenComment(const std::string& file) {
  const std::string& text = out->files[fileOf(file)].text;
  const size_t at = std::min(openComment(text), text.size());
  const size_t lineStart = at == 0 ? 0 : text.rfind('\n', at - 1) + 1;
  add(Severity::kError, RiError::kSyntax, file,
      1 + size_t(std::count(text.begin(), text.begin() + long(at), '\n')), at - lineStart + 1,
      "comment without an end");
}

void RunState::addOpenCondition(const std::string& file) {
  add(Severity::kError, RiError::kSyntax, file, openCondition(out->files[fileOf(file)].text), 1,
      "this condition has no #endif");
}

struct InputPolicy {
  template <class Context>
  class inner {
   public:
    template <class Position>
    static void init_iterators(Context& c, const Position& at, boost::wave::language_support language) {
      const std::string name(c.filename.c_str());
      Result<std::string> text = readSourceFile(name);
      if (text && !conditionsAreShallow(*text))
        text = makeError(RiError::kLimit, "'{}': #if nested too deeply", name);
      if (!text) {
        if (tRun)
          tRun->add(Severity::kError, text.error().code, std::string(at.get_file().c_str()), at.get_line(),
                    at.get_column(), text.error().message);
        c.instring = "\n";
      } else {
        const uint64_t hash = hashBytes(text->data(), text->size());
        c.instring = normalised(std::move(*text));
        if (tRun) {
          const uint32_t i = tRun->fileOf(name);
          tRun->out->files[i].text = c.instring;
          tRun->out->files[i].hash = hash;
        }
      }
      using Iterator = typename Context::iterator_type;
      c.first = Iterator(c.instring.begin(), c.instring.end(), Position(c.filename), language);
      c.last = Iterator();
    }

   private:
    std::string instring;
  };
};

struct Hooks : boost::wave::context_policies::default_preprocessing_hooks {
  template <class Context, class Token, class Container, class Iterator>
  bool expanding_function_like_macro(const Context&, const Token&, const std::vector<Token>&,
                                     const Container& body, const Token&,
                                     const std::vector<Container>& arguments, const Iterator&,
                                     const Iterator&) {
    size_t n = body.size() + 1;
    for (const Container& a : arguments) n += a.size();
    return count(n);
  }
  template <class Context, class Token, class Container>
  bool expanding_object_like_macro(const Context&, const Token&, const Container& body, const Token&) {
    return count(body.size() + 1);
  }
  template <class Context>
  void opened_include_file(const Context&, const std::string& relative, const std::string& absolute, bool) {
    if (!tRun) return;
    tRun->includeChain.push_back(relative);
    SourceFile& file = tRun->out->files[tRun->fileOf(absolute)];
    if (file.includedFrom.empty()) file.includedFrom = tRun->chain();
  }
  template <class Context>
  void returning_from_include_file(const Context&) {
    if (tRun && tRun->includeChain.size() > 1) tRun->includeChain.pop_back();
  }
  template <class Context, class Exception>
  void throw_exception(const Context&, const Exception& e) {
    const int severity = int(e.get_severity());
    std::string text = withoutSeverity(e.description());
    // Wave goes on after a broken _Pragma with a token that is not there, and reads on behind an open
    // comment.
    const bool fatal = severity >= int(boost::wave::util::severity_fatal) || !e.is_recoverable() ||
                       text.find("_Pragma") != std::string::npos ||
                       text.find("Unterminated 'C' style comment") != std::string::npos;
    if (tRun && text.find("Unterminated 'C' style comment") != std::string::npos) {
      tRun->addOpenComment(e.file_name());
    } else if (tRun && text.find("missing #endif") != std::string::npos) {
      tRun->addOpenCondition(e.file_name());
    } else if (tRun) {
      const bool error = fatal || severity >= int(boost::wave::util::severity_error);
      std::replace(text.begin(), text.end(), '\n', ' ');
      const bool include = text.find("could not find include file") != std::string::npos;
      tRun->add(error ? Severity::kError : Severity::kWarning, RiError::kSyntax, e.file_name(), e.line_no(),
                e.column_no(), text, include ? "folders to look in are given with -I" : "");
    }
    if (tRun && fatal) tRun->stopped = true;
    if (fatal) boost::throw_exception(e);
  }

 private:
  static bool count(size_t n) {
    if (tRun && (tRun->expansions += n) > tRun->options->maxMacroExpansions) throw LimitReached();
    return false;
  }
};

using Token = boost::wave::cpplexer::lex_token<>;
using LexIterator = boost::wave::cpplexer::lex_iterator<Token>;
using Context = boost::wave::context<std::string::const_iterator, LexIterator, InputPolicy, Hooks>;

void setUp(Context& ctx, const PreprocessOptions& options) {
  using namespace boost::wave;
  ctx.set_language(language_support(support_c99 | support_option_emit_pragma_directives |
                                    support_option_no_character_validation |
                                    support_option_insert_whitespace));
  ctx.set_max_include_nesting_depth(options.maxIncludeDepth);
  for (const std::string& path : options.includePaths) {
    ctx.add_sysinclude_path(path.c_str());
    ctx.add_include_path(path.c_str());
  }
  std::vector<std::string> defines{"FRANKENRENDER=1", "BMRT=1"};
  for (const std::string& d : options.defines) {
    if (d.starts_with('!')) {
      std::erase_if(defines, [&](const std::string& o) { return o.starts_with(d.substr(1) + "="); });
    } else {
      defines.push_back(d.find('=') == std::string::npos ? d + "=1" : d);
    }
  }
  for (const std::string& d : defines) ctx.add_macro_definition(d.c_str());
}

void copyTokens(Context& ctx, RunState& run) {
  PreprocessedSource& out = *run.out;
  std::string lastName;
  uint32_t lastFile = 0;
  for (auto it = ctx.begin(), end = ctx.end(); it != end; ++it) {
    const Token& token = *it;
    const auto& text = token.get_value();
    if (text.empty()) continue;
    // Tokens of a macro body carry the place of its definition.
    const auto& at = token.get_position();
    const std::string name(at.get_file().c_str());
    if (name != lastName) {
      lastName = name;
      lastFile = run.fileOf(name);
    }
    if (out.text.size() + text.size() > run.options->maxOutputBytes) throw LimitReached();
    out.runs.push_back(
        {uint32_t(out.text.size()), {lastFile, uint32_t(at.get_line()), uint32_t(at.get_column())}});
    out.text.append(text.c_str(), text.size());
  }
}

}  // namespace

bool preprocess(const std::string& fileName, std::string text, const PreprocessOptions& options,
                PreprocessedSource& out, Diagnostics& diagnostics) {
  out = {};
  const uint64_t hash = hashBytes(text.data(), text.size());
  const std::string source = normalised(std::move(text));
  RunState run{&out, &diagnostics, &options, 0, false, {}, {fileName}};
  out.files.clear();
  run.fileOf(fileName);
  out.files[0] = {fileName, source, hash};
  const size_t errorsBefore = diagnostics.errorCount();
  if (!conditionsAreShallow(source)) {
    run.add(Severity::kError, RiError::kLimit, fileName, 0, 0, "#if nested too deeply");
    return false;
  }
  RunState* const outer = tRun;
  tRun = &run;
  bool complete = false;
  try {
    Context ctx(source.begin(), source.end(), fileName.c_str());
    setUp(ctx, options);
    copyTokens(ctx, run);
    complete = true;
  } catch (const LimitReached&) {
    run.add(Severity::kError, RiError::kLimit, fileName, 0, 0,
            "macros expand to too much text (a macro that doubles itself?)");
  } catch (const boost::wave::cpp_exception& e) {
    if (!run.stopped)
      run.add(Severity::kError, RiError::kSyntax, e.file_name(), e.line_no(), e.column_no(),
              withoutSeverity(e.description()));
  } catch (const boost::wave::cpplexer::lexing_exception& e) {
    if (!run.stopped)
      run.add(Severity::kError, RiError::kSyntax, e.file_name(), e.line_no(), e.column_no(),
              withoutSeverity(e.description()));
  } catch (const std::exception& e) {
    run.add(Severity::kError, RiError::kSyntax, fileName, 0, 0, fmt::format("preprocessor: {}", e.what()));
  }
  tRun = outer;
  return complete && diagnostics.errorCount() == errorsBefore;
}

}  // namespace fr
