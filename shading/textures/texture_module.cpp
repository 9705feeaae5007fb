// What the shared object exports.
#include "shading/textures/texture_cache.h"

namespace {

using namespace fr::textures;

int open(uint32_t kilobytes, FrTextures** textures, char* message, size_t size) {
  return guarded(message, size, [&] { return openTextures(kilobytes, textures); });
}
void close(FrTextures* textures) {
  if (textures) closeTextures(textures);
}
int openOne(FrTextures* textures, const char* path, FrTextureFile** file, FrTextureInfo* info, char* message,
            size_t size) {
  return guarded(message, size, [&]() -> std::string {
    if (std::string why = openFile(*textures, path, file); !why.empty()) return why;
    *info = (*file)->info;
    return "";
  });
}
int texture(FrTextureFile* file, const FrTextureCall* call, char* message, size_t size) {
  return guarded(message, size, [&] { return lookUpTexture(*file, *call); });
}
int environment(FrTextureFile* file, const FrTextureCall* call, char* message, size_t size) {
  return guarded(message, size, [&] { return lookUpEnvironment(*file, *call); });
}
int shadow(FrTextureFile* file, const FrTextureCall* call, char* message, size_t size) {
  return guarded(message, size, [&] { return lookUpShadow(*file, *call); });
}
int range(FrTextureFile* file, int channels, float* smallest, float* largest, char* message, size_t size) {
  return guarded(message, size, [&] { return findRange(*file, channels, smallest, largest); });
}
int make(const FrMakeTexture* request, char* message, size_t size) {
  return guarded(message, size, [&] { return makeTexture(*request); });
}
void statistics(FrTextures* textures, FrTextureStatistics* out) {
  *out = {};
  {
    const std::lock_guard lock(textures->mutex);
    out->files = textures->files.size();
  }
  out->lookups = textures->lookups.load(std::memory_order_relaxed);
  long long read = 0, used = 0;
  textures->images->getattribute("stat:bytes_read", OIIO::TypeDesc::INT64, &read);
  textures->images->getattribute("stat:cache_memory_used", OIIO::TypeDesc::INT64, &used);
  out->bytesRead = uint64_t(read), out->heldBytes = uint64_t(used);
}

}  // namespace

extern "C" __attribute__((visibility("default"))) const FrTextureModule* frTextureModule(void) {
  static const FrTextureModule module = {FR_TEXTURE_ABI, open,   close, openOne, texture,
                                         environment,    shadow, range, make,    statistics};
  return &module;
}
