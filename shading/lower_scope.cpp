#include <algorithm>

#include "shading/lower.h"

namespace fr {

namespace {

enum Access : uint8_t { kNo, kRead, kWrite, kInLights, kInLightStatement };

/// RISpec 3.2.1 tables 12.1-12.5, with what real shaders rely on: surface shaders may move P for their own
/// use, and every shader may read the state of the point it runs on. N, s and t may be written wherever they
/// can be read, and lights may turn L.
Access accessOf(GlobalId id, ShaderType type) {
  const bool surface = type == ShaderType::kSurface, light = type == ShaderType::kLight,
             displacement = type == ShaderType::kDisplacement || type == ShaderType::kTransformation,
             volume = type == ShaderType::kVolume, imager = type == ShaderType::kImager;
  switch (id) {
    case GlobalId::k_Cs:
    case GlobalId::k_Os:
      return surface ? kWrite : displacement ? kRead : kNo;
    case GlobalId::k_P:
      return surface || displacement ? kWrite : kRead;
    case GlobalId::k_N:
    case GlobalId::k_s:
    case GlobalId::k_t:
      return imager ? kNo : kWrite;
    case GlobalId::k_dPdu:
    case GlobalId::k_dPdv:
    case GlobalId::k_Ng:
    case GlobalId::k_u:
    case GlobalId::k_v:
    case GlobalId::k_du:
    case GlobalId::k_dv:
    case GlobalId::k_dPdtime:
      return imager ? kNo : kRead;
    case GlobalId::k_L:
      return light ? kInLightStatement : surface || volume ? kInLights : kNo;
    case GlobalId::k_Cl:
    case GlobalId::k_Ol:
      return light ? kWrite : surface || volume ? kInLights : kNo;
    case GlobalId::k_Ps:
    case GlobalId::k_Ns:
      return light ? kRead : kNo;
    case GlobalId::k_I:
      return imager ? kNo : kRead;
    case GlobalId::k_Ci:
    case GlobalId::k_Oi:
      return surface || volume || imager ? kWrite : kNo;
    case GlobalId::k_alpha:
      return imager ? kWrite : kNo;
    case GlobalId::k___prmanspecular:
      return kRead;
    case GlobalId::k_E:
    case GlobalId::k_ncomps:
    case GlobalId::k_time:
    case GlobalId::k_dtime:
    case GlobalId::kCount:
      return kRead;
  }
  return kRead;
}

}  // namespace

Lower::Lower(const LowerInput& input, ProgramBuilder& builder, ShaderType type)
    : in_(input), b_(builder), type_(type) {
  bindGlobals();
  for (const ast::File* file : {input.prelude, input.file}) {
    if (!file) continue;
    for (const ast::Function* f : file->functions) {
      globals_.functions[f->name].push_back({f, &globals_});
      changedByFunctions_.merge(outerTargets(*f));
    }
  }
}

void Lower::error(const SourcePlace& place, std::string message, std::string hint, RiError code) {
  in_.diagnostics->add({Severity::kError, code, in_.source->location(place), std::move(message),
                        std::move(hint), in_.source->line(place)});
}

void Lower::warn(const SourcePlace& place, std::string message, std::string hint, Lint level) {
  if (in_.lint < level) return;
  if (place.file + 1 == in_.source->files.size() && in_.prelude) return;  // our own code
  if (in_.noLint && in_.noLint->count(uint64_t(place.file) << 32 | place.line)) return;
  in_.diagnostics->add({Severity::kWarning, RiError::kSyntax, in_.source->location(place), std::move(message),
                        std::move(hint), in_.source->line(place)});
}

void Lower::at(const SourcePlace& place) { b_.where = packPlace(place.file, place.line, place.column); }

void Lower::bindGlobals() {
  for (unsigned i = 0; i < unsigned(GlobalId::kCount); ++i) {
    const GlobalId id = GlobalId(i);
    Binding b;
    b.type = globalInfo(id).type;
    b.isGlobal = true;
    b.global = id;
    globals_.variables.emplace(globalInfo(id).name, b);
  }
  Binding pi;
  pi.symbol = b_.constantFloat(3.14159265358979323846f);
  pi.readOnly = "it is a constant";
  pi.isConstantPi = true;
  globals_.variables.emplace("PI", pi);
}

void Lower::pushScope(Scope& s) {
  if (!s.parent) s.parent = scope_;
  scope_ = &s;
}

void Lower::popScope() {
  // Blocks and functions: what was declared here and never used.
  std::vector<std::pair<const std::string*, const Binding*>> unused;
  for (const auto& [name, b] : scope_->variables)
    if (b.isLocal && !b.isRead && !b.target && b.place.line) unused.push_back({&name, &b});
  std::sort(unused.begin(), unused.end(), [](const auto& a, const auto& b) {
    return std::pair(a.second->place.line, a.second->place.column) <
           std::pair(b.second->place.line, b.second->place.column);
  });
  for (const auto& [name, b] : unused)
    warn(b->place, b->isParameter ? fmt::format("parameter '{}' is never used", *name)
                                  : fmt::format("variable '{}' is {}", *name,
                                                b->isWritten ? "set but never used" : "never used"));
  scope_ = scope_->isFunction ? scope_->caller : scope_->parent;
}

void Lower::define(const std::string& name, Binding b) {
  auto it = scope_->variables.find(name);
  if (it != scope_->variables.end()) {
    const SourceLocation old = in_.source->location(it->second.place);
    error(b.place, fmt::format("'{}' is already declared here", name),
          old.line ? fmt::format("the first declaration is in line {}", old.line) : "");
    return;
  }
  scope_->variables.emplace(name, std::move(b));
}

Binding* Lower::findFrom(Scope* from, const std::string& name, bool* crossed) {
  for (Scope* s = from; s; s = s->parent) {
    auto it = s->variables.find(name);
    if (it != s->variables.end()) return it->second.target ? it->second.target : &it->second;
    if (s->isFunction && s->parent != &globals_ && crossed) *crossed = true;
  }
  return nullptr;
}

Binding* Lower::find(const std::string& name, const SourcePlace& place) {
  bool crossed = false;
  Binding* b = findFrom(scope_, name, &crossed);
  if (b && crossed && b->isLocal)
    warn(place, fmt::format("'{}' belongs to the surrounding function", name), "declare it 'extern' here");
  return b;
}

std::string Lower::unknownNameHint(const std::string& name) const {
  NearestWord near(name);
  for (const Scope* s = scope_; s; s = s->parent)
    for (const auto& [n, b] : s->variables)
      if (!n.starts_with("__")) near.offer(n);
  return near.hint();
}

/// Once for each name: the others follow from the first.
void Lower::unknownVariable(const Expr& e) {
  if (!unknown_.insert(e.text).second) return;
  error(e.place, fmt::format("unknown variable '{}'", e.text),
        findBuiltins(e.text).empty() ? unknownNameHint(e.text) : fmt::format("'{}' is a function", e.text));
}

bool Lower::useGlobal(Binding& b, const SourcePlace& place, bool write) {
  if (!b.isGlobal) return true;
  if (b.global == GlobalId::k_Ps && !write &&
      (type_ == ShaderType::kSurface || type_ == ShaderType::kDisplacement || type_ == ShaderType::kVolume)) {
    // Old shaders (the RenderMan Companion's) say Ps for the point that is shaded, as lights do.
    if (b.symbol == kNoIndex) b.symbol = b_.global(GlobalId::k_P);
    return true;
  }
  const Access access = accessOf(b.global, type_);
  const GlobalInfo& info = globalInfo(b.global);
  if (access == kNo) {
    error(place, fmt::format("'{}' does not exist in a {} shader", info.name, shaderTypeName(type_)));
    return false;
  }
  if (write && (access == kRead || access == kInLights)) {
    error(place, fmt::format("'{}' cannot be changed in a {} shader", info.name, shaderTypeName(type_)),
          "copy it into a variable of your own");
    return false;
  }
  if (access == kInLights && lightDepth_ == 0)
    warn(place, fmt::format("'{}' has a value only inside 'illuminance'", info.name), "", Lint::kNone);
  if (access == kInLightStatement && lightDepth_ == 0 && !write)
    warn(place, fmt::format("'{}' has a value only inside 'illuminate' or 'solar'", info.name), "",
         Lint::kNone);
  if (b.symbol == kNoIndex) b.symbol = b_.global(b.global);
  return true;
}

uint32_t Lower::read(Binding& b) {
  b.isRead = true;
  return b.symbol;
}

Binding* Lower::writable(const Expr& e) {
  Binding* b = find(e.text, e.place);
  if (!b) {
    unknownVariable(e);
    return nullptr;
  }
  if (!useGlobal(*b, e.place, true)) return nullptr;
  if (b->readOnly) {
    error(e.place, fmt::format("'{}' cannot be changed: {}", e.text, b->readOnly),
          "copy it into a variable of your own, or declare it 'output'");
    return nullptr;
  }
  b->isWritten = true;
  return b;
}

}  // namespace fr
