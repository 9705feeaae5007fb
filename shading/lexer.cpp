#include "shading/lexer.h"

#include <charconv>
#include <cstring>

namespace fr {
namespace {

bool isWordStart(char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_'; }
bool isDigit(char c) { return c >= '0' && c <= '9'; }

/// Types of shaders are none: they begin a shader, and are names like others inside (color light = 1).
bool isKeyword(std::string_view w) {
  static const std::set<std::string_view> kWords{
      "float",   "point",   "vector",   "normal",      "color",      "string", "matrix", "void",
      "uniform", "varying", "output",   "extern",      "if",         "else",   "while",  "for",
      "return",  "break",   "continue", "illuminance", "illuminate", "solar",  "gather"};
  return kWords.count(w) != 0;
}

class Lexer {
 public:
  Lexer(const PreprocessedSource& source, Diagnostics& diagnostics, NoLintLines& noLint)
      : source_(source), text_(source.text), diagnostics_(diagnostics), noLint_(noLint) {}

  std::vector<SlToken> run() {
    while (skipBlank()) one();
    SlToken end;
    end.place = text_.empty() ? SourcePlace{} : source_.placeOf(text_.size() - 1);
    tokens_.push_back(end);
    return std::move(tokens_);
  }

 private:
  char at(size_t i) const { return i < text_.size() ? text_[i] : '\0'; }

  void error(size_t offset, std::string message, std::string hint = {}) {
    const SourcePlace place = source_.placeOf(offset);
    diagnostics_.add({Severity::kError, RiError::kSyntax, source_.location(place), std::move(message),
                      std::move(hint), source_.line(place)});
  }

  bool skipBlank() {
    for (;;) {
      const char c = at(i_);
      if (i_ >= text_.size()) return false;
      if (c == '\n') lineStart_ = true;
      if (c == ' ' || c == '\t' || c == '\n' || c == '\r' || c == '\f' || c == '\v') {
        ++i_;
      } else if (c == '/' && at(i_ + 1) == '/') {
        i_ = std::min(text_.find('\n', i_), text_.size());
      } else if (c == '/' && at(i_ + 1) == '*') {
        const size_t end = text_.find("*/", i_ + 2);
        if (end == std::string::npos) error(i_, "comment without an end");
        i_ = end == std::string::npos ? text_.size() : end + 2;
      } else if (c == '#' && lineStart_) {
        directive();
      } else {
        lineStart_ = false;
        return true;
      }
    }
  }

  // What the preprocessor leaves: #pragma. `#pragma nolint [n]` silences the next n lines (1 without n).
  void directive() {
    const size_t end = std::min(text_.find('\n', i_), text_.size());
    std::string line = text_.substr(i_, end - i_);
    const size_t word = line.find("nolint");
    if (line.find("pragma") != std::string::npos && word != std::string::npos) {
      const long n = std::clamp(std::strtol(line.c_str() + word + 6, nullptr, 10), 1l, 100000l);
      const SourcePlace p = source_.placeOf(i_);
      for (long k = 1; k <= n; ++k) noLint_.insert(uint64_t(p.file) << 32 | (p.line + uint64_t(k)));
    }
    i_ = end;
  }

  void one() {
    SlToken t;
    t.place = source_.placeOf(i_);
    const size_t begin = i_;
    const char c = at(i_);
    if (isWordStart(c)) {
      size_t j = i_;
      while (isWordStart(at(j)) || isDigit(at(j))) ++j;
      t.text = text_.substr(i_, j - i_);
      t.kind = isKeyword(t.text) ? TokenKind::kKeyword : TokenKind::kIdentifier;
      i_ = j;
    } else if (isDigit(c) || (c == '.' && isDigit(at(i_ + 1)))) {
      t.kind = TokenKind::kNumber;
      number(t);
    } else if (c == '"') {
      t.kind = TokenKind::kString;
      string(t);
      if (!tokens_.empty() && tokens_.back().kind == TokenKind::kString) {
        tokens_.back().text += t.text;
        return;
      }
    } else if (!punctuation(t)) {
      const unsigned char b = static_cast<unsigned char>(c);
      error(i_,
            b >= 32 && b < 127 ? fmt::format("unexpected character '{}'", c)
                               : fmt::format("unexpected byte 0x{:02x}", b),
            c == '&' || c == '|' ? "there are no operations on bits; conditions are joined with && and ||"
            : c == '\''          ? "strings stand between double quotes"
                                 : "");
      ++i_;
      return;
    }
    t.length = uint32_t(i_ - begin);
    tokens_.push_back(std::move(t));
  }

  void number(SlToken& t) {
    size_t j = i_;
    if (at(j) == '0' && (at(j + 1) == 'x' || at(j + 1) == 'X')) {
      unsigned long long v = 0;
      const auto r = std::from_chars(text_.data() + i_ + 2, text_.data() + text_.size(), v, 16);
      if (r.ec != std::errc() || r.ptr == text_.data() + i_ + 2) error(i_, "bad hexadecimal number");
      t.number = double(v);
      i_ = std::max(size_t(r.ptr - text_.data()), i_ + 2);
      return;
    }
    while (isDigit(at(j))) ++j;
    if (at(j) == '.') {
      ++j;
      while (isDigit(at(j))) ++j;
    }
    if (at(j) == 'e' || at(j) == 'E') {
      size_t k = j + 1;
      if (at(k) == '+' || at(k) == '-') ++k;
      if (isDigit(at(k))) {
        while (isDigit(at(k))) ++k;
        j = k;
      }
    }
    const auto r = std::from_chars(text_.data() + i_, text_.data() + j, t.number);
    if (r.ec == std::errc::result_out_of_range) {
      // Too small or too large for a double: strtod gives 0 or infinity.
      t.number = std::strtod(text_.substr(i_, j - i_).c_str(), nullptr);
    }
    if (t.number > 3.4028234e38) {
      error(i_, "number too large");
      t.number = 3.4028234e38;
    }
    if (at(j) == 'f' || at(j) == 'F') ++j;  // C habit
    if (isWordStart(at(j))) {
      size_t k = j;
      while (isWordStart(at(k)) || isDigit(at(k))) ++k;
      error(i_, fmt::format("'{}' is not a number", text_.substr(i_, k - i_)));
      j = k;
    }
    i_ = j;
  }

  void string(SlToken& t) {
    size_t j = i_ + 1;
    for (;; ++j) {
      const char c = at(j);
      if (j >= text_.size() || c == '\n') {
        error(i_, "string without an end");
        break;
      }
      if (c == '"') {
        ++j;
        break;
      }
      if (c != '\\') {
        t.text += c;
        continue;
      }
      const char e = at(++j);
      switch (e) {
        case 'n':
          t.text += '\n';
          break;
        case 't':
          t.text += '\t';
          break;
        case 'r':
          t.text += '\r';
          break;
        case 'b':
          t.text += '\b';
          break;
        case 'f':
          t.text += '\f';
          break;
        case '\n':
          break;
        default:
          if (e >= '0' && e <= '7') {
            int v = 0, n = 0;
            while (n < 3 && at(j) >= '0' && at(j) <= '7') v = v * 8 + (at(j++) - '0'), ++n;
            --j;
            if (v > 0 && v < 256) t.text += char(v);
          } else if (j < text_.size()) {
            t.text += e;
          }
      }
    }
    i_ = std::min(j, text_.size());
  }

  bool punctuation(SlToken& t) {
    static constexpr const char* kTwo[] = {"<=", ">=", "==", "!=", "&&", "||", "+=", "-=", "*=", "/="};
    t.kind = TokenKind::kPunctuation;
    for (const char* two : kTwo) {
      if (at(i_) == two[0] && at(i_ + 1) == two[1]) {
        t.text = two;
        i_ += 2;
        return true;
      }
    }
    if (at(i_) == '\0' || !std::strchr("+-*/%^.<>=!?:;,(){}[]", at(i_))) return false;
    t.text = at(i_++);
    return true;
  }

  const PreprocessedSource& source_;
  const std::string& text_;
  Diagnostics& diagnostics_;
  NoLintLines& noLint_;
  std::vector<SlToken> tokens_;
  size_t i_ = 0;
  bool lineStart_ = true;
};

}  // namespace

std::vector<SlToken> tokenize(const PreprocessedSource& source, Diagnostics& diagnostics,
                              NoLintLines& noLint) {
  return Lexer(source, diagnostics, noLint).run();
}

}  // namespace fr
