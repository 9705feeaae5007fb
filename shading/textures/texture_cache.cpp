#include "shading/textures/texture_cache.h"

#include <OpenImageIO/imagebuf.h>
#include <OpenImageIO/imagebufalgo.h>
#include <sys/stat.h>

#include <algorithm>

#include "shading/textures/picture.h"

namespace fr::textures {
namespace {

/// Larger pictures that are not tiled would be read and reduced as a whole, in memory.
constexpr int64_t kMostUntiledTexels = int64_t(1) << 28;
constexpr int kMostTexels = 1 << 20;  // per side
constexpr int kMostChannels = 1024;

bool differs(const FrTextureFile& f) {
  struct stat s {};
  if (::stat(f.path.c_str(), &s) != 0) return true;
  return s.st_mtim.tv_sec != f.seconds || s.st_mtim.tv_nsec != f.nanoseconds || s.st_size != f.bytes ||
         s.st_ino != f.inode;
}

int kindOf(const std::string& format) {
  if (format.find("LatLong") != std::string::npos) return FR_TEXTURE_LATLONG;
  if (format.find("CubeFace Env") != std::string::npos) return FR_TEXTURE_CUBE;
  if (format.find("Shadow") != std::string::npos) return FR_TEXTURE_SHADOW;
  return FR_TEXTURE_PLAIN;
}

std::string describe(FrTextureFile& f) {
  OIIO::ImageCache& images = *f.textures->images;
  OIIO::ImageSpec native, cached;
  if (!f.image || !images.get_imagespec(f.image, nullptr, native, 0, 0, true) ||
      !images.get_imagespec(f.image, nullptr, cached, 0, 0, false)) {
    const std::string why = images.geterror();
    return why.empty() ? "it cannot be read as an image" : why;
  }
  if (native.width <= 0 || native.height <= 0 || native.nchannels <= 0) return "it holds no pixels";
  if (native.width > kMostTexels || native.height > kMostTexels || native.nchannels > kMostChannels ||
      native.full_width <= 0 || native.full_height <= 0 || native.full_width > kMostTexels ||
      native.full_height > kMostTexels || native.depth > 1)
    return OIIO::Strutil::fmt::format("{} x {} x {} pixels of {} channels are no texture", native.width,
                                      native.height, native.depth, native.nchannels);
  if (native.tile_width == 0 && int64_t(native.width) * native.height > kMostUntiledTexels)
    return OIIO::Strutil::fmt::format(
        "{} x {} pixels are too many to be made a texture while rendering; use mkmip", native.width,
        native.height);
  FrTextureInfo& info = f.info;
  info.width = native.width, info.height = native.height;
  info.channels = native.nchannels;
  info.bits = int(native.format.basesize() * 8);
  info.kind = kindOf(native.get_string_attribute("textureformat"));
  info.yIsUp = native.get_string_attribute("oiio:updirection") == "y";
  info.hasCamera = takeCamera(native, info.worldToCamera, info.worldToScreen);
  info.faceScale = 1;
  if (info.kind == FR_TEXTURE_CUBE) {
    if (info.width % 3 != 0 || info.height % 2 != 0 || info.width / 3 != info.height / 2)
      return "a cube-face environment of an unknown layout; make it with mkmip -envcube";
    info.width /= 3, info.height /= 2;
    const float cotangent = native.get_float_attribute("fovcot", 1.0f);
    if (cotangent > 1e-3f && cotangent < 1e3f) info.faceScale = 1 / cotangent;
  }
  f.tileWidth = std::max(1, cached.tile_width), f.tileHeight = std::max(1, cached.tile_height);
  f.fullWidth = native.full_width, f.fullHeight = native.full_height;
  for (int c = 0; c < native.nchannels && c < int(native.channelnames.size()); ++c)
    if (native.channelnames[size_t(c)] == "Z" || native.channelnames[size_t(c)] == "z") f.depthChannel = c;
  return "";
}

}  // namespace

// Never torn down: the next frame finds the texels of this one, and a program that ends needs no tidying.
std::string openTextures(uint32_t kilobytes, FrTextures** out) {
  static std::mutex mutex;
  static FrTextures* process = nullptr;
  const std::lock_guard lock(mutex);
  if (!process) {
    auto t = std::make_unique<FrTextures>();
    t->system = OIIO::TextureSystem::create(false);
    if (!t->system) return "OpenImageIO makes no texture system: " + OIIO::geterror();
    t->images = t->system->imagecache();
    t->system->attribute("autotile", 64);
    t->system->attribute("automip", 1);
    t->system->attribute("accept_untiled", 1);
    t->system->attribute("accept_unmipped", 1);
    t->system->attribute("max_errors_per_file", 1);
    process = t.release();
  }
  const std::lock_guard inner(process->mutex);
  if (process->users++ == 0)
    for (auto f = process->files.begin(); f != process->files.end();) {
      if (!differs(*f->second)) {
        ++f;
        continue;
      }
      process->system->invalidate(f->second->name, true);
      f = process->files.erase(f);
    }
  if (kilobytes > process->kilobytes) {
    process->kilobytes = kilobytes;
    process->system->attribute("max_memory_MB", float(kilobytes) / 1024.0f);
  }
  *out = process;
  return "";
}

void closeTextures(FrTextures* textures) {
  const std::lock_guard lock(textures->mutex);
  --textures->users;
}

std::string openFile(FrTextures& textures, const std::string& path, FrTextureFile** out) {
  const std::lock_guard lock(textures.mutex);
  if (const auto known = textures.files.find(path); known != textures.files.end()) {
    *out = known->second.get();
    return "";
  }
  auto f = std::make_unique<FrTextureFile>();
  f->textures = &textures;
  f->path = path;
  f->name = OIIO::ustring(path);
  struct stat s {};
  if (::stat(path.c_str(), &s) != 0) return "there is no such file";
  f->seconds = s.st_mtim.tv_sec, f->nanoseconds = s.st_mtim.tv_nsec, f->bytes = s.st_size,
  f->inode = s.st_ino;
  // A file that could not be read before may be a better one now.
  textures.system->invalidate(f->name, true);
  f->texture = textures.system->get_texture_handle(f->name);
  f->image = textures.images->get_image_handle(f->name);
  if (const std::string why = describe(*f); !why.empty()) return why;
  *out = f.get();
  textures.files.emplace(path, std::move(f));
  return "";
}

std::string findRange(FrTextureFile& file, int channels, float* smallest, float* largest) {
  OIIO::ImageBuf picture(file.path);
  const auto s = OIIO::ImageBufAlgo::computePixelStats(picture);
  if (picture.has_error()) return picture.geterror();
  for (int c = 0; c < channels; ++c) {
    const bool known = size_t(c) < s.min.size() && size_t(c) < s.max.size();
    smallest[c] = known ? s.min[size_t(c)] : 0.0f;
    largest[c] = known ? s.max[size_t(c)] : 0.0f;
  }
  return "";
}

}  // namespace fr::textures
