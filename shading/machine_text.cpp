// Strings and message passing.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <regex>

#include "base/error.h"
#include "shading/machine_light.h"

namespace fr {

/// Texts live until the batch is done; the same text is kept once. Loops that make ever longer ones, or ever
/// new ones, end at a limit.
std::string_view Machine::keep(std::string s) {
  constexpr size_t kLongest = 32767, kMostBytes = size_t(64) << 20;
  const bool tooLong = s.size() > kLongest;
  if (tooLong) s.resize(kLongest);
  const auto known = texts_.find(s);
  if (known != texts_.end()) return *known;
  if (tooLong || textBytes_ + s.size() > kMostBytes) {
    const std::string& name = main_.exe().program().name;
    const bool tooMany = textBytes_ + s.size() > kMostBytes;
    reportOnce((tooMany ? "shading.texts." : "shading.text.") + name,
               makeError(RiError::kLimit, "shader \"{}\": {}", name,
                         tooMany ? "too many different strings; empty ones are used"
                                 : "a string became longer than 32767 characters and was cut"));
    if (tooMany) return {};
  }
  textBytes_ += s.size() + sizeof(std::string);
  return *texts_.insert(std::move(s)).first;
}

namespace {
/// One value with the flags, width and precision of C's printf; a number without any is written as short as
/// it can be.
std::string laidOut(std::string_view layout, char type, float number, const std::string& text) {
  if (layout.empty())
    return type == 's'   ? text
           : type == 'd' ? fmt::format("{}", int64_t(number))
                         : fmt::format("{:g}", number);
  // At most three digits of width and precision: "%99999999f" is no way to fill memory.
  std::string format = "%";
  int digits = 0, dots = 0;
  for (char c : layout) {
    if (c == '.' && dots++) break;
    digits = std::isdigit(static_cast<unsigned char>(c)) ? digits + 1 : 0;
    if (digits > 3) break;
    format += c;
  }
  format += type == 'd' ? "lld" : type == 's' ? "s" : "f";
  char buffer[4200];
  int n = 0;
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wformat-nonliteral"
  if (type == 's')
    n = std::snprintf(buffer, sizeof(buffer), format.c_str(), text.c_str());
  else if (type == 'd')
    n = std::snprintf(buffer, sizeof(buffer), format.c_str(), static_cast<long long>(number));
  else
    n = std::snprintf(buffer, sizeof(buffer), format.c_str(), double(number));
#pragma GCC diagnostic pop
  return std::string(buffer, size_t(std::clamp(n, 0, int(sizeof(buffer)) - 1)));
}
}  // namespace

/// printf's format with the operands from `first` on, for one point.
void Machine::formatText(Frame& f, const Step& s, uint32_t first, uint32_t lane, std::string& out) {
  const std::string_view pattern = text(f, s, first);
  uint32_t next = first + 1;
  const ShaderProgram& p = f.exe().program();
  for (size_t i = 0; i < pattern.size(); ++i) {
    if (pattern[i] != '%' || i + 1 >= pattern.size()) {
      out += pattern[i];
      continue;
    }
    size_t k = i + 1;
    while (k < pattern.size() && (std::isdigit(static_cast<unsigned char>(pattern[k])) || pattern[k] == '.' ||
                                  pattern[k] == '-' || pattern[k] == '+'))
      ++k;
    const char type = k < pattern.size() ? pattern[k] : '%';
    const std::string_view layout = pattern.substr(i + 1, k - i - 1);
    i = k;
    if (type == '%') {
      out += '%';
      continue;
    }
    if (next >= s.argCount) {
      out += "?";
      continue;
    }
    const uint32_t symbol = symbolOf(f, s, next);
    const Operand& o = f.args(s)[next];
    const Symbol& sym = p.symbols[symbol];
    ++next;
    if (sym.type == SlType::kString) {
      out += laidOut(layout, 's', 0, std::string(f.strings(symbol)[0]));
    } else if (type == 'd') {
      out += laidOut(layout, 'd', std::clamp(o.at(lane), -9e15f, 9e15f), {});
    } else {
      const uint32_t count = slTypeFloats(sym.type);
      for (uint32_t c = 0; c < count; ++c) {
        if (c) out += ' ';
        out += laidOut(layout, 'f', o.at(lane, c), {});
      }
    }
  }
}

namespace {
/// POSIX extended regular expression anywhere in the subject. Patterns that are broken, or so long that the
/// library might run out of stack, match nothing.
bool matches(std::string_view pattern, std::string_view subject) {
  constexpr size_t kLongestPattern = 1024;
  try {
    if (pattern.size() > kLongestPattern) throw std::regex_error(std::regex_constants::error_space);
    // GNU's "polynomial" never backtracks: no pattern takes for ever.
    const std::regex r(std::string(pattern), std::regex::extended | std::regex_constants::__polynomial);
    return std::regex_search(subject.begin(), subject.end(), r);
  } catch (const std::exception&) {
    const std::string shown(pattern.substr(0, 80));
    reportOnce(
        "shading.match." + shown,
        Error{RiError::kSyntax, Severity::kWarning, {}, fmt::format("match(): bad pattern \"{}\"", shown)});
    return false;
  }
}
}  // namespace

/// matches(), remembered: shaders ask the same for every batch, and compiling an expression takes longer than
/// most shaders.
bool Machine::matchesText(std::string_view pattern, std::string_view subject) {
  constexpr size_t kMost = 64, kLongest = 512;
  for (const Matched& m : matched_)
    if (m.pattern == pattern && m.subject == subject) return m.result;
  const bool result = matches(pattern, subject);
  if (pattern.size() + subject.size() > kLongest) return result;
  if (matched_.size() == kMost) matched_.clear();
  matched_.push_back({std::string(pattern), std::string(subject), result});
  return result;
}

void Machine::stringOp(Frame& f, const Step& s) {
  const Operand* a = f.args(s);
  uint32_t lane = 0;
  while (lane + 1 < f.lanes() && !f.mask[lane]) ++lane;
  switch (s.op) {
    case Op::eq_s:
      setFloat(f, a[0], text(f, s, 1) == text(f, s, 2) ? 1.0f : 0.0f);
      break;
    case Op::ne_s:
      setFloat(f, a[0], text(f, s, 1) != text(f, s, 2) ? 1.0f : 0.0f);
      break;
    case Op::select_s:
      f.strings(symbolOf(f, s, 0))[0] = text(f, s, a[1].at(lane) != 0.0f ? 2 : 3);
      break;
    case Op::concat: {
      std::string r;
      for (uint32_t k = 1; k < s.argCount && r.size() < 65536; ++k) r += text(f, s, k);
      f.strings(symbolOf(f, s, 0))[0] = keep(std::move(r));
      break;
    }
    case Op::format: {
      std::string r;
      formatText(f, s, 1, lane, r);
      f.strings(symbolOf(f, s, 0))[0] = keep(std::move(r));
      break;
    }
    case Op::printf: {
      // Uniform values: once. Otherwise once for every point.
      bool varying = false;
      for (uint32_t k = 1; k < s.argCount; ++k) varying |= a[k].data && a[k].varying();
      for (uint32_t i = 0; i < std::max(1u, batch_.points); ++i) {
        if (i >= f.lanes() || !f.mask[i]) continue;
        std::string r;
        formatText(f, s, 0, i, r);
        host_.print(r);
        if (!varying) break;
      }
      break;
    }
    case Op::strlen:
      setFloat(f, a[0], float(text(f, s, 1).size()));
      break;
    case Op::substr: {
      const std::string_view whole = text(f, s, 1);
      const float size = float(whole.size());
      float start = a[2].at(lane);
      if (start < 0) start += size;
      start = std::clamp(std::floor(start), 0.0f, size);
      const float length = a[3].at(lane) < 0 ? size : std::floor(a[3].at(lane));
      f.strings(symbolOf(f, s, 0))[0] =
          keep(std::string(whole.substr(size_t(start), size_t(std::clamp(length, 0.0f, size)))));
      break;
    }
    case Op::match: {
      setFloat(f, a[0], matchesText(text(f, s, 1), text(f, s, 2)) ? 1.0f : 0.0f);
      break;
    }
    case Op::shadername:
      f.strings(symbolOf(f, s, 0))[0] = f.exe().program().name;
      break;
    case Op::shadername_s: {
      const std::string_view type = text(f, s, 1);
      const ShaderInstance* i = type == "surface"        ? partners_.surface
                                : type == "displacement" ? partners_.displacement
                                : type == "atmosphere"   ? partners_.atmosphere
                                                         : nullptr;
      f.strings(symbolOf(f, s, 0))[0] = i ? std::string_view(i->program().name) : std::string_view();
      break;
    }
    default:
      break;
  }
}

namespace {
bool sameKind(SlType a, SlType b) { return a == b || (isTriple(a) && isTriple(b)); }
}  // namespace

/// Writes a value into operand `arg` (a symbol) for active points. False: types or lengths differ.
bool Machine::writeValue(Frame& f, uint32_t arg, const Operand& out, const ShaderValue& v) {
  const Symbol& symbol = f.exe().program().symbols[arg];
  if (!sameKind(symbol.type, v.type) || std::max(1u, symbol.arrayLength) > std::max(1u, v.arrayLength))
    return false;
  if (symbol.type == SlType::kString) {
    const uint32_t count = std::max(1u, symbol.arrayLength);
    if (v.strings.size() < count) return false;
    for (uint32_t k = 0; k < count; ++k) f.strings(arg)[k] = keep(v.strings[k]);
    return true;
  }
  if (v.floats.size() < symbol.floats()) return false;
  for (uint32_t c = 0; c < symbol.floats(); ++c)
    setFloat(f, Operand{out.comp(c), out.component, out.indexMask}, v.floats[c]);
  return true;
}

/// Reads a parameter of a shader that runs in this batch, with what it has written by now.
bool Machine::copyRegister(Frame& f, uint32_t arg, const Operand& out, Frame& from, std::string_view name) {
  const ShaderProgram& p = from.exe().program();
  const uint32_t index = p.findParameter(name);
  if (index == kNoIndex) return false;
  const uint32_t source = p.parameters[index].symbol;
  const Symbol& symbol = f.exe().program().symbols[arg];
  if (!sameKind(symbol.type, p.symbols[source].type) || symbol.arrayLength != p.symbols[source].arrayLength)
    return false;
  if (symbol.type == SlType::kString) {
    for (uint32_t k = 0; k < std::max(1u, symbol.arrayLength); ++k)
      f.strings(arg)[k] = from.strings(source)[k];
    return true;
  }
  const Operand& in = from.symbol(source);
  if (in.varying() && !out.varying()) return false;  // a value per point does not fit
  const uint32_t n = out.varying() ? f.lanes() : kLanePad;
  for (uint32_t c = 0; c < symbol.floats(); ++c)
    for (uint32_t i = 0; i < n; ++i)
      if (!out.varying() || f.mask[i]) out.comp(c)[i] = in.at(i, c);
  return true;
}

/// getvar(): a predefined variable as the shader has it now, else a primitive variable of the points.
bool Machine::pointVariable(Frame& f, uint32_t arg, const Operand& out, std::string_view name) {
  const Symbol& symbol = f.exe().program().symbols[arg];
  const uint32_t components = slTypeFloats(symbol.type);
  if (symbol.isArray() || components == 0 || components > 3) return false;
  const auto write = [&](uint32_t c, const Operand& in) {
    const uint32_t n = out.varying() ? f.lanes() : kLanePad;
    for (uint32_t i = 0; i < n; ++i)
      if (!out.varying() || f.mask[i]) out.comp(c)[i] = in.at(i);
  };
  for (size_t g = 0; g < size_t(GlobalId::kCount); ++g) {
    const GlobalInfo& info = globalInfo(GlobalId(g));
    if (name != info.name) continue;
    Operand in = f.global(GlobalId(g));
    if (!in.data) in = batch_.globals[g];
    if (!in.data || !sameKind(symbol.type, info.type)) return false;
    for (uint32_t c = 0; c < components; ++c) write(c, {in.comp(c), in.component, in.indexMask});
    return true;
  }
  if (!batch_.variables || !batch_.variables->variable(name, components - 1) ||
      batch_.variables->variable(name, components))
    return false;
  for (uint32_t c = 0; c < components; ++c)
    write(c, {const_cast<float*>(batch_.variables->variable(name, c)), f.lanes(), ~0u});
  return true;
}

bool Machine::copyInstance(Frame& f, uint32_t arg, const Operand& out, const ShaderInstance* from,
                           std::string_view name) {
  const ShaderValue* v = from ? from->parameter(name) : nullptr;
  return v && writeValue(f, arg, out, *v);
}

void Machine::message(Frame& f, const Step& s) {
  const Operand* a = f.args(s);  // found, name, value
  const std::string_view name = text(f, s, 1);
  const uint32_t arg = symbolOf(f, s, 2);
  const Operand& out = a[2];
  ShaderValue& v = answered_;  // keeps its memory from call to call
  v.type = SlType::kFloat, v.arrayLength = 0;
  v.floats.clear(), v.strings.clear();
  bool found = false;
  switch (s.op) {
    case Op::msg_surface:
      if (partners_.surface && &main_.instance() == partners_.surface)
        found = copyRegister(f, arg, out, main_, name);
      else if (partners_.ranSurface)
        found = copyRegister(f, arg, out, partners_.ranSurface->main_, name);
      else
        found = copyInstance(f, arg, out, partners_.surface, name);
      break;
    case Op::msg_displacement:
      found = partners_.ranDisplacement ? copyRegister(f, arg, out, partners_.ranDisplacement->main_, name)
                                        : copyInstance(f, arg, out, partners_.displacement, name);
      break;
    case Op::msg_atmosphere:
      found = copyInstance(f, arg, out, partners_.atmosphere, name);
      break;
    case Op::msg_incident:
    case Op::msg_opposite: {
      // On the ray's side is the exterior where the ray comes from outside.
      const Operand I = batch_.globals[size_t(GlobalId::k_I)], Ng = batch_.globals[size_t(GlobalId::k_Ng)];
      const auto outside = [&](uint32_t i) {
        if (!I.data || !Ng.data) return true;
        float d = 0;
        for (uint32_t c = 0; c < 3; ++c) d += I.at(i, c) * Ng.at(i, c);
        return !(d > 0);
      };
      uint32_t firstActive = 0;
      while (firstActive + 1 < f.lanes() && !f.mask[firstActive]) ++firstActive;
      const bool incident = s.op == Op::msg_incident;
      const auto volumeAt = [&](uint32_t i) {
        return outside(i) == incident ? partners_.exterior : partners_.interior;
      };
      const ShaderInstance* first = volumeAt(firstActive);
      const SlType type = f.exe().program().symbols[arg].type;
      if (!out.data || !out.varying() || type == SlType::kString) {
        found = copyInstance(f, arg, out, first, name);
        break;
      }
      // Two passes, each for the points of one side.
      const uint32_t n = f.lanes();
      std::vector<int32_t> saved(f.mask, f.mask + n);
      for (const ShaderInstance* volume : {partners_.exterior, partners_.interior}) {
        for (uint32_t i = 0; i < n; ++i) f.mask[i] = volumeAt(i) == volume ? saved[i] : 0;
        const bool copied = volume && copyInstance(f, arg, out, volume, name);
        if (volume == first) found = copied;
        if (partners_.exterior == partners_.interior) break;
      }
      std::memcpy(f.mask, saved.data(), n * sizeof(int32_t));
      break;
    }
    case Op::msg_lightsource:
      for (uint32_t k = f.depth; k-- > 0;) {
        const Control& c = f.control[k];
        if (c.kind != Control::Kind::kLights || c.light < 0 || c.light >= int32_t(lightCount_)) continue;
        found = copyRegister(f, arg, out, lights_[size_t(c.light)]->frame, name);
        break;
      }
      break;
    case Op::get_attribute:
      found = host_.attribute(name, batch_.attributes, v) && writeValue(f, arg, out, v);
      break;
    case Op::get_option:
      found = host_.option(name, v) && writeValue(f, arg, out, v);
      break;
    case Op::get_rendererinfo:
      found = host_.rendererInfo(name, v) && writeValue(f, arg, out, v);
      break;
    case Op::get_variable:
      found = pointVariable(f, arg, out, name);
      break;
    case Op::get_rayinfo: {
      if (name == "type") {
        v.type = SlType::kString;
        v.strings = {batch_.shadowRay                        ? "transmission"
                     : batch_.level == 0                     ? "camera"
                     : batch_.rayClass == RayClass::kDiffuse ? "diffuse"
                                                             : "specular"};
      } else if (name == "depth") {
        v.floats = {float(batch_.level)};
      } else if (name == "diffusedepth") {
        v.floats = {float(batch_.diffuseDepth)};
      } else if (name == "shadowdepth") {
        v.floats = {float(batch_.shadowDepth)};
      } else if (name == "speculardepth") {
        const uint32_t others = batch_.diffuseDepth + batch_.shadowDepth;
        v.floats = {float(batch_.level > others ? batch_.level - others : 0)};
      } else if (name == "label") {
        v.type = SlType::kString;
        v.strings = {std::string(batch_.rayLabel)};
      } else {
        // origin, direction and length follow from P and I.
        const Operand I = batch_.globals[size_t(GlobalId::k_I)], P = batch_.globals[size_t(GlobalId::k_P)];
        const SlType type = f.exe().program().symbols[arg].type;
        const uint32_t n = out.varying() ? f.lanes() : 1;
        const bool scalar = name == "length" && type == SlType::kFloat;
        const bool triple = (name == "origin" || name == "direction") && isTriple(type);
        if (!I.data || !P.data || (!scalar && !triple) || !out.varying()) break;
        for (uint32_t i = 0; i < n; ++i) {
          if (!f.mask[i]) continue;
          const Vec3 d(I.at(i, 0), I.at(i, 1), I.at(i, 2));
          const float length = glm::length(d);
          if (scalar) out.data[i] = length;
          for (uint32_t c = 0; triple && c < 3; ++c)
            out.comp(c)[i] = name == "origin" ? P.at(i, c) - d[int(c)]
                             : length > 0     ? d[int(c)] / length
                                              : 0.0f;
        }
        found = true;
        break;
      }
      found = writeValue(f, arg, out, v);
      break;
    }
    default:
      break;
  }
  setFloat(f, a[0], found ? 1.0f : 0.0f);
}

}  // namespace fr
