#include "scene_cache/cache_impl.h"
namespace fr::cache {
Result<std::unique_ptr<SceneCache>> SceneCache::openFile(const std::string& path) {
  return makeError(RiError::kUnimplemented, "{}: not yet", path);
}
Result<void> SceneCache::save(const std::string& path) {
  return makeError(RiError::kUnimplemented, "{}: not yet", path);
}
}  // namespace fr::cache
