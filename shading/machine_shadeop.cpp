// Functions in shared objects: one call for a batch, or one for each active point.
#include <algorithm>
#include <cstdlib>
#include <cstring>

#include "base/error.h"
#include "shading/machine_light.h"
#include "shading/machine_ray.h"

namespace fr {

namespace {
constexpr int kStringRoom = 256;
}

/// Grows to what the largest call needs, then stays.
struct Machine::ShadeopCalls {
  struct Text {
    STRING_DESC given{};  // what the function sees
    char* own = nullptr;  // from malloc, of `room` bytes: the function may realloc it
    int room = 0;
    uint32_t symbol = 0;
    bool written = false;
  };
  std::vector<Text> texts;  // by operand; numbers have none
  std::vector<void*> argv;
  std::vector<float> values;
  std::vector<FrShadeopArg> args;

  ~ShadeopCalls() {
    for (Text& t : texts) std::free(t.own);
  }
};

Machine::Machine(const ShaderHost& host) : host_(host) {}
Machine::~Machine() = default;

namespace {
/// Index of argument k among the operands; 0 is the result.
uint32_t operandOf(uint32_t k) { return k == 0 ? 0 : 3 + 2 * k; }
}  // namespace

void Machine::prepareStrings(Frame& f, const Step& s) {
  ShadeopCalls& calls = *shadeopCalls_;
  const ShaderProgram& p = f.exe().program();
  const uint32_t argc = 1 + uint32_t(s.shadeop->spec.arguments.size());
  if (calls.texts.size() < argc) calls.texts.resize(argc);
  for (uint32_t k = 0; k < argc; ++k) {
    ShadeopCalls::Text& t = calls.texts[k];
    t.symbol = symbolOf(f, s, operandOf(k));
    t.given = {};
    if (p.symbols[t.symbol].type != SlType::kString) continue;
    t.written = isWritten(f, s, operandOf(k));
    const std::string_view text = k == 0 ? std::string_view() : f.strings(t.symbol)[0];
    const int need = std::max(kStringRoom, int(std::min<size_t>(text.size(), 1u << 24)) + 1);
    if (t.room < need) {
      char* const grown = static_cast<char*>(std::realloc(t.own, size_t(need)));
      if (!grown) std::abort();
      t.own = grown, t.room = need;
    }
    const size_t n = std::min(text.size(), size_t(t.room) - 1);
    if (n) std::memcpy(t.own, text.data(), n);
    t.own[n] = '\0';
    t.given = {t.own, t.room};
  }
}

void Machine::takeStrings(Frame& f, const Step& s) {
  ShadeopCalls& calls = *shadeopCalls_;
  const uint32_t argc = 1 + uint32_t(s.shadeop->spec.arguments.size());
  for (uint32_t k = 0; k < argc; ++k) {
    ShadeopCalls::Text& t = calls.texts[k];
    if (!t.given.s && !t.own) continue;
    if (f.exe().program().symbols[t.symbol].type != SlType::kString) continue;
    if (t.written) {
      const size_t room = t.given.s && t.given.bufflen > 0 ? size_t(t.given.bufflen) : 0;
      const std::string_view text(t.given.s ? t.given.s : "", ::strnlen(t.given.s ? t.given.s : "", room));
      if (text != f.strings(t.symbol)[0]) f.strings(t.symbol)[0] = keep(std::string(text));
    }
    // The function has put another buffer in place of ours. Whether that one came from realloc, and ours is
    // gone, cannot be known: both are left alone. The next one is twice as large, so that this ends.
    if (t.given.s != t.own) {
      t.room = 0;
      t.own = nullptr;
      const int wanted = std::clamp(t.given.bufflen, kStringRoom, 1 << 24) * 2;
      t.own = static_cast<char*>(std::malloc(size_t(wanted)));
      if (!t.own) std::abort();
      t.room = wanted;
    }
  }
}

void Machine::callByPoint(Frame& f, const Step& s, bool varying) {
  ShadeopCalls& calls = *shadeopCalls_;
  const Shadeop& op = *s.shadeop;
  const ShaderProgram& p = f.exe().program();
  const Operand* a = f.args(s);
  const uint32_t argc = 1 + uint32_t(op.spec.arguments.size());
  struct Value {
    Operand operand;
    uint32_t floats;
    float* at;
    bool read, written;
  };
  Value values[257];
  size_t total = 0;
  for (uint32_t k = 0; k < argc; ++k) total += p.symbols[symbolOf(f, s, operandOf(k))].floats();
  if (calls.values.size() < total + 16) calls.values.resize(total + 16);
  if (calls.argv.size() < argc) calls.argv.resize(argc);
  prepareStrings(f, s);
  float* at = calls.values.data();
  uint32_t count = 0;
  for (uint32_t k = 0; k < argc; ++k) {
    const Symbol& symbol = p.symbols[symbolOf(f, s, operandOf(k))];
    if (symbol.type == SlType::kString) {
      calls.argv[k] = &calls.texts[k].given;
      continue;
    }
    calls.argv[k] = at;
    values[count++] = {a[operandOf(k)], symbol.floats(), at, k > 0, isWritten(f, s, operandOf(k))};
    at += symbol.floats();
  }
  void* const data = shadeopThreadData(op);
  const uint32_t lanes = varying ? f.lanes() : 1;
  for (uint32_t i = 0; i < lanes; ++i) {
    if (varying && !f.mask[i]) continue;
    for (uint32_t k = 0; k < count; ++k) {
      const Value& v = values[k];
      if (!v.read)
        std::fill_n(v.at, v.floats, 0.0f);
      else
        for (uint32_t c = 0; c < v.floats; ++c) v.at[c] = v.operand.at(i, c);
    }
    op.point(data, int(argc), calls.argv.data());
    for (uint32_t k = 0; k < count; ++k) {
      const Value& v = values[k];
      if (!v.written) continue;
      for (uint32_t c = 0; c < v.floats; ++c) {
        if (v.operand.varying())
          v.operand.comp(c)[i] = v.at[c];
        else
          std::fill_n(v.operand.comp(c), kLanePad, v.at[c]);
      }
    }
  }
  takeStrings(f, s);
}

void Machine::callByBatch(Frame& f, const Step& s, bool varying) {
  ShadeopCalls& calls = *shadeopCalls_;
  const Shadeop& op = *s.shadeop;
  const ShaderProgram& p = f.exe().program();
  const Operand* a = f.args(s);
  const uint32_t argc = 1 + uint32_t(op.spec.arguments.size());
  if (calls.args.size() < argc) calls.args.resize(argc);
  prepareStrings(f, s);
  for (uint32_t k = 0; k < argc; ++k) {
    const Operand& o = a[operandOf(k)];
    const Symbol& symbol = p.symbols[symbolOf(f, s, operandOf(k))];
    const bool text = symbol.type == SlType::kString;
    calls.args[k] = {text ? nullptr : o.data,       o.component,
                     int(symbol.floats()),          !text && o.varying(),
                     isWritten(f, s, operandOf(k)), text ? &calls.texts[k].given : nullptr};
  }
  static constexpr int kOne[1] = {1};
  static_assert(sizeof(int) == sizeof(int32_t));
  const FrShadeopBatch batch{FR_SHADEOP_VERSION,      varying ? int(f.lanes()) : 1,
                             varying ? f.mask : kOne, int(argc),
                             calls.args.data(),       p.name.c_str()};
  const int status = op.batch(shadeopThreadData(op), &batch);
  if (status != 0)
    reportOnce("shadeop.status." + op.path + op.name,
               Error{RiError::kSystem,
                     Severity::kWarning,
                     {},
                     fmt::format("shadeop {}() of '{}' failed with status {}", op.name, op.path, status)});
  // A uniform register holds its value in every lane.
  for (uint32_t k = 0; k < argc; ++k) {
    const Operand& o = a[operandOf(k)];
    if (!calls.args[k].written || !o.data || o.varying()) continue;
    for (int c = 0; c < calls.args[k].components; ++c)
      std::fill_n(o.comp(uint32_t(c)), kLanePad, o.comp(uint32_t(c))[0]);
  }
  takeStrings(f, s);
}

void Machine::shadeopCall(Frame& f, const Step& s) {
  if (!s.shadeop) return;  // has been reported: the result stays as it is
  const ShaderProgram& p = f.exe().program();
  const Operand* a = f.args(s);
  const uint32_t argc = 1 + uint32_t(s.shadeop->spec.arguments.size());
  if (!shadeopCalls_) shadeopCalls_ = std::make_unique<ShadeopCalls>();
  bool varying = false;
  for (uint32_t k = 0; k < argc; ++k) {
    const Operand& o = a[operandOf(k)];
    varying = varying || (o.data && o.varying());
  }
  try {
    if (s.shadeop->batch)
      callByBatch(f, s, varying);
    else
      callByPoint(f, s, varying);
  } catch (...) {
    reportOnce("shadeop.thrown." + s.shadeop->path + s.shadeop->name,
               makeError(RiError::kSystem, "shadeop {}() of '{}' threw an exception", s.shadeop->name,
                         s.shadeop->path));
  }
  // What comes from outside may be anything; numbers of shaders are finite.
  for (uint32_t k = 0; k < argc; ++k) {
    const Operand& o = a[operandOf(k)];
    if (!o.data || !isWritten(f, s, operandOf(k))) continue;
    for (uint32_t c = 0; c < p.symbols[symbolOf(f, s, operandOf(k))].floats(); ++c) {
      KernelCall call;
      const Operand column{o.comp(c), o.component, o.indexMask};
      call.arg = &column, call.argCount = 1, call.lanes = o.varying() ? f.lanes() : kLanePad,
      call.mask = f.mask;
      kernels().helper[size_t(Helper::sanitize)](call);
    }
  }
}

}  // namespace fr
