// Lights in recorded code: loops over those of the batch, written out or known before the code runs.
#include <algorithm>

#include "shading/run_recorder.h"

namespace fr {

namespace {
bool sameKind(SlType a, SlType b) { return a == b || (isTriple(a) && isTriple(b)); }
}  // namespace

void RunRecorder::lightsAreMissed() {
  failed_ = true;
  ahead_.failedAt = ahead_.at;
}

/// Whether the lights of a loop may run before the code: for the place, normal and cone that the shader's
/// registers hold by then, and for all points. Further loops find what the first one has asked for.
bool RunRecorder::canAskAhead(uint32_t i) {
  const Step& s = step(i);
  const Executable& exe = *parts_[0].exe;
  const bool ambient = s.op == Op::ambient_begin, cone = s.op == Op::illuminance_cone_begin;
  step_ = &s;
  std::array<NodeIndex, 10> question{};
  uint32_t count = 0;
  bool held = true;
  const auto ask = [&](uint32_t symbol, uint32_t components) {
    for (uint32_t c = 0; c < components; ++c) {
      const NodeIndex value = current(0, symbol, c);
      const Node& n = graph.nodes()[value];
      const bool own =
          (n.op == VectorOp::kLoad || n.op == VectorOp::kLoadUniform) && n.imm == exe.firstColumn(symbol) + c;
      held = held && (own || exe.program().symbols[symbol].storage == Storage::kConstant);
      question[count++] = value;
    }
  };
  ask(symbol(ambient ? 0 : 1), 3);
  if (const uint32_t N = exe.global(GlobalId::k_N); N != kNoIndex) ask(N, 3);
  // Shadow rays are asked for the points within the cone alone.
  const bool shadows =
      std::any_of(lights_.begin(), lights_.end(), [](const RunLight& l) { return l.shadowed; });
  if (cone && shadows) ask(symbol(2), 3), ask(symbol(3), 1);
  if (ahead_.loop == kNoIndex) {
    if (!held || mask_ != ones_) return false;
    ahead_.loop = i, ahead_.question = question;
    return true;
  }
  const bool sameKind =
      (step(ahead_.loop).op == Op::ambient_begin) == ambient && (!shadows || step(ahead_.loop).op == s.op);
  return sameKind && question == ahead_.question;
}

/// What is known of a light before the code runs (light_column).
RunRecorder::Triple RunRecorder::ofLight(uint32_t light, uint32_t column, uint32_t components) {
  const Part& p = parts_[light + 1];
  readsLights_ = true;
  Triple t;
  for (uint32_t c = 0; c < components; ++c)
    t.c[c] = graph.load(p.base + p.exe->columnCount() + column + c, false);
  return t;
}

/// A turn for every light of the loop's kind (Machine::lightTurn).
uint32_t RunRecorder::recordLights(uint32_t i) {
  const Step& s = step(i);
  const bool ambient = s.op == Op::ambient_begin;
  const bool ahead = std::any_of(lights_.begin(), lights_.end(), [&](const RunLight& l) {
    return (!l.plain || l.emitter) && l.exe->has(kProgramAmbientLight) == ambient;
  });
  if (ahead && !canAskAhead(i)) {
    lightsAreMissed();
    return s.jump + 1;
  }
  blocks_.push_back({Block::Kind::kLights, mask_, mask_});
  blocks_.back().ahead = ahead;
  for (uint32_t k = 0; k < lights_.size() && !failed_; ++k) {
    if (lights_[k].exe->has(kProgramAmbientLight) != ambient) continue;
    setMask(blocks_.back().other);
    if (nobody()) break;
    blocks_.back().light = k;
    Emission e;
    e.Ps = readTriple(s, ambient ? 0 : 1);
    e.N = readGlobal(0, GlobalId::k_N);
    const NodeIndex alive = mask_;
    const std::array<NodeIndex, 7> question = {k,        e.Ps.c[0], e.Ps.c[1], e.Ps.c[2],
                                               e.N.c[0], e.N.c[1],  e.N.c[2]};
    const bool plain = lights_[k].plain;
    if (plain && std::find(lightsAsked_.begin(), lightsAsked_.end(), question) == lightsAsked_.end())
      lightsAsked_.push_back(question);
    if (plain) {
      emission_ = &e;
      recordLight(k, alive);
      emission_ = nullptr;
    } else {
      e.lit = ofLight(k, light_column::kLit, 1).c[0];
      e.L = ofLight(k, light_column::kL, 3);
    }
    NodeIndex mask = ambient ? alive : both(alive, e.lit);
    setMask(mask);
    const auto seen = [&](Triple t) {
      for (NodeIndex& c : t.c) c = asActivePointsSeeIt(c);
      return t;
    };
    const recorded::Kernel negate = recordedKernels().op[size_t(Op::neg_t)];
    if (s.op == Op::illuminance_cone_begin) {
      const Triple toLight = call(negate, {seen(e.L)}), axis = readTriple(s, 2);
      mask = cone(mask, toLight, axis, read(3, 0));
      setMask(mask);
    }
    if (nobody()) continue;
    if (!ambient) writeGlobal(GlobalId::k_L, call(negate, {seen(e.L)}));
    const Triple ones{{graph.constant(1.0f), graph.constant(1.0f), graph.constant(1.0f)}};
    const bool opacity = lights_[k].exe->global(GlobalId::k_Ol) != kNoIndex;
    Triple Cl = plain ? readGlobal(k + 1, GlobalId::k_Cl) : ofLight(k, light_column::kCl, 3);
    if (lights_[k].emitter) {
      const NodeIndex dim = ofLight(k, light_column::kDim, 1).c[0];
      for (NodeIndex& c : Cl.c) c = graph.binary(VectorOp::kMul, c, dim);
    }
    writeGlobal(GlobalId::k_Cl, Cl);
    writeGlobal(GlobalId::k_Ol, !plain    ? ofLight(k, light_column::kOl, 3)
                                : opacity ? readGlobal(k + 1, GlobalId::k_Ol)
                                          : ones);
    recordRange(i + 1, s.jump);
  }
  setMask(blocks_.back().saved);
  blocks_.pop_back();
  return s.jump + 1;
}

/// The light's shader, for the points of `alive`.
void RunRecorder::recordLight(uint32_t light, NodeIndex alive) {
  Part& p = parts_[light + 1];
  const Executable& exe = *p.exe;
  // Variables begin anew; parameters are as they were.
  for (const uint32_t c : p.touched) p.values[c] = kUnknown;
  p.touched.clear();
  const bool emitter = lights_[light].emitter;
  const bool readsNormal =
      (!emitter && exe.global(GlobalId::k_N) != kNoIndex) || exe.global(GlobalId::k_Ns) != kNoIndex;
  if (readsNormal && parts_[0].exe->global(GlobalId::k_N) == kNoIndex) {
    failed_ = true;
    return;
  }
  const NodeIndex one = graph.constant(1.0f);
  setGlobal(light, GlobalId::k_Ps, emission_->Ps);
  setGlobal(light, GlobalId::k_N, emission_->N);
  setGlobal(light, GlobalId::k_Ns, emission_->N);
  if (emitter) {
    setGlobal(light, GlobalId::k_P, ofLight(light, light_column::kFrom, 3));
    setGlobal(light, GlobalId::k_N, ofLight(light, light_column::kNormal, 3));
  }
  setGlobal(light, GlobalId::k_L, {});
  setGlobal(light, GlobalId::k_Cl, {});
  setGlobal(light, GlobalId::k_Ol, {{one, one, one}});
  std::vector<Block> outer;
  outer.swap(blocks_);
  part_ = light + 1;
  setMask(alive);
  recordRange(exe.program().bodyBegin, uint32_t(exe.program().code.size()));
  part_ = 0;
  blocks_.swap(outer);
}

/// illuminate and solar (Machine::emit).
uint32_t RunRecorder::recordEmission(uint32_t i) {
  const Step& s = step(i);
  blocks_.push_back({Block::Kind::kEmission, mask_, 0});
  Triple direction;
  NodeIndex mask = mask_;
  const auto& kernel = recordedKernels();
  switch (s.op) {
    case Op::solar_begin:
      direction = call(kernel.op[size_t(Op::neg_t)], {emission_->N});
      break;
    case Op::solar_cone_begin:
      direction = call(kernel.op[size_t(Op::normalize)], {readTriple(s, 0)});
      break;
    default:
      direction = call(kernel.helper[size_t(Helper::subTriple)], {emission_->Ps, readTriple(s, 0)});
      if (s.op == Op::illuminate_cone_begin) {
        const Triple axis = readTriple(s, 1);
        mask = cone(mask, direction, axis, read(2, 0));
      }
  }
  setMask(mask);
  writeGlobal(GlobalId::k_L, direction);
  emission_->lit = graph.binary(VectorOp::kOr, emission_->lit, mask);
  emission_->L = chosen(mask, direction, emission_->L);
  recordRange(i + 1, s.jump);
  setMask(blocks_.back().saved);
  blocks_.pop_back();
  return s.jump + 1;
}

/// lightsource("name", value): what the light of the innermost loop has, if it has it.
void RunRecorder::recordMessage(const Step& s) {
  step_ = &s;
  const auto loop = std::find_if(blocks_.rbegin(), blocks_.rend(),
                                 [](const Block& b) { return b.kind == Block::Kind::kLights; });
  const ShaderProgram& p = parts_[0].exe->program();
  const Symbol& name = p.symbols[symbol(1)];
  const uint32_t to = symbol(2);
  const Symbol& out = p.symbols[to];
  if (loop == blocks_.rend() || name.storage != Storage::kConstant || out.type == SlType::kString) {
    failed_ = true;
    return;
  }
  const uint32_t part = loop->light + 1;
  const ShaderProgram& light = parts_[part].exe->program();
  const uint32_t parameter = light.findParameter(p.strings[name.data]);
  bool found = false;
  if (parameter != kNoIndex) {
    const uint32_t from = light.parameters[parameter].symbol;
    const Symbol& in = light.symbols[from];
    found = sameKind(out.type, in.type) && out.arrayLength == in.arrayLength &&
            !(parts_[part].exe->varying(from) && !parts_[0].exe->varying(to));
    for (uint32_t c = 0; found && c < out.floats(); ++c) writeColumn(to, c, readColumn(part, from, c), true);
  }
  writeColumn(symbol(0), 0, graph.constant(found ? 1.0f : 0.0f), true);
  ++steps_;
}

}  // namespace fr
