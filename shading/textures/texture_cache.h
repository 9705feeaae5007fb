// The inside of the texture module: one cache of OpenImageIO for the process, and its open files.
#pragma once

#include <OpenImageIO/imagecache.h>
#include <OpenImageIO/texture.h>

#include <atomic>
#include <cmath>
#include <cstdio>
#include <exception>
#include <map>
#include <memory>
#include <mutex>
#include <string>

#include "shading/texture_module.h"

struct FrTextureFile {
  FrTextures* textures = nullptr;
  std::string path;
  OIIO::ustring name;
  OIIO::TextureSystem::TextureHandle* texture = nullptr;
  OIIO::ImageCache::ImageHandle* image = nullptr;
  FrTextureInfo info{};
  int tileWidth = 0, tileHeight = 0, fullWidth = 0, fullHeight = 0;
  int depthChannel = 0;
  bool saysWrap = false;
  // What the file was when it was opened: other values mean that its texels must be read again.
  int64_t seconds = 0, nanoseconds = 0, bytes = 0;
  uint64_t inode = 0;
};

struct FrTextures {
  OIIO::TextureSystem* system = nullptr;
  OIIO::ImageCache* images = nullptr;
  std::mutex mutex;  // guards files, users, kilobytes
  std::map<std::string, std::unique_ptr<FrTextureFile>> files;
  int users = 0;
  uint32_t kilobytes = 0;
  std::atomic<uint64_t> lookups{0};
};

namespace fr::textures {

inline int fail(char* message, size_t size, const std::string& what) {
  if (size > 0) std::snprintf(message, size, "%s", what.c_str());
  return 1;
}
/// Runs f, which returns a reason for failure or "".
template <class F>
int guarded(char* message, size_t size, F&& f) {
  try {
    const std::string reason = f();
    return reason.empty() ? 0 : fail(message, size, reason);
  } catch (const std::exception& e) {
    return fail(message, size, e.what());
  } catch (...) {
    return fail(message, size, "unknown exception");
  }
}

inline float at(const FrLanes& l, uint32_t lane) { return l.data ? l.data[lane & l.mask] : 0.0f; }
/// NaN becomes 0, and nothing is larger than `limit`.
inline float bounded(float x, float limit) {
  return x >= -limit ? (x <= limit ? x : limit) : x < 0 ? -limit : 0.0f;
}
/// Filter widths that are no numbers are 0; more than the whole map is the whole map many times over. Beyond these bounds
/// OpenImageIO's ellipses lose their axes.
inline float boundedChange(float x) { return std::fabs(x) < 1e-10f ? 0.0f : bounded(x, 64.0f); }

/// The parts of OpenImageIO's options that a whole call shares.
OIIO::TextureOpt optionsOf(const FrTextureFile& file, const FrTextureCall& call);
/// How many channels are looked up, and whether one stands for all (grey files).
struct Channels {
  int asked = 1;
  bool grey = false;
};
Channels channelsOf(const FrTextureFile& file, const FrTextureCall& call);

std::string openTextures(uint32_t kilobytes, FrTextures** out);
void closeTextures(FrTextures* textures);
std::string openFile(FrTextures& textures, const std::string& path, FrTextureFile** out);
std::string lookUpTexture(FrTextureFile& file, const FrTextureCall& call);
std::string lookUpEnvironment(FrTextureFile& file, const FrTextureCall& call);
std::string lookUpShadow(FrTextureFile& file, const FrTextureCall& call);
std::string findRange(FrTextureFile& file, int channels, float* smallest, float* largest);
std::string makeTexture(const FrMakeTexture& make);

}  // namespace fr::textures
