#include "ri/lexer.h"

#include <gtest/gtest.h>
#include <rapidcheck.h>
#include <zlib.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "ri/input.h"

namespace fr::ri {
namespace {

// Gives one byte per read: every token crosses the edge of what is in memory.
class DripInput : public Input {
 public:
  explicit DripInput(std::string s) : text_(std::move(s)) {}
  Result<size_t> read(std::span<char> to) override {
    if (at_ == text_.size() || to.empty()) return size_t(0);
    to[0] = text_[at_++];
    return size_t(1);
  }

 private:
  std::string text_;
  size_t at_ = 0;
};

std::string describe(Lexer& lex) {
  std::string out;
  for (lex.advance(); lex.kind() != TokenKind::kEnd; lex.advance()) {
    switch (lex.kind()) {
      case TokenKind::kRequest:
        out += "R:" + lex.text();
        break;
      case TokenKind::kInteger:
        out += fmt::format("I:{}", lex.integer());
        break;
      case TokenKind::kReal:
        out += fmt::format("F:{}", lex.number());
        break;
      case TokenKind::kString:
        out += "S:" + lex.text();
        break;
      case TokenKind::kArrayBegin:
        out += "[";
        break;
      case TokenKind::kArrayEnd:
        out += "]";
        break;
      case TokenKind::kFloatArray:
        out += "A";
        for (float f : lex.floatArray()) out += fmt::format(":{}", f);
        break;
      case TokenKind::kStructure:
        out += "##" + lex.text();
        break;
      case TokenKind::kComment:
        out += "#" + lex.text();
        break;
      default:
        out += "BAD";
        break;
    }
    out += ' ';
  }
  return out;
}

std::string tokens(const std::string& text) {
  Lexer whole(std::move(openMemory(text)).value(), "t");
  Lexer drip(std::make_unique<DripInput>(text), "t");
  std::string a = describe(whole);
  const std::string b = describe(drip);
  EXPECT_EQ(a, b);
  return a;
}

TEST(Lexer, NumbersStringsAndWords) {
  EXPECT_EQ(tokens("Foo 1 -2 +3 1.5 -.5 1e3 2. [1 2]"),
            "R:Foo I:1 I:-2 I:3 F:1.5 F:-0.5 F:1000 F:2 [ I:1 I:2 ] ");
  EXPECT_EQ(tokens("Sphere\"a\"[\"b\"]"), "R:Sphere S:a [ S:b ] ");
  EXPECT_EQ(tokens("3000000000"), "F:3000000000 ");
  EXPECT_EQ(tokens("Rotate 0 0 0 1Rotate 1.5\x1a"), "R:Rotate I:0 I:0 I:0 I:1 R:Rotate F:1.5 ");
}

TEST(Lexer, NotNumbers) {
  EXPECT_EQ(tokens(". 1"), "BAD I:1 ");
  EXPECT_EQ(tokens("12abc X"), "BAD R:X ");
  EXPECT_EQ(tokens("+-1"), "BAD ");
  EXPECT_EQ(tokens("1-2"), "BAD ");
}

TEST(Lexer, StringEscapes) {
  EXPECT_EQ(tokens(R"("a\nb\"c\\d\101\7e")"), "S:a\nb\"c\\dA\7e ");
  EXPECT_EQ(tokens("\"a\\\nb\""), "S:ab ");
  EXPECT_EQ(tokens(R"("C:\windows\path")"), "S:C:\\windows\\path ");  // unknown escapes stay as they are
}

TEST(Lexer, PathsWithDrivesHaveNoEscapes) {
  EXPECT_EQ(tokens(R"("C:\new\tools\bin" "a;d:\fonts\1")"), R"(S:C:\new\tools\bin S:a;d:\fonts\1 )");
  EXPECT_EQ(tokens(R"("C:\\new\\tools" "http:\n" "H\072\n")"), "S:C:\\new\\tools S:http:\n S:H:\n ");
}

TEST(Lexer, StringsThatEndInABackslash) {
  // A drive: at once, wherever a token may end. Quoted words inside stay.
  EXPECT_EQ(tokens(R"(A ["C:\tex\"] "b" ["D:\" "x:\y\"])"), "R:A [ S:C:\\tex\\ ] S:b [ S:D:\\ S:x:\\y\\ ] ");
  EXPECT_EQ(tokens(R"("C:\run.exe \"a b\" c" B)"), "S:C:\\run.exe \"a b\" c R:B ");
  EXPECT_EQ(tokens(R"("C:\tex\")"), "S:C:\\tex\\ ");
  // Anything else: where the line ends before the string.
  EXPECT_EQ(tokens("A \"tex\\\"\nB \"c\" D"), "R:A S:tex\\ R:B S:c R:D ");
  EXPECT_EQ(tokens("A \"tex\\\""), "R:A S:tex\\ ");
  EXPECT_EQ(tokens("\"say \\\" and\" B"), "S:say \" and R:B ");
  EXPECT_EQ(tokens("\"one \\\"two\\\"\nthree\" B"), "S:one \"two\"\nthree R:B ");
  EXPECT_EQ(tokens("\"one \\\"\ntwo\\\" three\" B"), "S:one \"\ntwo\" three R:B ");
  // Behind the window: what is read again has been kept.
  const std::string blanks(300000, ' ');
  EXPECT_EQ(tokens(blanks + "\"tex\\\" " + blanks + "\nB"), "S:tex\\ R:B ");
}

// One line of them: each is read once, not to the end of the line for each. (It would take minutes.)
TEST(Lexer, ManyStringsThatEndInABackslash) {
  std::string line = "\"a\\\"";
  for (int i = 0; i < 100000; ++i) line += " a\\\" a\\\"";
  for (const char* end : {"", "\nA"}) {
    const std::string read = tokens(line + end);
    EXPECT_EQ(read.substr(0, 21), "S:a\\ R:a\\ S: a\\ R:a\\ ");
    EXPECT_EQ(size_t(std::ranges::count(read, 'S')), 100001u);
  }
}

TEST(Lexer, CommasAreBlanks) {
  EXPECT_EQ(tokens("A 1, 2,3 [1,2 , 3] \"a,b\""), "R:A I:1 I:2 I:3 [ I:1 I:2 I:3 ] S:a,b ");
}

TEST(Lexer, CommentsAndLineEnds) {
  EXPECT_EQ(tokens("A # no\r\nB#no\rC ##yes x\nD"), "R:A R:B R:C ##yes x R:D ");
  EXPECT_EQ(tokens("\xef\xbb\xbf##RenderMan RIB\n"), "##RenderMan RIB ");
}

TEST(Lexer, UnterminatedStringIsBadAndEnds) { EXPECT_EQ(tokens("A \"bc"), "R:A BAD "); }

TEST(Lexer, Positions) {
  for (const char* nl : {"\n", "\r\n", "\r"}) {
    const std::string text = std::string("one") + nl + nl + "  two" + nl + "three four";
    Lexer lex(std::move(openMemory(text)).value(), "f.rib");
    lex.advance();
    EXPECT_EQ(lex.location().str(), "f.rib:1:1");
    lex.advance();
    EXPECT_EQ(lex.location().str(), "f.rib:3:3");
    lex.advance();
    lex.advance();
    EXPECT_EQ(lex.location().str(), "f.rib:4:7");
  }
}

TEST(Lexer, PositionsSurviveLargeInput) {
  std::string text = "[";
  for (int i = 0; i < 200000; ++i) text += "0.125\r\n";
  text += "  here";
  Lexer lex(std::move(openMemory(text)).value(), "f");
  lex.advance();
  std::vector<float> v;
  EXPECT_FALSE(lex.readNumbers(v));
  EXPECT_EQ(v.size(), 200000u);
  EXPECT_EQ(lex.text(), "here");
  EXPECT_EQ(lex.location().str(), "f:200001:3");
}

template <class T>
std::pair<bool, std::vector<T>> readArray(const std::string& text, bool drip) {
  Lexer lex(drip ? std::make_unique<DripInput>(text) : std::move(openMemory(text)).value(), "t");
  lex.advance();
  EXPECT_EQ(lex.kind(), TokenKind::kArrayBegin);
  std::vector<T> v;
  const bool ok = lex.readNumbers(v);
  return {ok, v};
}

TEST(Lexer, NumberArrays) {
  for (bool drip : {false, true}) {
    EXPECT_EQ(readArray<float>("[1 -2.5 +3e1#c\n.5]", drip),
              std::make_pair(true, std::vector<float>{1, -2.5f, 30, .5f}));
    EXPECT_EQ(readArray<int>("[1 -2 2.0 +7]", drip), std::make_pair(true, std::vector<int>{1, -2, 2, 7}));
    EXPECT_EQ(readArray<int>("[1 2.5]", drip), std::make_pair(false, std::vector<int>{1}));
    EXPECT_EQ(readArray<int>("[99999999999]", drip).first, false);
    EXPECT_EQ(readArray<float>("[]", drip), std::make_pair(true, std::vector<float>{}));
    EXPECT_EQ(readArray<float>("[1 \"a\"]", drip).first, false);
    EXPECT_EQ(readArray<float>("[1 2", drip).first, false);
    const auto odd = readArray<float>("[nan -inf 1.#INF 1.#QNAN 5]", drip);
    ASSERT_TRUE(odd.first);
    ASSERT_EQ(odd.second.size(), 5u);
    EXPECT_TRUE(std::isnan(odd.second[0]));
    EXPECT_EQ(odd.second[1], -std::numeric_limits<float>::infinity());
    EXPECT_EQ(odd.second[2], std::numeric_limits<float>::infinity());
    EXPECT_TRUE(std::isnan(odd.second[3]));
    EXPECT_EQ(odd.second[4], 5);
  }
}

// Any floats, printed in any way, come back bit for bit.
TEST(Lexer, FloatsRoundTrip) {
  rc::check([](const std::vector<float>& values) {
    std::string text = "[";
    for (float f : values) text += fmt::format("{} ", f);
    const auto r = readArray<float>(text + "]", false);
    RC_ASSERT(r.first);
    RC_ASSERT(r.second == values);
  });
}

std::string bytes(std::initializer_list<int> b) {
  std::string s;
  for (int i : b) s += char(i);
  return s;
}

TEST(LexerBinary, SignedIntegers) {
  EXPECT_EQ(tokens(bytes({0200, 0377})), "I:-1 ");
  EXPECT_EQ(tokens(bytes({0200, 5})), "I:5 ");
  EXPECT_EQ(tokens(bytes({0201, 0xff, 0xfe})), "I:-2 ");
  EXPECT_EQ(tokens(bytes({0202, 0x01, 0x00, 0x00})), "I:65536 ");
  EXPECT_EQ(tokens(bytes({0202, 0xff, 0xff, 0xff})), "I:-1 ");
  EXPECT_EQ(tokens(bytes({0203, 0x80, 0, 0, 0})), "I:-2147483648 ");
}

TEST(LexerBinary, FixedPoint) {
  EXPECT_EQ(tokens(bytes({0205, 001, 0200})), "F:1.5 ");
  EXPECT_EQ(tokens(bytes({0204, 0200})), "F:-0.5 ");          // one byte, all fraction
  EXPECT_EQ(tokens(bytes({0210, 0100})), "F:0.0009765625 ");  // 64 / 65536
}

TEST(LexerBinary, FloatsAndArrays) {
  EXPECT_EQ(tokens(bytes({0244, 0x3f, 0x80, 0, 0})), "F:1 ");
  EXPECT_EQ(tokens(bytes({0245, 0x40, 0x04, 0, 0, 0, 0, 0, 0})), "F:2.5 ");
  EXPECT_EQ(tokens(bytes({0310, 2, 0x3f, 0x80, 0, 0, 0xc0, 0, 0, 0})), "A:1:-2 ");
}

// Arrays of single numbers have a fast way, where enough of them is in memory, and a slow one.
TEST(LexerBinary, ArraysOfNumbersAreTheSameFastAndSlowly) {
  rc::check([](const std::vector<uint32_t>& seeds) {
    std::string text = "[";
    std::vector<float> floats;
    std::vector<int> integers;
    const auto bigEndian = [&](uint32_t v, int bytes) {
      for (int k = bytes - 1; k >= 0; --k) text += char(v >> 8 * k & 0xff);
    };
    bool whole = true;
    for (int repeat = 0; repeat < 30; ++repeat) {  // beyond the part near the end that is read slowly
      for (const uint32_t s : seeds) {
        const int bytes = int(s & 3) + 1, fraction = s % 7 == 0 ? int(s >> 2 & 3) : 0;
        const int32_t value = int32_t(s * 2654435761u) >> (32 - 8 * bytes);
        if (s % 5 == 0) text += s % 2 ? " " : "\n";
        if (s % 11 == 0) {
          const float f = float(int32_t(s)) * 0.125f;
          text += char(0xa4), bigEndian(std::bit_cast<uint32_t>(f), 4);
          floats.push_back(f), whole = whole && f == std::floor(f) && std::abs(f) < 2147483648.0f;
          integers.push_back(whole ? int(f) : 0);
          continue;
        }
        text += char(0x80 | fraction << 2 | (bytes - 1)), bigEndian(uint32_t(value), bytes);
        const double d = std::ldexp(double(value), -8 * fraction);
        floats.push_back(float(d)), whole = whole && d == std::floor(d);
        integers.push_back(whole ? int(d) : 0);
      }
    }
    text += "]";
    for (const bool slowly : {false, true}) {
      const auto lexer = [&] {
        auto l = std::make_unique<Lexer>(
            slowly ? std::unique_ptr<Input>(std::make_unique<DripInput>(text)) : *openMemory(text), "t");
        l->advance();
        return l;
      };
      std::vector<float> f;
      RC_ASSERT(lexer()->readNumbers(f));
      RC_ASSERT(f == floats);
      std::vector<int> n;
      RC_ASSERT(lexer()->readNumbers(n) == whole);
      RC_ASSERT(!whole || n == integers);
    }
  });
}

// Lines are counted eight bytes at a time; here one by one.
TEST(Lexer, LinesAndColumnsOfAnyText) {
  rc::check([](const std::vector<uint8_t>& bytes) {
    std::string text;
    for (const uint8_t b : bytes) text += b < 20 ? '\n' : b < 30 ? '\r' : b < 40 ? ' ' : 'a';
    text += " X";
    int line = 1, column = 1;
    for (size_t i = 0; i + 1 < text.size(); ++i) {
      const bool ends = text[i] == '\r' || (text[i] == '\n' && (i == 0 || text[i - 1] != '\r'));
      if (ends) ++line;
      column = text[i] == '\n' || text[i] == '\r' ? 1 : column + 1;
    }
    Lexer lexer(*openMemory(text), "t");
    do {
      lexer.advance();
    } while (lexer.kind() != TokenKind::kEnd && lexer.text() != "X");
    RC_ASSERT(lexer.location().line == line);
    RC_ASSERT(lexer.location().column == column);
  });
}

TEST(LexerBinary, StringsOfManyLengths) {
  for (size_t n : {0u, 15u, 16u, 300u, 70000u}) {
    const std::string s(n, 'x');
    std::string head;
    if (n < 16) {
      head = bytes({0220 + int(n)});
    } else if (n < 256) {
      head = bytes({0240, int(n)});
    } else if (n < 65536) {
      head = bytes({0241, int(n >> 8), int(n & 255)});
    } else {
      head = bytes({0242, int(n >> 16), int(n >> 8 & 255), int(n & 255)});
    }
    EXPECT_EQ(tokens(head + s + " A"), "S:" + s + " R:A ");
  }
}

TEST(LexerBinary, DefinedRequestsAndStringsCanChange) {
  const std::string define = bytes({0314, 7}) + "\"Sphere\"";
  const std::string again = bytes({0314, 7, 0224}) + "Disk";
  EXPECT_EQ(tokens(define + bytes({0246, 7}) + again + bytes({0246, 7})), "R:Sphere R:Disk ");
  const std::string str = bytes({0315, 3, 0222}) + "Ka" + bytes({0317, 3}) + bytes({0316, 0, 3, 0222}) + "Kd";
  EXPECT_EQ(tokens(str + bytes({0320, 0, 3})), "S:Ka S:Kd ");
  EXPECT_EQ(tokens(bytes({0246, 9}) + " A"), "BAD R:A ");
  EXPECT_EQ(tokens(bytes({0317, 9}) + " A"), "BAD R:A ");
}

TEST(LexerBinary, EndMarkerAndReservedBytes) {
  EXPECT_EQ(tokens("A" + bytes({0377}) + "B"), "R:A ");
  EXPECT_EQ(tokens(bytes({0250}) + "B"), "BAD R:B ");
}

TEST(LexerBinary, AbsurdCountAllocatesNothing) {
  EXPECT_EQ(tokens(bytes({0313, 0xff, 0xff, 0xff, 0xff, 1, 2, 3})), "BAD ");
  EXPECT_EQ(tokens(bytes({0243, 0xff, 0xff, 0xff, 0xff}) + "abc"), "BAD ");
}

std::string gzip(const std::string& text) {
  z_stream z{};
  EXPECT_EQ(deflateInit2(&z, 6, Z_DEFLATED, 16 + MAX_WBITS, 8, Z_DEFAULT_STRATEGY), Z_OK);
  std::string out(deflateBound(&z, text.size()) + 100, '\0');
  z.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(text.data()));
  z.avail_in = uInt(text.size());
  z.next_out = reinterpret_cast<Bytef*>(out.data());
  z.avail_out = uInt(out.size());
  EXPECT_EQ(deflate(&z, Z_FINISH), Z_STREAM_END);
  out.resize(z.total_out);
  deflateEnd(&z);
  return out;
}

TEST(Input, GzipAlsoInSeveralMembers) {
  const std::string z = gzip("Sphere 1 ") + gzip("2 Disk");
  Lexer lex(std::move(openMemory(z)).value(), "z");
  EXPECT_EQ(describe(lex), "R:Sphere I:1 I:2 R:Disk ");
  EXPECT_EQ(lex.inputError(), nullptr);
}

TEST(Input, CutGzipGivesWhatItHasAndAnError) {
  std::string text;
  for (int i = 0; i < 20000; ++i) text += fmt::format("{} ", i * 7919);
  const std::string z = gzip(text);
  const std::string cut = z.substr(0, z.size() / 2);
  Lexer lex(std::move(openMemory(cut)).value(), "z");
  EXPECT_GT(describe(lex).size(), 1000u);
  ASSERT_NE(lex.inputError(), nullptr);
  EXPECT_EQ(lex.inputError()->code, RiError::kBadFile);
}

// Whatever the bytes, lexing ends and every token moves on.
TEST(Lexer, AnyBytesEnd) {
  rc::check([](const std::string& junk) {
    Lexer lex(std::move(openMemory(junk)).value(), "j");
    size_t n = 0;
    for (lex.advance(); lex.kind() != TokenKind::kEnd; lex.advance()) RC_ASSERT(++n <= junk.size());
  });
}

}  // namespace
}  // namespace fr::ri
