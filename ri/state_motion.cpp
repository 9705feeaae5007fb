// StateRenderer: attributes that move. Everything is shaded once for the whole time that the shutter is open,
// so a moving colour, opacity or parameter has its mean over that time: what a surface that stands still
// would show.
#include <algorithm>

#include "ri/state_renderer.h"

namespace fr::ri {
namespace {

/// How much each key counts in the mean over the shutter of what is linear between the keys, and constant
/// before and after them.
std::vector<double> shutterWeights(const std::vector<float>& times, double open, double close) {
  std::vector<double> weights(times.size(), 0.0);
  const auto add = [&](double t, double weight) {
    const auto after = size_t(std::upper_bound(times.begin(), times.end(), t) - times.begin());
    if (after == 0 || after == times.size()) {
      weights[after == 0 ? 0 : after - 1] += weight;
      return;
    }
    const double a = double(times[after - 1]), b = double(times[after]), f = (t - a) / (b - a);
    weights[after - 1] += weight * (1 - f), weights[after] += weight * f;
  };
  if (!(close > open)) {
    add(open, 1);
    return weights;
  }
  std::vector<double> ends{open};
  for (const float t : times)
    if (double(t) > open && double(t) < close) ends.push_back(double(t));
  ends.push_back(close);
  for (size_t i = 0; i + 1 < ends.size(); ++i) {
    const double half = (ends[i + 1] - ends[i]) / (close - open) / 2;
    add(ends[i], half), add(ends[i + 1], half);
  }
  return weights;
}

}  // namespace

bool StateRenderer::laterSample(const char* request) const {
  return motion_ && !object_ && motion_->request == request && motion_->count > 1;
}

ShaderPtr StateRenderer::meanShader(const std::vector<ShaderPtr>& keys, const std::vector<double>& weights) {
  auto mean = std::make_shared<ShaderInstance>(*keys.front());
  ParamList params;
  for (Param p : keys.front()->params) {
    std::vector<double> sum(p.floats.size(), 0.0);
    bool sameInAll = true;
    for (size_t k = 0; k < keys.size(); ++k) {
      const Param* q = keys[k]->params.find(p.name);
      sameInAll = sameInAll && q && q->declaration == p.declaration && q->floats.size() == sum.size() &&
                  q->ints == p.ints && q->strings == p.strings;
      if (!sameInAll) break;
      for (size_t i = 0; i < sum.size(); ++i) sum[i] += weights[k] * double(q->floats[i]);
    }
    if (sameInAll)
      std::copy(sum.begin(), sum.end(), p.floats.begin());
    else
      reportOnceHere(
          RiError::kBadMotion, Severity::kWarning,
          fmt::format("parameter \"{}\" of \"{}\" is not in all keys of its motion, or is no number; "
                      "its first value is used",
                      p.name, mean->name));
    params.set(std::move(p));
  }
  mean->params = std::move(params);
  return mean;
}

/// True: the block moved something that this file knows.
bool StateRenderer::endMovingAttribute(MotionBlock& m) {
  const size_t keys = std::max({m.colors.size(), m.shaders.size(), m.bounds.size()});
  if (keys == 0) return false;
  const size_t n = std::min(keys, m.times.size());
  m.times.resize(n);
  if (!m.bounds.empty()) {
    // What is inside one of them at some time is inside.
    Bound all = m.bounds.front();
    for (const Bound& b : m.bounds)
      for (size_t i = 0; i < 6; ++i) all[i] = i % 2 == 0 ? std::min(all[i], b[i]) : std::max(all[i], b[i]);
    AttributeState& a = state_.editAttributes();
    (m.request == "Bound" ? a.bound : a.detail) = all;
    return true;
  }
  const Options& o = state_.options();
  const std::vector<double> weights = shutterWeights(m.times, o.shutterOpen, o.shutterClose);
  if (!m.colors.empty()) {
    DVec3 sum(0);
    for (size_t k = 0; k < n; ++k) sum += weights[k] * DVec3(m.colors[k]);
    AttributeState& a = state_.editAttributes();
    (m.request == "Color" ? a.color : a.opacity) = Color(sum);
    return true;
  }
  m.shaders.resize(n);
  for (const ShaderPtr& s : m.shaders)
    if (!s || !m.shaders.front() || s->name != m.shaders.front()->name) {
      reportOnceHere(RiError::kBadMotion, Severity::kWarning,
                     fmt::format("{}: another shader in each key of a motion; the first is used", m.request));
      return true;
    }
  if (!m.shaders.front()) return true;
  ShaderPtr mean = meanShader(m.shaders, weights);
  const ShaderKind kind = mean->kind;
  if (kind == ShaderKind::kLight || kind == ShaderKind::kAreaLight)
    state_.setLightShader(m.light, std::move(mean));
  else
    setShader(kind, std::move(mean));
  return true;
}

}  // namespace fr::ri
