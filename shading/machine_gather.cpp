// gather: a loop over rays, whose hits tell what they are.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/error.h"
#include "base/random.h"
#include "shading/machine_ray.h"

namespace fr {

namespace {
/// Values that travel with the answers under a name of the call, but for those that every answer has.
bool isExtra(std::string_view name) {
  for (const std::string_view prefix : {"surface:", "displacement:", "volume:", "primitive:", "attribute:"})
    if (name.substr(0, prefix.size()) == prefix)
      return name != "surface:Ci" && name != "volume:Ci" && name != "primitive:P" && name != "primitive:N";
  return false;
}
/// Shaders have to run for it.
bool wantsShaders(std::string_view name) {
  return name.substr(0, 8) == "surface:" || name.substr(0, 7) == "volume:" ||
         name.substr(0, 13) == "displacement:";
}
constexpr uint32_t kFixed = 5;  // category, P, direction, angle, samples
constexpr float kMostSamples = 4096.0f;
}  // namespace

/// Asks for the written operands of a gather that only the hit knows.
void Machine::wantExtras(Frame& f, const Step& s, RayTerms& t) {
  std::string wanted;
  uint32_t columns = 0;
  for (uint32_t k = kFixed; k + 1 < s.argCount; k += 2) {
    if (!isWritten(f, s, k + 1)) continue;
    const std::string_view name = text(f, s, k);
    const Symbol& symbol = f.exe().program().symbols[symbolOf(f, s, k + 1)];
    const uint32_t components = slTypeFloats(symbol.type);
    if (!isExtra(name) || symbol.isArray() || (components != 1 && components != 3)) continue;
    const std::string line = fmt::format("{} {}\n", components, name);
    if (columns + components > kMaxExtraAnswers || wanted.size() + line.size() >= sizeof t.extras) {
      reportOnce("shading.gather.extras." + f.exe().program().name,
                 makeError(RiError::kLimit, "shader \"{}\": gather asks for more than {} values of a hit",
                           f.exe().program().name, kMaxExtraAnswers));
      break;
    }
    wanted += line, columns += components;
  }
  std::copy(wanted.begin(), wanted.end(), t.extras);
  std::fill(t.extras + wanted.size(), std::end(t.extras), '\0');
}

/// The question of one turn.
void Machine::describeGather(Frame& f, const Step& s, const Control& c, Question& q) {
  const Operand* a = f.args(s);
  q.kind = RayKind::kHitTest;
  for (uint32_t k = kFixed; k + 1 < s.argCount; k += 2)
    if (isWritten(f, s, k + 1) && wantsShaders(text(f, s, k))) q.kind = RayKind::kFullTrace;
  q.from = a[1], q.direction = a[2];
  q.site = hashStep(f.instance().id, c.begin);
  q.counter = f.counter(s.counter);
  q.cone.given = a[3];
  q.cosine = optionString(f, s, kFixed, "distribution") != "uniform";
  q.base = term(f, s, kFixed, "samplebase", 0.0f);
  q.samples.given = a[4];
  q.sample = c.turns;
  q.several = q.pairs = true;
  // "samplepattern" wants directions alone; every point takes the else branch.
  q.noRays = text(f, s, 0) == "samplepattern";
  readTerms(f, s, kFixed, q);
  q.diffuseBeyond = batch_.specularThreshold;
  wantExtras(f, s, q.terms);
}

/// Goes on with a gather loop: the next sample's rays, then the body for the points that hit.
Machine::Next Machine::gatherTurn(Frame& f) {
  Control& c = f.top();
  const Step& s = f.exe().steps()[c.begin];
  const uint32_t n = f.lanes();
  const size_t bytes = n * sizeof(int32_t);
  Question q;
  describeGather(f, s, c, q);
  if (c.phase == Control::Phase::kNext) {
    // Each point has as many turns as it wants samples.
    bool going = false;
    for (uint32_t i = 0; i < n; ++i) {
      const float samples = q.samples.at(i);
      if (!(std::min(samples, kMostSamples) > float(c.turns))) c.other[i] = 0;
      going |= c.other[i] != 0;
    }
    if (!going) {
      std::memcpy(f.mask, c.saved, bytes);
      uint32_t* const counter = f.counter(s.counter);
      for (uint32_t i = 0; i < n; ++i) counter[i] += uint32_t(-f.mask[i]);
      f.countActive();
      f.pop();
      f.pc = f.exe().steps()[s.jump].jump + 1;
      return Next::kGo;
    }
    std::memcpy(f.mask, c.other, bytes);
    std::memset(c.third, 0, bytes);
    beginGroups(c.other, q);
  } else {
    takeGathered(f, s, c, q);
  }
  c.phase = Control::Phase::kReturned;
  while (nextGroup(q)) {
    if (ask(q)) return Next::kSuspend;
    takeGathered(f, s, c, q);
  }
  ++c.turns;
  std::memcpy(f.mask, c.third, bytes);
  f.countActive();
  f.pc = f.active ? c.begin + 1 : s.jump;
  c.phase = Control::Phase::kBody;
  return Next::kGo;
}

/// Answers to the rays of one group: who hit, and what the shader wanted to know.
void Machine::takeGathered(Frame& f, const Step& s, Control& c, const Question& q) {
  const Operand* a = f.args(s);
  const uint32_t n = f.lanes();
  PendingRays& r = *rays_;
  const int32_t* const asked = groups_.asked;
  for (uint32_t k = 0; k < r.count; ++k) {
    const float farthest = std::min(q.maxDistance.at(r.lane[k]), 0.99e30f);
    if (!q.noRays && r.hitDistance[k] < farthest) c.third[r.lane[k]] = -1;
  }
  if (r.single && r.count) {
    const int32_t hit = c.third[r.lane[0]];
    for (uint32_t i = 0; i < n; ++i)
      if (asked[i]) c.third[i] = hit;
  } else if (batch_.copyPeriod) {
    for (uint32_t i = batch_.copyPeriod; i < n; ++i)
      if (asked[i]) c.third[i] = c.third[i % batch_.copyPeriod];
  }
  // What only hits have is written for those alone.
  std::vector<int32_t>& hits = groups_.hits;
  hits.assign(c.third, c.third + n);
  for (uint32_t i = 0; i < n; ++i) hits[i] &= asked[i];
  const std::string_view map = optionString(f, s, kFixed, "environmentmap");
  uint32_t column = 0;
  std::string_view rest = r.terms.extras;
  for (uint32_t k = kFixed; k + 1 < s.argCount; k += 2) {
    if (!isWritten(f, s, k + 1)) continue;
    const std::string_view name = text(f, s, k);
    const Operand& out = a[k + 1];
    const Symbol& symbol = f.exe().program().symbols[symbolOf(f, s, k + 1)];
    const uint32_t components = slTypeFloats(symbol.type);
    if (name == "sample:randompair" && symbol.type == SlType::kFloat && symbol.arrayLength == 2) {
      answer(out, 2, r.pair, asked);
    } else if (symbol.isArray()) {
      continue;
    } else if (components == 1) {
      if (name == "ray:length") {
        answer(out, 1, &r.hitDistance, asked);
      } else if (name == "effectivesamples") {
        for (uint32_t i = 0; i < (out.varying() ? n : kLanePad); ++i)
          if (!out.varying() || asked[i]) out.data[i] = std::floor(q.samples.at(i));
      }
    } else if (components == 3) {
      if (name == "ray:direction")
        answer(out, 3, r.direction, asked);
      else if (name == "ray:origin")
        answer(out, 3, r.origin, asked);
      else if (name == "primitive:P")
        answer(out, 3, r.hitP, hits.data());
      else if (name == "primitive:N")
        answer(out, 3, r.hitN, hits.data());
      else if (name == "surface:Ci" || name == "volume:Ci")
        answer(out, 3, r.color, hits.data());
      else if (name == "environment:color" && !map.empty())
        answerEnvironment(f, map, optionString(f, s, kFixed, "environmentspace"), out);
    }
    if (isExtra(name) && (components == 1 || components == 3) && !rest.empty() &&
        column + components <= kMaxExtraAnswers) {
      answer(out, components, r.extra + column, hits.data());
      column += components;
      rest.remove_prefix(std::min(rest.find('\n'), rest.size() - 1) + 1);
    }
  }
}

}  // namespace fr
