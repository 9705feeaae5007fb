// MakeTexture and its kin: pictures in, a tiled and mip-mapped file out (RISpec 3.2, section 7.1).
#include <OpenImageIO/imageio.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "shading/textures/picture.h"
#include "shading/textures/texture_cache.h"

namespace fr::textures {
namespace {

constexpr int kTile = 64;
constexpr float kFarAway = 1e38f;

int powerOfTwo(int n, int resize) {
  int up = 1;
  while (up < n) up *= 2;
  const int down = up > n ? up / 2 : up;
  if (resize == FR_RESIZE_UP) return up;
  if (resize == FR_RESIZE_DOWN) return std::max(1, down);
  // To the nearer one, by ratio.
  return double(n) * n >= double(up) * down ? up : std::max(1, down);
}

std::string formatOf(const std::string& path) {
  std::string e = std::filesystem::path(path).extension().string();
  std::transform(e.begin(), e.end(), e.begin(), [](unsigned char c) { return char(std::tolower(c)); });
  return e == ".exr" ? "openexr" : "tiff";
}

/// A file under a temporary name that appears complete or not at all.
class TextureWriter {
 public:
  TextureWriter(std::string path, OIIO::ImageSpec spec)
      : path_(std::move(path)),
        temporary_(path_ + ".tmp" + std::to_string(::getpid())),
        spec_(std::move(spec)),
        out_(OIIO::ImageOutput::create(formatOf(path_))) {}
  ~TextureWriter() {
    if (!finished_) {
      out_.reset();
      ::unlink(temporary_.c_str());
    }
  }
  std::string level(const Picture& p) {
    if (!out_) return "no writer for " + path_ + ": " + OIIO::geterror();
    OIIO::ImageSpec spec = spec_;
    spec.width = spec.full_width = p.width, spec.height = spec.full_height = p.height;
    // OpenImageIO's TIFF has no mip levels by that name: they are the further images of a texture's file.
    const auto mode = levels_ == 0               ? OIIO::ImageOutput::Create
                      : out_->supports("mipmap") ? OIIO::ImageOutput::AppendMIPLevel
                                                 : OIIO::ImageOutput::AppendSubimage;
    if (!out_->open(temporary_, spec, mode) || !out_->write_image(OIIO::TypeDesc::FLOAT, p.texels.data()))
      return path_ + ": " + out_->geterror();
    ++levels_;
    return "";
  }
  std::string finish() {
    if (!out_->close()) return path_ + ": " + out_->geterror();
    std::error_code failed;
    std::filesystem::rename(temporary_, path_, failed);
    if (failed) return path_ + ": " + failed.message();
    finished_ = true;
    return "";
  }

 private:
  std::string path_, temporary_;
  OIIO::ImageSpec spec_;
  std::unique_ptr<OIIO::ImageOutput> out_;
  int levels_ = 0;
  bool finished_ = false;
};

OIIO::ImageSpec specOf(const Picture& p, const std::string& path, const char* format, Wrap sWrap,
                       Wrap tWrap) {
  OIIO::TypeDesc type = p.type;
  const bool exr = formatOf(path) == "openexr";
  const bool integer = type == OIIO::TypeDesc::UINT8 || type == OIIO::TypeDesc::UINT16;
  if (exr ? type != OIIO::TypeDesc::HALF : !integer)
    type = exr && integer ? OIIO::TypeDesc::HALF : OIIO::TypeDesc::FLOAT;
  OIIO::ImageSpec spec(p.width, p.height, p.channels, type);
  spec.channelnames = p.channelNames;
  if (int(spec.channelnames.size()) != p.channels) spec.default_channel_names();
  spec.alpha_channel = spec.z_channel = -1;
  for (int c = 0; c < p.channels; ++c)
    if (spec.channelnames[size_t(c)] == "A") spec.alpha_channel = c;
  spec.tile_width = spec.tile_height = kTile, spec.tile_depth = 1;
  spec.attribute("compression", "zip");
  spec.attribute("textureformat", format);
  spec.attribute("wrapmodes", std::string(wrapName(sWrap)) + "," + wrapName(tWrap));
  spec.attribute("software", "frankenrender");
  if (p.hasCamera) {
    spec.attribute("worldtocamera", OIIO::TypeDesc::TypeMatrix, p.worldToCamera);
    spec.attribute("worldtoscreen", OIIO::TypeDesc::TypeMatrix, p.worldToScreen);
  }
  return spec;
}

void makeFinite(Picture& p, float otherwise) {
  for (float& x : p.texels)
    if (!std::isfinite(x)) x = otherwise;
}

std::string writePyramid(Picture base, const OIIO::ImageSpec& spec, const std::string& path,
                         const ReduceFilter& filter) {
  TextureWriter writer(path, spec);
  for (;;) {
    if (std::string why = writer.level(base); !why.empty()) return why;
    if (base.width == 1 && base.height == 1) return writer.finish();
    base = resampled(base, std::max(1, base.width / 2), std::max(1, base.height / 2), filter);
  }
}

std::string makeShadowMap(const std::string& picture, const std::string& path) {
  Picture p;
  if (std::string why = readPicture(picture, kFarAway, &p); !why.empty()) return why;
  int depth = p.channels == 1 ? 0 : -1;
  for (int c = 0; c < p.channels && c < int(p.channelNames.size()); ++c) {
    const std::string& n = p.channelNames[size_t(c)];
    if (n == "Z" || n == "z" || n == "depth") depth = c;
  }
  if (depth < 0) return picture + ": it has no depth: render it with Display mode \"z\"";
  if (p.type != OIIO::TypeDesc::FLOAT && p.type != OIIO::TypeDesc::HALF)
    return picture + ": its depths are integers: render it with Quantize \"z\" 0 0 0 0";
  if (!p.hasCamera) return picture + ": it does not say where its camera was (worldtocamera, worldtoscreen)";
  keepChannel(depth, &p);
  p.type = OIIO::TypeDesc::FLOAT;
  p.channelNames = {"Z"};
  makeFinite(p, kFarAway);
  TextureWriter writer(path, specOf(p, path, "Shadow", Wrap::kBlack, Wrap::kBlack));
  if (std::string why = writer.level(p); !why.empty()) return why;
  return writer.finish();
}

/// The six faces in one picture: px py pz over nx ny nz.
Picture assembled(const Picture (&faces)[6]) {
  const int n = faces[0].width;
  Picture all = faces[0];
  all.hasCamera = false;
  all.width = 3 * n, all.height = 2 * n;
  all.texels.assign(size_t(all.width) * size_t(all.height) * size_t(all.channels), 0.0f);
  for (int f = 0; f < 6; ++f)
    for (int y = 0; y < n; ++y)
      std::copy(faces[f].at(0, y), faces[f].at(0, y) + size_t(n) * size_t(all.channels),
                all.at((f / 2) * n, (f % 2) * n + y));
  return all;
}

std::string makeCube(const FrMakeTexture& make, const std::string& path, ReduceFilter filter) {
  if (make.pictureCount != 6) return "a cube-face environment wants six pictures: px nx py ny pz nz";
  if (!(make.fov > 0 && make.fov < 179))
    return path + ": the field of view of the faces must lie between 0 and 179 degrees";
  filter.sWrap = filter.tWrap = Wrap::kClamp;
  Picture faces[6];
  int size = 1;
  for (int f = 0; f < 6; ++f) {
    if (std::string why = readPicture(make.pictures[f], 0, &faces[f]); !why.empty()) return why;
    if (faces[f].channels != faces[0].channels)
      return std::string(make.pictures[f]) + ": it has other channels than the first face";
    size = std::max({size, faces[f].width, faces[f].height});
    makeFinite(faces[f], 0);
  }
  // A power of two, so that no texel of a coarse level straddles two faces.
  size = std::min(8192, powerOfTwo(size, make.resize == FR_RESIZE_NONE ? FR_RESIZE_UP : make.resize));
  for (Picture& f : faces) f = resampled(f, size, size, filter);
  const OIIO::TypeDesc type = faces[0].type;
  Picture level = assembled(faces);
  OIIO::ImageSpec spec = specOf(level, path, "CubeFace Environment", Wrap::kClamp, Wrap::kClamp);
  spec.attribute("fovcot", float(1 / std::tan(double(make.fov) * 3.14159265358979 / 360)));
  TextureWriter writer(path, spec);
  for (;;) {
    level.type = type;
    if (std::string why = writer.level(level); !why.empty()) return why;
    if (level.width == 1 && level.height == 1) return writer.finish();
    if (size > 1) {
      size /= 2;
      for (Picture& f : faces) f = resampled(f, size, size, filter);
      level = assembled(faces);
    } else {
      level = resampled(level, 1, 1, filter);
    }
  }
}

}  // namespace

std::string makeTexture(const FrMakeTexture& make) {
  const std::string path = make.texture ? make.texture : "";
  if (path.empty() || make.pictureCount < 1) return "a picture and the name of a texture are needed";
  if (make.kind == FR_MAKE_SHADOW) return makeShadowMap(make.pictures[0], path);
  ReduceFilter filter;
  filter.name = make.filter ? make.filter : "";
  if (!filterKnown(filter.name)) return path + ": unknown filter \"" + filter.name + "\"";
  filter.sWidth = make.sWidth > 0 ? make.sWidth : 1, filter.tWidth = make.tWidth > 0 ? make.tWidth : 1;
  const std::string sWrap = make.sWrap ? make.sWrap : "", tWrap = make.tWrap ? make.tWrap : "";
  if (!wrapNamed(sWrap, &filter.sWrap) || !wrapNamed(tWrap, &filter.tWrap))
    return path + ": unknown wrap mode \"" + (wrapNamed(sWrap, &filter.sWrap) ? tWrap : sWrap) +
           "\"; known are black, clamp and periodic";
  if (make.kind == FR_MAKE_CUBE) return makeCube(make, path, filter);
  Picture p;
  if (std::string why = readPicture(make.pictures[0], 0, &p); !why.empty()) return why;
  makeFinite(p, 0);
  const char* format = "Plain Texture";
  if (make.kind == FR_MAKE_LATLONG) {
    format = "LatLong Environment";
    filter.sWrap = Wrap::kPeriodic, filter.tWrap = Wrap::kClamp;
    p.hasCamera = false;
  }
  if (make.resize != FR_RESIZE_NONE)
    p = resampled(p, powerOfTwo(p.width, make.resize), powerOfTwo(p.height, make.resize), filter);
  const OIIO::ImageSpec spec = specOf(p, path, format, filter.sWrap, filter.tWrap);
  return writePyramid(std::move(p), spec, path, filter);
}

}  // namespace fr::textures
