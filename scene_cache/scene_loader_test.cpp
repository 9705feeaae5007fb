#include "scene_cache/scene_loader.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "scene_cache/skeleton_image.h"

namespace fr::cache {
namespace {

namespace fs = std::filesystem;

class SceneLoader : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() / fmt::format("scene_loader_test.{}", getpid());
    fs::create_directories(folder_ / "sub");
    fs::create_directories(folder_ / "elsewhere");
    setReportSink([this](const Error& e) { reports_.push_back(e); });
  }
  void TearDown() override {
    setReportSink({});
    fs::remove_all(folder_);
  }
  std::string write(const std::string& name, const std::string& text) {
    std::ofstream(folder_ / name) << text;
    return (folder_ / name).string();
  }
  /// Objects per frame.
  std::vector<uint64_t> load(const std::vector<RibInput>& inputs, bool expectOk = true,
                             const LoadOptions& o = {}) {
    std::vector<uint64_t> counts;
    auto r = loadScene(inputs, o, [&](Frame&& f) {
      SkeletonImage image(dup(f.skeletonFd()));
      EXPECT_EQ(image.bytes().size(), f.skeletonBytes());
      auto s = Skeleton::open(image.bytes(), o.checksum);
      EXPECT_TRUE(s.ok());
      counts.push_back(s.ok() ? s->objects().size() : 0);
      if (s.ok()) inspect(*s);
      if (s.ok()) paths_.assign(1, std::string(s->string(s->searchPaths()[0])));
      return true;
    });
    EXPECT_EQ(r.ok(), expectOk) << (r.ok() ? "" : r.error().str());
    return counts;
  }
  void inspect(const Skeleton& s) {
    sides_.clear();
    names_.clear();
    for (const ObjectRecord& o : s.objects()) {
      sides_.push_back(o.sides);
      const AttributeRecord& a = s.attributes()[o.attributes];
      names_ += a.surface == kNone ? "-" : std::string(s.string(s.shaders()[a.surface].name));
      names_ += ' ';
    }
    resolution_ = s.camera().resolution[0];
    rayLevel_ = s.options().maxRayLevel;
  }
  std::vector<uint8_t> sides_;
  std::string names_;
  int resolution_ = 0, rayLevel_ = 0;
  fs::path folder_;
  std::vector<Error> reports_;
  std::vector<std::string> paths_;
};

TEST_F(SceneLoader, ArchivesStandBesideTheFileThatNamesThem) {
  write("sub/ball.rib", "Sphere 1 -1 1 360\n");
  const std::string scene =
      write("sub/scene.rib", "WorldBegin ReadArchive \"ball.rib\" ReadArchive \"ball.rib\" WorldEnd\n");
  EXPECT_EQ(load({{scene}}), std::vector<uint64_t>{2});
  EXPECT_TRUE(reports_.empty());
}

TEST_F(SceneLoader, EnvironmentVariablesAreSearchPaths) {
  write("elsewhere/ball.rib", "Sphere 1 -1 1 360\n");
  const std::string scene = write("scene.rib", "WorldBegin ReadArchive \"ball.rib\" WorldEnd\n");
  setenv("ARCHIVES", (folder_ / "elsewhere").c_str(), 1);
  setenv("SHADERS", "/one:/two", 1);
  EXPECT_EQ(load({{scene}}), std::vector<uint64_t>{1});
  unsetenv("ARCHIVES");
  unsetenv("SHADERS");
  EXPECT_EQ(paths_[0], "/one:/two");
}

TEST_F(SceneLoader, FilesAreOneStream) {
  const std::string a = write("a.rib", "WorldBegin Sphere 1 -1 1 360\n");
  const std::string b = write("b.rib", "Sphere 1 -1 1 360\n");
  const std::string c = write("c.rib", "WorldEnd WorldBegin WorldEnd\n");
  EXPECT_EQ(load({{a}, {b, kForTracer}, {c}}), (std::vector<uint64_t>{2, 0}));
}

TEST_F(SceneLoader, EachSideReadsItsOwnStream) {
  const std::string common =
      write("common.rib", "Format 32 16 1 Surface \"plastic\" WorldBegin Sphere 1 -1 1 360 nonsense\n");
  const std::string tracer =
      write("tracer.rib", "Option \"render\" \"int max_raylevel\" [7] Surface \"glass\" Sphere 1 -1 1 360\n");
  const std::string reyes =
      write("reyes.rib", "Sphere 1 -1 1 360 Surface \"wood\" Sphere 1 -1 1 360 WorldEnd\n");
  EXPECT_EQ(load({{common}, {tracer, kForTracer}, {reyes, kForReyes}}), std::vector<uint64_t>{4});
  EXPECT_EQ(sides_, (std::vector<uint8_t>{3, kForReyes, kForReyes, kForTracer}));
  // The tracer's glass does not leak into the files that REYES reads after it.
  EXPECT_EQ(names_, "plastic plastic wood glass ");
  size_t nonsense = 0;
  for (const Error& e : reports_) nonsense += e.message.find("nonsense") != std::string::npos;
  EXPECT_EQ(nonsense, 1u) << "the common file is read twice, its errors are said once";
}

TEST_F(SceneLoader, WorldsOfBothSidesAreOneScene) {
  const std::string common = write("common.rib", "Format 32 16 1\n");
  const std::string tracer =
      write("tracer.rib",
            "Format 4 4 1 Display \"b\" \"file\" \"rgb\" Option \"render\" \"int max_raylevel\" [7]\n"
            "WorldBegin Surface \"cheap\" Sphere 1 -1 1 360 WorldEnd\n"
            "WorldBegin WorldEnd\n");
  const std::string reyes = write("reyes.rib", "WorldBegin Surface \"fine\" Sphere 1 -1 1 360 WorldEnd\n");
  for (const bool tracerFirst : {true, false}) {
    std::vector<RibInput> in{{common}, {tracer, kForTracer}, {reyes, kForReyes}};
    if (!tracerFirst) std::swap(in[1], in[2]);
    EXPECT_EQ(load(in), std::vector<uint64_t>{2});
    EXPECT_EQ(names_, "fine cheap ");
    EXPECT_EQ(sides_, (std::vector<uint8_t>{kForReyes, kForTracer}));
    EXPECT_EQ(resolution_, 32);
    EXPECT_EQ(rayLevel_, 7);
  }
  ASSERT_FALSE(reports_.empty());
  EXPECT_NE(reports_[0].message.find("1 more worlds"), std::string::npos);
}

TEST_F(SceneLoader, FramesReadOverKeepTheStreamsTogether) {
  const std::string reyes = write(
      "reyes.rib", "FrameBegin 1 WorldBegin WorldEnd FrameEnd FrameBegin 2 WorldBegin WorldEnd FrameEnd\n");
  const std::string tracer = write("tracer.rib",
                                   "WorldBegin Surface \"one\" Sphere 1 -1 1 360 WorldEnd\n"
                                   "WorldBegin Surface \"two\" Sphere 1 -1 1 360 WorldEnd\n");
  LoadOptions o;
  o.frames = {{2, 2}};
  EXPECT_EQ(load({{reyes, kForReyes}, {tracer, kForTracer}}, true, o), std::vector<uint64_t>{1});
  EXPECT_EQ(names_, "two ");
}

TEST_F(SceneLoader, AMissingFileIsAnErrorAndTheRestIsRead) {
  const std::string a = write("a.rib", "WorldBegin Sphere 1 -1 1 360 WorldEnd\n");
  EXPECT_EQ(load({{(folder_ / "none.rib").string()}, {a}}, false), std::vector<uint64_t>{1});
}

TEST_F(SceneLoader, TheCallbackCanStop) {
  const std::string a = write("a.rib", "WorldBegin WorldEnd WorldBegin WorldEnd WorldBegin WorldEnd\n");
  int frames = 0;
  EXPECT_TRUE(loadScene(std::vector<RibInput>{{a}}, {}, [&](Frame&&) { return ++frames < 2; }).ok());
  EXPECT_EQ(frames, 2);
}

TEST_F(SceneLoader, ChecksumsOnRequest) {
  const std::string a = write("a.rib", "WorldBegin Sphere 1 -1 1 360 WorldEnd\n");
  LoadOptions o;
  o.checksum = true;
  EXPECT_EQ(load({{a}}, true, o), std::vector<uint64_t>{1});
}

}  // namespace
}  // namespace fr::cache
