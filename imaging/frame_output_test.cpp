#include "imaging/frame_output.h"

#include <ImfArray.h>
#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <OpenImageIO/imageio.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <fstream>

namespace fr {
namespace {

namespace fs = std::filesystem;

class FrameOutputTest : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() / ("fr_frame_output_" + std::to_string(::getpid()));
    fs::create_directories(folder_);
    setReportSink([this](const Error& e) { messages_.push_back(e.str()); });
  }
  void TearDown() override {
    setReportSink({});
    fs::remove_all(folder_);
  }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  size_t filesLeft() const {
    return size_t(std::distance(fs::directory_iterator(folder_), fs::directory_iterator()));
  }

  fs::path folder_;
  std::vector<std::string> messages_;
};

/// A tile with channel c of pixel (x, y) = c + x / 100 + y / 10000.
FilmTile rampTile(const PixelRect& rect, int channels) {
  FilmTile t;
  t.rect = rect;
  t.channels.resize(size_t(channels));
  for (int c = 0; c < channels; ++c)
    for (int y = rect.y0; y < rect.y1; ++y)
      for (int x = rect.x0; x < rect.x1; ++x)
        t.channels[size_t(c)].push_back(float(c) + float(x) * 0.01f + float(y) * 0.0001f);
  return t;
}

std::string readAll(const std::string& name) {
  std::ifstream in(name, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

TEST_F(FrameOutputTest, ExrHoldsEveryChannelExactlyAndTheCrop) {
  FrameGeometry g{64, 48, {10, 20, 40, 44}, 1.0f, {}};
  DisplayRequest d{path("a.exr"), "openexr", "rgbaz", {}, {}, {}, {}};
  d.parameters.push_back({"exrpixeltype", std::vector<std::string>{"float"}});
  FrameOutput out(g, {d}, displaySearchPath({}));
  ASSERT_TRUE(out.open());
  out.addTile(rampTile({25, 20, 40, 44}, 5));  // right half first: rows complete only later
  out.addTile(rampTile({10, 30, 25, 44}, 5));
  EXPECT_FALSE(fs::exists(path("a.exr")));
  out.addTile(rampTile({10, 20, 25, 30}, 5));
  ASSERT_TRUE(out.finish());
  EXPECT_EQ(filesLeft(), 1u);

  Imf::InputFile in(path("a.exr").c_str());
  EXPECT_EQ(in.header().displayWindow(), Imath::Box2i({0, 0}, {63, 47}));
  EXPECT_EQ(in.header().dataWindow(), Imath::Box2i({10, 20}, {39, 43}));
  const char* names[5] = {"R", "G", "B", "A", "Z"};
  std::vector<float> data(30 * 24);
  for (int c = 0; c < 5; ++c) {
    Imf::FrameBuffer buffer;
    buffer.insert(names[c],
                  Imf::Slice(Imf::FLOAT, reinterpret_cast<char*>(data.data() - 10 - 20 * 30), 4, 4 * 30));
    in.setFrameBuffer(buffer);
    in.readPixels(20, 43);
    EXPECT_EQ(data, rampTile({10, 20, 40, 44}, 5).channels[size_t(c)]) << names[c];
  }
  EXPECT_TRUE(messages_.empty());
}

TEST_F(FrameOutputTest, SeveralDisplaysWithOwnQuantisers) {
  FrameGeometry g{16, 8, {0, 0, 16, 8}, 1.0f, {}};
  DisplayRequest png{path("a.png"), "file", "rgb", {}, {255, 0, 255, 0}, {}, {}};
  DisplayRequest tiff{path("b.tif"), "file", "rgba", {}, {65535, 0, 65535, 0}, {}, {2, 2}};
  DisplayRequest depth{path("c.z"), "zfile", "z", {}, {}, {0, 0, 0, 0}, {}};
  FrameOutput out(g, {png, tiff, depth}, displaySearchPath({}));
  ASSERT_TRUE(out.open());
  out.addTile(rampTile(g.crop, 5));
  ASSERT_TRUE(out.finish());
  EXPECT_EQ(filesLeft(), 3u);
  EXPECT_EQ(readAll(path("a.png")).substr(1, 3), "PNG");
  EXPECT_EQ(readAll(path("b.tif")).substr(0, 2), "II");
  EXPECT_EQ(readAll(path("c.z")).substr(0, 2), "II");
  EXPECT_TRUE(messages_.empty()) << messages_[0];
}

TEST_F(FrameOutputTest, FormatsWithoutAlphaTakeTheColour) {
  FrameGeometry g{4, 3, {0, 0, 4, 3}, 1.0f, {}};
  DisplayRequest ppm{path("a.ppm"), "file", "rgba", {}, {255, 0, 255, 0}, {}, {}};
  DisplayRequest hdr{path("a.hdr"), "file", "rgba", {}, {}, {}, {}};
  FrameOutput out(g, {ppm, hdr}, displaySearchPath({}));
  ASSERT_TRUE(out.open()) << messages_.front();
  FilmTile tile = rampTile({0, 0, 4, 3}, 5);
  for (float& v : tile.channels[0]) v = 0.2f;
  out.addTile(tile);
  ASSERT_TRUE(out.finish());
  const std::string pixels = readAll(path("a.ppm"));
  ASSERT_GE(pixels.size(), 36u);
  for (size_t i = 0; i < 12; ++i)
    EXPECT_EQ(pixels.substr(pixels.size() - 36 + 3 * i, 3), "\x33\xff\xff") << i;
  EXPECT_EQ(readAll(path("a.hdr")).substr(0, 2), "#?");
}

TEST_F(FrameOutputTest, NullDisplaysWriteNothingAndSayNothing) {
  FrameGeometry g{4, 3, {0, 0, 4, 3}, 1.0f, {}};
  FrameOutput out(g, {{path("a.tif"), "null", "rgba", {}, {255, 0, 255, 0}, {}, {}}}, displaySearchPath({}));
  ASSERT_TRUE(out.open());
  out.addTile(rampTile({0, 0, 4, 3}, 5));
  ASSERT_TRUE(out.finish());
  EXPECT_EQ(filesLeft(), 0u);
  EXPECT_TRUE(messages_.empty());
}

TEST_F(FrameOutputTest, TiffAndPngHoldWhatWasRendered) {
  const PixelRect crop{5, 2, 25, 12};
  FrameGeometry g{32, 16, crop, 1.0f, {}};
  DisplayRequest tiff8{path("a.tif"), "tiff", "rgba", {}, {255, 0, 255, 0}, {}, {}};
  DisplayRequest tiff16{path("b.tif"), "tiff", "rgba", {}, {65535, 0, 65535, 0}, {}, {}};
  DisplayRequest floats{path("c.tif"), "tiff", "rgba", {}, {0, 0, 0, 0}, {}, {}};
  DisplayRequest png8{path("d.png"), "png", "rgba", {}, {255, 0, 255, 0}, {}, {}};
  DisplayRequest png16{path("e.png"), "png", "rgb", {}, {65535, 0, 65535, 0}, {}, {}};
  DisplayRequest pngOfFloats{path("f.png"), "png", "a", {}, {0, 0, 0, 0}, {}, {}};
  tiff16.parameters.push_back({"compression", std::vector<std::string>{"lzw"}});
  FrameOutput out(g, {tiff8, tiff16, floats, png8, png16, pngOfFloats}, displaySearchPath({}));
  ASSERT_TRUE(out.open());
  FilmTile tile;
  tile.rect = crop;
  tile.channels.assign(5, std::vector<float>(200));
  for (size_t i = 0; i < 200; ++i) {
    const float alpha = float(i % 11) / 10;
    for (size_t c = 0; c < 3; ++c) tile.channels[c][i] = alpha * float((i * (c + 3)) % 101) / 100;
    tile.channels[3][i] = alpha;
  }
  const FilmTile made = tile;
  out.addTile(std::move(tile));
  ASSERT_TRUE(out.finish());
  const auto check = [&](const char* name, std::vector<size_t> channels, bool divided, float tolerance) {
    const auto in = OIIO::ImageInput::open(path(name));
    ASSERT_TRUE(in) << name << OIIO::geterror();
    ASSERT_EQ(in->spec().width, 20) << name;
    ASSERT_EQ(in->spec().height, 10) << name;
    ASSERT_EQ(in->spec().nchannels, int(channels.size())) << name;
    if (!divided && channels.size() == 4) {
      EXPECT_EQ(in->spec().x, 5);
      EXPECT_EQ(in->spec().y, 2);
      EXPECT_EQ(in->spec().full_width, 32);
      EXPECT_EQ(in->spec().alpha_channel, 3);
    }
    std::vector<float> pixels(200 * channels.size());
    ASSERT_TRUE(in->read_image(0, 0, 0, int(channels.size()), OIIO::TypeDesc::FLOAT, pixels.data()));
    for (size_t i = 0; i < 200; ++i)
      for (size_t c = 0; c < channels.size(); ++c) {
        // OpenImageIO multiplies by alpha what PNG keeps without.
        EXPECT_NEAR(pixels[i * channels.size() + c], made.channels[channels[c]][i], tolerance)
            << name << " " << i;
      }
  };
  check("a.tif", {0, 1, 2, 3}, false, 0.5f / 255 + 1e-6f);
  check("b.tif", {0, 1, 2, 3}, false, 0.5f / 65535 + 1e-6f);
  check("c.tif", {0, 1, 2, 3}, false, 0);
  // Rounded twice: before and after the division by alpha.
  check("d.png", {0, 1, 2, 3}, true, 1.6f / 255);
  check("e.png", {0, 1, 2}, true, 0.5f / 65535 + 1e-6f);
  check("f.png", {3}, true, 0.5f / 65535 + 1e-6f);
  EXPECT_TRUE(messages_.empty()) << messages_[0];
}

TEST_F(FrameOutputTest, UnwritableFolderIsOneClearErrorAndTheOthersGoOn) {
  FrameGeometry g{16, 8, {0, 0, 16, 8}, 1.0f, {}};
  DisplayRequest bad{path("nosuchfolder/a.exr"), "openexr", "rgba", {}, {}, {}, {}};
  DisplayRequest good{path("b.exr"), "openexr", "rgba", {}, {}, {}, {}};
  FrameOutput out(g, {bad, good}, displaySearchPath({}));
  ASSERT_TRUE(out.open());
  out.addTile(rampTile(g.crop, 5));
  const auto r = out.finish();
  ASSERT_FALSE(r);
  EXPECT_EQ(r.error().message, "1 of 2 pictures was not written");  // which, and why, has been said
  ASSERT_EQ(messages_.size(), 1u);
  EXPECT_NE(messages_[0].find("nosuchfolder/a.exr"), std::string::npos);
  EXPECT_TRUE(fs::exists(path("b.exr")));
  EXPECT_EQ(filesLeft(), 1u);
}

TEST_F(FrameOutputTest, UnfinishedFramesLeaveTheOldFileAlone) {
  std::ofstream(path("a.exr")) << "old";
  {
    FrameOutput out({16, 8, {0, 0, 16, 8}, 1.0f, {}}, {{path("a.exr"), "exr", "rgba", {}, {}, {}, {}}},
                    displaySearchPath({}));
    ASSERT_TRUE(out.open());
    out.addTile(rampTile({0, 0, 16, 4}, 5));
    EXPECT_LE(filesLeft(), 2u);  // without a name where the file system can do that
  }
  EXPECT_EQ(readAll(path("a.exr")), "old");
  EXPECT_EQ(filesLeft(), 1u);
}

/// Writing beyond a file size limit fails as a full disk does.
TEST_F(FrameOutputTest, FullDiskIsAnErrorAndLeavesNothing) {
  for (const char* name : {"a.exr", "b.tif"}) {
    messages_.clear();
    rlimit old{};
    ::getrlimit(RLIMIT_FSIZE, &old);
    std::signal(SIGXFSZ, SIG_IGN);
    FrameGeometry g{256, 256, {0, 0, 256, 256}, 1.0f, {}};
    DisplayRequest d{path(name), "file", "rgba", {}, {0, 0, 0, 0}, {}, {}};
    d.parameters.push_back({"compression", std::vector<std::string>{"none"}});
    FrameOutput out(g, {d}, displaySearchPath({}));
    ASSERT_TRUE(out.open());
    const rlimit small{20000, old.rlim_max};
    ::setrlimit(RLIMIT_FSIZE, &small);
    out.addTile(rampTile(g.crop, 5));
    const auto r = out.finish();
    ::setrlimit(RLIMIT_FSIZE, &old);
    EXPECT_FALSE(r) << name;
    EXPECT_EQ(messages_.size(), 1u) << name;
    EXPECT_EQ(filesLeft(), 0u) << name;
  }
}

TEST_F(FrameOutputTest, ImagerRunsAfterExposure) {
  FrameGeometry g{4, 1, {0, 0, 4, 1}, 1.0f, {}};
  DisplayRequest d{path("a.exr"), "exr", "rgb", {{"exrpixeltype", std::vector<std::string>{"float"}}}, {}, {},
                   {3, 1}};
  FrameOutput out(g, {d}, displaySearchPath({}));
  std::vector<float> seen;
  out.setImager([&](size_t n, const float* x, const float*, float* const color[3], float* const[3], float*) {
    for (size_t i = 0; i < n; ++i) seen.push_back(x[i]), seen.push_back(color[1][i]);
    return true;
  });
  ASSERT_TRUE(out.open());
  out.addTile(rampTile(g.crop, 5));
  ASSERT_TRUE(out.finish());
  ASSERT_EQ(seen.size(), 8u);
  EXPECT_EQ(seen[2], 1.5f);
  EXPECT_FLOAT_EQ(seen[3], 3 * 1.01f);
}

}  // namespace
}  // namespace fr
