// Texture files by the names that shaders give them, behind a module that is opened when the first one is
// asked for.
#pragma once

#include <array>
#include <atomic>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

#include "base/error.h"
#include "shading/texture_module.h"

namespace fr {

/// Opens fr_textures.so, once: from the folder $FRANKENRENDER_MODULES, else from <folder of the
/// program>/../lib/ frankenrender (true of the installed tree and of the build tree). Stays open until the
/// program ends. Thread-safe. Errors: kNoFile, kVersion, kSystem.
Result<const FrTextureModule*> openTextureModule();

/// A file as a shader names it, or a comma-separated list of files.
struct Texture {
  std::string name;
  std::string path;               // where the file was found
  FrTextureFile* file = nullptr;  // nullptr: missing or unusable, which has been reported
  FrTextureInfo info{};
  std::vector<const Texture*> parts;  // of a list
};

/// The textures of one scene. Thread-safe; what has been found once is found again without a lock.
class TextureLibrary {
 public:
  struct Options {
    std::vector<std::string> folders;  // searched in order; then the current folder
    uint32_t memoryKilobytes = 65536;  // of texels (OpenImageIO wants 10 MB at least)
  };
  explicit TextureLibrary(Options options) : options_(std::move(options)) {}
  ~TextureLibrary();
  TextureLibrary(const TextureLibrary&) = delete;
  TextureLibrary& operator=(const TextureLibrary&) = delete;

  /// Never fails: a texture without a file stands for one that is missing (reported once, kNoFile).
  const Texture& find(std::string_view name) const { return *lookUp(name, false); }
  /// A list of maps, as shadow() takes it. A single name is a list of one.
  const Texture& findList(std::string_view names) const { return *lookUp(names, true); }
  /// Runs a function of the module; a failure is reported once for each texture.
  template <class F>
  bool call(const Texture& t, F&& f) const {
    char message[512] = "";
    if (f(*module_.load(std::memory_order_acquire), message, sizeof message) == 0) return true;
    reportFailure(t, message);
    return false;
  }
  /// Zeros as long as no texture was asked for.
  FrTextureStatistics statistics() const;

 private:
  struct Entry {
    Texture texture;
    bool list = false;
    const Entry* next = nullptr;
  };
  static constexpr size_t kBuckets = 1024;
  const Texture* lookUp(std::string_view name, bool list) const;
  const Texture* known(std::string_view name, bool list, size_t bucket) const;
  void load(Texture& t) const;
  void reportFailure(const Texture& t, const char* why) const;

  const Options options_;
  mutable std::array<std::atomic<const Entry*>, kBuckets> buckets_{};
  mutable std::recursive_mutex mutex_;  // guards loading
  mutable std::vector<std::unique_ptr<Entry>> entries_;
  mutable std::atomic<const FrTextureModule*> module_{nullptr};
  mutable FrTextures* textures_ = nullptr;
  mutable bool moduleFailed_ = false;
};

/// What MakeTexture and its kin, and mkmip, ask for.
struct TextureRequest {
  FrMakeKind kind = FR_MAKE_TEXTURE;
  std::vector<std::string> pictures;  // file names; cube: px nx py ny pz nz
  std::string texture;
  std::string sWrap, tWrap, filter;
  double sWidth = 1, tWidth = 1;
  double fov = 90;  // cube: degrees
  FrMakeResize resize = FR_RESIZE_NONE;
};
/// Writes a tiled, mip-mapped texture. The file appears complete or not at all. Errors: kNoFile, kBadFile.
Result<void> makeTexture(const TextureRequest& request);

}  // namespace fr
