// Files: where they are found, what is made of them, and what bad ones do.
#include <cmath>
#include <csignal>
#include <limits>

#include "shading/texture_fixture.h"

namespace fr {
namespace {

using OIIO::TypeDesc;
using TextureFile = TextureTest;

void write(const std::string& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary) << bytes;
}

TEST_F(TextureFile, FoundInFoldersByAbsoluteNameAndOnce) {
  picture("here.tif", 8, 8, 1, [](int, int, int) { return 0.5f; });
  EXPECT_NEAR(value("float texture(\"here.tif\", .5, .5)").x, 0.5f, 1e-6f);
  EXPECT_NEAR(value("float texture(\"" + file("here.tif") + "\", .5, .5)").x, 0.5f, 1e-6f);
  EXPECT_TRUE(errors.empty());
  for (int k = 0; k < 3; ++k) EXPECT_EQ(value("float texture(\"nosuch.tif\", .5, .5)").x, 1.0f) << "neutral";
  EXPECT_EQ(value("float environment(\"nosuch.tif\", vector(1,0,0))").x, 0.0f);
  ASSERT_EQ(errors.size(), 1u) << "one clear error";
  EXPECT_EQ(errors[0].code, RiError::kNoFile);
  EXPECT_NE(errors[0].message.find("nosuch.tif"), std::string::npos);
  EXPECT_EQ(value("float texture(\"\", .5, .5)").x, 1.0f);
  EXPECT_EQ(errors.size(), 2u);
}

TEST_F(TextureFile, BadFilesAreOneErrorEach) {
  write(file("text.tif"), "this is no image at all\n");
  write(file("empty.png"), "");
  write(file("noise.exr"), std::string("\x76\x2f\x31\x01\x02\x00\x00\x00", 8) + std::string(3000, 'x'));
  // The header of a PNG of 0 x 0, and of one of 2^31-1 squared.
  const auto png = [](uint32_t size) {
    std::string s("\x89PNG\r\n\x1a\n\0\0\0\rIHDR", 16);
    for (int k = 0; k < 2; ++k)
      for (int shift = 24; shift >= 0; shift -= 8) s += char(size >> shift & 255);
    s += std::string("\x08\x02\0\0\0", 5);
    uint32_t crc = ~0u;
    for (size_t i = 12; i < s.size(); ++i) {
      crc ^= uint8_t(s[i]);
      for (int b = 0; b < 8; ++b) crc = crc & 1 ? crc >> 1 ^ 0xedb88320u : crc >> 1;
    }
    crc = ~crc;
    for (int shift = 24; shift >= 0; shift -= 8) s += char(crc >> shift & 255);
    return s + std::string("\0\0\0\0IEND\xae\x42\x60\x82", 12);
  };
  write(file("zero.png"), png(0));
  write(file("huge.png"), png(0x7fffffff));
  write(file("large.png"), png(60000));
  std::filesystem::create_directory(file("folder.tif"));
  int expected = 0;
  for (const char* name :
       {"text.tif", "empty.png", "noise.exr", "zero.png", "huge.png", "large.png", "folder.tif"}) {
    for (int k = 0; k < 2; ++k)
      EXPECT_EQ(value("float texture(\"" + std::string(name) + "\", .5, .5)").x, 1.0f) << name;
    EXPECT_EQ(int(errors.size()), ++expected) << name;
    if (!errors.empty()) {
      EXPECT_NE(errors.back().message.find(name), std::string::npos) << errors.back().message;
    }
  }
}

TEST_F(TextureFile, TruncatedFilesGiveWhatTheyHaveAndOneError) {
  const Texel texel = [](int x, int y, int) { return float((x * 31 + y * 17) % 29) / 29; };
  picture("plain.tif", 256, 256, 1, texel);
  picture("plain.png", 256, 256, 1, texel, TypeDesc::UINT8);
  picture("plain.exr", 256, 256, 1, texel);
  ASSERT_EQ(madeError(FR_MAKE_TEXTURE, {"plain.tif"}, "made.tx"), "");
  for (const std::string name : {"plain.tif", "plain.png", "plain.exr", "made.tx"}) {
    std::ifstream in(file(name), std::ios::binary);
    const std::string all((std::istreambuf_iterator<char>(in)), {});
    for (const double part : {0.02, 0.3, 0.6, 0.95}) {
      const std::string cut = std::to_string(part) + name;
      write(file(cut), all.substr(0, size_t(double(all.size()) * part)));
      const size_t before = errors.size();
      for (int k = 0; k < 3; ++k) {
        grid(15, 15);
        run("float texture(\"" + cut + "\", s, t)");
        for (uint32_t i = 0; i < f.count; ++i)
          ASSERT_TRUE(std::isfinite(f.Ci(i))) << cut << " " << k << " " << i << " " << f.Ci(i);
      }
      EXPECT_LE(errors.size(), before + 1) << cut;
      // OpenImageIO's TIFF reader takes missing strips for zeros without a word; the others tell.
      if (name == "plain.png" || name == "plain.exr") {
        EXPECT_EQ(errors.size(), before + 1) << cut;
      }
    }
  }
}

TEST_F(TextureFile, TexelsThatAreNoNumbersStayInTheFile) {
  picture("holes.exr", 8, 8, 1, [](int x, int y, int) {
    return x < 4   ? std::numeric_limits<float>::quiet_NaN()
           : y < 4 ? std::numeric_limits<float>::infinity()
                   : 0.5f;
  });
  for (const char* call : {"float texture(\"holes.exr\", .2, .5)", "float texture(\"holes.exr\", .8, .2)",
                           "float environment(\"holes.exr\", vector(0, -1, 0))"})
    EXPECT_TRUE(std::isfinite(value(call).x)) << call;
}

TEST_F(TextureFile, PlainFilesAreTexturesToo) {
  // The same filter on a plain picture and on the texture that was made of it.
  picture(
      "plain.png", 200, 120, 3, [](int x, int y, int c) { return float((x / 5 + y / 7 + c) % 3) / 2; },
      TypeDesc::UINT8);
  ASSERT_TRUE(make(FR_MAKE_TEXTURE, {"plain.png"}, "made.tx", "black").ok());
  const auto in = OIIO::ImageInput::open(file("made.tx"));
  ASSERT_TRUE(in);
  EXPECT_EQ(in->spec().tile_width, 64);
  EXPECT_EQ(in->spec().format, TypeDesc(TypeDesc::UINT8));
  int levels = 1;
  while (in->seek_subimage(0, levels)) ++levels;
  EXPECT_EQ(levels, 8) << "200 x 120 down to 1 x 1";
  std::vector<float> plain;
  for (const char* name : {"plain.png", "made.tx"}) {
    grid(9, 9);
    run("color texture(\"" + std::string(name) + "\", .1 + .8 * s, .1 + .8 * t)");
    for (uint32_t i = 0; i < f.count; ++i) {
      if (name[0] == 'p') {
        plain.push_back(f.Ci(i));
      } else {
        ASSERT_NEAR(f.Ci(i), plain[i], 0.04f);
      }
    }
  }
}

TEST_F(TextureFile, JpegTooAndAFileThatChanges) {
  picture(
      "a.jpg", 64, 64, 3, [](int, int, int) { return 0.5f; }, TypeDesc::UINT8);
  EXPECT_NEAR(value("float texture(\"a.jpg\", .5, .5)").x, 0.5f, 0.02f);
  for (const float v : {0.1f, 0.9f, 0.3f}) {
    picture("b.tif", 64, 64, 1, [v](int, int, int) { return v; });
    ASSERT_TRUE(make(FR_MAKE_TEXTURE, {"b.tif"}, "b.tx").ok());
    reload();
    EXPECT_NEAR(value("float texture(\"b.tif\", .5, .5)").x, v, 1e-6f);
    EXPECT_NEAR(value("float texture(\"b.tx\", .5, .5)").x, v, 1e-6f);
  }
}

TEST_F(TextureFile, FiltersKeepTheMean) {
  picture("p.tif", 100, 64, 1, [](int x, int y, int) { return float((x * 31 + y * 17) % 29) / 29; });
  double mean = 0;
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 100; ++x) mean += double((x * 31 + y * 17) % 29) / 29 / 6400;
  for (const char* filter :
       {"box", "gaussian", "triangle", "catmull-rom", "mitchell", "sinc", "disk", "bessel", ""}) {
    ASSERT_TRUE(make(FR_MAKE_TEXTURE, {"p.tif"}, "p.tx", "periodic", filter).ok()) << filter;
    const auto in = OIIO::ImageInput::open(file("p.tx"));
    ASSERT_TRUE(in->seek_subimage(0, 6));
    float last = 0;
    ASSERT_TRUE(in->read_image(0, 6, 0, 1, TypeDesc::FLOAT, &last));
    EXPECT_NEAR(last, mean, filter[0] == 0 || filter[0] == 'b' ? 1e-3 : 0.02) << filter;
  }
}

TEST_F(TextureFile, ResizeToPowersOfTwo) {
  picture("p.tif", 100, 60, 1, [](int x, int, int) { return (float(x) + 0.5f) / 100; });
  const std::pair<FrMakeResize, std::pair<int, int>> cases[] = {{FR_RESIZE_UP, {128, 64}},
                                                                {FR_RESIZE_DOWN, {64, 32}},
                                                                {FR_RESIZE_ROUND, {128, 64}},
                                                                {FR_RESIZE_NONE, {100, 60}}};
  for (const auto& [resize, size] : cases) {
    TextureRequest r;
    r.pictures = {file("p.tif")}, r.texture = file("p.tx"), r.resize = resize;
    ASSERT_TRUE(makeTexture(r).ok());
    const auto in = OIIO::ImageInput::open(file("p.tx"));
    EXPECT_EQ(in->spec().width, size.first);
    EXPECT_EQ(in->spec().height, size.second);
    reload();
    EXPECT_NEAR(value("float texture(\"p.tx\", .5, .5)").x, 0.5f, 0.01f);
  }
}

TEST_F(TextureFile, WhatCannotBeMadeIsSaidAndLeavesNothing) {
  picture("p.tif", 16, 16, 3, [](int, int, int) { return 1.0f; });
  picture("z.tif", 16, 16, 1, [](int, int, int) { return 1.0f; }, TypeDesc::FLOAT, nullptr, {"Z"});
  write(file("text.tif"), "no image");
  const auto message = [](const Result<void>& r) { return r.ok() ? std::string() : r.error().message; };
  EXPECT_NE(message(make(FR_MAKE_TEXTURE, {"nosuch.tif"}, "o.tx")).find("nosuch.tif"), std::string::npos);
  EXPECT_NE(message(make(FR_MAKE_TEXTURE, {"text.tif"}, "o.tx")).find("text.tif"), std::string::npos);
  EXPECT_NE(message(make(FR_MAKE_TEXTURE, {"p.tif"}, "o.tx", "mirror")).find("mirror"), std::string::npos);
  EXPECT_NE(message(make(FR_MAKE_TEXTURE, {"p.tif"}, "o.tx", "black", "best")).find("best"),
            std::string::npos);
  EXPECT_NE(message(make(FR_MAKE_SHADOW, {"p.tif"}, "o.tx")).find("depth"), std::string::npos);
  EXPECT_NE(message(make(FR_MAKE_SHADOW, {"z.tif"}, "o.tx")).find("camera"), std::string::npos);
  EXPECT_NE(message(make(FR_MAKE_CUBE, {"p.tif"}, "o.tx")).find("six"), std::string::npos);
  EXPECT_NE(message(make(FR_MAKE_CUBE, {"p.tif", "p.tif", "p.tif", "p.tif", "p.tif", "p.tif"}, "o.tx", "",
                         "box", 200))
                .find("field of view"),
            std::string::npos);
  EXPECT_FALSE(make(FR_MAKE_TEXTURE, {"p.tif"}, "nosuch/o.tx").ok());
  for (const auto& e : std::filesystem::directory_iterator(folder))
    EXPECT_EQ(e.path().filename().string().find("o.tx"), std::string::npos) << e.path();
}

}  // namespace
}  // namespace fr
