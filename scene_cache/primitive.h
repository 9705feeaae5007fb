// One primitive on its way from the RI into the skeleton.
#pragma once

#include <span>

#include "base/error.h"
#include "ri/primitives.h"
#include "scene_cache/skeleton_writer.h"

namespace fr::ri {
struct TrimCurve;
}

namespace fr::cache {

/// A primitive with the state it was made under. The pointers are borrowed for the call.
struct PrimitiveDesc {
  /// Has passed ri::checkPrimitive: topology, indices and variable counts can be trusted.
  const ri::Primitive* primitive = nullptr;
  ri::ValueCounts counts;

  /// Bases in force (RISpec 3.2, "Basis"): bicubic patches and cubic curves. Bytes as in RIB.
  DMat4 uBasis{1}, vBasis{1};
  ri::BasisSteps steps;
  const ri::TrimCurve* trimCurve = nullptr;  ///< for NuPatch; nullptr: none
  bool trimOutside = false;                  ///< Attribute "trimcurve" "sense" "outside"

  /// Deformation keys: the same request with other numbers. Empty: not deforming. keys[0] == primitive.
  std::span<const ri::Primitive* const> keys;
  std::span<const float> keyTimes;

  TransformId transform = 0;  ///< object -> world; its keys are those of the writer's table
  AttributeId attributes = 0;
  uint8_t sides = kForReyes | kForTracer;  ///< which renderer sees it
  SolidId solid = kNone;                   ///< leaf that it bounds, kNone: an ordinary surface
  float fixedRate = 0;                     ///< of a prototype (ObjectRecord::fixedRate)
  uint32_t surfaceGroup = 0;               ///< SkeletonWriter::surfaceGroup(attributes, transform, solid)
  StringId locationFile = 0;
  uint32_t locationLine = 0;
  SourceLocation location;  ///< the same, for messages
};

/// Adds objects, root patches, edges and the source data of one primitive. One RI primitive may become
/// several objects (a polygon mesh with large and small faces). kUnimplemented for kinds that cannot be diced
/// yet: the caller warns once per kind. Any other error: the primitive is left out and nothing half-made
/// stays visible.
Result<void> addPrimitive(SkeletonWriter& writer, const PrimitiveDesc& desc);

}  // namespace fr::cache
