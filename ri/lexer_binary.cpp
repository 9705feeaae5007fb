// The binary encoding of RIB (RISpec 3.2, Table C.1).
#include <bit>
#include <cmath>
#include <cstring>

#include "ri/lexer.h"

namespace fr::ri {

bool Lexer::peek(unsigned char& out) {
  if (cur_ == end_ && !refill(cur_)) return false;
  out = static_cast<unsigned char>(*cur_);
  return true;
}

// Appends as bytes come, so that a count from a stranger never decides an allocation.
bool Lexer::readBytes(size_t n, std::string& to) {
  while (n > 0) {
    if (cur_ == end_ && !refill(cur_)) return false;
    const size_t m = std::min(n, size_t(end_ - cur_));
    to.append(cur_, m);
    cur_ += m;
    n -= m;
  }
  return true;
}

bool Lexer::readBigEndian(int n, uint32_t& out) {
  out = 0;
  for (int i = 0; i < n; ++i) {
    unsigned char b = 0;
    if (!peek(b)) return false;
    ++cur_;
    out = out << 8 | b;
  }
  return true;
}

// A string in any of its encodings, as an operand of the define requests.
bool Lexer::readBinaryString(std::string& to) {
  unsigned char c = 0;
  to.clear();
  do {
    if (!peek(c)) return false;
    if (c == ' ' || c == '\t' || c == '\n' || c == '\r') ++cur_;
  } while (c == ' ' || c == '\t' || c == '\n' || c == '\r');
  if (c == '"') {
    lexString();
    to = std::move(text_);
    return kind_ == TokenKind::kString;
  }
  ++cur_;
  uint32_t n = 0;
  if (c >= 0x90 && c <= 0x9f) return readBytes(c - 0x90u, to);
  if (c >= 0xa0 && c <= 0xa3) return readBigEndian(c - 0xa0 + 1, n) && readBytes(n, to);
  return false;
}

bool Lexer::readBinaryFloats(uint32_t count) {
  floatArray_.clear();
  for (uint64_t left = count; left > 0;) {
    if (end_ - cur_ < 4) {
      while (end_ - cur_ < 4 && refill(cur_)) {
      }
      if (end_ - cur_ < 4) return false;
    }
    const size_t m = size_t(std::min<uint64_t>(left, uint64_t(end_ - cur_) / 4));
    const size_t at = floatArray_.size();
    floatArray_.resize(at + m);
    // Nothing here but what vectorises.
    const char* const from = cur_;
    float* const to = floatArray_.data() + at;
    uint32_t odd = 0;
    for (size_t i = 0; i < m; ++i) {
      uint32_t bits = 0;
      std::memcpy(&bits, from + 4 * i, 4);
      bits = __builtin_bswap32(bits);
      static_assert(std::endian::native == std::endian::little);
      odd |= (bits & 0x7f800000u) == 0x7f800000u ? 1u : 0u;  // infinite or no number
      to[i] = std::bit_cast<float>(bits);
    }
    nonFinite_ |= odd != 0;
    cur_ += 4 * m;
    left -= m;
  }
  return true;
}

// 0314: request code; 0315, 0316: string token. False when the stream ends inside.
bool Lexer::defineBinary(unsigned char code) {
  uint32_t token = 0;
  std::string name;
  if (!readBigEndian(code == 0xcc ? 1 : code - 0xcd + 1, token) || !readBinaryString(name)) return false;
  if (code == 0xcc) {
    tables_->requests[token & 0xff] = std::move(name);
  } else {
    if (tables_->strings.size() <= token) tables_->strings.resize(token + 1);
    tables_->strings[token] = std::move(name);
  }
  return true;
}

// Lexes what starts with a byte of 0200 or more; false when it was a definition and no token.
bool Lexer::lexBinary(unsigned char code) {
  const auto cut = [this] {
    bad("the file ends inside a binary token");
    cur_ = end_;
    return true;
  };
  if (code == 0xff) {  // stays there: the stream is over for this reader
    kind_ = TokenKind::kEnd;
    return true;
  }
  ++cur_;
  uint32_t v = 0;
  if (code <= 0x8f) {
    const int bytes = (code & 3) + 1;
    const int fraction = code >> 2 & 3;
    if (!readBigEndian(bytes, v)) return cut();
    const int shift = 32 - 8 * bytes;
    const int32_t i = std::bit_cast<int32_t>(v << shift) >> shift;
    number_ = std::ldexp(double(i), -8 * fraction);
    integer_ = i;
    kind_ = fraction == 0 ? TokenKind::kInteger : TokenKind::kReal;
    return true;
  }
  if (code <= 0xa3) {
    --cur_;
    std::string s;
    if (!readBinaryString(s)) return cut();
    text_ = std::move(s);
    kind_ = TokenKind::kString;
    return true;
  }
  if (code == 0xa4) {
    if (!readBigEndian(4, v)) return cut();
    number_ = std::bit_cast<float>(v);
    nonFinite_ |= !std::isfinite(number_);
    kind_ = TokenKind::kReal;
    return true;
  }
  if (code == 0xa5) {
    uint32_t low = 0;
    if (!readBigEndian(4, v) || !readBigEndian(4, low)) return cut();
    number_ = std::bit_cast<double>(uint64_t(v) << 32 | low);
    nonFinite_ |= !std::isfinite(number_);
    kind_ = TokenKind::kReal;
    return true;
  }
  if (code == 0xa6) {
    if (!readBigEndian(1, v)) return cut();
    text_ = tables_->requests[v & 0xff];
    kind_ = TokenKind::kRequest;
    if (text_.empty()) bad(fmt::format("request code {} was never defined", v));
    return true;
  }
  if (code >= 0xc8 && code <= 0xcb) {
    if (!readBigEndian(code - 0xc8 + 1, v) || !readBinaryFloats(v)) return cut();
    kind_ = TokenKind::kFloatArray;
    return true;
  }
  if (code >= 0xcc && code <= 0xce) return defineBinary(code) ? false : cut();
  if (code == 0xcf || code == 0xd0) {
    if (!readBigEndian(code - 0xcf + 1, v)) return cut();
    if (v >= tables_->strings.size()) {
      bad(fmt::format("string token {} was never defined", v));
      return true;
    }
    text_ = tables_->strings[v];
    kind_ = TokenKind::kString;
    return true;
  }
  bad(fmt::format("byte 0{:o} begins nothing that RIB knows", code));
  return true;
}

}  // namespace fr::ri
