// Shaders in C++ for tests of the tracer: an implementation of ShadingSystem and ShadeTask that knows these
// surfaces:
//   constant   Ci = Os Cs, Oi = Os
//   mirror     Ci = 0.05 Cs + 0.8 trace(reflection)
//   clear      Ci = Cs trace(straight on), Oi = 1; as a shadow ray Oi = 0.25
//   lit        Ci = Os Cs visibility(P, a light at (0.3, 0.2, 8)), Oi = Os
//   halves     Ci = Oi, Oi = 1 where u < 0.5, else 0
//   endless    asks visibility even for its own opacity
//   noise      Ci = hash(seed), Oi = 0.5
//   wild       Ci = NaN, Oi = infinity
#include <cmath>

#include "base/random.h"
#include "shading/shading_system.h"

namespace fr {

using namespace cache;

struct ShadingSystem::Impl {
  SceneCache* cache;
  std::string name(AttributeId a) const {
    return std::string(cache->skeleton().string(
        cache->skeleton().shaders()[cache->skeleton().attributes()[a].surface].name));
  }
};

ShadingSystem::ShadingSystem(SceneCache& cache, Options) : impl_(new Impl{&cache}) {}
ShadingSystem::~ShadingSystem() = default;
void ShadingSystem::loadShaders(uint32_t) {}
bool ShadingSystem::isOpaque(AttributeId a) const {
  const std::string n = impl_->name(a);
  return n == "mirror" || (n == "constant" && impl_->cache->skeleton().attributes()[a].opacity == Color(1));
}
uint32_t ShadingSystem::shadeGroup(AttributeId a) const { return a; }
ShadingStatistics ShadingSystem::statistics() const { return {}; }
Displacer& ShadingSystem::displacer() {
  static struct : Displacer {
    bool displaces(ObjectId) const override { return false; }
    void displace(NodeId, size_t, const uint32_t*, const float*, const float*, int, int, float* const*,
                  float* const*) override {}
  } none;
  return none;
}

struct ShadeTask::Impl {
  ShadingSystem::Impl* system;
  ShadePoints points;
  std::string shader;
  int stage = 0;
  std::vector<Vec3> P, N;
  std::vector<float> color[3], opacity[3];
  Color cs, os;
  bool asks() const {
    return shader == "mirror" || shader == "lit" || shader == "endless" ||
           (shader == "clear" && !points.shadowRay);
  }
};

ShadeTask::ShadeTask(ShadingSystem& s) : impl_(new Impl) { impl_->system = s.impl_.get(); }
ShadeTask::~ShadeTask() = default;
ShadeTask::ShadeTask(ShadeTask&&) noexcept = default;
ShadeTask& ShadeTask::operator=(ShadeTask&&) noexcept = default;

void ShadeTask::begin(const ShadePoints& p) {
  Impl& t = *impl_;
  t.points = p;
  t.stage = 0;
  const AttributeRecord& a = t.system->cache->attributesOf(p.node[0]);
  t.shader = t.system->name(t.system->cache->objectOf(p.node[0]).attributes);
  t.cs = a.color, t.os = a.opacity;
  t.P.resize(p.count), t.N.resize(p.count);
  for (int c = 0; c < 3; ++c) t.color[c].assign(p.count, 0), t.opacity[c].assign(p.count, 1);
  for (size_t i = 0; i < p.count; ++i) {
    SurfaceOut out;
    for (int c = 0; c < 3; ++c) out.P[c] = &t.P[i][c], out.Ng[c] = &t.N[i][c];
    t.system->cache->evaluateDiced(p.node[i], 1, p.cell + i, p.u + i, p.v + i, out);
    Color o = t.shader == "constant" || t.shader == "lit" ? t.os : Color(1);
    Color ci = o * t.cs;
    if (t.shader == "halves") o = ci = Color(p.u[i] < 0.5f ? 1.0f : 0.0f);
    if (t.shader == "clear" && p.shadowRay) o = Color(0.25f);
    if (t.shader == "endless") o = Color(0.5f);
    if (t.shader == "noise") o = Color(0.5f), ci = Color(toUnitFloat64(p.seed[i]));
    if (t.shader == "wild") o = Color(INFINITY), ci = Color(NAN);
    for (int c = 0; c < 3; ++c) t.opacity[c][i] = o[c], t.color[c][i] = ci[c];
  }
}

ShadeTask::Status ShadeTask::run() {
  return impl_->stage++ == 0 && impl_->asks() ? Status::kNeedsRays : Status::kDone;
}
uint32_t ShadeTask::rayCount() const { return uint32_t(impl_->points.count); }

void ShadeTask::writeRays(RayQuery& q) const {
  const Impl& t = *impl_;
  const bool light = t.shader == "lit" || t.shader == "endless";
  q.kind = light ? RayKind::kVisibility : RayKind::kTrace;
  q.count = rayCount();
  q.level = t.points.level + 1;
  for (uint32_t i = 0; i < q.count; ++i) {
    const Vec3 I(t.points.direction[0][i], t.points.direction[1][i], t.points.direction[2][i]);
    const Vec3 d = light                  ? Vec3(0.3f, 0.2f, 8) - t.P[i]
                   : t.shader == "mirror" ? I - 2 * glm::dot(I, t.N[i]) * t.N[i]
                                          : I;
    for (int c = 0; c < 3; ++c)
      q.origin[c][i] = t.P[i][c], q.direction[c][i] = d[c], q.normal[c][i] = t.N[i][c];
    q.time[i] = t.points.time[i];
    q.radius[i] = t.points.radius[i], q.spread[i] = t.points.spread[i];
    q.node[i] = t.points.node[i], q.cell[i] = t.points.cell[i], q.u[i] = t.points.u[i],
    q.v[i] = t.points.v[i];
    q.seed[i] = hashStep(t.points.seed[i], 1);
    q.point[i] = i;
  }
}

void ShadeTask::readAnswers(const RayQuery& q) {
  Impl& t = *impl_;
  for (uint32_t i = 0; i < q.count; ++i)
    for (int c = 0; c < 3; ++c) {
      const float a = q.color[c][i];
      float& ci = t.color[c][i];
      if (t.shader == "mirror") ci = 0.05f * t.cs[c] + 0.8f * a;
      if (t.shader == "clear") ci = t.cs[c] * a;
      if (t.shader == "lit") ci = t.os[c] * t.cs[c] * a;
    }
}
void ShadeTask::missAll() {}
const float* ShadeTask::color(int c) const { return impl_->color[c].data(); }
const float* ShadeTask::opacity(int c) const { return impl_->opacity[c].data(); }
const float* ShadeTask::output(std::string_view, int) const { return nullptr; }

}  // namespace fr
