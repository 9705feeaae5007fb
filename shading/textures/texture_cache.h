// The inside of the texture module: one cache of OpenImageIO for the process, and its open files.
#pragma once

#include <OpenImageIO/imagecache.h>
#include <OpenImageIO/texture.h>

#include <atomic>
#include <cmath>
#include <cstdio>
#include <exception>
#include <initializer_list>
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
/// What a map gives at most: files that are cut short or hold NaN must not reach the picture.
constexpr float kBrightest = 1e30f;
/// A place on a map and its changes to the neighbours: the filter.
struct Footprint {
  float s = 0, t = 0, dsdx = 0, dtdx = 0, dsdy = 0, dtdy = 0;
};
/// Filter widths that are no numbers are 0; more than the whole map is the whole map many times over.
inline float boundedChange(float x) { return bounded(x, 64.0f); }
/// The same filter, of sizes and shapes for which OpenImageIO's ellipses have two axes: where the two changes
/// are nearly parallel the shorter one is turned away a little, below what anisotropic filtering can resolve.
inline void condition(Footprint& f) {
  f.s = bounded(f.s, 1e4f), f.t = bounded(f.t, 1e4f);  // beyond any sense: texel numbers would overflow
  for (float* x : {&f.dsdx, &f.dtdx, &f.dsdy, &f.dtdy}) *x = boundedChange(*x);
  const float x2 = f.dsdx * f.dsdx + f.dtdx * f.dtdx, y2 = f.dsdy * f.dsdy + f.dtdy * f.dtdy;
  const float longest2 = x2 > y2 ? x2 : y2;
  if (!(longest2 > 1e-14f)) {
    f.dsdx = f.dtdx = f.dsdy = f.dtdy = 0;
    return;
  }
  constexpr float kThinnest = 0.01f;
  const float area = f.dsdx * f.dtdy - f.dtdx * f.dsdy;
  if (std::fabs(area) >= kThinnest * longest2) return;
  const float add = area < 0 ? -kThinnest : kThinnest;
  if (x2 >= y2)
    f.dsdy -= add * f.dtdx, f.dtdy += add * f.dsdx;
  else
    f.dsdx += add * f.dtdy, f.dtdx -= add * f.dsdy;
}

/// The parts of OpenImageIO's options that a whole call shares.
OIIO::TextureOpt optionsOf(const FrTextureFile& file, const FrTextureCall& call);
/// How many channels are looked up, and whether one stands for all (grey files).
struct Channels {
  int asked = 1;
  bool grey = false;
};
Channels channelsOf(const FrTextureFile& file, const FrTextureCall& call);
/// The file has none of the channels that are asked for: fills the results and says so. OpenImageIO must not
/// be asked then, it would read behind its tiles.
bool beyondChannels(const FrTextureFile& file, const FrTextureCall& call);

std::string openTextures(uint32_t kilobytes, FrTextures** out);
void closeTextures(FrTextures* textures);
std::string openFile(FrTextures& textures, const std::string& path, FrTextureFile** out);
std::string lookUpTexture(FrTextureFile& file, const FrTextureCall& call);
std::string lookUpEnvironment(FrTextureFile& file, const FrTextureCall& call);
std::string lookUpShadow(FrTextureFile& file, const FrTextureCall& call);
std::string findRange(FrTextureFile& file, int channels, float* smallest, float* largest);
std::string makeTexture(const FrMakeTexture& make);

}  // namespace fr::textures
