// Records what the instructions of a run compute, as a graph: one after the other, with conditions and plain
// light loops written out.
//
// Every point goes through all of it. Who is active is a value of the graph like any other; an assignment
// within a block keeps the old value where its condition does not hold. A value that is read within the same
// block is the assigned one, so most of these choices never become code.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "shading/executable.h"
#include "shading/recorded_kernels.h"

namespace fr {

/// Columns of the graph: those of the surface's Executable, then those of the first light, and so on.
class RunRecorder final : public OperandRecorder {
 public:
  RunRecorder(const Executable& exe, std::span<const RunLight> lights);

  /// Whether a run may hold the block that begins at this instruction of the shader: what follows it, and
  /// about how many nodes it takes; end 0: it may not.
  struct Extent {
    uint32_t end = 0, nodes = 0;
  };
  Extent block(uint32_t begin) const { return blockOf(0, begin, 0); }
  /// The same of any instruction.
  Extent instruction(uint32_t i) const { return instructionOf(0, i, 0); }
  bool hasLoop(uint32_t begin, uint32_t end) const;
  bool isNothing(uint32_t i) const { return parts_[0].exe->steps()[i].op == Op::nop; }

  /// Forgets everything but what it was made for.
  void clear();
  /// Appends the instructions [begin, end): whole blocks. False: something about them cannot be recorded
  /// after all.
  bool record(uint32_t begin, uint32_t end);

  /// Differences between neighbours, of values that the registers hold when the run begins: columns behind
  /// those of all lights, which the machine fills before the run.
  const std::vector<RunDifference>& differences() const { return differences_; }
  uint32_t firstDifference() const { return firstDifference_; }
  /// The light loop whose lights have to run before the code does, kNoIndex: there is none.
  uint32_t loopAhead() const { return ahead_.loop; }
  /// Why record() failed: this instruction, or the block that it begins, needs lights for a place that is not
  /// known when the code begins. kNoIndex: for another reason.
  uint32_t failedFor() const { return ahead_.failedAt; }

  NodeIndex value(uint32_t column) const { return parts_[0].values[column]; }
  bool readsLights() const { return readsLights_; }
  uint32_t steps() const { return steps_; }
  uint32_t varyingSteps() const { return varyingSteps_; }
  /// Lights that are looked at, each once for the same place and normal: their values are the same nodes.
  uint32_t lightsRun() const { return uint32_t(lightsAsked_.size()); }
  struct Written {
    uint32_t symbol, column;
    bool masked;  // inactive points keep their value
  };
  const std::vector<Written>& written() const { return written_; }

  NodeIndex read(uint32_t operand, uint32_t component) override;
  void write(uint32_t operand, uint32_t component, NodeIndex value) override;

  ValueGraph graph;

 private:
  static constexpr NodeIndex kUnknown = ~0u;  // a column that the run has not looked at

  /// The surface, or one of the lights.
  struct Part {
    const Executable* exe;
    uint32_t base;  // of its columns
    std::vector<NodeIndex> values;
    std::vector<uint32_t> touched;
  };
  struct Block {
    enum class Kind : uint8_t { kIf, kInline, kLights, kEmission, kLoop } kind;
    NodeIndex saved;  // who is active behind it
    NodeIndex other;  // kLights: who still takes part. kLoop: who has gone on to the next turn
    uint32_t light = 0;
    bool ahead = false;  // kLights: some of its lights run before the code
  };
  struct Triple {
    NodeIndex c[3] = {};
  };
  /// What a light does to the points that are lit: nodes 0 where it does nothing.
  struct Emission {
    Triple Ps, N, L;
    NodeIndex lit = 0;
  };

  Extent blockOf(uint32_t part, uint32_t begin, uint32_t depth) const;
  Extent instructionOf(uint32_t part, uint32_t i, uint32_t depth) const;
  Extent lightsOf(uint32_t begin, uint32_t depth) const;
  Extent loopOf(uint32_t begin, uint32_t depth) const;
  /// Where a loop's condition is tested, and where its step begins.
  std::pair<uint32_t, uint32_t> placesOf(uint32_t begin) const;
  bool leavesWithin(uint32_t part, uint32_t i) const;
  bool jumpsOut(uint32_t begin, uint32_t end) const;

  void recordRange(uint32_t begin, uint32_t end);
  uint32_t recordIf(uint32_t i);
  uint32_t recordInline(uint32_t i);
  uint32_t recordLights(uint32_t i);
  uint32_t recordLoop(uint32_t i);
  void recordLight(uint32_t light, NodeIndex alive);
  bool canAskAhead(uint32_t i);
  void lightsAreMissed();
  Triple ofLight(uint32_t light, uint32_t column, uint32_t components);
  uint32_t recordEmission(uint32_t i);
  void recordMessage(const Step& s);
  void recordStep(const Step& s);
  void recordDifference(const Step& s);
  void leave(size_t outermost);
  void leaveLoop(const Step& s);

  const Step& step(uint32_t i) const { return parts_[part_].exe->steps()[i]; }
  uint32_t symbol(uint32_t operand) const {
    return parts_[part_].exe->program().args[step_->firstArg + operand] & kArgIndex;
  }
  NodeIndex& current(uint32_t part, uint32_t symbol, uint32_t component);
  NodeIndex readColumn(uint32_t part, uint32_t symbol, uint32_t component);
  void writeColumn(uint32_t symbol, uint32_t component, NodeIndex value, bool masked);
  Triple readTriple(const Step& s, uint32_t operand);
  Triple readGlobal(uint32_t part, GlobalId id);
  void writeGlobal(GlobalId id, const Triple& t);
  void setGlobal(uint32_t light, GlobalId id, const Triple& t);
  Triple chosen(NodeIndex mask, const Triple& a, const Triple& b);
  Triple call(recorded::Kernel kernel, std::initializer_list<Triple> in);
  NodeIndex cone(NodeIndex mask, const Triple& direction, const Triple& axis, NodeIndex angle);
  NodeIndex both(NodeIndex a, NodeIndex b) { return graph.binary(VectorOp::kAnd, a, b); }
  NodeIndex without(NodeIndex a, NodeIndex b) { return graph.binary(VectorOp::kAndNot, b, a); }
  void setMask(NodeIndex mask);
  bool nobody() const { return mask_ == 0; }
  NodeIndex asActivePointsSeeIt(NodeIndex value);

  std::vector<RunLight> lights_;
  std::vector<Part> parts_;
  std::vector<RunDifference> differences_;
  uint32_t firstDifference_ = 0, differenceColumns_ = 0;
  uint32_t part_ = 0;
  std::vector<Block> blocks_;
  NodeIndex ones_ = 0, mask_ = 0;
  std::vector<NodeIndex> holds_, fails_;  // masks that are all ones, or 0, where mask_ is set
  Emission* emission_ = nullptr;
  const Step* step_ = nullptr;
  std::vector<Written> written_;
  std::vector<recorded::Operand> operands_;
  bool sends_ = false;  // a light loop has options
  /// Of lights that run before the code: the first loop over them, its place, the normal and the cone.
  struct Ahead {
    uint32_t loop = kNoIndex, at = 0, failedAt = kNoIndex;
    std::array<NodeIndex, 10> question{};
  } ahead_;
  bool failed_ = false, readsLights_ = false;
  uint32_t steps_ = 0, varyingSteps_ = 0;
  std::vector<std::array<NodeIndex, 7>> lightsAsked_;  // light, Ps, N
};

}  // namespace fr
