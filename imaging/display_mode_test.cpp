#include "imaging/display_mode.h"
#include "imaging/frame_output.h"

#include <gtest/gtest.h>

#include "imaging/driver_search.h"

namespace fr {
namespace {

std::string channelsOf(const std::string& mode) {
  std::string s;
  for (const auto& c : parseDisplayMode(mode).channels)
    s += c.name + "=" + (c.variable.empty() ? "#" : c.variable) + std::to_string(c.component) + " ";
  return s;
}

TEST(DisplayMode, RiModes) {
  EXPECT_EQ(channelsOf("rgb"), "R=#0 G=#1 B=#2 ");
  EXPECT_EQ(channelsOf("rgbaz"), "R=#0 G=#1 B=#2 A=#3 Z=#4 ");
  EXPECT_EQ(channelsOf("rgbz"), "R=#0 G=#1 B=#2 Z=#4 ");
  EXPECT_EQ(channelsOf("a"), "A=#3 ");
  EXPECT_EQ(channelsOf("az"), "A=#3 Z=#4 ");
  EXPECT_EQ(channelsOf("z"), "Z=#4 ");
  EXPECT_EQ(channelsOf(""), channelsOf("rgba"));
  EXPECT_EQ(channelsOf(" , "), channelsOf("rgba"));
}

TEST(DisplayMode, OutputVariables) {
  EXPECT_EQ(channelsOf("N"), "R=N0 G=N1 B=N2 ");
  EXPECT_EQ(channelsOf("varying float mask2"), "Y=mask20 ");
  EXPECT_EQ(channelsOf("s"), "Y=s0 ");
  EXPECT_EQ(channelsOf("Ci"), channelsOf("rgb"));
  EXPECT_EQ(channelsOf("rgba,color diff"), channelsOf("rgba") + "diff.R=diff0 diff.G=diff1 diff.B=diff2 ");
}

TEST(DisplayMode, TypesDecideTheNumberOfChannels) {
  EXPECT_EQ(channelsOf("float[2] st"), "0=st0 1=st1 ");
  EXPECT_EQ(channelsOf("rgb, float[2] st"), channelsOf("rgb") + "st.0=st0 st.1=st1 ");
  EXPECT_EQ(channelsOf("color Ci2"), "R=Ci20 G=Ci21 B=Ci22 ");
  // A name can be in a file once.
  EXPECT_EQ(channelsOf("rgba,Ci"), channelsOf("rgba"));
  EXPECT_EQ(channelsOf("Ci,Oi"), channelsOf("rgb") + "Oi.R=#3 Oi.G=#3 Oi.B=#3 ");
}

TEST(DisplayMode, TypesThatTheModeDoesNotSay) {
  std::vector<DisplayRequest> d(1);
  d[0].mode = "rgba, mask ,color tint,pair";
  resolveOutputTypes(d, [](std::string_view name) { return name == "mask" ? 1 : name == "pair" ? 2 : 0; });
  EXPECT_EQ(d[0].mode, "rgba,float mask,color tint,float[2] pair");
}

TEST(DisplayType, NamesAndExtensions) {
  const auto target = [](const std::string& type, const std::string& name) {
    const DisplayTarget t = resolveDisplayType(type, name, {});
    return t.driver + ":" + t.fileFormat + ":" + t.path;
  };
  EXPECT_EQ(target("file", "a.tif"), "tiff:tiff:a.tif");
  EXPECT_EQ(target("file", "a.b/c"), "tiff:tiff:a.b/c");
  EXPECT_EQ(target("file", "a.EXR"), "exr:openexr:a.EXR");
  EXPECT_EQ(target("openexr", "x"), "exr:openexr:x");
  EXPECT_EQ(target("tiff", "x.png"), "tiff:tiff:x.png");
  EXPECT_EQ(target("zfile", "s.z"), "tiff:tiff:s.z");
  EXPECT_EQ(target("file", "a.png"), "png:png:a.png");
  EXPECT_EQ(target("jpeg", "a"), "oiio:jpeg:a");
  EXPECT_TRUE(resolveDisplayType("zfile", "s.z", {}).isDepth);
}

TEST(DisplayType, WindowsBecomeFilesWithOneMessage) {
  int messages = 0;
  setReportSink([&](const Error&) { ++messages; });
  EXPECT_EQ(resolveDisplayType("framebuffer", "untitled", {}).path, "untitled.tif");
  EXPECT_EQ(resolveDisplayType("framebuffer", "b.png", {}).fileFormat, "png");
  EXPECT_EQ(messages, 1);
  EXPECT_EQ(resolveDisplayType("nosuchthing", "c", {}).driver, "tiff");
  EXPECT_EQ(messages, 2);
  setReportSink({});
}

TEST(DisplayDriver, MissingOrBadNamesAreErrors) {
  EXPECT_FALSE(openDisplayDriver("nosuchdriver", displaySearchPath({"/tmp"})));
  EXPECT_FALSE(openDisplayDriver("../../etc/x", displaySearchPath({})));
}

}  // namespace
}  // namespace fr
