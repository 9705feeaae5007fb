// RIB tokens from a stream of bytes: ASCII and binary encodings, freely mixed (RISpec 3.2, appendix C).
//
// The lexer keeps a window over the input and never the whole of it; memory is bounded by the window plus
// the longest single string or request name. Number arrays are converted straight into the caller's vector.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "base/error.h"
#include "ri/input.h"

namespace fr::ri {

enum class TokenKind : uint8_t {
  kRequest,     ///< text() is the name
  kInteger,     ///< integer(), number()
  kReal,        ///< number()
  kString,      ///< text(), escapes undone
  kArrayBegin,  ///< [
  kArrayEnd,    ///< ]
  kFloatArray,  ///< a whole binary array of floats: floatArray()
  kStructure,   ///< "##" comment, text() is the rest of the line
  kComment,     ///< "#" comment; only when keepComments was set
  kBad,         ///< text() is the error message; lexing can go on
  kEnd,         ///< end of input, or byte 0377
};

/// Codes defined by a binary stream for its requests and strings. Archives recorded from a stream share them.
struct BinaryTables {
  std::array<std::string, 256> requests;
  std::vector<std::string> strings;  // 65536 at most
};

class Lexer {
 public:
  /// `name` is the file in messages; lines count from `firstLine`.
  Lexer(std::unique_ptr<Input> input, std::string name, int firstLine = 1);
  ~Lexer();
  Lexer(const Lexer&) = delete;
  Lexer& operator=(const Lexer&) = delete;

  void setKeepComments(bool on) { keepComments_ = on; }

  /// The current token. Its text is valid until the next call of advance() or of a read function.
  TokenKind kind() const { return kind_; }
  const std::string& text() const { return text_; }
  /// Puts another text in place of the current token's.
  void replaceText(std::string text) { text_ = std::move(text); }
  int integer() const { return integer_; }
  double number() const { return number_; }
  std::vector<float>& floatArray() { return floatArray_; }
  /// Place of the current token.
  SourceLocation location() const;
  /// The same without the file name: cheap enough to be asked once per request.
  void position(int& line, int& column) const;
  const std::string& fileName() const { return name_; }

  void advance();

  /// With the current token "[": appends the numbers up to "]" and moves past it. On anything else than a
  /// number it stops there and returns false, the offending token being the current one.
  /// ints: reals with integral values are accepted; others stop.
  bool readNumbers(std::vector<float>& to);
  bool readNumbers(std::vector<double>& to);
  bool readNumbers(std::vector<int>& to);

  /// Records raw bytes from the current request on until the request `end` that is not nested in
  /// `begin`...`end` pairs. The current token afterwards is `end`, or kEnd if it never came. `firstLine`
  /// receives the line on which the text begins.
  std::string recordUntil(std::string_view begin, std::string_view end, int& firstLine);

  /// True once after a number that is not finite (nan, inf, 1.#INF) was read.
  bool takeNonFinite() { return std::exchange(nonFinite_, false); }

  /// True once after commas, which are skipped.
  bool takeComma() { return std::exchange(comma_, false); }
  /// True once after a string whose last backslash would have escaped its end ("C:\tex\"): it was ended
  /// there. Of the last string alone.
  bool takeEndedByBackslash() { return std::exchange(endedByBackslash_, false); }

  std::shared_ptr<BinaryTables> tables() const { return tables_; }
  void setTables(std::shared_ptr<BinaryTables> t) { tables_ = std::move(t); }

  /// The error that ended the input early (a read error, broken gzip data), if one did; reported by the
  /// reader once.
  const Error* inputError() const { return inputError_ ? &*inputError_ : nullptr; }

 private:
  bool refill(const char* keep);
  void lexNumber();
  void lexString();
  void lexEscape(uint64_t keepOffset);
  void lexWord();
  bool lexComment();
  bool lexBinary(unsigned char code);
  void bad(std::string message);
  bool peek(unsigned char& out);
  bool readBytes(size_t n, std::string& to);
  bool readBigEndian(int n, uint32_t& out);
  bool readBinaryString(std::string& to);
  bool readBinaryFloats(uint32_t count);
  bool defineBinary(unsigned char code);
  void markToken();
  void countLines(uint64_t upTo) const;
  uint64_t offsetOf(const char* p) const { return base_ + uint64_t(p - buffer_.get()); }
  template <class T>
  bool readNumbersAs(std::vector<T>& to);
  template <class T>
  bool convertOne(const char*& p, std::vector<T>& to);
  template <class T>
  bool convertBinary(const char*& p, std::vector<T>& to);

  std::unique_ptr<Input> input_;
  std::string name_;
  std::unique_ptr<char[]> buffer_;
  size_t capacity_ = 0;
  uint64_t base_ = 0;          // offset in the stream of buffer_[0]
  const char* cur_ = nullptr;  // next unread byte
  const char* end_ = nullptr;  // end of valid bytes; *end_ == 0
  bool atEnd_ = false;
  bool keepComments_ = false;
  bool nonFinite_ = false;
  bool comma_ = false;
  bool endedByBackslash_ = false;
  uint64_t noEndBefore_ = 0;  // no string that begins before this offset ends before it
  std::optional<Error> inputError_;

  TokenKind kind_ = TokenKind::kEnd;
  std::string text_;
  int integer_ = 0;
  double number_ = 0;
  std::vector<float> floatArray_;
  std::shared_ptr<BinaryTables> tables_;

  bool recording_ = false;
  uint64_t recordFrom_ = 0;
  std::string recorded_;

  // Lines are counted when someone asks or when bytes leave the window, never twice.
  uint64_t tokenOffset_ = 0;
  mutable uint64_t counted_ = 0;    // stream offset up to which lines are counted
  mutable uint64_t lineStart_ = 0;  // stream offset at which the line of counted_ begins
  mutable int line_ = 1;
  mutable bool afterReturn_ = false;             // the byte before counted_ is a carriage return
  mutable int tokenLine_ = 0, tokenColumn_ = 0;  // 0 = not known yet
};

}  // namespace fr::ri
