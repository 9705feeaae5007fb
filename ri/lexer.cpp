#include "ri/lexer.h"

#include <fast_float/fast_float.h>

#include <algorithm>
#include <bit>
#include <cctype>
#include <cmath>
#include <cstring>
#include <limits>
#include <type_traits>

namespace fr::ri {
namespace {

constexpr size_t kWindow = size_t(256) << 10;
constexpr size_t kBehind = 8;  // bytes behind the window: a 0, and what is read together with the last ones

enum CharClass : uint8_t { kWordChar = 0, kBlank = 1, kDelimiter = 2, kHigh = 3 };

// A NUL byte counts as blank: padded files exist, and it is also the sentinel at the end of the window. So
// does 0x1a, which ends files of DOS.
constexpr std::array<uint8_t, 256> makeClasses() {
  std::array<uint8_t, 256> c{};
  for (int i = 128; i < 256; ++i) c[size_t(i)] = kHigh;
  for (unsigned char b : {'\0', ' ', '\t', '\n', '\r', '\f', '\v', '\x1a'}) c[b] = kBlank;
  for (unsigned char b : {'[', ']', '"', '#', ','}) c[b] = kDelimiter;
  return c;
}
constexpr std::array<uint8_t, 256> kClass = makeClasses();
/// The high bit of each byte of `word` that is `c`, first byte lowest. (Exact, unlike the usual test for
/// "any".)
inline uint64_t bytesEqual(uint64_t word, char c) {
  constexpr uint64_t kOnes = 0x0101010101010101, kLow = 0x7f * kOnes;
  static_assert(std::endian::native == std::endian::little);
  const uint64_t x = word ^ (kOnes * static_cast<unsigned char>(c));
  return ~(((x & kLow) + kLow) | x | kLow);
}

inline uint8_t classOf(char c) { return kClass[static_cast<unsigned char>(c)]; }
inline bool isDigit(char c) { return static_cast<unsigned>(c - '0') < 10u; }
inline bool isUpper(char c) { return static_cast<unsigned>(c - 'A') < 26u; }

// "1.#INF", "-1.#IND", "1.#QNAN": what some C libraries print. `p` stands on the '#'.
size_t microsoftNonFinite(const char* p, const char* end) {
  size_t n = 1;
  while (p + n < end && (std::isalnum(static_cast<unsigned char>(p[n])) != 0)) ++n;
  const std::string_view word(p, n);
  const bool known = word.starts_with("#INF") || word.starts_with("#IND") || word.starts_with("#QNAN") ||
                     word.starts_with("#SNAN");
  return known ? n : 0;
}

// "C:", alone or behind anything that can stand before a path in a list.
bool endsInDrive(std::string_view text) {
  const size_t n = text.size();
  const auto isLetter = [](char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z'); };
  return n >= 2 && text[n - 1] == ':' && isLetter(text[n - 2]) &&
         (n == 2 || !std::isalnum(static_cast<unsigned char>(text[n - 3])));
}

}  // namespace

Lexer::Lexer(std::unique_ptr<Input> input, std::string name, int firstLine)
    : input_(std::move(input)), name_(std::move(name)), tables_(std::make_shared<BinaryTables>()) {
  capacity_ = kWindow;
  buffer_ = std::make_unique<char[]>(capacity_ + kBehind);
  cur_ = end_ = buffer_.get();
  buffer_[0] = 0;
  line_ = firstLine;
  // A UTF-8 byte order mark is not a binary token. No more is read than it takes to know: a program whose
  // whole answer is the end mark waits for the next question.
  static constexpr char kMark[] = "\xef\xbb\xbf";
  const auto have = [this] { return size_t(std::min<ptrdiff_t>(end_ - cur_, 3)); };
  while (have() < 3 && std::memcmp(cur_, kMark, have()) == 0 && refill(cur_)) {
  }
  if (have() == 3 && std::memcmp(cur_, kMark, 3) == 0) cur_ += 3;
}
Lexer::~Lexer() = default;

// Makes room and reads on. Bytes from `keep` on stay (at another address); cur_ keeps its meaning. False at
// the end of the input.
bool Lexer::refill(const char* keep) {
  if (atEnd_) return false;
  const size_t kept = size_t(end_ - keep);
  const size_t ahead = size_t(cur_ - keep);
  const uint64_t keptOffset = offsetOf(keep);
  if (keep != buffer_.get()) {
    if (tokenOffset_ < keptOffset) {
      int line = 0, column = 0;
      position(line, column);
    }
    countLines(keptOffset);
    if (recording_ && recordFrom_ < keptOffset) {
      recorded_.append(buffer_.get() + (recordFrom_ - base_), size_t(keptOffset - recordFrom_));
      recordFrom_ = keptOffset;
    }
    std::memmove(buffer_.get(), keep, kept);
    base_ = keptOffset;
  }
  if (kept == capacity_) {  // one token fills the window; the input has given as many bytes as we ask for now
    auto bigger = std::make_unique<char[]>(capacity_ * 2 + kBehind);
    std::memcpy(bigger.get(), buffer_.get(), kept);
    capacity_ *= 2;
    buffer_ = std::move(bigger);
  }
  Result<size_t> n = input_->read({buffer_.get() + kept, capacity_ - kept});
  if (!n) inputError_ = n.error();
  const size_t got = n ? *n : 0;
  atEnd_ = got == 0;
  cur_ = buffer_.get() + ahead;
  end_ = buffer_.get() + kept + got;
  buffer_[kept + got] = 0;
  return !atEnd_;
}

// Line ends are LF, CR LF and CR alone.
void Lexer::countLines(uint64_t upTo) const {
  if (upTo <= counted_) return;
  const char* p = buffer_.get() + (counted_ - base_);
  const char* const stop = buffer_.get() + (upTo - base_);
  for (; p < stop; ++p) {
    // Eight bytes at a time where no carriage return makes it hard: every byte of a file comes by here.
    if (!afterReturn_) {
      while (p < stop) {
        uint64_t word = 0;
        std::memcpy(&word, p, 8);  // there is room for it behind the window
        if (stop - p < 8) word &= (uint64_t(1) << 8 * (stop - p)) - 1;
        if (bytesEqual(word, '\r')) break;
        if (const uint64_t ends = bytesEqual(word, '\n')) {
          line_ += std::popcount(ends);
          lineStart_ = offsetOf(p) + 8 - uint64_t(std::countl_zero(ends)) / 8;
        }
        p += 8;
      }
      if (p >= stop) break;
    }
    if (*p == '\n') {
      if (!afterReturn_) ++line_;
      lineStart_ = offsetOf(p) + 1;
      afterReturn_ = false;
    } else if (*p == '\r') {
      ++line_;
      lineStart_ = offsetOf(p) + 1;
      afterReturn_ = true;
    } else {
      afterReturn_ = false;
    }
  }
  counted_ = upTo;
}

void Lexer::markToken() {
  tokenOffset_ = offsetOf(cur_);
  tokenLine_ = 0;
}

void Lexer::position(int& line, int& column) const {
  if (tokenLine_ == 0) {
    countLines(tokenOffset_);
    tokenLine_ = line_;
    tokenColumn_ = int(std::min<uint64_t>(tokenOffset_ - lineStart_ + 1, std::numeric_limits<int>::max()));
  }
  line = tokenLine_;
  column = tokenColumn_;
}

SourceLocation Lexer::location() const {
  SourceLocation l{name_, 0, 0};
  position(l.line, l.column);
  return l;
}

void Lexer::bad(std::string message) {
  kind_ = TokenKind::kBad;
  text_ = std::move(message);
}

void Lexer::advance() {
  for (;;) {
    while (classOf(*cur_) == kBlank) {
      if (cur_ == end_) {
        if (refill(cur_)) continue;
        markToken();
        kind_ = TokenKind::kEnd;
        return;
      }
      ++cur_;
    }
    markToken();
    const char c = *cur_;
    switch (classOf(c)) {
      case kDelimiter:
        if (c == '[' || c == ']') {
          ++cur_;
          kind_ = c == '[' ? TokenKind::kArrayBegin : TokenKind::kArrayEnd;
          return;
        }
        if (c == '"') return lexString();
        if (c == ',') {  // hands and scripts put them between numbers
          ++cur_;
          comma_ = true;
          continue;
        }
        if (lexComment()) return;
        continue;
      case kHigh:
        if (lexBinary(static_cast<unsigned char>(c))) return;
        continue;
      default:
        if (isDigit(c) || c == '-' || c == '+' || c == '.') return lexNumber();
        return lexWord();
    }
  }
}

// True when the comment is to be seen by the reader.
bool Lexer::lexComment() {
  ++cur_;
  if (cur_ == end_) refill(cur_);
  const bool structure = *cur_ == '#';
  if (structure) ++cur_;
  const bool wanted = structure || keepComments_;
  text_.clear();
  for (;;) {
    const char* p = cur_;
    while (p < end_ && *p != '\n' && *p != '\r') ++p;
    if (wanted) text_.append(cur_, p);
    cur_ = p;
    if (p < end_ || !refill(p)) break;
  }
  kind_ = structure ? TokenKind::kStructure : TokenKind::kComment;
  return wanted;
}

void Lexer::lexWord() {
  const char* p = cur_;
  for (;;) {
    while (classOf(*p) == kWordChar) ++p;
    if (p < end_) break;
    const size_t length = size_t(p - cur_);
    const bool more = refill(cur_);  // moves the bytes even when nothing follows
    p = cur_ + length;
    if (!more) break;
  }
  text_.assign(cur_, p);
  cur_ = p;
  kind_ = TokenKind::kRequest;
}

// Programs of Windows end strings with a folder's backslash: "C:\tex\". Read by the rules, that is a
// quotation mark inside a string which goes on to the next one, somewhere else. It is taken for the string's
// end where nothing can have been quoted and a token could end: at once if the string holds a path with a
// drive, else if the line ends before the string does. Quotation marks of such a line that stay behind begin
// no string that ends in it, so the line is not read on for each of them.
void Lexer::lexString() {
  ++cur_;
  text_.clear();
  endedByBackslash_ = false;
  bool drive = false, quoted = false;
  size_t escaped = 0;  // so much of the text ends in an escape: no drive is written as one
  struct End {
    uint64_t offset;    // behind the quotation mark
    size_t textLength;  // before the backslash
  };
  std::optional<End> maybe;
  // The first byte that may be read again.
  const auto keep = [&] { return maybe ? std::min(maybe->offset, offsetOf(cur_)) : offsetOf(cur_); };
  const auto keepAt = [&] { return buffer_.get() + (keep() - base_); };
  const auto endThere = [this](const End& e) {
    cur_ = buffer_.get() + (e.offset - base_);
    text_.resize(e.textLength);
    text_ += '\\';
    kind_ = TokenKind::kString;
    endedByBackslash_ = true;
  };
  for (;;) {
    const char* p = cur_;
    while (p < end_ && *p != '"' && *p != '\\') ++p;
    if (maybe && std::find_if(cur_, p, [](char c) { return c == '\n' || c == '\r'; }) != p) {
      noEndBefore_ = offsetOf(cur_);
      return endThere(*maybe);
    }
    text_.append(cur_, p);
    cur_ = p;
    if (p == end_) {
      if (refill(keepAt())) continue;
      noEndBefore_ = offsetOf(cur_);
      return maybe ? endThere(*maybe) : bad("unterminated string");
    }
    ++cur_;
    if (*p == '"') break;
    while (end_ - cur_ < 2 && refill(keepAt())) {
    }
    if (cur_ == end_) continue;
    drive = drive || (*cur_ != '\\' && text_.size() >= escaped + 2 && endsInDrive(text_));
    if (*cur_ == '"') {
      const char after = cur_ + 1 < end_ ? cur_[1] : ' ';
      const bool named = !text_.empty() && classOf(text_.back()) != kBlank;  // no folder ends in a blank
      if (named && !quoted && !maybe && (classOf(after) == kBlank || after == ']')) {
        maybe = End{offsetOf(cur_ + 1), text_.size()};
        if (drive || maybe->offset <= noEndBefore_) return endThere(*maybe);
      }
      quoted = !quoted;
    }
    if (drive && *cur_ != '\\' && *cur_ != '"') {
      text_ += '\\';  // and what follows is itself: "C:\new\tools" holds no line end
      continue;
    }
    lexEscape(keep());
    escaped = text_.size();
  }
  kind_ = TokenKind::kString;
}

// cur_ stands after a backslash inside a string; bytes from keepOffset on stay in the window. Unknown escapes
// stay as they are: paths of another system are written without doubling their separators.
void Lexer::lexEscape(uint64_t keepOffset) {
  while (end_ - cur_ < 3 && refill(buffer_.get() + (keepOffset - base_))) {
  }
  if (cur_ == end_) return;
  const char c = *cur_++;
  switch (c) {
    case 'n':
      text_ += '\n';
      return;
    case 'r':
      text_ += '\r';
      return;
    case 't':
      text_ += '\t';
      return;
    case 'b':
      text_ += '\b';
      return;
    case 'f':
      text_ += '\f';
      return;
    case '\\':
    case '"':
      text_ += c;
      return;
    case '\n':
      return;
    case '\r':
      if (*cur_ == '\n') ++cur_;
      return;
    default:
      break;
  }
  if (c < '0' || c > '7') {
    text_ += '\\';
    text_ += c;
    return;
  }
  int value = c - '0';
  for (int i = 0; i < 2 && *cur_ >= '0' && *cur_ <= '7'; ++i) value = value * 8 + (*cur_++ - '0');
  text_ += char(value & 0xff);
}

void Lexer::lexNumber() {
  const char* p = cur_;
  bool real = false;
  for (;;) {  // the longest run that can belong to a number
    while (isDigit(*p) || *p == '-' || *p == '+' || *p == '.' || *p == 'e' || *p == 'E') {
      real |= *p == '.' || *p == 'e' || *p == 'E';
      ++p;
    }
    if (p < end_) break;
    const size_t length = size_t(p - cur_);
    const bool more = refill(cur_);  // moves the bytes even when nothing follows
    p = cur_ + length;
    if (!more) break;
  }
  const char* first = *cur_ == '+' ? cur_ + 1 : cur_;
  const auto r = fast_float::from_chars(first, p, number_);
  const bool complete = r.ptr == p && p > first && !(first > cur_ && *first == '-');
  // "1Rotate": where a line end was lost, the number ends at the next request.
  const bool requestFollows = complete && p < end_ && isUpper(*p);
  if (!complete || (classOf(*p) == kWordChar && !requestFollows)) {
    for (;;) {
      while (classOf(*p) == kWordChar) ++p;
      if (p < end_) break;
      const size_t length = size_t(p - cur_);
      const bool more = refill(cur_);  // moves the bytes even when nothing follows
      p = cur_ + length;
      if (!more) break;
    }
    bad(fmt::format("\"{}\" is not a number",
                    std::string_view(cur_, std::min<size_t>(size_t(p - cur_), 40))));
    cur_ = p;
    return;
  }
  if (*p == '#') {
    if (const size_t n = microsoftNonFinite(p, end_)) {
      number_ =
          p[3] == 'F' ? std::numeric_limits<double>::infinity() : std::numeric_limits<double>::quiet_NaN();
      if (*cur_ == '-') number_ = -number_;
      p += n;
    }
  }
  nonFinite_ |= !std::isfinite(number_);
  cur_ = p;
  kind_ = TokenKind::kReal;
  if (!real && number_ >= std::numeric_limits<int>::min() && number_ <= std::numeric_limits<int>::max()) {
    kind_ = TokenKind::kInteger;
    integer_ = int(number_);
  }
}

namespace {

inline bool endsNumber(char c) {
  const uint8_t k = classOf(c);
  return k == kBlank || c == ']' || k >= kDelimiter;
}

}  // namespace

// Converts the number at p and moves p past it; the byte after it must be in the window. False leaves p.
template <class T>
bool Lexer::convertOne(const char*& p, std::vector<T>& to) {
  const char* q = p;
  if constexpr (std::is_same_v<T, int>) {
    const bool negative = *q == '-';
    if (negative || *q == '+') ++q;
    const char* digits = q;
    int64_t v = 0;
    while (isDigit(*q) && q - digits < 11) v = v * 10 + (*q++ - '0');
    if (negative) v = -v;
    if (q > digits && endsNumber(*q) && *q != '#' && v >= std::numeric_limits<int>::min() &&
        v <= std::numeric_limits<int>::max()) {
      to.push_back(int(v));
      p = q;
      return true;
    }
    double d = 0;
    const auto r = fast_float::from_chars(p, end_, d);
    if (r.ptr == p || !endsNumber(*r.ptr) || !(std::abs(d) <= 2147483647.0) || d != std::floor(d))
      return false;
    to.push_back(int(d));
    p = r.ptr;
    return true;
  } else {
    if (*q == '+') ++q;
    if (q > p && !isDigit(*q) && *q != '.') return false;
    T v = 0;
    const auto r = fast_float::from_chars(q, end_, v);
    if (r.ptr == q || !endsNumber(*r.ptr)) return false;
    q = r.ptr;
    if (!std::isfinite(v)) nonFinite_ = true;
    if (*q == '#') {
      if (const size_t n = microsoftNonFinite(q, end_)) {
        v = q[3] == 'F' ? std::numeric_limits<T>::infinity() : std::numeric_limits<T>::quiet_NaN();
        q += n;
        nonFinite_ = true;
      }
    }
    to.push_back(v);
    p = q;
    return true;
  }
}

// The same for a binary number: integers and fixed point (RISpec 3.2, Table C.1), and single floats.
template <class T>
bool Lexer::convertBinary(const char*& p, std::vector<T>& to) {
  const auto code = static_cast<unsigned char>(*p);
  if (code > 0x8f && code != 0xa4) return false;
  uint32_t bits = 0;
  std::memcpy(&bits, p + 1, 4);
  bits = __builtin_bswap32(bits);
  if (code == 0xa4) {
    const float v = std::bit_cast<float>(bits);
    if (std::is_same_v<T, int> || !std::isfinite(v)) return false;
    to.push_back(T(v));
    p += 5;
    return true;
  }
  const int bytes = (code & 3) + 1, fraction = code >> 2 & 3;
  const int32_t i = std::bit_cast<int32_t>(bits) >> (32 - 8 * bytes);
  if (fraction == 0) {
    to.push_back(T(i));
  } else if constexpr (std::is_same_v<T, int>) {
    return false;
  } else {
    constexpr double kScale[4] = {1, 1.0 / 256, 1.0 / 65536, 1.0 / 16777216};
    to.push_back(T(double(i) * kScale[fraction]));
  }
  p += 1 + bytes;
  return true;
}

template <class T>
bool Lexer::readNumbersAs(std::vector<T>& to) {
  // Numbers are shorter than this; nearer to the end of the window more is read first when the next number
  // may go on behind it. No more than that: a program at the other end of a pipe may have said everything.
  constexpr ptrdiff_t kLongest = 512;
  const auto cutAtEnd = [this](const char* p) {
    while (p < end_ && classOf(*p) == kBlank) ++p;
    while (p < end_ && (classOf(*p) == kWordChar || *p == '#')) ++p;
    return p == end_;
  };
  for (;;) {
    const char* p = cur_;
    const char* const safe = end_ - kLongest;
    while (p < safe) {  // the fast path
      const char c = *p;
      if (classOf(c) == kBlank) {
        ++p;
        continue;
      }
      if (classOf(c) == kHigh ? !convertBinary(p, to) : classOf(c) != kWordChar || !convertOne(p, to)) break;
    }
    cur_ = p;
    if (p >= safe && !atEnd_ && cutAtEnd(p)) {
      refill(p);
      continue;
    }
    // Anything else goes the slow way, one token at a time.
    if (*p == ']' && p < end_) {
      ++cur_;
      advance();
      return true;
    }
    if (p < end_ && (classOf(*p) == kBlank || (classOf(*p) == kWordChar && convertOne(cur_, to)))) {
      if (classOf(*p) == kBlank) ++cur_;
      continue;
    }
    advance();
    switch (kind_) {
      case TokenKind::kArrayEnd:
        advance();
        return true;
      case TokenKind::kStructure:
      case TokenKind::kComment:
        continue;
      case TokenKind::kInteger:
      case TokenKind::kReal:
        if constexpr (std::is_same_v<T, int>) {
          if (kind_ == TokenKind::kReal &&
              (number_ != std::floor(number_) || std::abs(number_) > 2147483647.0)) {
            return false;
          }
        }
        to.push_back(T(number_));
        continue;
      default:
        return false;
    }
  }
}

bool Lexer::readNumbers(std::vector<float>& to) { return readNumbersAs(to); }
bool Lexer::readNumbers(std::vector<double>& to) { return readNumbersAs(to); }
bool Lexer::readNumbers(std::vector<int>& to) { return readNumbersAs(to); }

std::string Lexer::recordUntil(std::string_view begin, std::string_view end, int& firstLine) {
  int column = 0;
  position(firstLine, column);
  recorded_.clear();
  int depth = 0;
  if (kind_ == TokenKind::kRequest) {
    if (text_ == end) return {};
    if (text_ == begin) ++depth;
    recorded_ = text_ + " ";
  }
  recording_ = true;
  recordFrom_ = offsetOf(cur_);
  for (;;) {
    advance();
    if (kind_ == TokenKind::kEnd) break;
    if (kind_ != TokenKind::kRequest) continue;
    if (text_ == begin) ++depth;
    if (text_ == end && depth-- == 0) break;
  }
  recording_ = false;
  if (recordFrom_ <= tokenOffset_) {
    recorded_.append(buffer_.get() + (recordFrom_ - base_), size_t(tokenOffset_ - recordFrom_));
  } else {  // the beginning of a binary request name has left the window already
    recorded_.resize(recorded_.size() - size_t(recordFrom_ - tokenOffset_));
  }
  return std::exchange(recorded_, {});
}

}  // namespace fr::ri
