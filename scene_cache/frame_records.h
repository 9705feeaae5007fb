// Camera, options, displays and search paths of the RI as records of the skeleton.
#pragma once

#include "ri/graphics_state.h"
#include "scene_cache/attribute_records.h"
#include "scene_cache/scene_loader.h"
#include "scene_cache/skeleton_writer.h"

namespace fr::cache {

/// The options with the command line's answers in place of the RIB's, and where the RIB says nothing.
ri::Options overridden(ri::Options options, const FrameOverrides& overrides, const FrameDefaults& defaults);

/// Camera, options, displays, search paths and cache origin of a world that begins now (RISpec 3.2,
/// section 4.1).
void writeFrameRecords(const ri::Options& options, const ri::TransformPtr& worldToCamera, int frameNumber,
                       AttributeRecords& records, SkeletonWriter* writer);

/// What the ray tracer's own files say about options, added to those of the image: generic options that the
/// image's files do not set, ray depth, search paths.
void mergeTracerOptions(const ri::Options& tracer, SkeletonWriter* writer);

/// Origin of cache space for a camera: its position rounded to a lattice that is coarse against the steps of
/// a moving camera (successive frames share grids) and fine enough that floats resolve what stands at the
/// near plane to 2^-18 of its distance. Zero when the matrix cannot be inverted.
DVec3 chooseCacheOrigin(const DMat4& worldToCamera, double nearClip);

}  // namespace fr::cache
