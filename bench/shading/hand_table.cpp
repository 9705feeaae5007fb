#include "bench/shading/hand.h"

#define FR_HAND_SHADERS(X)                                                                              \
  X(constant, Constant)                                                                                 \
  X(null, Null)                                                                                         \
  X(defaultsurface, DefaultSurface)                                                                     \
  X(matte, Matte)                                                                                       \
  X(matteByArea, MatteByArea)                                                                           \
  X(metal, Metal) X(plastic, Plastic) X(paintedplastic, PaintedPlastic) X(texture, Texture)             \
      X(checker, Checker) X(bumpy, Bumpy) X(fbm, Fbm) X(marble, Marble) X(brick, Brick) X(fog, Fog)     \
          X(depthcue, Depthcue) X(smoke, Smoke) X(background, Background) X(clamptoalpha, ClampToAlpha) \
              X(mirror, Mirror) X(shiny, Shiny) X(shinymetal, ShinyMetal) X(glass, Glass)               \
                  X(occluded, Occluded)

namespace fr {

#define FR_DECLARE(name, function) void hand##function(const bench::HandTask&);
namespace sse4 {
FR_HAND_SHADERS(FR_DECLARE)
}
namespace avx2 {
FR_HAND_SHADERS(FR_DECLARE)
}
namespace avx512 {
FR_HAND_SHADERS(FR_DECLARE)
}

namespace bench {

HandShader handShader(std::string_view name, int isa) {
#define FR_ENTRY(text, function) \
  {#text, {&sse4::hand##function, &avx2::hand##function, &avx512::hand##function}},
  struct Entry {
    std::string_view name;
    HandShader byIsa[3];
  };
  static constexpr Entry kTable[] = {FR_HAND_SHADERS(FR_ENTRY)};
  for (const Entry& e : kTable)
    if (e.name == name) return e.byIsa[isa];
  return nullptr;
}

}  // namespace bench
}  // namespace fr
