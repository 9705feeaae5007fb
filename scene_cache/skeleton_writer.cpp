#include "scene_cache/skeleton_writer.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cstring>
#include <map>
#include <tuple>
#include <unordered_map>

#include "ri/param_list.h"
#include "scene_cache/cache.h"
#include "shm/segment.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

namespace fr::cache {
namespace {

struct ContentHash {
  uint64_t low, high;
  bool operator==(const ContentHash&) const = default;
};
struct HashOfHash {
  size_t operator()(const ContentHash& h) const { return size_t(h.low); }
};
/// What a hash stands for: equal bytes of two kinds are two things.
enum class Content : uint64_t { kBlob = 1, kParams, kTransform, kShader, kLightList, kAttributes };

ContentHash hashOf(Content kind, std::span<const std::byte> bytes, uint64_t extra = 0) {
  const XXH128_hash_t h = XXH3_128bits_withSeed(bytes.data(), bytes.size(), uint64_t(kind) << 32 | extra);
  return {h.low64, h.high64};
}
template <class T>
std::span<const std::byte> bytesOf(const T& record) {
  return std::as_bytes(std::span<const T, 1>(&record, 1));
}
uint64_t alignUp(uint64_t x, uint64_t align) { return (x + align - 1) & ~(align - 1); }

constexpr uint64_t kTableAlign = 64;
constexpr uint64_t kGrowStep = uint64_t(1) << 18;
/// Address space for one skeleton; the segment takes less where the system refuses so much.
constexpr uint64_t kReserve = uint64_t(1) << 40;

/// Gives up the mapping and forbids every later change (of memory; a file in a scratch folder has no name,
/// but also no seals). Returns a read-only descriptor: before Linux 6.7 a file sealed against writing could
/// not be mapped shared through one that is open for writing.
Result<int> seal(shm::Segment segment, uint64_t bytes, bool memory) {
  // Growth was rounded up generously; the file cannot shrink, but its tail need not take memory.
  if (segment.size() > bytes)
    if (auto r = segment.discard(bytes, segment.size() - bytes); !r) report(r.error());
  auto writable = segment.share(shm::Access::kReadWrite);
  if (!writable) return std::move(writable).error();
  auto readable = segment.share(shm::Access::kReadOnly);
  if (!readable) return std::move(readable).error();
  segment = shm::Segment();  // a file with a writable mapping cannot be sealed
  if (!memory) {
    if (ftruncate(writable->get(), off_t(bytes)) != 0)
      return makeError(RiError::kSystem, "cannot cut a scratch file: {}", std::strerror(errno));
    return readable->release();
  }
  if (fcntl(writable->get(), F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_WRITE | F_SEAL_SEAL) != 0)
    return makeError(RiError::kSystem, "cannot seal shared memory: {}", std::strerror(errno));
  return readable->release();
}

}  // namespace

struct SkeletonWriter::Impl {
  Impl(shm::Segment s, bool inMemory) : segment(std::move(s)), memory(inMemory) {}

  shm::Segment segment;
  bool memory;
  uint64_t end = alignUp(sizeof(SkeletonHeader), kTableAlign);
  std::optional<Error> error;

  CameraRecord camera{};
  OptionsRecord options{};
  DVec3 cacheOrigin{0};

  std::unordered_map<std::string_view, StringId> stringIds;  // views into the segment, which never moves
  std::unordered_map<ContentHash, Range, HashOfHash> blobs;
  std::unordered_map<ContentHash, Slice, HashOfHash> runs;  // params, light lists
  std::unordered_map<ContentHash, uint32_t, HashOfHash> records;
  std::map<std::tuple<AttributeId, TransformId, SolidId>, uint32_t> surfaceGroups;

  std::vector<StringRecord> strings;
  std::vector<ParamRecord> params;
  std::vector<TransformRecord> transforms;
  std::vector<TransformKeys> transformKeys;
  std::vector<ShaderRecord> shaders;
  std::vector<ShaderId> lightLists;
  std::vector<NamedSpaceRecord> namedSpaces;
  std::vector<AttributeRecord> attributes;
  std::vector<ObjectRecord> objects;
  std::vector<RootPatchRecord> rootPatches;
  std::vector<EdgeRecord> edges;
  std::vector<DisplayRecord> displays;
  std::vector<StringId> searchPaths;
  std::vector<SolidRecord> solids;

  bool fail(Error e) {
    if (!error) error = std::move(e);
    return false;
  }
  /// True when a table may take `more` entries.
  template <class T>
  bool room(const std::vector<T>& table, size_t more, const char* what) {
    if (error) return false;
    if (more <= size_t(kNone) - 1 - table.size()) return true;
    return fail(makeError(RiError::kLimit, "the scene has more than {} {}", kNone - 1, what));
  }
  std::byte* append(size_t bytes, size_t align, Range* range) {
    *range = {};
    if (error) return nullptr;
    const uint64_t offset = alignUp(end, align);
    if (offset + bytes > segment.size()) {
      // An eighth more than asked for: few system calls however large it grows.
      auto r = segment.grow(offset + bytes + std::min(offset / 8, uint64_t(256) << 20));
      if (!r) r = segment.grow(offset + bytes);
      if (!r) {
        fail(std::move(r).error());
        return nullptr;
      }
    }
    // The gap of the alignment is zero already: the segment is fresh memory.
    *range = {offset, bytes};
    end = offset + bytes;
    return segment.data() + offset;
  }
  /// Moves a table to the segment and frees it.
  template <class T>
  Range flush(std::vector<T>& table) {
    Range r;
    const std::span<const std::byte> bytes = std::as_bytes(std::span<const T>(table));
    std::byte* to = append(bytes.size(), kTableAlign, &r);
    if (!to) return {};
    if (!bytes.empty()) std::memcpy(to, bytes.data(), bytes.size());
    r.count = table.size();
    std::vector<T>().swap(table);
    return r;
  }
  template <class T>
  Slice addRun(Content kind, std::vector<T>& table, std::span<const T> run, const char* what) {
    if (run.empty() || !room(table, run.size(), what)) return {};
    const ContentHash key = hashOf(kind, std::as_bytes(run));
    const Slice fresh{uint32_t(table.size()), uint32_t(run.size())};
    const auto [it, inserted] = runs.try_emplace(key, fresh);
    if (inserted) table.insert(table.end(), run.begin(), run.end());
    return it->second;
  }
};

SkeletonWriter::SkeletonWriter(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
SkeletonWriter::SkeletonWriter(SkeletonWriter&&) noexcept = default;
SkeletonWriter& SkeletonWriter::operator=(SkeletonWriter&&) noexcept = default;
SkeletonWriter::~SkeletonWriter() = default;

Result<SkeletonWriter> SkeletonWriter::create(const std::string& scratch) {
  shm::SegmentOptions options;
  options.name = "frankenrender-skeleton";
  options.reserve = kReserve;
  options.growStep = kGrowStep;
  auto segment = scratch.empty() ? shm::Segment::createAnonymous(options, kGrowStep)
                                 : shm::Segment::createScratch(scratch, options, kGrowStep);
  if (!segment) return std::move(segment).error();
  SkeletonWriter w(std::make_unique<Impl>(std::move(segment).value(), scratch.empty()));
  w.intern("");
  if (!w.ok()) return *w.impl_->error;
  return w;
}

void SkeletonWriter::setCamera(const CameraRecord& camera) { impl_->camera = camera; }
void SkeletonWriter::setOptions(const OptionsRecord& options) { impl_->options = options; }
void SkeletonWriter::setCacheOrigin(const DVec3& origin) { impl_->cacheOrigin = origin; }
const CameraRecord& SkeletonWriter::camera() const { return impl_->camera; }
const OptionsRecord& SkeletonWriter::options() const { return impl_->options; }
const DVec3& SkeletonWriter::cacheOrigin() const { return impl_->cacheOrigin; }

StringId SkeletonWriter::intern(std::string_view s) {
  Impl& m = *impl_;
  if (const auto it = m.stringIds.find(s); it != m.stringIds.end()) return it->second;
  if (s.size() > kNone) {
    m.fail(makeError(RiError::kLimit, "a string of {} bytes", s.size()));
    return 0;
  }
  if (!m.room(m.strings, 1, "strings")) return 0;
  Range r;
  std::byte* to = m.append(s.size(), 1, &r);
  if (!to) return 0;
  if (!s.empty()) std::memcpy(to, s.data(), s.size());
  const StringId id = StringId(m.strings.size());
  m.strings.push_back({r.offset, uint32_t(s.size()), 0});
  m.stringIds.emplace(std::string_view(reinterpret_cast<const char*>(to), s.size()), id);
  return id;
}

std::string_view SkeletonWriter::string(StringId id) const {
  const Impl& m = *impl_;
  if (id >= m.strings.size()) return {};
  return {reinterpret_cast<const char*>(m.segment.data() + m.strings[id].offset), m.strings[id].size};
}

Range SkeletonWriter::addBlob(std::span<const std::byte> bytes, size_t align) {
  Impl& m = *impl_;
  FR_CHECK(std::has_single_bit(align) && align <= 4096);
  if (bytes.empty() || m.error) return {};
  const ContentHash key = hashOf(Content::kBlob, bytes, align);
  if (const auto it = m.blobs.find(key); it != m.blobs.end()) return it->second;
  Range r;
  std::byte* to = m.append(bytes.size(), align, &r);
  if (!to) return {};
  std::memcpy(to, bytes.data(), bytes.size());
  m.blobs.emplace(key, r);
  return r;
}

std::span<const std::byte> SkeletonWriter::bytes(const Range& byteRange) const {
  const Impl& m = *impl_;
  if (byteRange.offset > m.end || byteRange.count > m.end - byteRange.offset) return {};
  return {m.segment.data() + byteRange.offset, size_t(byteRange.count)};
}

std::byte* SkeletonWriter::appendUninitialized(size_t bytes, size_t align, Range* range) {
  FR_CHECK(std::has_single_bit(align) && align <= 4096);
  return impl_->append(bytes, align, range);
}

TransformId SkeletonWriter::addTransform(const TransformKeys& keys) {
  Impl& m = *impl_;
  FR_CHECK(!keys.matrices.empty() && keys.matrices.size() == keys.times.size());
  if (!m.room(m.transforms, 1, "transforms")) return 0;
  // Equal keys have equal ranges, because blobs are shared.
  const TransformRecord record{addArray(std::span<const float>(keys.times)),
                               addArray(std::span<const DMat4>(keys.matrices), 16)};
  if (m.error) return 0;
  const auto [it, inserted] =
      m.records.try_emplace(hashOf(Content::kTransform, bytesOf(record)), uint32_t(m.transforms.size()));
  if (inserted) {
    m.transforms.push_back(record);
    m.transformKeys.push_back(keys);
  }
  return it->second;
}

const TransformKeys& SkeletonWriter::transform(TransformId id) const {
  static const TransformKeys identity{{0.0f}, {DMat4(1)}};
  return id < impl_->transformKeys.size() ? impl_->transformKeys[id] : identity;
}

ShaderId SkeletonWriter::addShader(const ShaderRecord& record) {
  Impl& m = *impl_;
  if (!m.room(m.shaders, 1, "shaders")) return kNone;
  const ShaderId next = ShaderId(m.shaders.size());
  // Two equal lights are two lights: they shine twice and are switched apart.
  if (record.kind != ShaderKind::kLight) {
    ShaderRecord anywhere = record;
    anywhere.locationFile = anywhere.locationLine = 0;
    const auto [it, inserted] = m.records.try_emplace(hashOf(Content::kShader, bytesOf(anywhere)), next);
    if (!inserted) return it->second;
  }
  m.shaders.push_back(record);
  return next;
}

ShaderRecord& SkeletonWriter::shader(ShaderId id) { return impl_->shaders[id]; }
uint32_t SkeletonWriter::shaderCount() const { return uint32_t(impl_->shaders.size()); }

Slice SkeletonWriter::addLightList(std::span<const ShaderId> lights) {
  return impl_->addRun(Content::kLightList, impl_->lightLists, lights, "entries in light lists");
}

AttributeId SkeletonWriter::addAttributes(const AttributeRecord& record) {
  Impl& m = *impl_;
  if (!m.room(m.attributes, 1, "attribute states")) return 0;
  const auto [it, inserted] =
      m.records.try_emplace(hashOf(Content::kAttributes, bytesOf(record)), uint32_t(m.attributes.size()));
  if (inserted) m.attributes.push_back(record);
  return it->second;
}

const AttributeRecord& SkeletonWriter::attributes(AttributeId id) const {
  static const AttributeRecord none{};
  return id < impl_->attributes.size() ? impl_->attributes[id] : none;
}

Slice SkeletonWriter::addDisplays(std::span<const DisplayRecord> displays) {
  Impl& m = *impl_;
  if (displays.empty() || !m.room(m.displays, displays.size(), "displays")) return {};
  const Slice s{uint32_t(m.displays.size()), uint32_t(displays.size())};
  m.displays.insert(m.displays.end(), displays.begin(), displays.end());
  return s;
}

void SkeletonWriter::addNamedSpace(std::string_view name, TransformId toWorld) {
  Impl& m = *impl_;
  const StringId id = intern(name);
  for (NamedSpaceRecord& r : m.namedSpaces)
    if (r.name == id) {
      r.transform = toWorld;
      return;
    }
  if (m.room(m.namedSpaces, 1, "coordinate systems")) m.namedSpaces.push_back({id, toWorld});
}

void SkeletonWriter::setSearchPaths(std::span<const StringId> paths) {
  impl_->searchPaths.assign(paths.begin(), paths.end());
}

std::span<const StringId> SkeletonWriter::searchPaths() const { return impl_->searchPaths; }
std::span<const ParamRecord> SkeletonWriter::params(Slice s) const {
  if (uint64_t(s.first) + s.count > impl_->params.size()) return {};
  return std::span<const ParamRecord>(impl_->params).subspan(s.first, s.count);
}

uint32_t SkeletonWriter::surfaceGroup(AttributeId attributes, TransformId transform, SolidId solid) {
  Impl& m = *impl_;
  return m.surfaceGroups.try_emplace({attributes, transform, solid}, uint32_t(m.surfaceGroups.size()))
      .first->second;
}

SolidId SkeletonWriter::addSolid(const SolidRecord& record) {
  Impl& m = *impl_;
  if (!m.room(m.solids, 1, "solids")) return kNone;
  m.solids.push_back(record);
  return SolidId(m.solids.size() - 1);
}

ObjectId SkeletonWriter::nextObject() const { return ObjectId(impl_->objects.size()); }
NodeId SkeletonWriter::nextRootPatch() const { return NodeId(impl_->rootPatches.size()); }
uint32_t SkeletonWriter::nextEdge() const { return uint32_t(impl_->edges.size()); }

ObjectId SkeletonWriter::addObject(const ObjectRecord& record) {
  Impl& m = *impl_;
  if (!m.room(m.objects, 1, "objects")) return kNone;
  m.objects.push_back(record);
  return ObjectId(m.objects.size() - 1);
}
NodeId SkeletonWriter::addRootPatch(const RootPatchRecord& record) { return addRootPatches({&record, 1}); }
NodeId SkeletonWriter::addRootPatches(std::span<const RootPatchRecord> records) {
  Impl& m = *impl_;
  if (!m.room(m.rootPatches, records.size(), "patches")) return kNone;
  const NodeId first = NodeId(m.rootPatches.size());
  m.rootPatches.insert(m.rootPatches.end(), records.begin(), records.end());
  return first;
}
uint32_t SkeletonWriter::addEdges(std::span<const EdgeRecord> records) {
  Impl& m = *impl_;
  if (!m.room(m.edges, records.size(), "edges")) return kNone;
  const uint32_t first = uint32_t(m.edges.size());
  m.edges.insert(m.edges.end(), records.begin(), records.end());
  return first;
}
ObjectRecord& SkeletonWriter::object(ObjectId id) {
  FR_CHECK(id < impl_->objects.size());
  return impl_->objects[id];
}
RootPatchRecord& SkeletonWriter::rootPatch(NodeId id) {
  FR_CHECK(id < impl_->rootPatches.size());
  return impl_->rootPatches[id];
}
EdgeRecord& SkeletonWriter::edge(uint32_t index) {
  FR_CHECK(index < impl_->edges.size());
  return impl_->edges[index];
}
void SkeletonWriter::rollBack(ObjectId objects, NodeId rootPatches, uint32_t edges) {
  Impl& m = *impl_;
  m.objects.resize(std::min<size_t>(objects, m.objects.size()));
  m.rootPatches.resize(std::min<size_t>(rootPatches, m.rootPatches.size()));
  m.edges.resize(std::min<size_t>(edges, m.edges.size()));
}

bool SkeletonWriter::ok() const { return !impl_->error; }
uint64_t SkeletonWriter::bytesWritten() const { return impl_->end; }

Result<int> SkeletonWriter::finish(bool withChecksum) {
  const std::unique_ptr<Impl> owned = std::move(impl_);
  Impl& m = *owned;
  SkeletonHeader h{};
  h.version = kFormatVersion;
  h.byteOrder = 0x01020304;
  h.layout = layoutFingerprint();
  h.cacheOrigin = m.cacheOrigin;
  h.strings = m.flush(m.strings);
  h.params = m.flush(m.params);
  h.transforms = m.flush(m.transforms);
  h.shaders = m.flush(m.shaders);
  h.lightLists = m.flush(m.lightLists);
  h.namedSpaces = m.flush(m.namedSpaces);
  h.attributes = m.flush(m.attributes);
  h.objects = m.flush(m.objects);
  h.rootPatches = m.flush(m.rootPatches);
  h.edges = m.flush(m.edges);
  h.displays = m.flush(m.displays);
  std::vector<CameraRecord> camera{m.camera};
  h.camera = m.flush(camera);
  std::vector<OptionsRecord> options{m.options};
  h.options = m.flush(options);
  h.searchPaths = m.flush(m.searchPaths);
  h.solids = m.flush(m.solids);
  if (m.error) return std::move(*m.error).context("cannot write the scene cache");

  h.totalBytes = m.end;
  if (withChecksum) h.checksum = skeletonChecksum({m.segment.data(), size_t(m.end)});
  h.magic = kSkeletonMagic;
  // A reader only ever sees the sealed segment, so the order of these bytes does not matter here.
  std::memcpy(m.segment.data(), &h, sizeof(h));
  return seal(std::move(m.segment), m.end, m.memory);
}

Slice SkeletonWriter::addParams(std::span<const ParamRecord> records) {
  return impl_->addRun(Content::kParams, impl_->params, records, "parameters");
}

}  // namespace fr::cache
