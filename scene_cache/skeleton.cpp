#include <algorithm>

#include "scene_cache/cache.h"
#include "scene_cache/motion.h"
#include "scene_cache/skeleton_check.h"

namespace fr::cache {
namespace {

template <class T>
std::span<const T> at(std::span<const std::byte> bytes, const Range& r) {
  return {reinterpret_cast<const T*>(bytes.data() + r.offset), size_t(r.count)};
}
template <class T>
std::span<const T> part(std::span<const T> table, Slice s) {
  if (uint64_t(s.first) + s.count > table.size()) return {};
  return table.subspan(s.first, s.count);
}

}  // namespace

Result<Skeleton> Skeleton::open(std::span<const std::byte> bytes, bool verifyChecksum) {
  if (auto r = checkSkeleton(bytes, verifyChecksum); !r) return std::move(r).error();
  Skeleton s;
  s.header_ = reinterpret_cast<const SkeletonHeader*>(bytes.data());
  s.bytes_ = bytes.first(size_t(s.header_->totalBytes));
  return s;
}

std::span<const ParamRecord> Skeleton::params(Slice s) const {
  return part(at<ParamRecord>(bytes_, header_->params), s);
}
std::span<const TransformRecord> Skeleton::transforms() const {
  return at<TransformRecord>(bytes_, header_->transforms);
}
std::span<const ShaderRecord> Skeleton::shaders() const { return at<ShaderRecord>(bytes_, header_->shaders); }
std::span<const ShaderId> Skeleton::lightList(Slice s) const {
  return part(at<ShaderId>(bytes_, header_->lightLists), s);
}
std::span<const NamedSpaceRecord> Skeleton::namedSpaces() const {
  return at<NamedSpaceRecord>(bytes_, header_->namedSpaces);
}
std::span<const AttributeRecord> Skeleton::attributes() const {
  return at<AttributeRecord>(bytes_, header_->attributes);
}
std::span<const ObjectRecord> Skeleton::objects() const { return at<ObjectRecord>(bytes_, header_->objects); }
std::span<const RootPatchRecord> Skeleton::rootPatches() const {
  return at<RootPatchRecord>(bytes_, header_->rootPatches);
}
std::span<const EdgeRecord> Skeleton::edges() const { return at<EdgeRecord>(bytes_, header_->edges); }
std::span<const DisplayRecord> Skeleton::displays(Slice s) const {
  return part(at<DisplayRecord>(bytes_, header_->displays), s);
}
const CameraRecord& Skeleton::camera() const { return at<CameraRecord>(bytes_, header_->camera)[0]; }
const OptionsRecord& Skeleton::options() const { return at<OptionsRecord>(bytes_, header_->options)[0]; }
std::span<const StringId> Skeleton::searchPaths() const { return at<StringId>(bytes_, header_->searchPaths); }
std::span<const SolidRecord> Skeleton::solids() const { return at<SolidRecord>(bytes_, header_->solids); }

std::string_view Skeleton::string(StringId id) const {
  const auto all = at<StringRecord>(bytes_, header_->strings);
  if (id >= all.size()) return {};
  return {reinterpret_cast<const char*>(bytes_.data() + all[id].offset), all[id].size};
}

std::span<const float> Skeleton::floats(const ParamRecord& p) const {
  if (p.type == ParamType::kInteger || p.type == ParamType::kString) return {};
  return at<float>(bytes_, p.values);
}
std::span<const int32_t> Skeleton::integers(const ParamRecord& p) const {
  return p.type == ParamType::kInteger ? at<int32_t>(bytes_, p.values) : std::span<const int32_t>();
}
std::span<const StringId> Skeleton::strings(const ParamRecord& p) const {
  return p.type == ParamType::kString ? at<StringId>(bytes_, p.values) : std::span<const StringId>();
}

const ParamRecord* Skeleton::find(Slice s, std::string_view name) const {
  for (const ParamRecord& p : params(s))
    if (string(p.name) == name) return &p;
  return nullptr;
}

DMat4 Skeleton::toWorld(TransformId id, float time) const {
  const auto all = transforms();
  if (id >= all.size()) return DMat4(1);
  return interpolateMotion(at<float>(bytes_, all[id].times), at<DMat4>(bytes_, all[id].matrices), time);
}

DMat4 Skeleton::toCache(TransformId id, float time) const {
  DMat4 m = toWorld(id, time);
  // The origin is subtracted in double before anything is rounded.
  for (int c = 0; c < 4; ++c) m[c] -= DVec4(header_->cacheOrigin * m[c].w, 0.0);
  return m;
}

DMat4 Skeleton::worldToCamera(float time) const { return toWorld(camera().worldToCamera, time); }

DMat4 Skeleton::cacheToCamera(float time) const {
  DMat4 m = worldToCamera(time);
  m[3] = m * DVec4(header_->cacheOrigin, 1.0);
  return m;
}

}  // namespace fr::cache
