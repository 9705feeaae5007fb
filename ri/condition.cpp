#include "ri/condition.h"

#include <fast_float/fast_float.h>

#include <cctype>
#include <cmath>
#include <optional>
#include <string>

namespace fr::ri {
namespace {

constexpr int kMaxDepth = 64;

struct Value {
  std::string text;
  std::optional<double> number;
  bool truth() const { return number ? *number != 0 : !text.empty(); }
};

Value fromNumber(double d) { return {fmt::format("{}", d), d}; }
Value fromText(std::string s) {
  Value v{std::move(s), std::nullopt};
  double d = 0;
  const char* end = v.text.data() + v.text.size();
  const auto r = fast_float::from_chars(v.text.data(), end, d);
  if (r.ec == std::errc() && r.ptr == end && !v.text.empty()) v.number = d;
  return v;
}
Value fromParam(const Param* p) {
  if (!p) return {};
  if (!p->strings.empty()) return fromText(p->strings[0]);
  if (!p->ints.empty()) return fromNumber(p->ints[0]);
  if (!p->floats.empty()) return fromNumber(p->floats[0]);
  return {};
}

// Glob matching for =~: '*' and '?'; linear in practice (one star is remembered).
bool globMatch(std::string_view s, std::string_view p) {
  size_t i = 0, j = 0, star = std::string_view::npos, mark = 0;
  while (i < s.size()) {
    if (j < p.size() && (p[j] == '?' || p[j] == s[i])) {
      ++i, ++j;
    } else if (j < p.size() && p[j] == '*') {
      star = j++;
      mark = i;
    } else if (star != std::string_view::npos) {
      j = star + 1;
      i = ++mark;
    } else {
      return false;
    }
  }
  while (j < p.size() && p[j] == '*') ++j;
  return j == p.size();
}

class Evaluator {
 public:
  Evaluator(std::string_view s, const VariableLookup& lookup) : s_(s), lookup_(lookup) {}

  Result<bool> run() {
    Value v = orExpression();
    blank();
    if (!failed_ && at_ < s_.size()) fail();
    if (failed_)
      return makeError(RiError::kSyntax, "condition \"{}\": unexpected text at character {}", s_,
                       failedAt_ + 1);
    return v.truth();
  }

 private:
  void fail() {
    if (!failed_) failedAt_ = at_;
    failed_ = true;
    at_ = s_.size();
  }
  void blank() {
    while (at_ < s_.size() && std::isspace(static_cast<unsigned char>(s_[at_]))) ++at_;
  }
  bool take(std::string_view op) {
    blank();
    if (s_.substr(at_, op.size()) != op) return false;
    at_ += op.size();
    return true;
  }
  std::string_view word(bool braces) {
    const size_t from = at_;
    const auto part = [&](char c) {
      return std::isalnum(static_cast<unsigned char>(c)) || c == '_' || c == ':' || (braces && c != '}');
    };
    while (at_ < s_.size() && part(s_[at_])) ++at_;
    return s_.substr(from, at_ - from);
  }

  Value orExpression() {
    Value a = andExpression();
    while (take("||")) {
      const Value b = andExpression();
      a = fromNumber(a.truth() || b.truth());
    }
    return a;
  }
  Value andExpression() {
    Value a = comparison();
    while (take("&&")) {
      const Value b = comparison();
      a = fromNumber(a.truth() && b.truth());
    }
    return a;
  }
  Value comparison() {
    Value a = sum();
    for (const char* op : {"==", "!=", "<=", ">=", "=~", "<", ">"}) {
      if (!take(op)) continue;
      const Value b = sum();
      if (op[1] == '~') return fromNumber(globMatch(a.text, b.text));
      int order = a.text.compare(b.text);
      // An unset variable equals 0, as integer variables of exporters expect.
      if ((a.number || a.text.empty()) && (b.number || b.text.empty()) && (a.number || b.number)) {
        const double x = a.number.value_or(0), y = b.number.value_or(0);
        order = x < y ? -1 : x > y ? 1 : 0;
      }
      switch (op[0]) {
        case '=':
          return fromNumber(order == 0);
        case '!':
          return fromNumber(order != 0);
        case '<':
          return fromNumber(op[1] ? order <= 0 : order < 0);
        default:
          return fromNumber(op[1] ? order >= 0 : order > 0);
      }
    }
    return a;
  }
  Value sum() {
    Value a = product();
    for (;;) {
      if (take("+")) {
        a = fromNumber(a.number.value_or(0) + product().number.value_or(0));
      } else if (take("-")) {
        a = fromNumber(a.number.value_or(0) - product().number.value_or(0));
      } else {
        return a;
      }
    }
  }
  Value product() {
    Value a = unary();
    for (;;) {
      if (take("*")) {
        a = fromNumber(a.number.value_or(0) * unary().number.value_or(0));
      } else if (take("/")) {
        const double d = unary().number.value_or(0);
        a = fromNumber(d != 0 ? a.number.value_or(0) / d : 0);
      } else {
        return a;
      }
    }
  }
  Value unary() {
    if (++depth_ > kMaxDepth) {
      fail();
      return {};
    }
    Value v = primary();
    --depth_;
    return v;
  }
  Value primary() {
    blank();
    if (at_ >= s_.size()) {
      fail();
      return {};
    }
    const char c = s_[at_];
    if (c == '!' && s_.substr(at_, 2) != "!=") {
      ++at_;
      return fromNumber(!unary().truth());
    }
    if (c == '-') {
      ++at_;
      return fromNumber(-unary().number.value_or(0));
    }
    if (c == '(') {
      ++at_;
      Value v = orExpression();
      if (!take(")")) fail();
      return v;
    }
    if (c == '\'' || c == '"') {
      const size_t close = s_.find(c, at_ + 1);
      if (close == std::string_view::npos) {
        fail();
        return {};
      }
      Value v = fromText(std::string(s_.substr(at_ + 1, close - at_ - 1)));
      at_ = close + 1;
      return v;
    }
    if (c == '$') return fromParam(lookup_(variableName()));
    if (std::isdigit(static_cast<unsigned char>(c)) || c == '.') {
      double d = 0;
      const auto r = fast_float::from_chars(s_.data() + at_, s_.data() + s_.size(), d);
      if (r.ec != std::errc()) {
        fail();
        return {};
      }
      at_ = size_t(r.ptr - s_.data());
      return fromNumber(d);
    }
    const std::string_view w = word(false);
    if (w.empty()) {
      fail();
      return {};
    }
    if (w == "defined" && take("(")) {
      blank();
      const bool set = lookup_(variableName()) != nullptr;
      if (!take(")")) fail();
      return fromNumber(set);
    }
    return fromText(std::string(w));
  }
  std::string_view variableName() {
    if (at_ < s_.size() && s_[at_] == '$') ++at_;
    if (at_ < s_.size() && s_[at_] == '{') {
      ++at_;
      const std::string_view w = word(true);
      if (!take("}")) fail();
      return w;
    }
    return word(false);
  }

  std::string_view s_;
  const VariableLookup& lookup_;
  size_t at_ = 0;
  int depth_ = 0;
  bool failed_ = false;
  size_t failedAt_ = 0;
};

}  // namespace

Result<bool> evaluateCondition(std::string_view text, const VariableLookup& lookup) {
  return Evaluator(text, lookup).run();
}

}  // namespace fr::ri
