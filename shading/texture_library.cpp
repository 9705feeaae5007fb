#include "shading/texture_library.h"

#include <dlfcn.h>
#include <unistd.h>

#include <cstdlib>

#include "base/install_folders.h"
#include "ri/search_path.h"

namespace fr {
namespace {

std::string moduleFile() {
  if (const char* folder = std::getenv("FRANKENRENDER_MODULES"); folder && *folder)
    return std::string(folder) + "/fr_textures.so";
  return installedFile("lib/frankenrender", "fr_textures.so");
}

Result<const FrTextureModule*> openOnce() {
  const std::string file = moduleFile();
  if (::access(file.c_str(), R_OK) != 0)
    return makeError(RiError::kNoFile, "textures are not available: there is no {}", file);
  void* const module = ::dlopen(file.c_str(), RTLD_NOW | RTLD_LOCAL);
  if (!module) return makeError(RiError::kSystem, "textures are not available: {}", ::dlerror());
  const auto entry = reinterpret_cast<FrTextureEntry>(::dlsym(module, FR_TEXTURE_ENTRY));
  const FrTextureModule* const m = entry ? entry() : nullptr;
  if (!m || m->abi != FR_TEXTURE_ABI)
    return makeError(RiError::kVersion, "textures are not available: {} is of another version", file);
  return m;
}

size_t hashOf(std::string_view s) {
  uint64_t h = 0xcbf29ce484222325ull;
  for (const char c : s) h = (h ^ static_cast<unsigned char>(c)) * 0x100000001b3ull;
  return size_t(h ^ (h >> 32));
}

std::string_view trimmed(std::string_view s) {
  while (!s.empty() && s.front() == ' ') s.remove_prefix(1);
  while (!s.empty() && s.back() == ' ') s.remove_suffix(1);
  return s;
}

}  // namespace

Result<const FrTextureModule*> openTextureModule() {
  static const Result<const FrTextureModule*> once = openOnce();
  return once;
}

TextureLibrary::~TextureLibrary() {
  if (textures_) module_.load()->close(textures_);
}

const Texture* TextureLibrary::known(std::string_view name, bool list, size_t bucket) const {
  for (const Entry* e = buckets_[bucket].load(std::memory_order_acquire); e; e = e->next)
    if (e->list == list && e->texture.name == name) return &e->texture;
  return nullptr;
}

const Texture* TextureLibrary::lookUp(std::string_view name, bool list) const {
  const size_t bucket = hashOf(name) % kBuckets;
  if (const Texture* t = known(name, list, bucket)) return t;
  const std::lock_guard lock(mutex_);
  if (const Texture* t = known(name, list, bucket)) return t;
  auto entry = std::make_unique<Entry>();
  entry->list = list;
  entry->texture.name = name;
  if (list) {
    for (std::string_view rest = name;;) {
      const size_t comma = std::min(rest.find(','), rest.size());
      if (const std::string_view part = trimmed(rest.substr(0, comma)); !part.empty())
        entry->texture.parts.push_back(lookUp(part, false));
      if (comma == rest.size()) break;
      rest.remove_prefix(comma + 1);
    }
  } else {
    load(entry->texture);
  }
  entry->next = buckets_[bucket].load(std::memory_order_relaxed);
  entries_.push_back(std::move(entry));
  buckets_[bucket].store(entries_.back().get(), std::memory_order_release);
  return &entries_.back()->texture;
}

void TextureLibrary::load(Texture& t) const {
  if (moduleFailed_) return;
  if (t.name.empty()) {
    reportOnce("texture.", makeError(RiError::kNoFile, "a shader looks up a texture without a name"));
    return;
  }
  bool moved = false;
  const std::string path = ri::findMovedFile(t.name, options_.folders, moved);
  if (moved)
    reportOnce("texture." + t.name,
               Error{RiError::kNoFile,
                     Severity::kWarning,
                     {},
                     fmt::format("there is no texture \"{}\"; {} is used instead", t.name, path)});
  if (path.empty()) {
    std::string searched;
    for (const std::string& f : options_.folders) searched += (searched.empty() ? "" : ":") + f;
    reportOnce("texture." + t.name,
               makeError(RiError::kNoFile, "there is no texture \"{}\" (searched: {}{}the current folder)",
                         t.name, searched, searched.empty() ? "" : ", "));
    return;
  }
  char message[512] = "";
  if (!textures_) {
    const auto module = openTextureModule();
    if (!module) {
      moduleFailed_ = true;
      reportOnce("texture module", module.error());
      return;
    }
    if ((*module)->open(options_.memoryKilobytes, &textures_, message, sizeof message) != 0) {
      moduleFailed_ = true;
      reportOnce("texture module", makeError(RiError::kSystem, "textures are not available: {}", message));
      return;
    }
    module_.store(*module, std::memory_order_release);
  }
  FrTextureFile* file = nullptr;
  if (module_.load()->openFile(textures_, path.c_str(), &file, &t.info, message, sizeof message) != 0) {
    reportOnce("texture." + t.name, makeError(RiError::kBadFile, "texture \"{}\": {}", path, message));
    return;
  }
  t.path = path;
  t.file = file;
}

void TextureLibrary::reportFailure(const Texture& t, const char* why) const {
  reportOnce("texture." + t.name, makeError(RiError::kBadFile, "texture \"{}\": {}", t.path, why));
}

FrTextureStatistics TextureLibrary::statistics() const {
  FrTextureStatistics s{};
  const std::lock_guard lock(mutex_);
  if (textures_) module_.load()->statistics(textures_, &s);
  return s;
}

Result<void> makeTexture(const TextureRequest& r) {
  const auto module = openTextureModule();
  if (!module) return module.error();
  for (const std::string& p : r.pictures)
    if (::access(p.c_str(), R_OK) != 0)
      return makeError(RiError::kNoFile, "\"{}\" is not written: there is no picture \"{}\"", r.texture, p);
  std::vector<const char*> pictures;
  for (const std::string& p : r.pictures) pictures.push_back(p.c_str());
  FrMakeTexture make{};
  make.kind = r.kind;
  make.pictureCount = int(pictures.size()), make.pictures = pictures.data();
  make.texture = r.texture.c_str();
  make.sWrap = r.sWrap.c_str(), make.tWrap = r.tWrap.c_str(), make.filter = r.filter.c_str();
  make.sWidth = float(r.sWidth), make.tWidth = float(r.tWidth);
  make.fov = float(r.fov);
  make.resize = r.resize;
  char message[512] = "";
  if ((*module)->make(&make, message, sizeof message) != 0)
    return makeError(RiError::kBadFile, "{}", message);
  return {};
}

}  // namespace fr
