// For tests: RIB text to an open SceneCache, and the whole of it diced.
#pragma once

#include <gtest/gtest.h>

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "ri/reader.h"
#include "scene_cache/cache.h"
#include "scene_cache/scene_builder.h"

namespace fr::cache {

/// One world of RIB text. Errors reported while loading are kept.
struct DiceScene {
  std::vector<Error> reports;
  Frame frame;
  std::unique_ptr<SceneCache> cache;

  explicit DiceScene(const std::string& rib) {
    setReportSink([this](const Error& e) { reports.push_back(e); });
    SceneBuilder builder({},
                         [this](Frame&& f) {
                           frame = std::move(f);
                           return true;
                         },
                         {});
    ri::Reader reader(builder);
    EXPECT_TRUE(reader.readBuffer(rib, "test.rib").ok());
    builder.finish();
    setReportSink({});
    if (frame.skeletonFd() < 0) return;
    auto c = SceneCache::create(frame.skeletonFd());
    EXPECT_TRUE(c.ok()) << (c.ok() ? "" : c.error().str());
    if (c.ok()) cache = *std::move(c);
  }
  /// Calls fn for every grid under every root patch, dicing as needed.
  void forEachGrid(const std::function<void(NodeId, const GridRecord&)>& fn) {
    for (NodeId root = 0; root < cache->skeleton().rootPatches().size(); ++root) visit(root, fn);
  }
  void visit(NodeId id, const std::function<void(NodeId, const GridRecord&)>& fn) {
    const ResolvedNode r = cache->resolve(id);
    ASSERT_NE(r.state, NodeState::kEmpty) << "node " << id;
    if (r.state == NodeState::kSplit) {
      visit(r.children[0], fn);
      visit(r.children[1], fn);
    } else {
      fn(id, *r.grid);
    }
  }
};

inline std::string diceWorld(const std::string& options, const std::string& body) {
  return options + "\nWorldBegin\n" + body + "\nWorldEnd\n";
}
/// 256 x 256, perspective, camera at z = -distance looking along +z.
inline std::string diceCamera(double distance, double shadingRate = 1, int resolution = 256) {
  return fmt::format(
      "Format {} {} 1\nProjection \"perspective\" \"fov\" [40]\nShadingRate {}\nTranslate 0 0 {}", resolution,
      resolution, shadingRate, distance);
}

}  // namespace fr::cache
