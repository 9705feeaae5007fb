#include "scene_cache/add_primitive.h"
namespace fr::cache {
Result<void> addPolygons(Adding& a) { return a.error(RiError::kUnimplemented, "not yet"); }
Result<void> addSubdivision(Adding& a) { return a.error(RiError::kUnimplemented, "not yet"); }
}  // namespace fr::cache
