#include "shading/diagnostics.h"

#include <algorithm>

namespace fr {

std::string Diagnostic::str() const {
  const char* kind = severity >= Severity::kError     ? "error"
                     : severity == Severity::kWarning ? "warning"
                                                      : "note";
  const std::string place = where.str();
  std::string r = place.empty() ? fmt::format("{}: {}\n", kind, message)
                                : fmt::format("{}: {}: {}\n", place, kind, message);
  if (!sourceLine.empty()) {
    // Programs write lines of any length: what stands around the place is enough.
    constexpr size_t kBefore = 100, kShown = 160;
    const size_t column = size_t(std::max(where.column, 1)) - 1;
    const size_t from = sourceLine.size() <= kShown
                            ? 0
                            : std::min(column - std::min(column, kBefore), sourceLine.size() - kShown);
    const std::string line = (from > 0 ? "... " : "") + sourceLine.substr(from, kShown) +
                             (from + kShown < sourceLine.size() ? " ..." : "");
    r += "  " + line + "\n";
    if (where.column > 0 && size_t(where.column) <= sourceLine.size() + 1) {
      std::string pad = line.substr(0, column - from + (from > 0 ? 4 : 0));
      for (char& c : pad)
        if (c != '\t') c = ' ';
      r += "  " + pad + "^\n";
    }
  }
  if (!hint.empty()) r += "  hint: " + hint + "\n";
  return r;
}

void Diagnostics::add(Diagnostic d) {
  for (const Diagnostic& o : all_)
    if (o.where.line == d.where.line && o.where.column == d.where.column && o.message == d.message &&
        o.where.file == d.where.file)
      return;
  (d.severity >= Severity::kError ? errors_ : warnings_)++;
  if (all_.size() < kMaxKept) all_.push_back(std::move(d));
}

std::string Diagnostics::str() const {
  std::string r;
  for (const Diagnostic& d : all_) r += d.str();
  const size_t more = errors_ + warnings_ - all_.size();
  if (more) r += fmt::format("and {} more messages\n", more);
  return r;
}

Error Diagnostics::firstError(std::string_view what) const {
  for (const Diagnostic& d : all_) {
    if (d.severity < Severity::kError) continue;
    std::string message = d.message;
    if (errors_ > 1) message += fmt::format(" (and {} more errors)", errors_ - 1);
    return Error{d.code, d.severity, d.where, fmt::format("{}: {}", what, message)};
  }
  return makeError(RiError::kBug, "{}: failed without a message", what);
}

NearestWord::NearestWord(std::string_view word)
    : word_(word), distance_(word.size() < 3 ? 1 : word.size() / 3 + 2) {}

void NearestWord::offer(std::string_view c) {
  if (c.size() > 64 || word_.size() > 64) return;
  size_t row[66];
  for (size_t j = 0; j <= c.size(); ++j) row[j] = j;
  for (size_t i = 1; i <= word_.size(); ++i) {
    size_t diagonal = row[0];
    row[0] = i;
    for (size_t j = 1; j <= c.size(); ++j) {
      const size_t up = row[j];
      row[j] = std::min({up + 1, row[j - 1] + 1, diagonal + (word_[i - 1] == c[j - 1] ? 0 : 1)});
      diagonal = up;
    }
  }
  if (row[c.size()] < distance_) {
    distance_ = row[c.size()];
    best_ = c;
  }
}

std::string NearestWord::hint() const {
  return best_.empty() ? "" : fmt::format("did you mean '{}'?", best_);
}

}  // namespace fr
