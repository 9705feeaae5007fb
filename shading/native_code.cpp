#include "shading/native_code.h"

#include "shading/executable.h"
#include "shading/liveness.h"
#include "shading/recorded_kernels.h"

namespace fr {

namespace {

/// Programs beyond this are not worth the time.
constexpr size_t kMostInstructions = 50000;
/// About as many nodes in one run: compilation grows a little faster than the run.
constexpr uint32_t kMostNodes = 8000;
constexpr NodeIndex kUnknown = ~0u;

uint32_t nodesOf(Op op) {
  switch (opInfo(op).cost) {
    case Cost::kHeavy:
      return 700;
    case Cost::kMath:
      return 50;
    default:
      return 5;
  }
}

bool hasRecipe(const Step& s) { return s.kernel && !s.control && recordedKernels().op[size_t(s.op)]; }

/// The values of a run's registers while it is recorded.
class RunRecorder final : public OperandRecorder {
 public:
  explicit RunRecorder(const Executable& exe) : exe_(exe), values_(exe.columnCount(), kUnknown) {}

  void record(const Step& s) {
    step_ = &s;
    operands_.resize(s.argCount);
    for (uint32_t k = 0; k < s.argCount; ++k) operands_[k] = {this, k};
    recorded::KernelCall call;
    call.arg = operands_.data(), call.argCount = s.argCount;
    recordedKernels().op[size_t(s.op)](call);
  }
  NodeIndex read(uint32_t operand, uint32_t component) override {
    const uint32_t s = symbol(operand), column = exe_.firstColumn(s) + component;
    if (values_[column] == kUnknown) {
      values_[column] = graph.load(column, !exe_.varying(s));
      touched_.push_back(column);
    }
    return values_[column];
  }
  void write(uint32_t operand, uint32_t component, NodeIndex value) override {
    const uint32_t s = symbol(operand), column = exe_.firstColumn(s) + component;
    if (values_[column] == kUnknown) touched_.push_back(column);
    values_[column] = value;
    written.push_back({s, column, step_->masked});
  }
  NodeIndex value(uint32_t column) const { return values_[column]; }
  void clear() {
    for (const uint32_t c : touched_) values_[c] = kUnknown;
    touched_.clear();
    written.clear();
    graph.clear();
  }

  struct Written {
    uint32_t symbol, column;
    bool masked;  // inactive points keep their value
  };
  ValueGraph graph;
  std::vector<Written> written;

 private:
  uint32_t symbol(uint32_t operand) const {
    return exe_.program().args[step_->firstArg + operand] & kArgIndex;
  }
  const Executable& exe_;
  const Step* step_ = nullptr;
  std::vector<NodeIndex> values_;
  std::vector<uint32_t> touched_;
  std::vector<recorded::Operand> operands_;
};

struct Range {
  uint32_t begin, end;
};

std::vector<Range> findRuns(const Executable& exe) {
  std::vector<Range> runs;
  const std::vector<Step>& steps = exe.steps();
  uint32_t nodes = 0;
  for (uint32_t i = exe.program().bodyBegin; i < steps.size(); ++i) {
    if (!hasRecipe(steps[i])) {
      nodes = 0;
      continue;
    }
    if (nodes == 0 || nodes > kMostNodes) {
      runs.push_back({i, i});
      nodes = 0;
    }
    runs.back().end = i + 1;
    nodes += nodesOf(steps[i].op);
  }
  return runs;
}

}  // namespace

std::unique_ptr<const NativeCode> NativeCode::compile(const Executable& exe) {
  const ShaderProgram& p = exe.program();
  if (!nativeCodeAvailable() || p.code.size() > kMostInstructions) return nullptr;
  const std::vector<Range> ranges = findRuns(exe);
  if (ranges.empty()) return nullptr;
  // What is read behind each run.
  std::vector<uint32_t> ends;
  for (const Range& r : ranges) ends.push_back(r.end);
  const Liveness liveness(p, exe.varyingControl());
  const std::vector<Liveness::Bits> live = liveness.before(ends);

  std::unique_ptr<NativeCode> result(new NativeCode);
  result->runAt_.assign(p.code.size(), 0);
  std::vector<uint8_t> code;
  std::vector<size_t> offsets;
  RunRecorder recorder(exe);
  const RecordingScope scope(recorder.graph);
  for (size_t k = 0; k < ranges.size(); ++k) {
    const Range range = ranges[k];
    recorder.clear();
    Run run;
    run.end = range.end;
    for (uint32_t i = range.begin; i < range.end; ++i) {
      recorder.record(exe.steps()[i]);
      ++run.steps, run.varyingSteps += exe.steps()[i].varying;
    }
    // Points that a light was not asked for keep what an earlier turn has left.
    const bool varyingControl = exe.varyingControl()[range.begin], light = p.type == ShaderType::kLight;
    std::vector<RunOutput> outputs;
    std::vector<bool> seen(exe.columnCount(), false);
    bool possible = true;
    for (size_t w = recorder.written.size(); w-- > 0;) {
      const auto [s, column, masked] = recorder.written[w];
      const Symbol& symbol = p.symbols[s];
      const Storage st = symbol.storage;
      const bool shared =
          st == Storage::kGlobal || st == Storage::kOutputParameter || st == Storage::kParameter;
      if (seen[column] || (!Liveness::has(live[k], s) && !shared)) continue;
      seen[column] = true;
      const Node& value = recorder.graph.nodes()[recorder.value(column)];
      if ((value.op == VectorOp::kLoad || value.op == VectorOp::kLoadUniform) && value.imm == column)
        continue;
      RunOutput o;
      o.column = column;
      o.value = recorder.value(column);
      o.uniform = !exe.varying(s);
      o.masked = !o.uniform && masked && (varyingControl || (light && shared));
      possible = possible && !(o.uniform && !value.uniform);
      outputs.push_back(o);
    }
    if (!possible) continue;
    recorder.graph.mask();
    const std::vector<uint8_t> bytes = compileRun(recorder.graph, outputs, true);
    code.resize((code.size() + 63) / 64 * 64);
    offsets.push_back(code.size());
    code.insert(code.end(), bytes.begin(), bytes.end());
    result->runs_.push_back(run);
    result->runAt_[range.begin] = uint32_t(result->runs_.size());
  }
  if (result->runs_.empty()) return nullptr;
  result->memory_ = NativeMemory::of(code);
  if (!result->memory_) return nullptr;
  for (size_t k = 0; k < result->runs_.size(); ++k)
    result->runs_[k].function =
        reinterpret_cast<RunFunction>(reinterpret_cast<uintptr_t>(result->memory_->at(offsets[k])));
  return result;
}

}  // namespace fr
