// mkmip: pictures to tiled, mip-mapped textures, environments and shadow maps, with the flags of BMRT's tool.
#include <charconv>
#include <cstdio>
#include <string_view>

#include "shading/texture_library.h"

namespace {

constexpr const char* kHelp =
    R"(Usage: mkmip [options] picture texture
       mkmip -envcube [options] px nx py ny pz nz texture
       mkmip -envlatl [options] picture texture
       mkmip -shadow depth-picture shadow-map

Makes textures for shaders: tiled files that hold the picture in all resolutions down to 1 x 1. Renderers read plain
pictures too, but only from made ones do they load no more than they look at, and only these say what lies outside.
The same is done by the RIB requests MakeTexture, MakeCubeFaceEnvironment, MakeLatLongEnvironment and MakeShadow.
Pictures: TIFF, EXR, PNG, JPEG and what else OpenImageIO reads. The texture is a TIFF, or an EXR if its name ends so.

  -mode M           what lies outside of the picture: black (default), clamp (the border goes on), periodic
  -smode M          the same for s alone (to the right)
  -tmode M          the same for t alone (downwards)
  -envcube          six faces of a cube, seen from its middle along +x -x +y -y +z -z
  -fov F            field of view of the faces in degrees (default 90)
  -envlatl          a picture of all directions: longitude to the right, the pole +z at the top
  -shadow           a depth picture (Display "..." "zfile" "z") becomes a map for shadow()
  -resize R         up, down, round: to powers of two; a "-" behind (up-) is accepted and changes nothing
  -filter F         of the smaller resolutions: box (default), triangle, gaussian, catmull-rom, sinc, mitchell, lanczos
  -width W          full support of the filter in pixels of the smaller picture (default 1; gaussian 2 is usual)
  -help, -version

Every option may be written with two dashes. Exit status: 0 made; 1 not made, and why is said; 2 wrong usage.

Examples:
  mkmip wood.png wood.tx                             a texture
  mkmip -mode periodic -resize up tiles.tif tiles.tx one that repeats
  mkmip -shadow light.z light.shd                    for shadowspot's "shadowname"
  mkmip -envcube px.tif nx.tif py.tif ny.tif pz.tif nz.tif room.env
)";

int wrongUsage(const std::string& what) {
  std::fprintf(stderr, "mkmip: %s; try mkmip -help\n", what.c_str());
  return 2;
}

bool isNumber(std::string_view text, double& out) {
  const auto [end, failed] = std::from_chars(text.data(), text.data() + text.size(), out);
  return failed == std::errc() && end == text.data() + text.size();
}

bool isWrap(std::string_view mode) { return mode == "black" || mode == "clamp" || mode == "periodic"; }

}  // namespace

int main(int argc, char** argv) {
  fr::TextureRequest r;
  std::vector<std::string> files;
  for (int i = 1; i < argc; ++i) {
    std::string_view a = argv[i];
    if (a.size() < 2 || a[0] != '-') {
      files.emplace_back(a);
      continue;
    }
    a.remove_prefix(a.substr(0, 2) == "--" ? 2 : 1);
    if (a == "help" || a == "h") {
      std::fputs(kHelp, stdout);
      return 0;
    }
    if (a == "version") {
      std::puts("mkmip (frankenrender) " FR_VERSION);
      return 0;
    }
    if (a == "envcube" || a == "envlatl" || a == "shadow") {
      if (r.kind != FR_MAKE_TEXTURE)
        return wrongUsage("only one of -envcube, -envlatl and -shadow is possible");
      r.kind = a == "envcube" ? FR_MAKE_CUBE : a == "envlatl" ? FR_MAKE_LATLONG : FR_MAKE_SHADOW;
      continue;
    }
    const bool takesValue = a == "mode" || a == "smode" || a == "tmode" || a == "fov" || a == "resize" ||
                            a == "filter" || a == "width";
    if (!takesValue) return wrongUsage(fmt::format("unknown option -{}", a));
    if (i + 1 >= argc) return wrongUsage(fmt::format("-{} wants a value", a));
    std::string_view value = argv[++i];
    double number = 0;
    if (a == "mode" || a == "smode" || a == "tmode") {
      if (!isWrap(value))
        return wrongUsage(fmt::format("-{} is black, clamp or periodic, not \"{}\"", a, value));
      if (a != "tmode") r.sWrap = value;
      if (a != "smode") r.tWrap = value;
    } else if (a == "resize") {
      if (!value.empty() && value.back() == '-') value.remove_suffix(1);
      if (value != "up" && value != "down" && value != "round" && value != "none")
        return wrongUsage(fmt::format("-resize is up, down or round, not \"{}\"", argv[i]));
      r.resize = value == "up"      ? FR_RESIZE_UP
                 : value == "down"  ? FR_RESIZE_DOWN
                 : value == "round" ? FR_RESIZE_ROUND
                                    : FR_RESIZE_NONE;
    } else if (a == "filter") {
      r.filter = value;
    } else if (!isNumber(value, number) || !(number > 0)) {
      return wrongUsage(fmt::format("-{} wants a number above 0, not \"{}\"", a, value));
    } else if (a == "fov") {
      r.fov = number;
    } else {
      r.sWidth = r.tWidth = number;
    }
  }
  const size_t pictures = r.kind == FR_MAKE_CUBE ? 6 : 1;
  if (files.size() != pictures + 1)
    return wrongUsage(fmt::format("{} wanted, {} given",
                                  pictures == 6 ? "six pictures and the name of the texture are"
                                                : "a picture and the name of the texture are",
                                  files.size()));
  r.texture = files.back();
  files.pop_back();
  r.pictures = std::move(files);
  if (const fr::Result<void> made = fr::makeTexture(r); !made) {
    std::fprintf(stderr, "mkmip: %s\n", made.error().message.c_str());
    return 1;
  }
  return 0;
}
