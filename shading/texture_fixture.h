// For tests of textures: pictures with known values in a folder of their own, and shaders that look them up.
#pragma once

#include <OpenImageIO/imageio.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <functional>

#include "shading/machine_fixture.h"
#include "shading/texture_library.h"

namespace fr {

class TextureTest : public testing::Test {
 protected:
  TextureTest()
      : folder(std::filesystem::temp_directory_path() /
               ("fr_texture_test." + std::to_string(::getpid()) + "." +
                std::to_string(reinterpret_cast<uintptr_t>(this)))) {
    std::filesystem::create_directories(folder);
    setReportSink([this](const Error& e) { errors.push_back(e); });
    reload();
  }
  ~TextureTest() override {
    setReportSink({});
    std::filesystem::remove_all(folder);
  }
  /// A library that knows nothing yet: files are looked at again.
  void reload() {
    library.reset();
    TextureLibrary::Options o;
    o.folders = {folder.string()};
    library = std::make_unique<TextureLibrary>(std::move(o));
    f.host.library = library.get();
  }
  std::string file(const std::string& name) const { return (folder / name).string(); }

  using Texel = std::function<float(int x, int y, int channel)>;
  /// Writes a picture; the format follows the name's ending. `matrices`: world to camera, world to screen.
  void picture(const std::string& name, int width, int height, int channels, const Texel& texel,
               OIIO::TypeDesc type = OIIO::TypeDesc::FLOAT, const float* matrices = nullptr,
               const std::vector<std::string>& channelNames = {}) {
    std::vector<float> data;
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x)
        for (int c = 0; c < channels; ++c) data.push_back(texel(x, y, c));
    OIIO::ImageSpec spec(width, height, channels, type);
    if (!channelNames.empty()) spec.channelnames = channelNames;
    if (matrices) {
      spec.attribute("worldtocamera", OIIO::TypeDesc::TypeMatrix, matrices);
      spec.attribute("worldtoscreen", OIIO::TypeDesc::TypeMatrix, matrices + 16);
    }
    const auto out = OIIO::ImageOutput::create(file(name));
    ASSERT_TRUE(out) << OIIO::geterror();
    ASSERT_TRUE(out->open(file(name), spec)) << out->geterror();
    ASSERT_TRUE(out->write_image(OIIO::TypeDesc::FLOAT, data.data())) << out->geterror();
    ASSERT_TRUE(out->close());
  }
  Result<void> make(FrMakeKind kind, const std::vector<std::string>& pictures, const std::string& texture,
                    const std::string& wrap = "", const std::string& filter = "box", double fov = 90) {
    TextureRequest r;
    r.kind = kind;
    for (const std::string& p : pictures) r.pictures.push_back(file(p));
    r.texture = file(texture);
    r.sWrap = r.tWrap = wrap;
    r.filter = filter;
    r.fov = fov;
    return makeTexture(r);
  }

  std::string madeError(FrMakeKind kind, const std::vector<std::string>& pictures, const std::string& texture,
                        const std::string& wrap = "", const std::string& filter = "box") {
    const Result<void> r = make(kind, pictures, texture, wrap, filter);
    return r.ok() ? "" : r.error().message;
  }

  /// Batch of (nu+1) x (nv+1) points with s, t = 0..1 and differences between neighbours.
  void grid(uint32_t nu, uint32_t nv) {
    f.resize(nu, nv);
    gridStencil(stencil, nu, nv, f.lanes, 1.0f / float(nu), 1.0f / float(nv));
    f.batch.stencil = &stencil;
  }
  /// Runs "Ci = <expression>" (a surface whose parameters stand in `declarations`).
  void run(const std::string& expression, const std::string& declarations = "",
           const std::string& before = "") {
    const auto s =
        f.shader("surface test(" + declarations + ") { " + before + " Ci = " + expression + "; Oi = 1; }");
    ASSERT_TRUE(s) << f.error;
    f.run(*s);
  }
  /// The value of a shader expression at every point of a small batch, where it is uniform.
  Vec3 value(const std::string& expression) {
    f.resize(3, 3);
    run(expression);
    return {f.Ci(0, 0), f.Ci(0, 1), f.Ci(0, 2)};
  }
  int errorCount(RiError code) const {
    int n = 0;
    for (const Error& e : errors) n += e.code == code;
    return n;
  }

  std::filesystem::path folder;
  std::vector<Error> errors;
  std::unique_ptr<TextureLibrary> library;
  MachineFixture f;
  DerivativeStencil stencil;
};

}  // namespace fr
