// Writes the skeleton of one frame (format.h): bulk data straight into a growing shared-memory segment,
// small tables at the end.
//
// Content-addressed: equal blobs, parameter lists, transforms, attribute states and shaders are stored once,
// so an instance or a repeated archive costs its object records alone. Of what every object may have of its
// own, only the last 65,536 or more are known again (recent_content.h); tables grow in segments of their own
// (growing_table.h). So what a writer holds beside files in a scratch folder hardly grows with the scene.
//
// Errors stick: after the first one (out of memory, a table with more than 2^32 - 2 entries) every call
// returns empty values and finish() returns the error. Not thread-safe.
#pragma once

#include <memory>
#include <span>
#include <string_view>
#include <vector>

#include "base/error.h"
#include "scene_cache/format.h"

namespace fr::ri {
struct Param;
class ParamList;
}  // namespace fr::ri

namespace fr::cache {

/// A transform as keys; one matrix: still. `times` ascending, as many as matrices.
struct TransformKeys {
  std::vector<float> times;
  std::vector<DMat4> matrices;
};

class SkeletonWriter {
 public:
  /// Makes the segment. kNoMem or kSystem when the system refuses. `scratch`: as SharedStore::create().
  static Result<SkeletonWriter> create(const std::string& scratch = {});
  SkeletonWriter(SkeletonWriter&&) noexcept;
  SkeletonWriter& operator=(SkeletonWriter&&) noexcept;
  ~SkeletonWriter();

  // ---- frame-wide facts; known before the first primitive
  // ------------------------------------------------------

  void setCamera(const CameraRecord& camera);
  void setOptions(const OptionsRecord& options);
  void setCacheOrigin(const DVec3& origin);
  const CameraRecord& camera() const;
  const OptionsRecord& options() const;
  const DVec3& cacheOrigin() const;

  // ---- bulk data
  // -----------------------------------------------------------------------------------------------

  StringId intern(std::string_view s);
  std::string_view string(StringId id) const;

  /// Bytes at a multiple of `align` (a power of two, at most 4096). Range::count is in bytes.
  Range addBlob(std::span<const std::byte> bytes, size_t align = 16);
  /// The same for an array of plain values; Range::count is in elements.
  template <class T>
  Range addArray(std::span<const T> values, size_t align = alignof(T)) {
    static_assert(std::is_trivially_copyable_v<T>);
    Range r = addBlob(std::as_bytes(values), align < alignof(T) ? alignof(T) : align);
    r.count = r.count == values.size_bytes() ? values.size() : 0;
    return r;
  }
  /// What addBlob stored, to be read back while building. The address is stable until finish().
  std::span<const std::byte> bytes(const Range& byteRange) const;
  /// Space for a blob that is filled in place and not shared with equal ones; nullptr after an error.
  std::byte* appendUninitialized(size_t bytes, size_t align, Range* range);

  // ---- parameters
  // ----------------------------------------------------------------------------------------------

  /// Value of one parameter; its numbers are stored, the record itself is not.
  ParamRecord makeParam(const ri::Param& p, std::string_view rename = {});
  ParamRecord makeFloatParam(std::string_view name, ParamClass storage, ParamType type, uint32_t arrayLength,
                             std::span<const float> values);
  ParamRecord makeIntegerParam(std::string_view name, ParamClass storage, uint32_t arrayLength,
                               std::span<const int32_t> values);
  ParamRecord makeStringParam(std::string_view name, ParamClass storage, uint32_t arrayLength,
                              std::span<const StringId> values);
  /// Consecutive records, shared with an equal run.
  Slice addParams(std::span<const ParamRecord> records);
  Slice addParams(const ri::ParamList& list);
  /// Dies with the next addParams.
  std::span<const ParamRecord> params(Slice s) const;

  // ---- states
  // --------------------------------------------------------------------------------------------------

  TransformId addTransform(const TransformKeys& keys);
  TransformKeys transform(TransformId id) const;
  ShaderId addShader(const ShaderRecord& record);  ///< shared with an equal one, except lights
  Slice addLightList(std::span<const ShaderId> lights);
  AttributeId addAttributes(const AttributeRecord& record);
  const AttributeRecord& attributes(AttributeId id) const;
  Slice addDisplays(std::span<const DisplayRecord> displays);
  /// A later definition of the same name replaces the earlier one.
  void addNamedSpace(std::string_view name, TransformId toWorld);
  /// Five lists: shader texture archive procedural display.
  void setSearchPaths(std::span<const StringId> paths);
  std::span<const StringId> searchPaths() const;
  /// Number shared by the objects that may be pieces of one surface. `solid`: the leaf that they bound, or
  /// kNone.
  uint32_t surfaceGroup(AttributeId attributes, TransformId transform, SolidId solid = kNone);
  /// Its parent, if any, must have been added.
  SolidId addSolid(const SolidRecord& record);
  ShaderRecord& shader(ShaderId id);  ///< to be completed later (areaLightObject)
  uint32_t shaderCount() const;

  // ---- geometry
  // ------------------------------------------------------------------------------------------------

  /// Ids that the next addObject / addRootPatch / addEdges will return.
  ObjectId nextObject() const;
  NodeId nextRootPatch() const;
  uint32_t nextEdge() const;
  ObjectId addObject(const ObjectRecord& record);
  NodeId addRootPatch(const RootPatchRecord& record);
  NodeId addRootPatches(std::span<const RootPatchRecord> records);  ///< first of them
  uint32_t addEdges(std::span<const EdgeRecord> records);           ///< first of them
  /// Filling in what was not known when the record was added. Ids must be valid; references die with the next
  /// add.
  ObjectRecord& object(ObjectId id);
  RootPatchRecord& rootPatch(NodeId id);
  EdgeRecord& edge(uint32_t index);
  /// Forgets everything after these marks: a primitive that failed half way. Blobs stay (unreferenced).
  void rollBack(ObjectId objects, NodeId rootPatches, uint32_t edges);

  bool ok() const;
  uint64_t bytesWritten() const;

  /// Writes tables and header, seals the segment against any further change and returns its descriptor (the
  /// caller closes it). The writer is empty afterwards. The checksum costs one pass over the data and is only
  /// needed in files: without it the header's field is 0 until the file is saved.
  Result<int> finish(bool withChecksum = false);

 private:
  struct Impl;
  explicit SkeletonWriter(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace fr::cache
