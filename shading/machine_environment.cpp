// What rays that hit nothing see: the environment maps of ray calls.
#include <algorithm>
#include <cmath>

#include "shading/machine_ray.h"
#include "shading/texture_library.h"
#include "shading/texture_module.h"

namespace fr {

namespace {
/// Columns of kMaxRays floats.
enum Column : uint32_t { kColor = 0, kPlace = 3, kAcross = 6, kAlong = 9, kColumns = 12 };
}  // namespace

/// Colours of the map in the directions of all pending rays, filtered over their footprints, in missColor_.
/// False: there is no such map.
bool Machine::lookUpEnvironment(const Frame& f, std::string_view map, std::string_view spaceName) {
  const TextureLibrary* const library = host_.textures();
  if (!library) return false;
  const Texture& texture = library->find(map);
  if (!texture.file) return false;
  DMat4 toCurrent(1.0);
  space(f, spaceName.empty() ? "world" : spaceName, batch_.objects.empty() ? kNoIndex : batch_.objects[0],
        toCurrent);
  const Mat3 toMap = glm::inverse(Mat3(toCurrent));
  const PendingRays& r = *rays_;
  missColor_.reserve(size_t(kColumns) * kMaxRays);
  float* const scratch = missColor_.data();
  const auto column = [&](uint32_t c) { return scratch + size_t(c) * kMaxRays; };
  const auto set = [&](uint32_t c, uint32_t k, const Vec3& v) {
    for (uint32_t m = 0; m < 3; ++m) column(c + m)[k] = v[int(m)];
  };
  for (uint32_t k = 0; k < r.count; ++k) {
    const Vec3 d = toMap * Vec3(r.direction[0][k], r.direction[1][k], r.direction[2][k]);
    // Any two directions perpendicular to it, as long as the footprint is wide at distance 1.
    const Vec3 axis = std::fabs(d.x) < std::fabs(d.y) ? Vec3(1, 0, 0) : Vec3(0, 1, 0);
    const Vec3 across = glm::cross(d, axis), along = glm::cross(d, across);
    const auto wide = [&](const Vec3& v) {
      const float length = glm::length(v);
      return length > 0 ? v * (2.0f * r.spread[k] * glm::length(d) / length) : Vec3(0);
    };
    set(kPlace, k, d), set(kAcross, k, wide(across)), set(kAlong, k, wide(along));
  }
  FrTextureCall call{};
  call.lanes = r.count;
  call.channelCount = 3;
  call.filter = FR_TEXTURE_BOX;
  call.sWidth = call.tWidth = 1;
  call.samples = 16;
  for (uint32_t m = 0; m < 3; ++m) {
    std::fill_n(column(kColor + m), r.count, 0.0f);
    call.place[m] = {column(kPlace + m), ~0u};
    call.placeDx[m] = {column(kAcross + m), ~0u};
    call.placeDy[m] = {column(kAlong + m), ~0u};
  }
  call.result = column(kColor), call.resultStride = kMaxRays;
  return library->call(texture, [&](const FrTextureModule& m, char* message, size_t size) {
    return m.environment(texture.file, &call, message, size);
  });
}

/// gather's "environment:color": of the points of this group that hit nothing.
void Machine::answerEnvironment(const Frame& f, std::string_view map, std::string_view spaceName,
                                const Operand& out) {
  if (!lookUpEnvironment(f, map, spaceName)) return;
  std::vector<int32_t>& missed = groups_.missed;
  missed.resize(batch_.lanes);
  PendingRays& r = *rays_;
  for (uint32_t i = 0; i < batch_.lanes; ++i) missed[i] = groups_.asked[i] & ~groups_.hits[i];
  for (uint32_t m = 0; m < 3; ++m) std::copy_n(missColor_.data() + m * kMaxRays, r.count, r.missP[m]);
  answer(out, 3, r.missP, missed.data());
}

}  // namespace fr
