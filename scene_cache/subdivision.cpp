#include "scene_cache/subdivision.h"

namespace fr::cache {

struct SubdivisionStore::Impl {};
SubdivisionStore::SubdivisionStore(const Skeleton&) {}
SubdivisionStore::~SubdivisionStore() = default;
const SubdivisionSurface* SubdivisionStore::surface(ObjectId, float) { return nullptr; }
bool SubdivisionStore::evaluate(ObjectId, uint32_t, const ParamRecord&, std::span<const float>, uint32_t,
                                size_t, const float*, const float*, float* const*) {
  return false;
}
Vec3 SubdivisionSurface::point(uint32_t, float, float) const { return Vec3(0); }
Vec3 SubdivisionSurface::derivatives(uint32_t, float, float, Vec3&, Vec3&) const { return Vec3(0); }
Box3f SubdivisionSurface::bound(uint32_t) const { return {}; }

}  // namespace fr::cache
