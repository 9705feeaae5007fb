// From what a block or a mail says to rays that can be traced: nothing that a client wrote is trusted, and
// each value is read once, since the client may be writing.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/random.h"
#include "tracer/answer_level.h"

namespace fr::tracer {

using namespace cache;

namespace {

/// Embree's arithmetic has no headroom beyond (its vertices are limited to 1.8e18).
constexpr float kFarthestOrigin = 1e18f;

/// Of Ray::chance.
constexpr uint64_t kChanceSeed = 3ull << 32;

/// True when the comma-separated `list` and `wanted` have a name in common.
bool sharesName(std::string_view list, std::string_view wanted) {
  const auto next = [](std::string_view& rest) {
    const size_t from = rest.find_first_not_of(", ");
    if (from == std::string_view::npos) return rest = {}, std::string_view();
    rest.remove_prefix(from);
    const size_t end = std::min(rest.find_first_of(", "), rest.size());
    const std::string_view word = rest.substr(0, end);
    rest.remove_prefix(end);
    return word;
  };
  while (!wanted.empty()) {
    const std::string_view name = next(wanted);
    if (name.empty()) break;
    for (std::string_view rest = list; !rest.empty();) {
      const std::string_view group = next(rest);
      if (group == name) return true;
      if (group.empty()) break;
    }
  }
  return false;
}

}  // namespace

/// Copies what a block says about its rays, and sees to it that it makes sense.
void AnswerThread::readTerms(const RayTerms& terms, Level& at) {
  RayTerms& t = at.terms;
  std::memcpy(&t, &terms, sizeof t);
  const auto end = [](auto& text) { text[sizeof text - 1] = 0; };
  end(t.label), end(t.subset), end(t.excludeSubset), end(t.extras);
  if (uint32_t(t.rayClass) > uint32_t(RayClass::kDiffuse)) t.rayClass = RayClass::kSpecular;
  if (uint32_t(t.hitMode) > uint32_t(HitMode::kShader)) t.hitMode = HitMode::kDefault;
  if (!(t.maxDistance > 0) || !std::isfinite(t.maxDistance)) t.maxDistance = 0;
  if (!(t.bias >= 0) || !std::isfinite(t.bias)) t.bias = 0;
  for (float& o : t.opaque)
    if (!std::isfinite(o)) o = 1;
  t.diffuseDepth = std::min(t.diffuseDepth, 1u << 20), t.shadowDepth = std::min(t.shadowDepth, 1u << 20);

  const std::string_view subset = t.subset, exclude = t.excludeSubset;
  at.limited = !subset.empty() || !exclude.empty();
  if (at.limited && (at.seen.empty() || at.seenSubset != subset || at.seenExclude != exclude)) {
    const Skeleton& skeleton = tracer_.cache().skeleton();
    at.seen.clear();
    for (const AttributeRecord& a : skeleton.attributes()) {
      const std::string_view groups = skeleton.string(a.groups);
      at.seen.push_back((subset.empty() || sharesName(groups, subset)) && !sharesName(groups, exclude));
    }
    at.seenSubset = subset, at.seenExclude = exclude;
  }
  if (at.extrasText == t.extras) return;
  at.extrasText = t.extras;
  at.extras.clear();
  uint32_t column = 0;
  for (std::string_view rest = at.extrasText; rest.size() > 2;) {
    const size_t lineEnd = std::min(rest.find('\n'), rest.size());
    const std::string_view line = rest.substr(0, lineEnd);
    rest.remove_prefix(std::min(lineEnd + 1, rest.size()));
    const uint32_t components = line.size() > 2 && line[0] == '3' ? 3 : 1;
    if (line.size() < 3 || column + components > kMaxExtraAnswers) break;
    at.extras.push_back({std::string(line.substr(2)), components, column});
    column += components;
  }
}

/// Where representations are in transition, a ray sees the one that it starts on, and otherwise those that a
/// number of its own decides for.
float AnswerThread::chanceOf(const AskedRay& asked) const {
  float chance = toUnitFloat64(hashStep(asked.seed, kChanceSeed));
  const SceneCache& cache = tracer_.cache();
  if (asked.node >= cache.nodeCount()) return chance;
  const float* thinning = cache.skeleton().attributes()[cache.objectOf(asked.node).attributes].thinning;
  const float from = thinning[0], to = 1 - thinning[1];
  if (from > 0 || to < 1) chance = std::min(from + chance * (to - from), std::nextafter(to, 0.0f));
  return chance;
}

/// What of a ray does not depend on where it is.
void AnswerThread::fillRay(Ray& r, const AskedRay& asked, uint32_t mask, const Level& at) const {
  r.time = asked.time >= 0 && asked.time <= 1 ? asked.time : asked.time > 1 ? 1.0f : 0.0f;
  r.mask = mask;
  if (tracer_.scene()->isThinned()) r.chance = chanceOf(asked);
  r.radius = asked.saneRadius(), r.spread = std::max(0.0f, asked.saneSpread());
  if (at.limited) r.seen = at.seen.data();
  if (at.terms.flags & RayTerms::kFrontOnly) r.side = 1;
  if (at.terms.flags & RayTerms::kBackOnly) r.side = -1;
  const bool segment = mask & (kOpaqueShadowRay | kFilteredShadowRay);
  if (!segment && at.terms.maxDistance > 0) r.farDistance = at.terms.maxDistance;
}

/// The ray that was asked. False: it makes no sense, or is a segment without length (whose farDistance is 0).
bool AnswerThread::startRay(Ray& r, const AskedRay& asked, uint32_t mask, const Level& at) {
  const RayScene* scene = tracer_.scene();
  const bool segment = mask & (kOpaqueShadowRay | kFilteredShadowRay);
  const DVec3 d(asked.direction);
  const double length = glm::length(d);
  r = Ray{};
  // Lengths of what is nowhere near the limit need not be known.
  const float farthest =
      std::max({std::abs(asked.origin.x), std::abs(asked.origin.y), std::abs(asked.origin.z)});
  if (!(scene && std::isfinite(length) && length > 0 && isFinite(asked.origin) &&
        (farthest < 0.5f * kFarthestOrigin || glm::length(DVec3(asked.origin)) <= double(kFarthestOrigin)))) {
    counts_.rejected += 1;
    return false;
  }
  r.direction = Vec3(d / length);
  fillRay(r, asked, mask, at);
  r.origin = asked.origin;
  if (at.terms.flags & RayTerms::kHasBias)
    r.departure.nearDistance = r.nearDistance = at.terms.bias;
  else
    scene->leave(r, asked.node, asked.normal);
  if (!segment) return true;
  // Its end stays where it is.
  const DVec3 rest = DVec3(asked.origin) + d - DVec3(r.origin);
  const double distance = glm::length(rest);
  if (!(distance > 0) || !(distance < double(kInfinity))) {
    r.farDistance = 0;
    return false;
  }
  r.direction = Vec3(rest / distance);
  r.farDistance = float(distance);
  r.endsOnSurface = true;
  return true;
}

void AnswerThread::startPath(PathRay& p, const AskedRay& asked, uint32_t mask, const Level& at) {
  p.askedOrigin = asked.origin;
  p.askedDirection = asked.direction;
  p.seed = asked.seed;
  p.radius = asked.saneRadius();
  p.spread = asked.saneSpread();
  p.going = startRay(p.ray, asked, mask, at);
  p.sane = p.going || p.ray.farDistance == 0;
  p.steps = 0;
  p.through = Color(1);
  p.color = Color(0);
  p.hit = p.firstHit = Hit{};
  p.missDepth = 0;
  p.missP = p.missR = Vec3(0);
  p.volumeOf = kNone, p.inside = false, p.segmentStart = 0;
  if (p.sane && asked.node < tracer_.cache().nodeCount() && isFinite(asked.normal) &&
      asked.normal != Vec3(0)) {
    p.volumeOf = tracer_.cache().objectOf(asked.node).attributes;
    p.inside = glm::dot(DVec3(asked.direction), DVec3(asked.normal)) < 0;
  }
}

/// Each value is read once: the client may be writing.
AnswerThread::AskedRay AnswerThread::askedRay(const RayQuery& query, uint32_t k) {
  const volatile RayQuery& q = query;
  AskedRay asked;
  for (int c = 0; c < 3; ++c) {
    asked.origin[c] = q.origin[c][k];
    asked.direction[c] = q.direction[c][k];
    asked.normal[c] = q.normal[c][k];
  }
  asked.time = q.time[k], asked.radius = q.radius[k], asked.spread = q.spread[k];
  asked.node = q.node[k];
  asked.seed = q.seed[k];
  return asked;
}

void AnswerThread::readRays(const RayQuery& query, uint32_t first, Level& at, uint32_t mask) {
  for (uint32_t i = 0; i < at.count; ++i) startPath(at.path[i], askedRay(query, first + i), mask, at);
}

}  // namespace fr::tracer
