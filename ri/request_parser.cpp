#include "ri/request_parser.h"

#include <array>
#include <cmath>
#include <cstdlib>
#include <utility>

#include "base/interrupt.h"
#include "ri/condition.h"
#include "ri/rib_text.h"

namespace fr::ri {
namespace {

// A file that is no RIB at all must not print a million lines.
constexpr int kMaxComplaints = 200;
constexpr int kMaxUndeclared = 1 << 20;  // numbers or strings in a value whose type is guessed

bool mayBeUndeclared(std::string_view context) {
  static constexpr std::string_view kContexts[] = {
      "Surface",     "Displacement", "Atmosphere",  "Interior",        "Exterior",
      "Deformation", "Imager",       "LightSource", "AreaLightSource", "user"};
  return std::find(std::begin(kContexts), std::end(kContexts), context) != std::end(kContexts);
}

bool isConditional(std::string_view name) {
  return name == "IfBegin" || name == "ElseIf" || name == "Else" || name == "IfEnd";
}

}  // namespace

RequestParser::RequestParser(Reader& reader, Lexer& lexer)
    : reader_(reader), renderer_(reader.renderer_), lexer_(lexer), outer_(renderer_.setLocator(this)) {
  lexer_.setKeepComments(reader.options_.keepComments);
}
RequestParser::~RequestParser() { renderer_.setLocator(outer_); }

void RequestParser::complain(Severity severity, RiError code, std::string message) {
  int& n = reader_.complaints_;
  if (n++ > kMaxComplaints) return;
  if (n == kMaxComplaints + 1) message = "too many problems in this input; no more of them are printed";
  SourceLocation where = lexer_.location();
  report(Error{code, severity, std::move(where), std::move(message)});
}

void RequestParser::fail(RiError code, std::string message) {
  if (failed_) return;
  failed_ = true;
  complain(Severity::kError, code, fmt::format("{}: {}", name_, message));
}
void RequestParser::warn(RiError code, std::string message) {
  complain(Severity::kWarning, code, fmt::format("{}: {}", name_, message));
}
void RequestParser::warnOnce(RiError code, std::string message) {
  if (reader_.warned_.size() < size_t(kMaxComplaints) && reader_.warned_.insert(message).second) {
    warn(code, std::move(message));
  }
}
void RequestParser::stop(Error e) {
  stopped_ = true;
  if (!stopError_) stopError_ = std::move(e);
}

bool RequestParser::atNumber() const {
  return lexer_.kind() == TokenKind::kInteger || lexer_.kind() == TokenKind::kReal;
}
bool RequestParser::atArray() const {
  return lexer_.kind() == TokenKind::kArrayBegin || lexer_.kind() == TokenKind::kFloatArray;
}

std::string RequestParser::describeToken() const {
  switch (lexer_.kind()) {
    case TokenKind::kRequest:
      return fmt::format("{}", lexer_.text().substr(0, 60));
    case TokenKind::kInteger:
    case TokenKind::kReal:
      return fmt::format("number {}", lexer_.number());
    case TokenKind::kString:
      return fmt::format("string \"{}\"", lexer_.text().substr(0, 60));
    case TokenKind::kArrayBegin:
      return "[";
    case TokenKind::kArrayEnd:
      return "]";
    case TokenKind::kFloatArray:
      return "an array of numbers";
    case TokenKind::kBad:
      return lexer_.text();
    case TokenKind::kEnd:
      return "the end of the input";
    default:
      return "a comment";
  }
}

// Comments between arguments are kept until the request has been called: the order stays.
void RequestParser::next() {
  for (;;) {
    lexer_.advance();
    if (lexer_.kind() == TokenKind::kStructure) {
      comments_.emplace_back(RecordKind::kStructure, lexer_.text());
    } else if (lexer_.kind() == TokenKind::kComment) {
      comments_.emplace_back(RecordKind::kComment, lexer_.text());
    } else {
      if (lexer_.kind() == TokenKind::kString) stringRead();
      return;
    }
  }
}

void RequestParser::stringRead() {
  if (lexer_.takeEndedByBackslash())
    complain(Severity::kWarning, RiError::kSyntax,
             fmt::format("string \"{}\" ends in a backslash and a quotation mark; that is taken for its end "
                         "(write \"/\", or the backslash twice)",
                         lexer_.text().substr(0, 60)));
  if (!reader_.substitution_.empty()) substitute();
}

// Option "ribparse" "varsubst": $name and ${name} inside strings. Conditions look their variables up
// themselves.
void RequestParser::substitute() {
  const std::string& text = lexer_.text();
  if (text.find_first_of(reader_.substitution_) == std::string::npos || isConditional(name_) || skipping() ||
      reader_.options_.passThrough)
    return;
  std::string out;
  const auto isNameChar = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' || c == ':';
  };
  for (size_t i = 0; i < text.size();) {
    if (reader_.substitution_.find(text[i]) == std::string::npos) {
      out += text[i++];
      continue;
    }
    const bool braces = i + 1 < text.size() && text[i + 1] == '{';
    const size_t first = i + (braces ? 2 : 1);
    size_t last = first;
    while (last < text.size() && (braces ? text[last] != '}' : isNameChar(text[last]))) ++last;
    const size_t next = std::min(text.size(), last + (braces ? 1 : 0));
    const std::string name = text.substr(first, last - first);
    const Param* p = name.empty() ? nullptr : renderer_.variable(name);
    if (p && !p->strings.empty()) {
      out += p->strings[0];
    } else if (p && !p->ints.empty()) {
      out += fmt::format("{}", p->ints[0]);
    } else if (p && !p->floats.empty()) {
      out += fmt::format("{}", p->floats[0]);
    } else if (const char* e = name.empty() ? nullptr : std::getenv(name.c_str())) {
      out += e;
    } else {
      if (!name.empty())
        warnOnce(RiError::kBadToken, fmt::format("variable \"{}\" is not set; left as it stands", name));
      out.append(text, i, next - i);
    }
    i = next;
  }
  lexer_.replaceText(std::move(out));
}

void RequestParser::passVerbatim() {
  std::string text = name_;
  for (; lexer_.kind() != TokenKind::kRequest && lexer_.kind() != TokenKind::kEnd; next()) {
    if (text.back() != '[' && lexer_.kind() != TokenKind::kArrayEnd) text += ' ';
    switch (lexer_.kind()) {
      case TokenKind::kInteger:
      case TokenKind::kReal:
        appendNumber(text, lexer_.number());
        break;
      case TokenKind::kString:
        appendQuoted(text, lexer_.text());
        break;
      case TokenKind::kArrayBegin:
        text += '[';
        break;
      case TokenKind::kArrayEnd:
        text += ']';
        break;
      case TokenKind::kFloatArray:
        text += '[';
        for (const float f : lexer_.floatArray()) {
          if (text.back() != '[') text += ' ';
          appendNumber(text, f);
        }
        text += ']';
        break;
      default:
        complain(Severity::kError, RiError::kSyntax, fmt::format("{}: {}", name_, describeToken()));
    }
  }
  renderer_.archiveRecord(RecordKind::kVerbatim, std::move(text));
}

void RequestParser::flushComments() {
  for (auto& [kind, text] : comments_) renderer_.archiveRecord(kind, std::move(text));
  comments_.clear();
}

void RequestParser::skipToRequest() {
  while (lexer_.kind() != TokenKind::kRequest && lexer_.kind() != TokenKind::kEnd) next();
}

std::string RequestParser::string() {
  if (failed_) return {};
  const bool bracket = lexer_.kind() == TokenKind::kArrayBegin;
  if (bracket) next();
  if (!atString()) {
    fail(RiError::kSyntax, fmt::format("a string is expected, not {}", describeToken()));
    return {};
  }
  std::string s = lexer_.text();
  next();
  if (bracket) {
    if (lexer_.kind() != TokenKind::kArrayEnd) {
      fail(RiError::kSyntax, fmt::format("one string is expected, not {}", describeToken()));
      return {};
    }
    next();
  }
  return s;
}

double RequestParser::number() {
  double d = 0;
  numbers({&d, 1});
  return d;
}

int RequestParser::integer() {
  const double d = number();
  if (failed_) return 0;
  if (d != std::floor(d) || std::abs(d) > 2147483647.0) {
    fail(RiError::kSyntax, fmt::format("an integer is expected, not {}", d));
    return 0;
  }
  return int(d);
}

Handle RequestParser::handle() {
  if (atString()) return {string(), false};
  const int i = integer();
  return {fmt::format("{}", i), true};
}

void RequestParser::numbers(std::span<double> out) {
  if (failed_) return;
  const auto wrong = [&](size_t actual) {
    fail(RiError::kSyntax, fmt::format("{} number{} expected, {} found before {}", out.size(),
                                       out.size() == 1 ? " is" : "s are", actual, describeToken()));
  };
  if (lexer_.kind() == TokenKind::kFloatArray) {
    const std::vector<float>& a = lexer_.floatArray();
    if (a.size() != out.size()) return wrong(a.size());
    std::copy(a.begin(), a.end(), out.begin());
    return next();
  }
  if (lexer_.kind() == TokenKind::kArrayBegin) {
    numbers_.clear();
    if (!lexer_.readNumbers(numbers_) || numbers_.size() != out.size()) return wrong(numbers_.size());
    std::copy(numbers_.begin(), numbers_.end(), out.begin());
    keepComment();
    return;
  }
  for (size_t i = 0; i < out.size(); ++i) {
    if (!atNumber()) return wrong(i);
    out[i] = lexer_.number();
    next();
  }
}

DMat4 RequestParser::matrix() {
  std::array<double, 16> a{};
  numbers(a);
  DMat4 m;
  for (int i = 0; i < 16; ++i) m[i / 4][i % 4] = a[size_t(i)];
  return m;
}

template <class T>
std::vector<T> RequestParser::numberArray(const char* what) {
  std::vector<T> v;
  if (failed_) return v;
  if (lexer_.kind() == TokenKind::kFloatArray) {
    if constexpr (std::is_same_v<T, float>) {
      v = std::move(lexer_.floatArray());
      lexer_.floatArray().clear();
    } else {
      fail(RiError::kSyntax, "integers are expected, not an array of floats");
      return v;
    }
    next();
    return v;
  }
  if (lexer_.kind() == TokenKind::kArrayBegin) {
    if (!lexer_.readNumbers(v)) {
      fail(RiError::kSyntax, fmt::format("{} are expected, not {}", what, describeToken()));
      return v;
    }
    keepComment();
    return v;
  }
  if (!atNumber()) {
    fail(RiError::kSyntax, fmt::format("{} are expected, not {}", what, describeToken()));
    return v;
  }
  const double d = lexer_.number();
  if (std::is_same_v<T, int> && (d != std::floor(d) || std::abs(d) > 2147483647.0)) {
    fail(RiError::kSyntax, fmt::format("{} are expected, not {}", what, describeToken()));
    return v;
  }
  v.push_back(T(d));
  next();
  return v;
}

std::vector<float> RequestParser::floats() { return numberArray<float>("numbers"); }
std::vector<int> RequestParser::ints() { return numberArray<int>("integers"); }

std::vector<std::string> RequestParser::strings() {
  std::vector<std::string> v;
  if (failed_) return v;
  if (atString()) {
    v.push_back(lexer_.text());
    next();
    return v;
  }
  if (lexer_.kind() != TokenKind::kArrayBegin) {
    fail(RiError::kSyntax, fmt::format("strings are expected, not {}", describeToken()));
    return v;
  }
  next();
  while (atString()) {
    v.push_back(lexer_.text());
    next();
  }
  if (lexer_.kind() != TokenKind::kArrayEnd) {
    fail(RiError::kSyntax, fmt::format("strings are expected, not {}", describeToken()));
    return v;
  }
  next();
  return v;
}

// After a value that could not be used: past its closing bracket, or to the next token.
void RequestParser::skipValue() {
  if (lexer_.kind() != TokenKind::kArrayBegin) {
    if (atNumber() || atString() || lexer_.kind() == TokenKind::kFloatArray) next();
    return;
  }
  while (lexer_.kind() != TokenKind::kArrayEnd && lexer_.kind() != TokenKind::kEnd &&
         lexer_.kind() != TokenKind::kRequest) {
    next();
  }
  if (lexer_.kind() == TokenKind::kArrayEnd) next();
}

// The same when reading the value has already begun; inBracket_ says how.
void RequestParser::skipRestOfValue() {
  if (!inBracket_) {
    if (atNumber() || atString() || lexer_.kind() == TokenKind::kFloatArray) next();
    return;
  }
  while (lexer_.kind() != TokenKind::kArrayEnd && lexer_.kind() != TokenKind::kEnd &&
         lexer_.kind() != TokenKind::kRequest) {
    next();
  }
  if (lexer_.kind() == TokenKind::kArrayEnd) next();
}

// Fills the value. False: reported, the rest of the value skipped, nothing of the request lost but this.
bool RequestParser::value(Param& p) {
  switch (p.declaration.type) {
    case ValueType::kString:
      p.strings = strings();
      break;
    case ValueType::kInteger:
      p.ints = ints();
      break;
    default:
      p.floats = floats();
      break;
  }
  if (!failed_) return true;
  failed_ = false;
  skipRestOfValue();
  return false;
}

// readNumbers() stops at whatever stands behind the array, comments too.
void RequestParser::keepComment() {
  if (lexer_.kind() != TokenKind::kStructure && lexer_.kind() != TokenKind::kComment) return;
  comments_.emplace_back(
      lexer_.kind() == TokenKind::kStructure ? RecordKind::kStructure : RecordKind::kComment, lexer_.text());
  next();
}

// A value whose type only its reader knows: numbers or strings. Only the shader can tell three floats from a
// colour; shading/ binds them as what the parameter is. False: the value was skipped.
bool RequestParser::undeclaredValue(Param& p) {
  p.declaration.storage = StorageClass::kUniform;
  p.declaration.type = ValueType::kFloat;
  if (lexer_.kind() == TokenKind::kArrayBegin) {
    inBracket_ = true;
    if (lexer_.readNumbers(p.floats)) {
      keepComment();
    } else {
      if (p.floats.empty() && atString()) {
        stringRead();  // readNumbers() came upon it
        p.declaration.type = ValueType::kString;
        for (; atString(); next()) p.strings.push_back(lexer_.text());
      }
      const bool whole = !p.strings.empty() && lexer_.kind() == TokenKind::kArrayEnd;
      skipRestOfValue();
      if (!whole) return false;
    }
  } else if (atString()) {
    p.declaration.type = ValueType::kString;
    p.strings = strings();
  } else if (atNumber() || atArray()) {
    p.floats = floats();
  }
  const size_t n = p.elementCount();
  if (n == 0 || n > size_t(kMaxUndeclared)) return false;
  p.declaration.arrayLength = int(n);
  p.declaration.isArray = n > 1;
  return true;
}

ParamList RequestParser::params(std::string_view context, bool primitive, std::string first) {
  ParamList list;
  while (ok() && (!first.empty() || atString())) {
    const bool given = !first.empty();
    const std::string token = given ? std::exchange(first, {}) : lexer_.text();
    if (!given) next();
    Param p;
    Result<ParsedToken> parsed = parseToken(token);
    if (!parsed) {
      warn(RiError::kBadToken, std::move(parsed).error().message);
      skipValue();
      continue;
    }
    p.name = parsed->name;
    std::optional<Declaration> d =
        parsed->declaration ? parsed->declaration : renderer_.dictionary().find(p.name, context);
    if (!parsed->declaration) p.form = TokenForm::kBare;
    if (!d) {
      p.form = TokenForm::kUndeclared;
      if (mayBeUndeclared(context) || reader_.options_.passThrough) {
        if (undeclaredValue(p)) {
          list.set(std::move(p));
          continue;
        }
      } else {
        skipValue();
      }
      warnOnce(RiError::kBadToken, fmt::format("\"{}\" was never declared; ignored", p.name));
      continue;
    }
    p.declaration = *d;
    if (!atString() && !atNumber() && !atArray()) {
      fail(RiError::kSyntax, fmt::format("\"{}\" has no value, {} follows", p.name, describeToken()));
      break;
    }
    inBracket_ = lexer_.kind() == TokenKind::kArrayBegin;
    if (!primitive && p.form == TokenForm::kBare && d->type == ValueType::kString) {
      // Options and attributes that were strings became numbers later ("visibility" "transmission"): files
      // have both.
      if (!undeclaredValue(p)) {
        warn(RiError::kSyntax, fmt::format("\"{}\" has no value; ignored", p.name));
        continue;
      }
      if (p.floats.empty()) p.declaration = *d;
    } else if (!value(p)) {
      continue;
    }
    if (!primitive && d->type == ValueType::kColor && p.floats.size() == 1 && !d->isArray) {
      warn(RiError::kConsistency,
           fmt::format("\"{} {}\" has 1 number, expected 3; all three are that one", d->str(), p.name));
      p.floats.resize(3, p.floats[0]);
    }
    if (!primitive && p.elementCount() < d->width()) {
      warn(RiError::kConsistency, fmt::format("\"{} {}\" has {} numbers or strings, expected {}; ignored",
                                              d->str(), p.name, p.elementCount(), d->width()));
      continue;
    }
    if (const size_t extra = p.elementCount() % p.declaration.width(); !primitive && extra > 0) {
      warn(RiError::kConsistency,
           fmt::format("\"{} {}\" has {} numbers or strings, which are no whole values; the "
                       "last {} are ignored",
                       p.declaration.str(), p.name, p.elementCount(), extra));
      const auto shorten = [extra](auto& values) {
        if (values.size() >= extra) values.resize(values.size() - extra);
      };
      shorten(p.floats), shorten(p.ints), shorten(p.strings);
    }
    list.set(std::move(p));
  }
  return list;
}

void RequestParser::recordArchive(const std::string& name) {
  auto archive = std::make_shared<InlineArchive>();
  archive->file = lexer_.fileName();
  archive->text = lexer_.recordUntil("ArchiveBegin", "ArchiveEnd", archive->firstLine);
  archive->tables = std::make_shared<BinaryTables>(*lexer_.tables());
  if (lexer_.kind() != TokenKind::kRequest)
    return fail(RiError::kNesting, fmt::format("\"{}\" has no ArchiveEnd", name));
  reader_.inlineArchives_[name] = std::move(archive);
  next();
}

bool RequestParser::condition(const std::string& text) {
  if (!reader_.options_.evaluateConditions) return true;
  Result<bool> r = evaluateCondition(text, [this](std::string_view n) { return renderer_.variable(n); });
  if (r) return *r;
  fail(r.error().code, r.error().message);
  failed_ = false;
  return false;
}

void RequestParser::ifBegin(const std::string& text) {
  if (reader_.options_.passThrough) renderer_.conditional("IfBegin", text);
  Branch b;
  b.enclosing = !skipping();
  b.active = b.enclosing && condition(text);
  b.taken = b.active;
  branches_.push_back(b);
}
void RequestParser::elseIf(const std::string& text) {
  if (branches_.empty()) return fail(RiError::kNesting, "no IfBegin before it");
  if (reader_.options_.passThrough) renderer_.conditional("ElseIf", text);
  Branch& b = branches_.back();
  b.active = b.enclosing && (!b.taken || !reader_.options_.evaluateConditions) && condition(text);
  b.taken |= b.active;
}
void RequestParser::elseBranch() {
  if (branches_.empty()) return fail(RiError::kNesting, "no IfBegin before it");
  if (reader_.options_.passThrough) renderer_.conditional("Else", {});
  Branch& b = branches_.back();
  b.active = b.enclosing && (!b.taken || !reader_.options_.evaluateConditions);
  b.taken = true;
}
void RequestParser::ifEnd() {
  if (branches_.empty()) return fail(RiError::kNesting, "no IfBegin before it");
  if (reader_.options_.passThrough) renderer_.conditional("IfEnd", {});
  branches_.pop_back();
}

void RequestParser::request() {
  name_ = lexer_.text();
  lexer_.position(line_, column_);
  failed_ = false;
  if (skipping() && !isConditional(name_)) {
    next();
    skipToRequest();
    comments_.clear();
    return;
  }
  const RequestHandler handler = findRequest(name_);
  next();
  if (!handler) {
    if (reader_.warned_.size() < size_t(kMaxComplaints) && reader_.warned_.insert(name_).second) {
      const std::string_view meant = requestInOtherCase(name_);
      complain(Severity::kWarning, RiError::kBadToken,
               fmt::format("request \"{}\" is not known{}; {}", name_.substr(0, 60),
                           meant.empty() ? "" : fmt::format(" (its name is {})", meant),
                           reader_.options_.passThrough ? "passed on" : "skipped"));
    }
    if (reader_.options_.passThrough) return passVerbatim();
    skipToRequest();
    return;
  }
  handler(*this);
  if (lexer_.takeComma())
    warnOnce(RiError::kSyntax, "commas are read as blanks; a number with a decimal comma is two");
  if (lexer_.takeNonFinite()) warn(RiError::kMath, "a number of this request is not finite");
  if (ok() && lexer_.kind() != TokenKind::kRequest && lexer_.kind() != TokenKind::kEnd) {
    warn(RiError::kSyntax, fmt::format("{} is more than the request takes; skipped", describeToken()));
  }
  skipToRequest();
}

Result<void> RequestParser::run() {
  next();
  flushComments();
  while (!stopped_) {
    const TokenKind kind = lexer_.kind();
    if (kind == TokenKind::kRequest) {
      request();
      flushComments();
    } else if (kind == TokenKind::kEnd) {
      break;
    } else {
      lexer_.position(line_, column_);
      complain(Severity::kError, RiError::kSyntax,
               fmt::format("a request is expected, not {}", describeToken()));
      skipToRequest();
      flushComments();
    }
    if (interrupted()) return makeError(RiError::kNone, "stopped while the scene was read");
    if (abortRequested())
      return makeError(RiError::kNone, "stopped at the first error, as ErrorHandler asks");
  }
  flushComments();
  if (const Error* e = lexer_.inputError()) {
    Error placed = *e;
    placed.where = lexer_.location();
    report(placed);
  }
  if (!branches_.empty()) {
    name_ = "IfBegin";
    complain(Severity::kError, RiError::kNesting, fmt::format("{} IfBegin without IfEnd", branches_.size()));
  }
  if (stopError_) return *stopError_;
  return {};
}

}  // namespace fr::ri
