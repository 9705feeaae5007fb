#include "shading/slx.h"

#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "base/whole_file.h"
#include "shading/passes.h"

namespace fr {
namespace {

constexpr char kMagic[8] = {'F', 'R', 'S', 'L', 'X', '\r', '\n', '\x1a'};
constexpr uint32_t kEndian = 0x01020304;

struct Header {
  char magic[8];
  uint32_t version;
  uint32_t endian;
  uint64_t payloadBytes;
  uint64_t payloadHash;
};
static_assert(sizeof(Header) == 32);

class Writer {
 public:
  std::string bytes;
  void number(uint32_t v) { raw(&v, 4); }
  void number64(uint64_t v) { raw(&v, 8); }
  void text(std::string_view s) {
    number(uint32_t(s.size()));
    bytes.append(s);
  }
  template <class T>
  void array(const std::vector<T>& v) {
    static_assert(std::is_trivially_copyable_v<T>);
    number(uint32_t(v.size()));
    raw(v.data(), v.size() * sizeof(T));
  }
  void texts(const std::vector<std::string>& v) {
    number(uint32_t(v.size()));
    for (const std::string& s : v) text(s);
  }

 private:
  void raw(const void* p, size_t n) { bytes.append(static_cast<const char*>(p), n); }
};

/// Every read is checked against what is left; after a failure all reads give zero.
class Reader {
 public:
  explicit Reader(std::span<const char> bytes) : left_(bytes) {}
  bool failed() const { return failed_; }
  bool atEnd() const { return left_.empty(); }
  uint32_t number() {
    uint32_t v = 0;
    raw(&v, 4);
    return v;
  }
  uint64_t number64() {
    uint64_t v = 0;
    raw(&v, 8);
    return v;
  }
  std::string text() {
    const uint32_t n = number();
    if (failed_ || n > left_.size()) return fail(), std::string();
    std::string s(left_.data(), n);
    left_ = left_.subspan(n);
    return s;
  }
  template <class T>
  std::vector<T> array() {
    const uint32_t n = number();
    std::vector<T> v;
    if (failed_ || n > left_.size() / sizeof(T)) return fail(), v;
    v.resize(n);
    if (n) raw(v.data(), n * sizeof(T));
    return v;
  }
  std::vector<std::string> texts() {
    const uint32_t n = number();
    std::vector<std::string> v;
    if (failed_ || n > left_.size() / 4) return fail(), v;
    for (uint32_t i = 0; i < n && !failed_; ++i) v.push_back(text());
    return v;
  }

 private:
  void fail() { failed_ = true; }
  void raw(void* p, size_t n) {
    if (failed_ || n > left_.size()) return fail();
    std::memcpy(p, left_.data(), n);
    left_ = left_.subspan(n);
  }
  std::span<const char> left_;
  bool failed_ = false;
};

Error bad(std::string_view what) { return makeError(RiError::kBadFile, "not a valid .slx file: {}", what); }

}  // namespace

std::string writeSlx(const ShaderProgram& p) {
  Writer w;
  w.number(uint32_t(p.type));
  w.text(p.name);
  w.number64(p.sourceHash);
  w.texts(p.strings);
  w.texts(p.files);
  w.array(p.fileHashes);
  w.array(p.floats);
  w.array(p.symbols);
  w.array(p.parameters);
  w.array(p.args);
  // Operations by name: their numbers may change between versions.
  std::vector<std::string> names;
  std::vector<uint32_t> number(size_t(Op::kCount), kNoIndex);
  for (const Instruction& in : p.code) {
    if (number[size_t(in.op)] != kNoIndex) continue;
    number[size_t(in.op)] = uint32_t(names.size());
    names.emplace_back(opInfo(in.op).name);
  }
  w.texts(names);
  std::vector<Instruction> code = p.code;
  for (Instruction& in : code) in.op = Op(uint16_t(number[size_t(in.op)]));
  w.array(code);
  w.number(p.bodyBegin);

  Header h{};
  std::memcpy(h.magic, kMagic, 8);
  h.version = kSlxVersion;
  h.endian = kEndian;
  h.payloadBytes = w.bytes.size();
  h.payloadHash = hashBytes(w.bytes.data(), w.bytes.size());
  return std::string(reinterpret_cast<const char*>(&h), sizeof(h)) + w.bytes;
}

Result<ShaderProgram> readSlx(std::span<const char> bytes) {
  Header h;
  if (bytes.size() < sizeof(h)) return bad("too short");
  std::memcpy(&h, bytes.data(), sizeof(h));
  if (std::memcmp(h.magic, kMagic, 8) != 0) return bad("wrong first bytes");
  if (h.endian != kEndian) return bad("byte order of another machine");
  if (h.version != kSlxVersion)
    return makeError(RiError::kVersion, "the .slx file has version {}, this program reads {}", h.version,
                     kSlxVersion);
  const std::span<const char> payload = bytes.subspan(sizeof(h));
  if (h.payloadBytes != payload.size()) return bad("wrong length");
  if (h.payloadHash != hashBytes(payload.data(), payload.size())) return bad("checksum");
  Reader r(payload);
  ShaderProgram p;
  const uint32_t type = r.number();
  if (type > uint32_t(ShaderType::kTransformation)) return bad("shader type");
  p.type = ShaderType(type);
  p.name = r.text();
  p.sourceHash = r.number64();
  p.strings = r.texts();
  p.files = r.texts();
  p.fileHashes = r.array<uint64_t>();
  p.floats = r.array<float>();
  p.symbols = r.array<Symbol>();
  p.parameters = r.array<Parameter>();
  p.args = r.array<uint32_t>();
  const std::vector<std::string> names = r.texts();
  p.code = r.array<Instruction>();
  p.bodyBegin = r.number();
  if (r.failed() || !r.atEnd()) return bad("wrong structure");
  std::vector<Op> ops;
  for (const std::string& n : names) {
    ops.push_back(opByName(n));
    if (ops.back() == Op::kCount)
      return makeError(RiError::kVersion, "the .slx file uses the unknown operation '{}'", n);
  }
  for (Instruction& in : p.code) {
    const size_t i = size_t(in.op);
    if (i >= ops.size()) return bad("operation");
    in.op = ops[i];
  }
  if (Result<void> v = validate(p); !v) return std::move(v).error();
  analyze(p);  // derived, not stored: cannot contradict the code
  return p;
}

Result<void> writeSlxFile(const std::string& path, const ShaderProgram& program) {
  const std::string bytes = writeSlx(program);
  const auto failed = [&](int error) {
    return makeError(error == ENOSPC || error == EDQUOT ? RiError::kDiskFull : RiError::kSystem,
                     "cannot write '{}': {}", path, std::strerror(error));
  };
  WholeFile file;
  if (const int error = file.open(path)) return failed(error);
  for (size_t done = 0; done < bytes.size();) {
    const ssize_t n = ::write(file.descriptor(), bytes.data() + done, bytes.size() - done);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return failed(n < 0 ? errno : EIO);
    done += size_t(n);
  }
  if (const int error = file.finish()) return failed(error);
  return {};
}

Result<ShaderProgram> readSlxFile(const std::string& path) {
  Result<std::string> bytes = readSourceFile(path);
  if (!bytes) return std::move(bytes).error();
  Result<ShaderProgram> p = readSlx(*bytes);
  if (!p) return std::move(p).error().context(path);
  return p;
}

}  // namespace fr
