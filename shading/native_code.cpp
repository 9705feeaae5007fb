#include "shading/native_code.h"

#include "shading/executable.h"
#include "shading/liveness.h"
#include "shading/run_recorder.h"

namespace fr {

namespace {

/// Programs beyond this are not worth the time.
constexpr size_t kMostInstructions = 50000;
/// About as many nodes in one run: compilation grows a little faster than the run.
constexpr uint32_t kMostNodes = 8000;

struct Range {
  uint32_t begin, end;
  bool blocks = true;  // whole blocks may be part of it
  bool loops = true;   // so may loops
};

/// Adds runs of instructions that can be recorded in a row.
void findRuns(const RunRecorder& recorder, const Range& within, std::vector<Range>& runs) {
  uint32_t nodes = 0;
  for (uint32_t i = within.begin; i < within.end;) {
    RunRecorder::Extent e = recorder.instruction(i);
    if (!within.blocks && e.end != i + 1) e = {};
    if (!within.loops && e.end > i && recorder.hasLoop(i, e.end)) e = {};
    if (e.end == 0) {
      nodes = 0;
      ++i;
      continue;
    }
    if (nodes == 0 && recorder.isNothing(i)) {
      ++i;
      continue;
    }
    if (nodes == 0 || nodes > kMostNodes) {
      runs.push_back({i, i, within.blocks, within.loops});
      nodes = 0;
    }
    runs.back().end = i = e.end;
    nodes += e.nodes;
  }
}

/// Compiles run after run into one piece of memory.
class Compilation {
 public:
  Compilation(const Executable& exe, std::span<const RunLight> lights)
      : exe_(exe),
        program_(exe.program()),
        recorder_(exe, lights),
        scope_(recorder_.graph),
        liveness_(program_, exe.varyingControl()) {}

  void compileAll() {
    std::vector<Range> runs;
    findRuns(recorder_, {program_.bodyBegin, uint32_t(program_.code.size())}, runs);
    while (!runs.empty()) runs = compile(runs);
  }

  struct Result {
    uint32_t begin = 0;
    size_t offset = 0;
    NativeCode::Run run;
  };
  std::vector<uint8_t> code;
  std::vector<Result> results;

 private:
  /// Returns what remains to be tried.
  std::vector<Range> compile(const std::vector<Range>& ranges) {
    std::vector<uint32_t> ends;
    for (const Range& r : ranges) ends.push_back(r.end);
    const std::vector<Liveness::Bits> live = liveness_.before(ends);  // what is read behind each run
    std::vector<Range> rest;
    for (size_t k = 0; k < ranges.size(); ++k)
      if (!compile(ranges[k], live[k])) divide(ranges[k], rest);
    return rest;
  }
  void divide(const Range& failed, std::vector<Range>& parts) const;
  bool compile(const Range& range, const Liveness::Bits& live);
  bool listOutputs(const Range& range, const Liveness::Bits& live, std::vector<RunOutput>& outputs) const;

  const Executable& exe_;
  const ShaderProgram& program_;
  RunRecorder recorder_;
  const RecordingScope scope_;
  const Liveness liveness_;
};

/// Predefined variables that the renderer and other shaders may look at, and parameters.
bool isShared(const ShaderProgram& p, const Symbol& s) {
  if (s.storage == Storage::kOutputParameter || s.storage == Storage::kParameter) return true;
  return s.storage == Storage::kGlobal && !setByLightLoop(p, GlobalId(s.data));
}

bool Compilation::listOutputs(const Range& range, const Liveness::Bits& live,
                              std::vector<RunOutput>& outputs) const {
  // Points that a light was not asked for keep what an earlier turn has left.
  const bool varyingControl = exe_.varyingControl()[range.begin], light = program_.type == ShaderType::kLight;
  std::vector<bool> seen(exe_.columnCount(), false);
  const auto& written = recorder_.written();
  for (size_t w = written.size(); w-- > 0;) {
    const auto [s, column, masked] = written[w];
    const bool shared = isShared(program_, program_.symbols[s]);
    if (seen[column] || (!Liveness::has(live, s) && !shared)) continue;
    seen[column] = true;
    const Node& value = recorder_.graph.nodes()[recorder_.value(column)];
    if ((value.op == VectorOp::kLoad || value.op == VectorOp::kLoadUniform) && value.imm == column) continue;
    RunOutput o;
    o.column = column;
    o.value = recorder_.value(column);
    o.uniform = !exe_.varying(s);
    o.masked = !o.uniform && masked && (varyingControl || (light && shared));
    if (o.uniform && !value.uniform) return false;
    outputs.push_back(o);
  }
  return true;
}

/// What to try instead of a run that could not be compiled.
void Compilation::divide(const Range& failed, std::vector<Range>& parts) const {
  const uint32_t at = recorder_.failedFor();
  if (at == kNoIndex) {
    if (failed.loops && recorder_.hasLoop(failed.begin, failed.end))
      findRuns(recorder_, {failed.begin, failed.end, failed.blocks, false}, parts);
    else if (failed.blocks)
      findRuns(recorder_, {failed.begin, failed.end, false, false}, parts);
  } else if (at > failed.begin) {
    findRuns(recorder_, {failed.begin, at, true, failed.loops}, parts);
    findRuns(recorder_, {at, failed.end, true, failed.loops}, parts);
  } else {
    findRuns(recorder_, {at + 1, failed.end, true, failed.loops}, parts);  // the block stays control flow
  }
}

bool Compilation::compile(const Range& range, const Liveness::Bits& live) {
  recorder_.clear();
  std::vector<RunOutput> outputs;
  if (!recorder_.record(range.begin, range.end) || !listOutputs(range, live, outputs)) return false;
  recorder_.graph.mask();
  const std::vector<uint8_t> bytes = compileRun(recorder_.graph, outputs, true);
  code.resize((code.size() + 63) / 64 * 64);
  Result r;
  r.begin = range.begin, r.offset = code.size();
  r.run.end = range.end;
  r.run.steps = recorder_.steps(), r.run.varyingSteps = recorder_.varyingSteps();
  r.run.lights = recorder_.lightsRun(), r.run.readsLights = recorder_.readsLights();
  r.run.loopAhead = recorder_.loopAhead();
  r.run.differences = recorder_.differences(), r.run.firstDifference = recorder_.firstDifference();
  code.insert(code.end(), bytes.begin(), bytes.end());
  results.push_back(r);
  return true;
}

}  // namespace

std::unique_ptr<const NativeCode> NativeCode::compile(const Executable& exe,
                                                      std::span<const RunLight> lights) {
  if (!nativeCodeAvailable() || exe.program().code.size() > kMostInstructions) return nullptr;
  Compilation c(exe, lights);
  c.compileAll();
  if (c.results.empty()) return nullptr;
  std::unique_ptr<NativeCode> result(new NativeCode);
  result->memory_ = NativeMemory::of(c.code);
  if (!result->memory_) return nullptr;
  result->runAt_.assign(exe.program().code.size(), 0);
  for (Compilation::Result& r : c.results) {
    r.run.function =
        reinterpret_cast<RunFunction>(reinterpret_cast<uintptr_t>(result->memory_->at(r.offset)));
    result->runs_.push_back(r.run);
    result->runAt_[r.begin] = uint32_t(result->runs_.size());
  }
  return result;
}

}  // namespace fr
