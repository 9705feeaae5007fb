#include "shading/executable.h"

#include <algorithm>

#include "base/error.h"
#include "shading/liveness.h"

namespace fr {

namespace {
constexpr uint32_t kBatchesBeforeNative = 4;
/// Sets of lights with code of their own; further ones are lit by kernels.
constexpr size_t kMostNatives = 64;
/// Outcomes of tests of parameters that have a program of their own; for others all remains to be asked.
constexpr size_t kMostDecided = 16;
}  // namespace

Executable::Executable(std::shared_ptr<const ShaderProgram> program,
                       const std::vector<std::string>& varyingParameters)
    : program_(std::move(program)), varyingParameters_(varyingParameters) {
  places_.resize(program_->symbols.size());
  globals_.fill(kNoIndex);
  inferClasses(varyingParameters);
  const Liveness liveness(*program_, varyingControl_);
  placeSymbols(liveness);
  prepareSteps();
  findUnread(liveness);
  // Numbers can be sent to lights.
  parameterTests_ = findParameterTests(*program_, [&](uint32_t s) {
    const bool number = program_->symbols[s].type != SlType::kString;
    return !places_[s].varying && !(number && program_->type == ShaderType::kLight);
  });
  plainLight_ = fr::plainLight(*this);
}

namespace {
bool opensBlock(Op op) {
  switch (op) {
    case Op::if_begin:
    case Op::loop_begin:
    case Op::inline_begin:
    case Op::illuminance_begin:
    case Op::illuminance_cone_begin:
    case Op::ambient_begin:
    case Op::illuminate_begin:
    case Op::illuminate_cone_begin:
    case Op::solar_begin:
    case Op::solar_cone_begin:
    case Op::gather_begin:
      return true;
    default:
      return false;
  }
}
bool closesBlock(Op op) {
  switch (op) {
    case Op::if_end:
    case Op::loop_end:
    case Op::inline_end:
    case Op::illuminance_end:
    case Op::illuminate_end:
    case Op::solar_end:
    case Op::gather_end:
      return true;
    default:
      return false;
  }
}
}  // namespace

// The compiler has inferred classes for uniform parameters. Where primitive variables override some of them,
// the inference is done again from there: to a fixed point, since loops feed values back.
void Executable::inferClasses(const std::vector<std::string>& varyingParameters) {
  const ShaderProgram& p = *program_;
  for (size_t i = 0; i < p.symbols.size(); ++i)
    places_[i].varying = p.symbols[i].isVarying() && p.symbols[i].type != SlType::kString;
  bool changed = false;
  for (const std::string& name : varyingParameters) {
    const uint32_t index = p.findParameter(name);
    if (index == kNoIndex) continue;
    const uint32_t s = p.parameters[index].symbol;
    if (p.symbols[s].type == SlType::kString || places_[s].varying) continue;
    places_[s].varying = changed = true;
  }
  // Blocks that some points leave early, by index of their first instruction.
  std::vector<char> leaves(p.code.size(), 0);
  if (changed)
    while (followControl(leaves, true)) {
    }
  while (followControl(leaves, false)) {
  }
}

/// One pass over the body: where some points may be inactive, and (inferring) what is varying for that or for
/// its operands. True when it found something new.
bool Executable::followControl(std::vector<char>& leaves, bool inferring) {
  const ShaderProgram& p = *program_;
  bool changed = false;
  std::vector<char> varying;  // one per open block
  std::vector<uint32_t> open;
  varyingControl_.assign(p.code.size(), false);
  for (uint32_t i = p.bodyBegin; i < p.code.size(); ++i) {
    const Instruction& in = p.code[i];
    const uint32_t flags = opInfo(in.op).flags;
    bool reads = false;
    for (uint32_t a : p.operands(in)) reads |= (a & kArgRead) && places_[a & kArgIndex].varying;
    const bool inside = !varying.empty() && varying.back();
    varyingControl_[i] = inside;
    if (opensBlock(in.op)) {
      open.push_back(i);
      varying.push_back(inside || leaves[i] || (in.op == Op::if_begin && reads) ||
                        (in.op != Op::if_begin && in.op != Op::loop_begin && in.op != Op::inline_begin));
    } else if (closesBlock(in.op)) {
      if (!open.empty()) open.pop_back(), varying.pop_back();
    } else if (in.op == Op::loop_test && reads && !open.empty()) {
      if (!leaves[open.back()]) leaves[open.back()] = 1, changed = true;
      varying.back() = 1;
    } else if (inside &&
               (in.op == Op::break_loop || in.op == Op::continue_loop || in.op == Op::inline_return)) {
      // Some points leave: all blocks out to the one that is left run under varying control.
      for (size_t k = open.size(); k-- > 0;) {
        if (!leaves[open[k]]) leaves[open[k]] = 1, changed = true;
        const uint32_t end = p.code[open[k]].jump;
        if (in.jump != kNoIndex && end != kNoIndex && end >= in.jump) break;
      }
    }
    if (!inferring || (flags & kOpResultUniform)) continue;
    for (uint32_t a : p.operands(in)) {
      const uint32_t s = a & kArgIndex;
      if (!(a & kArgWritten) || places_[s].varying || p.symbols[s].type == SlType::kString) continue;
      if (reads || (flags & kOpResultVarying) || ((flags & kOpMasked) && inside))
        places_[s].varying = changed = true;
    }
  }
  return changed;
}

void Executable::placeSymbols(const Liveness& liveness) {
  const ShaderProgram& p = *program_;
  liveAtEntry_.resize(p.symbols.size());
  for (uint32_t i = 0; i < p.symbols.size(); ++i) {
    const Symbol& s = p.symbols[i];
    if (s.storage == Storage::kGlobal && s.data < globals_.size()) {
      globals_[s.data] = i;
      usedGlobals_.push_back(GlobalId(s.data));
    }
    firstColumn_.push_back(columnCount_);
    columnCount_ += s.floats();
    uint32_t& counter = s.type == SlType::kString ? strings_ : places_[i].varying ? columns_ : blocks_;
    places_[i].first = counter;
    counter += s.type == SlType::kString ? std::max(1u, s.arrayLength) : s.floats();
    liveAtEntry_[i] = liveness.atEntry(i);
    const bool variable = s.storage == Storage::kLocal || s.storage == Storage::kTemp;
    if (variable && s.type != SlType::kString && liveAtEntry_[i]) zeroed_.push_back(i);
  }
  for (uint32_t k = 0; k < p.args.size(); ++k) {
    const Symbol& s = p.symbol(p.args[k]);
    if (s.storage == Storage::kGlobal && s.data < globals_.size()) globalArgs_[s.data].push_back(k);
  }
}

const NativeCode* Executable::native(std::span<const RunLight> lights, OwnerOf ownerOf, const void* owner,
                                     bool& final) const {
  final = true;
  if (!nativeCodeAvailable()) return nullptr;
  std::unique_lock lock(nativeMutex_);
  const auto known = std::find_if(natives_.begin(), natives_.end(), [&](const auto& n) {
    return std::equal(n->lights.begin(), n->lights.end(), lights.begin(), lights.end());
  });
  const bool isNew = known == natives_.end();
  if (isNew && natives_.size() >= kMostNatives) return nullptr;
  Native& n = isNew ? *natives_.emplace_back(std::make_unique<Native>()) : **known;
  if (isNew) {
    n.lights.assign(lights.begin(), lights.end());
    for (uint32_t k = 0; k < lights.size(); ++k) n.owners.push_back(ownerOf(owner, k));
  }
  final = n.done;
  if (n.tried) return n.code.get();
  if (!nativeAtOnce_.load(std::memory_order_relaxed) && n.batches++ < kBatchesBeforeNative) return nullptr;
  n.tried = true;
  lock.unlock();
  std::unique_ptr<const NativeCode> code = NativeCode::compile(*this, n.lights);
  lock.lock();
  n.code = std::move(code);
  final = n.done = true;
  return n.code.get();
}

std::shared_ptr<const Executable> Executable::decided(const std::vector<ShaderValue>& values) const {
  if (parameterTests_.empty()) return nullptr;
  const uint64_t results = parameterTestResults(*program_, parameterTests_, values);
  const std::lock_guard lock(decidedMutex_);
  for (const auto& [r, e] : decided_)
    if (r == results) return e;
  if (decided_.size() >= kMostDecided) return nullptr;
  auto program =
      std::make_shared<const ShaderProgram>(decideParameterTests(*program_, parameterTests_, results));
  auto e = std::make_shared<Executable>(std::move(program), varyingParameters_);
  if (nativeAtOnce_.load(std::memory_order_relaxed)) e->makeNativeAtOnce();
  decided_.push_back({results, e});
  return e;
}

uint32_t Executable::nativeCount() const {
  const std::lock_guard lock(nativeMutex_);
  return uint32_t(std::count_if(natives_.begin(), natives_.end(), [](const auto& n) { return n->tried; }));
}

/// Not found, or not what the program was compiled for: the machine says so when it gets there.
void Executable::bindShadeop(Step& s, const Instruction& in) {
  const ShaderProgram& p = *program_;
  const auto o = p.operands(in);
  const auto text = [&](size_t k) -> const std::string& { return p.strings[p.symbol(o[k]).data]; };
  const Result<const Shadeop*> op = fr::bindShadeop(text(1), text(2), text(3));
  if (!op) return reportOnce("shadeop." + text(1) + text(2) + text(3), op.error());
  const ShadeopSpec& spec = (*op)->spec;
  bool fits = o.size() == 4 + 2 * spec.arguments.size() &&
              p.symbol(o[0]).type == (spec.result == SlType::kVoid ? SlType::kFloat : spec.result);
  for (size_t k = 0; fits && k < spec.arguments.size(); ++k) {
    const Symbol& x = p.symbol(o[5 + 2 * k]);
    const ShadeopArgument& a = spec.arguments[k];
    fits = slTypeFloats(x.type) == slTypeFloats(a.type) && x.isArray() == a.isArray &&
           (a.arrayLength == 0 || x.arrayLength == a.arrayLength);
  }
  if (!fits)
    return reportOnce(
        "shadeop." + text(1) + text(2) + text(3),
        makeError(RiError::kBadFile, "shader '{}': the call of {}() does not fit \"{}\" of '{}'", p.name,
                  text(2), text(3), text(1)));
  s.shadeop = *op;
}

void Executable::prepareSteps() {
  const ShaderProgram& p = *program_;
  const KernelTable& table = kernels();
  steps_.resize(p.code.size());
  uint32_t depth = 0;
  for (size_t i = 0; i < p.code.size(); ++i) {
    const Instruction& in = p.code[i];
    const uint32_t flags = opInfo(in.op).flags;
    Step& s = steps_[i];
    s.op = in.op;
    s.kernel = table.op[size_t(in.op)];
    s.firstArg = in.firstArg;
    s.argCount = in.argCount;
    s.jump = in.jump;
    s.masked = (flags & kOpMasked) != 0;
    s.control = (flags & kOpControl) != 0;
    for (uint32_t a : p.operands(in))
      if (a & kArgWritten) s.varying |= places_[a & kArgIndex].varying;
    if (in.op == Op::dso_call) bindShadeop(s, in);
    if (flags & (kOpRandom | kOpRay | kOpTexture)) s.counter = counters_++;
    if (opensBlock(in.op)) depth_ = std::max(depth_, ++depth);
    if (closesBlock(in.op) && depth > 0) --depth;
  }
}

/// Results of ray operations that need not be copied from the block to registers.
void Executable::findUnread(const Liveness& liveness) {
  const ShaderProgram& p = *program_;
  std::vector<uint32_t> calls, behind;
  for (uint32_t i = p.bodyBegin; i < p.code.size(); ++i)
    if (opInfo(p.code[i].op).flags & kOpRay) calls.push_back(i), behind.push_back(i + 1);
  if (calls.empty()) return;
  const std::vector<Liveness::Bits> live = liveness.before(behind);
  for (size_t k = 0; k < calls.size(); ++k) {
    const auto operands = p.operands(p.code[calls[k]]);
    for (uint32_t o = 0; o < std::min<size_t>(operands.size(), 32); ++o)
      if ((operands[o] & kArgWritten) && !Liveness::has(live[k], operands[o] & kArgIndex))
        steps_[calls[k]].unread |= 1u << o;
  }
}

}  // namespace fr
