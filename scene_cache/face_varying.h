// Face-varying values of a mesh as OpenSubdiv wants them: indices that tell where neighbours share a value.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace fr::cache {

/// Face-varying values come one row a corner; corners at one vertex with equal rows are one value, so a
/// border where the rows differ is a seam.
struct WeldedFaceVarying {
  std::vector<uint32_t> valueOfCorner;
  std::vector<uint32_t> cornerOfValue;  // a corner that has it
};

/// `values`: rows of `width` floats, one for each of `vertices`, the mesh's vertex indices corner by corner.
/// NaNs are equal to themselves here. O(n log n), whatever the valence.
WeldedFaceVarying weldFaceVarying(std::span<const float> values, uint32_t width,
                                  std::span<const uint32_t> vertices);

}  // namespace fr::cache
