#include "scene_cache/skeleton_writer.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cstring>
#include <unordered_map>

#include "ri/param_list.h"
#include "scene_cache/cache.h"
#include "scene_cache/growing_table.h"
#include "scene_cache/recent_content.h"
#include "shm/segment.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

namespace fr::cache {
namespace {

/// What a hash stands for: equal bytes of two kinds are two things.
enum class Content : uint64_t { kBlob = 1, kParams, kTransform, kShader, kLightList, kAttributes, kSurface };

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
  Impl(shm::Segment s, std::string folder)
      : segment(std::move(s)),
        paged({segment.data(), [this] { return segment.size(); }, segment.descriptor(), 0}),
        scratch(std::move(folder)) {}

  shm::Segment segment;
  shm::PagedMapping paged;
  std::string scratch;
  uint64_t end = alignUp(sizeof(SkeletonHeader), kTableAlign);
  std::optional<Error> error;

  CameraRecord camera{};
  OptionsRecord options{};
  DVec3 cacheOrigin{0};

  std::unordered_map<std::string_view, StringId> stringIds;  // views into the segment, which never moves
  // There are as many of these as a scene has objects.
  RecentContent<Range> blobs;
  RecentContent<Slice> paramRuns;
  RecentContent<uint32_t> transformIds, attributeIds, surfaceGroups;
  uint32_t surfaceGroupCount = 0;
  // Of these there are few.
  std::unordered_map<ContentHash, Slice, HashOfHash> lightRuns;
  std::unordered_map<ContentHash, ShaderId, HashOfHash> shaderIds;

  std::vector<StringRecord> strings;
  GrowingTable<ParamRecord> params{scratch};
  GrowingTable<TransformRecord> transforms{scratch};
  std::vector<ShaderRecord> shaders;
  std::vector<ShaderId> lightLists;
  std::vector<NamedSpaceRecord> namedSpaces;
  GrowingTable<AttributeRecord> attributes{scratch};
  GrowingTable<ObjectRecord> objects{scratch};
  GrowingTable<RootPatchRecord> rootPatches{scratch};
  GrowingTable<EdgeRecord> edges{scratch};
  std::vector<DisplayRecord> displays;
  std::vector<StringId> searchPaths;
  std::vector<SolidRecord> solids;

  bool fail(Error e) {
    if (!error) error = std::move(e);
    return false;
  }
  /// True when a table may take `more` entries.
  template <class Table>
  bool room(const Table& table, size_t more, const char* what) {
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
    shm::noteGrowth(bytes);
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
  /// In pieces, so that pages of both can go meanwhile.
  template <class T>
  Range flush(GrowingTable<T>& table) {
    constexpr size_t kPiece = std::max<size_t>(1, (size_t(2) << 20) / sizeof(T));
    Range whole;
    std::span<const T> rest = table.all();
    if (!append(0, kTableAlign, &whole)) return {};
    while (!rest.empty()) {
      const auto piece = std::as_bytes(rest.first(std::min(rest.size(), kPiece)));
      Range r;
      std::byte* to = append(piece.size(), 1, &r);
      if (!to) return {};
      std::memcpy(to, piece.data(), piece.size());
      shm::noteGrowth(piece.size());  // read
      rest = rest.subspan(std::min(rest.size(), kPiece));
    }
    whole.count = table.size();
    table.clear();
    return whole;
  }
  template <class T>
  bool add(GrowingTable<T>& table, std::span<const T> records, const char* what) {
    if (!room(table, records.size(), what)) return false;
    auto r = table.append(records);
    return r || fail(std::move(r).error());
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
  SkeletonWriter w(std::make_unique<Impl>(std::move(segment).value(), scratch));
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
  if (const Range* known = m.blobs.find(key)) return *known;
  Range r;
  std::byte* to = m.append(bytes.size(), align, &r);
  if (!to) return {};
  std::memcpy(to, bytes.data(), bytes.size());
  m.blobs.add(key, r);
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
  if (m.error) return 0;
  // Equal keys have equal ranges, because blobs are shared.
  const TransformRecord record{addArray(std::span<const float>(keys.times)),
                               addArray(std::span<const DMat4>(keys.matrices), 16)};
  if (m.error) return 0;
  const ContentHash key = hashOf(Content::kTransform, bytesOf(record));
  if (const uint32_t* known = m.transformIds.find(key)) return *known;
  const auto id = TransformId(m.transforms.size());
  if (!m.add(m.transforms, std::span(&record, 1), "transforms")) return 0;
  return *m.transformIds.add(key, id);
}

TransformKeys SkeletonWriter::transform(TransformId id) const {
  const Impl& m = *impl_;
  if (id >= m.transforms.size()) return {{0.0f}, {DMat4(1)}};
  const TransformRecord& r = m.transforms[id];
  const auto* times = reinterpret_cast<const float*>(m.segment.data() + r.times.offset);
  const auto* matrices = reinterpret_cast<const DMat4*>(m.segment.data() + r.matrices.offset);
  return {{times, times + r.times.count}, {matrices, matrices + r.matrices.count}};
}

ShaderId SkeletonWriter::addShader(const ShaderRecord& record) {
  Impl& m = *impl_;
  if (!m.room(m.shaders, 1, "shaders")) return kNone;
  const ShaderId next = ShaderId(m.shaders.size());
  // Two equal lights are two lights: they shine twice and are switched apart.
  if (record.kind != ShaderKind::kLight) {
    ShaderRecord anywhere = record;
    anywhere.locationFile = anywhere.locationLine = 0;
    const auto [it, inserted] = m.shaderIds.try_emplace(hashOf(Content::kShader, bytesOf(anywhere)), next);
    if (!inserted) return it->second;
  }
  m.shaders.push_back(record);
  return next;
}

ShaderRecord& SkeletonWriter::shader(ShaderId id) { return impl_->shaders[id]; }
uint32_t SkeletonWriter::shaderCount() const { return uint32_t(impl_->shaders.size()); }

Slice SkeletonWriter::addLightList(std::span<const ShaderId> lights) {
  Impl& m = *impl_;
  if (lights.empty() || !m.room(m.lightLists, lights.size(), "entries in light lists")) return {};
  const auto [it, inserted] =
      m.lightRuns.try_emplace(hashOf(Content::kLightList, std::as_bytes(lights)),
                              Slice{uint32_t(m.lightLists.size()), uint32_t(lights.size())});
  if (inserted) m.lightLists.insert(m.lightLists.end(), lights.begin(), lights.end());
  return it->second;
}

AttributeId SkeletonWriter::addAttributes(const AttributeRecord& record) {
  Impl& m = *impl_;
  if (m.error) return 0;
  const ContentHash key = hashOf(Content::kAttributes, bytesOf(record));
  if (const uint32_t* known = m.attributeIds.find(key)) return *known;
  const auto id = AttributeId(m.attributes.size());
  if (!m.add(m.attributes, std::span(&record, 1), "attribute states")) return 0;
  return *m.attributeIds.add(key, id);
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
  return impl_->params.all().subspan(s.first, s.count);
}

uint32_t SkeletonWriter::surfaceGroup(AttributeId attributes, TransformId transform, SolidId solid) {
  Impl& m = *impl_;
  const uint32_t of[] = {attributes, transform, solid};
  const ContentHash key = hashOf(Content::kSurface, std::as_bytes(std::span(of)));
  if (const uint32_t* known = m.surfaceGroups.find(key)) return *known;
  return *m.surfaceGroups.add(key, m.surfaceGroupCount++);
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
  if (!m.add(m.objects, std::span(&record, 1), "objects")) return kNone;
  return ObjectId(m.objects.size() - 1);
}
NodeId SkeletonWriter::addRootPatch(const RootPatchRecord& record) { return addRootPatches({&record, 1}); }
NodeId SkeletonWriter::addRootPatches(std::span<const RootPatchRecord> records) {
  Impl& m = *impl_;
  const auto first = NodeId(m.rootPatches.size());
  return m.add(m.rootPatches, records, "patches") ? first : kNone;
}
uint32_t SkeletonWriter::addEdges(std::span<const EdgeRecord> records) {
  Impl& m = *impl_;
  const auto first = uint32_t(m.edges.size());
  return m.add(m.edges, records, "edges") ? first : kNone;
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
  m.objects.cut(objects);
  m.rootPatches.cut(rootPatches);
  m.edges.cut(edges);
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
  m.paged = {};
  return seal(std::move(m.segment), m.end, m.scratch.empty());
}

Slice SkeletonWriter::addParams(std::span<const ParamRecord> records) {
  Impl& m = *impl_;
  if (records.empty() || m.error) return {};
  const ContentHash key = hashOf(Content::kParams, std::as_bytes(records));
  if (const Slice* known = m.paramRuns.find(key)) return *known;
  const Slice fresh{uint32_t(m.params.size()), uint32_t(records.size())};
  if (!m.add(m.params, records, "parameters")) return {};
  return *m.paramRuns.add(key, fresh);
}

}  // namespace fr::cache
