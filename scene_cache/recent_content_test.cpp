#include "scene_cache/recent_content.h"

#include <gtest/gtest.h>

#include "scene_cache/growing_table.h"
#include "scene_cache/skeleton_writer.h"
#include "shm/scratch_file.h"

namespace fr::cache {
namespace {

ContentHash key(uint64_t i) { return {i * 0x9e3779b97f4a7c15ull, i}; }

TEST(RecentContent, RemembersAGenerationAndWhatIsAskedForAgain) {
  RecentContent<uint64_t> c;
  constexpr uint64_t kCount = 5 * RecentContent<uint64_t>::kGeneration;
  for (uint64_t i = 0; i < kCount; ++i) {
    EXPECT_EQ(c.find(key(i)), nullptr) << i;
    c.add(key(i), i);
    // Asked for again and again: never forgotten.
    if (i % 1000 == 0) {
      ASSERT_NE(c.find(key(0)), nullptr) << i;
      EXPECT_EQ(*c.find(key(0)), 0u);
    }
    if (i > 1000) {
      ASSERT_NE(c.find(key(i - 1000)), nullptr) << i;
    }
  }
  EXPECT_EQ(c.find(key(1)), nullptr);  // long ago
}

TEST(GrowingTable, KeepsItsRecordsAndItsPlace) {
  for (const std::string& folder : {std::string(), shm::scratchFolder({})}) {
    GrowingTable<uint64_t> t(folder);
    EXPECT_EQ(t.size(), 0u);
    EXPECT_TRUE(t.all().empty());
    const uint64_t first = 7;
    ASSERT_TRUE(t.append(std::span(&first, 1)));
    const uint64_t* place = &t[0];
    for (uint64_t i = 1; i < 300000; ++i) ASSERT_TRUE(t.append(std::span(&i, 1)));
    EXPECT_EQ(&t[0], place);
    t.cut(200000);
    ASSERT_EQ(t.size(), 200000u);
    ASSERT_TRUE(t.append(std::span(&first, 1)));
    EXPECT_EQ(t[0], 7u);
    EXPECT_EQ(t[199999], 199999u);
    EXPECT_EQ(t[200000], 7u);
  }
}

TEST(SkeletonWriter, TransformsComeBackAsTheyWere) {
  auto made = SkeletonWriter::create();
  ASSERT_TRUE(made.ok());
  SkeletonWriter w = *std::move(made);
  std::vector<TransformId> ids;
  for (int i = 0; i < 1000; ++i) {
    TransformKeys k{{0.0f, float(i + 1)}, {DMat4(1), DMat4(double(i))}};
    ids.push_back(w.addTransform(k));
    EXPECT_EQ(w.addTransform(k), ids.back());
  }
  for (int i = 0; i < 1000; ++i) {
    const TransformKeys k = w.transform(ids[size_t(i)]);
    ASSERT_EQ(k.times.size(), 2u);
    EXPECT_EQ(k.times[1], float(i + 1));
    EXPECT_EQ(k.matrices[1], DMat4(double(i)));
  }
}

}  // namespace
}  // namespace fr::cache
