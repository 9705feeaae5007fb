#include <algorithm>
#include <unordered_map>

#include "shading/passes.h"

namespace fr {
namespace {

/// What the operation is called in the language: du_f is Du, texture_t is texture.
std::string sourceName(std::string_view op) {
  std::string r(op.substr(0, op.find('_')));
  if (r == "du" || r == "dv" || r == "deriv") r[0] = char(r[0] - 'a' + 'A');
  return r;
}

class Uniformity {
 public:
  Uniformity(ShaderProgram& p, const PassContext& context) : p_(p), context_(context) {}

  std::vector<bool> run() {
    for (Symbol& s : p_.symbols)
      if ((s.storage == Storage::kLocal || s.storage == Storage::kTemp) && !s.declaredClass)
        s.cls = SlClass::kUniform;
    loopVaries_.assign(p_.code.size(), false);
    uniformRandom();
    do {
      changed_ = false;
      scan(false);
    } while (changed_);
    scan(true);
    return std::move(under_);
  }
  /// After run(): a string that differs from point to point.
  const std::string& dividedString() const { return dividedString_; }

 private:
  struct Frame {
    uint32_t begin;
    Op op;
    bool varying;
    bool conditional;  // by the shader's own conditions and jumps; the loops over lights are none
    bool divides;      // it, not one around it, is entered or left by some points only
    uint32_t id;       // of the block; both branches of an if have their own
  };

  const Symbol& symbol(uint32_t arg) const { return p_.symbols[arg & kArgIndex]; }

  void makeVarying(uint32_t arg) {
    Symbol& s = p_.symbols[arg & kArgIndex];
    if (s.declaredClass || s.cls == SlClass::kVarying) return;
    if (s.storage != Storage::kLocal && s.storage != Storage::kTemp && s.storage != Storage::kOutputParameter)
      return;
    s.cls = SlClass::kVarying;
    changed_ = true;
  }

  // random() is one number when a uniform variable takes it.
  void uniformRandom() {
    for (size_t i = 0; i + 1 < p_.code.size(); ++i) {
      const Op op = p_.code[i].op, next = p_.code[i + 1].op;
      if ((op != Op::random_f && op != Op::random_t) || (next != Op::assign_f && next != Op::assign_t))
        continue;
      const auto a = p_.operands(p_.code[i]), b = p_.operands(p_.code[i + 1]);
      if ((a[0] & kArgIndex) != (b[1] & kArgIndex)) continue;
      if (symbol(b[0]).declaredClass && symbol(b[0]).cls == SlClass::kUniform)
        p_.symbols[a[0] & kArgIndex].declaredClass = 1;
    }
  }

  bool varying() const { return !frames_.empty() && frames_.back().varying; }
  bool conditional() const { return !frames_.empty() && frames_.back().conditional; }

  void markLoop(uint32_t begin) {
    if (loopVaries_[begin]) return;
    loopVaries_[begin] = true;
    changed_ = true;
  }

  static bool isLoop(Op op) {
    return op == Op::loop_begin || op == Op::gather_begin || op == Op::illuminance_begin ||
           op == Op::illuminance_cone_begin || op == Op::ambient_begin;
  }

  // Points leave everything up to frame k: what follows in these frames runs for some points only.
  void leaveUpTo(size_t k) {
    for (size_t i = k; i < frames_.size(); ++i) {
      frames_[i].varying = frames_[i].conditional = frames_[i].divides = true;
      if (frames_[i].op == Op::loop_begin) markLoop(frames_[i].begin);
    }
  }

  void control(uint32_t i, const Instruction& in, bool conditionVaries) {
    const bool now = varying(), chosen = conditional();
    switch (in.op) {
      case Op::if_begin:
        frames_.push_back(
            {i, in.op, now || conditionVaries, chosen || conditionVaries, conditionVaries, ++blocks_});
        break;
      case Op::loop_begin:
        frames_.push_back(
            {i, in.op, now || loopVaries_[i], chosen || loopVaries_[i], loopVaries_[i], ++blocks_});
        break;
      case Op::loop_test:
        if (conditionVaries && !frames_.empty()) {
          markLoop(frames_.back().begin);
          frames_.back().varying = frames_.back().conditional = frames_.back().divides = true;
        }
        break;
      case Op::inline_begin:
        frames_.push_back({i, in.op, now, chosen, false, ++blocks_});
        break;
      case Op::illuminance_begin:
      case Op::illuminance_cone_begin:
      case Op::ambient_begin:
      case Op::illuminate_begin:
      case Op::illuminate_cone_begin:
      case Op::solar_begin:
      case Op::solar_cone_begin:
        frames_.push_back({i, in.op, true, chosen, false, ++blocks_});
        break;
      case Op::gather_begin:
        frames_.push_back({i, in.op, true, true, true, ++blocks_});
        break;
      case Op::if_else:
        if (!frames_.empty()) frames_.back().id = ++blocks_;
        break;
      case Op::if_end:
      case Op::loop_end:
      case Op::inline_end:
      case Op::illuminance_end:
      case Op::gather_end:
      case Op::illuminate_end:
      case Op::solar_end:
        if (!frames_.empty()) frames_.pop_back();
        break;
      case Op::inline_return:
      case Op::break_loop:
      case Op::continue_loop: {
        if (!now) break;
        int levels = in.op == Op::inline_return ? 1 << 20 : int(p_.floats[symbol(p_.operands(in)[0]).data]);
        size_t k = frames_.size();
        while (k > 0) {
          --k;
          if (frames_[k].op == Op::inline_begin) break;
          if (isLoop(frames_[k].op) && --levels <= 0) break;
        }
        leaveUpTo(k);
        break;
      }
      default:
        break;
    }
  }

  void scan(bool final) {
    frames_.clear();
    if (final) under_.assign(p_.code.size(), false);
    for (uint32_t i = 0; i < p_.code.size(); ++i) {
      const Instruction& in = p_.code[i];
      const OpInfo& info = opInfo(in.op);
      const auto operands = p_.operands(in);
      bool value = (info.flags & (kOpResultVarying | kOpRay)) != 0;
      for (uint32_t a : operands)
        if ((a & kArgRead) && (!(a & kArgWritten) || in.op == Op::dso_call) && symbol(a).isVarying())
          value = true;
      const bool ofPoint = in.op == Op::msg_surface || in.op == Op::msg_displacement ||
                           in.op == Op::msg_atmosphere || in.op == Op::msg_lightsource ||
                           in.op == Op::msg_incident || in.op == Op::msg_opposite ||
                           in.op == Op::get_rayinfo || in.op == Op::get_variable;
      for (uint32_t a : operands) {
        if (!(a & kArgWritten)) continue;
        const bool inout = (a & kArgRead) != 0;
        bool result = (info.flags & kOpResultUniform) && !inout ? false : value;
        if (inout && (ofPoint || (info.flags & kOpControl))) result = true;
        const bool masked =
            (info.flags & kOpMasked) && varying() && !((info.flags & kOpResultUniform) && !inout);
        if (final) {
          check(in, a, result, masked);
        } else if (result || masked) {
          makeVarying(a);
        }
      }
      if (final) {
        followStrings(i, in);
        under_[i] = varying();
        if (conditional() && (info.flags & kOpDerivative))
          lint(in, fmt::format("the result of '{}' is undefined where only some points are active",
                               sourceName(info.name)));
      }
      if (info.flags & kOpControl) control(i, in, value);
    }
  }

  /// A string has one value for all points of a batch. What is set for some points, and read where others are
  /// too, is said, and so is what is chosen for each point.
  void followStrings(uint32_t i, const Instruction& in) {
    const auto operands = p_.operands(in);
    for (uint32_t a : operands) {
      if (!(a & kArgRead) || symbol(a).type != SlType::kString) continue;
      const auto set = setForSome_.find(a & kArgIndex);
      if (set == setForSome_.end()) continue;
      const auto within = [&](const Frame& f) { return f.id == set->second.block; };
      if (std::none_of(frames_.begin(), frames_.end(), within)) divided(p_.code[set->second.instruction], a);
    }
    const bool chosen = in.op == Op::select_s || in.op == Op::load_s || in.op == Op::format;
    for (uint32_t a : operands) {
      if (chosen && (a & kArgRead) && symbol(a).type == SlType::kFloat && symbol(a).isVarying())
        divided(in, operands[0]);
      if (!(a & kArgWritten) || symbol(a).type != SlType::kString) continue;
      setForSome_.erase(a & kArgIndex);
      if (in.op != Op::assign_s && in.op != Op::store_s) continue;
      const auto by =
          std::find_if(frames_.rbegin(), frames_.rend(), [](const Frame& f) { return f.divides; });
      if (by != frames_.rend()) setForSome_[a & kArgIndex] = {by->id, i};
    }
  }

  void divided(const Instruction& in, uint32_t a) {
    const Symbol& s = symbol(a);
    const std::string name(s.name < p_.strings.size() ? p_.strings[s.name] : std::string());
    const bool named = s.storage != Storage::kTemp && !name.empty();
    if (dividedString_.empty()) dividedString_ = named ? name : "that is chosen";
    lint(in, fmt::format("{} differs from point to point, but all points see one value of it",
                         named ? fmt::format("string '{}'", name) : "a string"));
  }

  void check(const Instruction& in, uint32_t a, bool result, bool masked) {
    const Symbol& s = symbol(a);
    if (!s.declaredClass || s.cls != SlClass::kUniform || s.storage == Storage::kGlobal) return;
    if (in.op == Op::random_f || in.op == Op::random_t) return;
    // Messages of one value a point leave the first active point's value in a uniform variable.
    const bool assignment = (opInfo(in.op).flags & kOpMasked) && opInfo(in.op).cost < Cost::kExternal;
    if (result && assignment) {
      report(Severity::kError, in,
             fmt::format("varying value in the uniform variable '{}'", p_.strings[s.name]),
             s.storage == Storage::kOutputParameter || s.storage == Storage::kParameter
                 ? "declare the parameter 'varying'"
                 : "declare the variable 'varying'");
    } else if (masked && conditional()) {  // loops over lights set them light by light
      lint(in, fmt::format("uniform variable '{}' changes where only some points are active",
                           p_.strings[s.name]));
    }
  }

  void report(Severity severity, const Instruction& in, std::string message, std::string hint) {
    if (!context_.diagnostics) return;
    const SourcePlace place{in.file(), in.line(), in.column()};
    context_.diagnostics->add({severity, RiError::kSyntax, context_.source->location(place),
                               std::move(message), std::move(hint), context_.source->line(place)});
  }

  void lint(const Instruction& in, std::string message) {
    if (context_.lint < Lint::kCommon || in.file() + 1 >= context_.source->files.size()) return;
    if (context_.noLint && context_.noLint->count(uint64_t(in.file()) << 32 | in.line())) return;
    report(Severity::kWarning, in, std::move(message), "");
  }

  ShaderProgram& p_;
  const PassContext& context_;
  std::vector<Frame> frames_;
  std::vector<bool> loopVaries_, under_;
  struct SetForSome {
    uint32_t block, instruction;
  };
  std::unordered_map<uint32_t, SetForSome> setForSome_;  // by symbol
  std::string dividedString_;
  uint32_t blocks_ = 0;
  bool changed_ = false;
};

}  // namespace

std::vector<bool> inferUniformity(ShaderProgram& program, const PassContext& context) {
  return Uniformity(program, context).run();
}

std::string dividedString(ShaderProgram program, const std::vector<std::string>& varyingParameters) {
  const bool mayBe = std::any_of(program.code.begin(), program.code.end(), [](const Instruction& in) {
    return in.op == Op::assign_s || in.op == Op::store_s || in.op == Op::select_s || in.op == Op::load_s ||
           in.op == Op::format;
  });
  if (!mayBe) return {};
  for (const std::string& name : varyingParameters)
    if (const uint32_t k = program.findParameter(name); k != kNoIndex)
      program.symbols[program.parameters[k].symbol].cls = SlClass::kVarying;
  const PassContext quiet;
  Uniformity u(program, quiet);
  (void)u.run();
  return u.dividedString();
}

}  // namespace fr
