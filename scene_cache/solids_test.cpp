// Solids from RIB to records, and what of a line's crossings is surface.
#include "scene_cache/solids.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <optional>
#include <random>
#include <string>

#include "ri/reader.h"
#include "scene_cache/scene_builder.h"
#include "scene_cache/skeleton_image.h"

namespace fr::cache {
namespace {

struct World {
  std::optional<SkeletonImage> image;
  Skeleton skeleton;
  std::vector<Error> reports;

  explicit World(const std::string& body) {
    setReportSink([&](const Error& e) { reports.push_back(e); });
    SceneBuilder builder({},
                         [&](Frame&& f) {
                           image.emplace(dup(f.skeletonFd()));
                           auto s = Skeleton::open(image->bytes(), false);
                           EXPECT_TRUE(s.ok()) << s.error().str();
                           if (s.ok()) skeleton = *s;
                           return true;
                         },
                         {});
    ri::Reader reader(builder);
    builder.setReader(&reader);
    EXPECT_TRUE(reader.readBuffer("WorldBegin\n" + body + "\nWorldEnd\n", "test.rib").ok());
    builder.finish();
    setReportSink({});
  }
  std::span<const SolidRecord> solids() const { return skeleton.solids(); }
  SolidId solid(size_t object) const { return solidOf(skeleton.objects()[object]); }
  uint32_t flags(size_t object) const {
    return skeleton.attributes()[skeleton.objects()[object].attributes].flags;
  }
  /// "union(primitive primitive)" of the tree that begins at `root`.
  std::string tree(SolidId root) const {
    static constexpr const char* kNames[] = {"p", "u", "i", "d"};
    std::string s = kNames[size_t(solids()[root].operation)];
    std::string parts;
    for (SolidId i = root + 1; i < solids().size(); ++i)
      if (solids()[i].parent == root) {
        EXPECT_EQ(solids()[i].isFirst, parts.empty());
        parts += (parts.empty() ? "" : " ") + tree(i);
      }
    return parts.empty() ? s : s + "(" + parts + ")";
  }
};

const std::string kSphere = "Sphere 1 -1 1 360\n";
std::string block(const std::string& operation, const std::string& inside) {
  return "SolidBegin \"" + operation + "\"\n" + inside + "SolidEnd\n";
}
const std::string kLeaf = block("primitive", kSphere);

TEST(Solids, BlocksBecomeATree) {
  const World w(block("difference", block("union", kLeaf + block("primitive", kSphere + kSphere)) +
                                        block("intersection", kLeaf + block("difference", kLeaf + kLeaf))));
  EXPECT_TRUE(w.reports.empty());
  ASSERT_EQ(w.solids().size(), 9u);
  EXPECT_EQ(w.tree(0), "d(u(p p) i(p d(p p)))");
  ASSERT_EQ(w.skeleton.objects().size(), 6u);
  EXPECT_EQ(w.solid(1), w.solid(2));
  EXPECT_NE(w.solid(0), w.solid(1));
}

TEST(Solids, SurfacesOfWhatIsSubtractedAreTurnedOver) {
  const World w(block("difference", kLeaf + block("difference", kLeaf + kLeaf) + kLeaf) + kSphere);
  ASSERT_EQ(w.skeleton.objects().size(), 5u);
  const uint32_t plain = w.flags(4);
  const uint32_t turned = (plain | kSubtracted) ^ (kReverseInCacheSpace | kReverseOrientation);
  EXPECT_EQ(w.flags(0), plain);
  EXPECT_EQ(w.flags(1), turned);
  EXPECT_EQ(w.flags(2), plain) << "subtracted twice";
  EXPECT_EQ(w.flags(3), turned);
  // Surfaces of two solids are never pieces of one, whatever their attributes and transforms.
  EXPECT_NE(w.skeleton.objects()[0].surfaceGroup, w.skeleton.objects()[2].surfaceGroup);
}

TEST(Solids, WhatNothingEnclosesIsAnOrdinarySurface) {
  const World w(kLeaf + kSphere);
  EXPECT_TRUE(w.solids().empty());
  EXPECT_EQ(w.solid(0), kNone);
  EXPECT_EQ(w.solid(1), kNone);
}

TEST(Solids, PrimitivesAndInstancesInsideAnOperationAreSolidsOfTheirOwn) {
  const World w("ObjectBegin 1\n" + kSphere + kSphere + "ObjectEnd\nObjectBegin 2\n" +
                block("intersection", kLeaf + kLeaf) + "ObjectEnd\n" +
                block("union", kSphere + kSphere + "ObjectInstance 1\nObjectInstance 1\nObjectInstance 2\n"));
  EXPECT_TRUE(w.reports.empty());
  EXPECT_EQ(w.tree(0), "u(p p p p i(p p))");
  EXPECT_EQ(w.solid(2), w.solid(3));
  EXPECT_NE(w.solid(3), w.solid(4));
}

TEST(Solids, ProceduralsBelongToTheBlockThatTheyStandIn) {
  const std::string archive = "ArchiveBegin \"balls\"\n" + kSphere + kSphere + "ArchiveEnd\n";
  const std::string ask = "Procedural \"DelayedReadArchive\" [\"balls\"] [-1 1 -1 1 -1 1]\n";
  const World w(archive + block("difference", block("primitive", ask) + kLeaf) + ask + "ObjectBegin 1\n" +
                block("union", block("primitive", ask) + kLeaf) + "ObjectEnd\nObjectInstance 1\n");
  EXPECT_TRUE(w.reports.empty());
  EXPECT_EQ(w.tree(0), "d(p p)");
  EXPECT_EQ(w.tree(3), "u(p p)");
  ASSERT_EQ(w.skeleton.objects().size(), 8u);
  std::vector<SolidId> of;
  for (size_t i = 0; i < 8; ++i) of.push_back(w.solid(i));
  std::sort(of.begin(), of.end());
  EXPECT_EQ(of, (std::vector<SolidId>{1, 1, 2, 4, 4, 5, kNone, kNone}));
}

TEST(Solids, BadBlocksAreReportedAndEmptyOnesAreEmpty) {
  const World w(block("difference", block("primitive", "") + kLeaf + block("primitive", kSphere + kLeaf)) +
                block("union", ""));
  ASSERT_EQ(w.reports.size(), 1u);
  EXPECT_EQ(w.reports[0].code, RiError::kBadSolid);
  EXPECT_EQ(w.tree(0), "d(p p p)");
  EXPECT_EQ(w.solid(1), w.solid(2)) << "a block inside a primitive block bounds that one";

  const World thin(block("union", kLeaf + "Points \"P\" [0 0 0]\n"));
  ASSERT_EQ(thin.reports.size(), 1u);
  EXPECT_EQ(thin.reports[0].code, RiError::kBadSolid);
  EXPECT_EQ(thin.solid(1), kNone);
}

TEST(Solids, DeepNestingCostsNoStack) {
  std::string text = kLeaf;
  for (int i = 0; i < 20000; ++i) text.insert(0, "SolidBegin \"union\"\n"), text += "SolidEnd\n";
  const World w(text);
  ASSERT_EQ(w.solids().size(), 20001u);
  const SolidForest forest(w.skeleton);
  std::vector<uint32_t> memory;
  SolidState state(forest, memory);
  EXPECT_TRUE(state.toggle(20000));
  EXPECT_TRUE(state.toggle(20000));
}

TEST(Solids, BoundsOfTheWhole) {
  const std::string shifted = "TransformBegin Translate 1.5 0 0 " + kSphere + "TransformEnd\n";
  const auto bound = [&](const std::string& operation) {
    const World w(block(operation, kSphere + shifted));
    const SolidForest f(w.skeleton);
    EXPECT_EQ(f.treeCount(), 1u);
    return f.bound(0);
  };
  EXPECT_NEAR(bound("union").max.x, 2.5f, 1e-2);
  EXPECT_NEAR(bound("intersection").min.x, 0.5f, 1e-2);
  EXPECT_NEAR(bound("intersection").max.x, 1, 1e-2);
  EXPECT_NEAR(bound("difference").max.x, 1, 1e-2);
  const World apart(block("intersection", kSphere + "Translate 5 0 0 " + kSphere));
  EXPECT_TRUE(SolidForest(apart.skeleton).bound(0).empty());
}

// ---- evaluation against a recursive one
// ---------------------------------------------------------------------

struct Random {
  std::mt19937 engine;
  int below(int n) { return int(engine() % uint32_t(n)); }
};

/// Text of a random tree; counts its leaves.
std::string randomTree(Random& r, int depth, int* leaves) {
  static constexpr const char* kOperations[] = {"union", "intersection", "difference"};
  if (depth == 0 || r.below(4) == 0) return ++*leaves, kLeaf;
  std::string parts;
  for (int n = 1 + r.below(3); n > 0; --n) parts += randomTree(r, depth - 1, leaves);
  return block(kOperations[r.below(3)], parts);
}

bool holds(std::span<const SolidRecord> solids, SolidId at, const std::vector<bool>& inside) {
  if (solids[at].operation == SolidOperation::kPrimitive) return inside[at];
  bool all = true, any = false, first = false, others = false, parts = false;
  for (SolidId i = at + 1; i < solids.size(); ++i) {
    if (solids[i].parent != at) continue;
    const bool in = holds(solids, i, inside);
    parts = true, all &= in, any |= in;
    (solids[i].isFirst ? first : others) |= in;
  }
  switch (solids[at].operation) {
    case SolidOperation::kUnion:
      return any;
    case SolidOperation::kIntersection:
      return parts && all;
    default:
      return first && !others;
  }
}

TEST(SolidState, AgreesWithTheDefinition) {
  Random r{std::mt19937(7)};
  for (int round = 0; round < 200; ++round) {
    int leaves = 0;
    const World w(block("union", randomTree(r, 4, &leaves)));
    const SolidForest forest(w.skeleton);
    std::vector<SolidId> leaf;
    for (SolidId i = 0; i < w.solids().size(); ++i)
      if (w.solids()[i].operation == SolidOperation::kPrimitive) leaf.push_back(i);
    std::vector<bool> inside(w.solids().size(), false);
    std::vector<uint32_t> memory;
    SolidState state(forest, memory);
    bool value = false;
    const auto toggle = [&](SolidId i) {
      inside[i] = !inside[i];
      const bool now = holds(w.solids(), 0, inside);
      ASSERT_EQ(state.toggle(i), now != value);
      value = now;
    };
    for (int k = 0; k < 50; ++k) toggle(leaf[size_t(r.below(int(leaf.size())))]);
    for (SolidId i : leaf)
      if (inside[i]) toggle(i);
    EXPECT_FALSE(value);
    EXPECT_TRUE(std::all_of(memory.begin(), memory.end(), [](uint32_t x) { return x == 0; }));
  }
}

// ---- lines
// --------------------------------------------------------------------------------------------------

/// Items of the crossings that are surfaces. Leaves are numbered from 1 in the tree op(p p ...).
std::vector<uint32_t> surfaces(const std::string& operation, int leaves, std::vector<SolidCrossing> line,
                               float absolute = 0) {
  std::string parts;
  for (int i = 0; i < leaves; ++i) parts += kLeaf;
  const World w(block(operation, parts));
  const SolidForest forest(w.skeleton);
  std::vector<uint32_t> memory, found;
  SolidState state(forest, memory);
  forEachSurface(std::span(line), state, kSamePlace, absolute, [&](const SolidCrossing& c) {
    found.push_back(c.item);
    return true;
  });
  EXPECT_TRUE(std::all_of(memory.begin(), memory.end(), [](uint32_t x) { return x == 0; }));
  return found;
}
using Items = std::vector<uint32_t>;

TEST(SolidLine, OrderOfArrivalDoesNotMatter) {
  std::vector<SolidCrossing> line = {{1, 1, 0, 0}, {2, 2, 0, 1}, {3, 1, 0, 2}, {4, 2, 0, 3}};
  std::sort(line.begin(), line.end(), [](auto& a, auto& b) { return a.item < b.item; });
  do {
    EXPECT_EQ(surfaces("union", 2, line), (Items{0, 3}));
    EXPECT_EQ(surfaces("intersection", 2, line), (Items{1, 2}));
    EXPECT_EQ(surfaces("difference", 2, line), (Items{0, 1}));
  } while (std::next_permutation(line.begin(), line.end(), [](auto& a, auto& b) { return a.item < b.item; }));
}

TEST(SolidLine, WhatTheLineStartsInIsKnownFromItsEnd) {
  // Starts inside of 1; 2 is entered and left.
  EXPECT_EQ(surfaces("difference", 2, {{1, 2, 0, 0}, {2, 2, 0, 1}, {3, 1, 0, 2}}), (Items{0, 1, 2}));
  // Starts inside of both.
  EXPECT_EQ(surfaces("difference", 2, {{1, 2, 0, 0}, {3, 1, 0, 1}}), (Items{0, 1}));
  EXPECT_EQ(surfaces("intersection", 2, {{1, 2, 0, 0}, {3, 1, 0, 1}}), (Items{0}));
}

TEST(SolidLine, CoincidentSurfacesAreCrossedAtOnce) {
  const float ulp = 1e-7f;
  for (const float d : {-ulp, 0.0f, ulp}) {
    // A hole whose ends are flush with those of the block: nothing is there.
    EXPECT_EQ(surfaces("difference", 2, {{1, 1, 1, 0}, {1 + d, 2, 2, 1}, {2, 1, 1, 2}, {2 + d, 2, 2, 3}}),
              Items{});
    // Two blocks that touch are one.
    EXPECT_EQ(surfaces("union", 2, {{1, 1, 1, 0}, {2, 1, 1, 1}, {2 + d, 2, 2, 2}, {3, 2, 2, 3}}),
              (Items{0, 3}));
    // Of two faces in one place the lower rank shows, whichever is nearer by rounding.
    EXPECT_EQ(surfaces("union", 2, {{1, 1, 1, 0}, {1 + d, 2, 2, 1}, {2, 1, 1, 2}, {2 + d, 2, 2, 3}}),
              (Items{0, 3}));
  }
}

TEST(SolidLine, TwoSidesOfAThinThingAreTwo) {
  EXPECT_EQ(surfaces("union", 2, {{1, 1, 1, 0}, {1, 1, 1, 1}}), (Items{0, 1}));
  EXPECT_EQ(surfaces("union", 2, {{5, 1, 1, 0}, {5.001f, 1, 1, 1}}, 0.1f), (Items{0, 1}));
}

}  // namespace
}  // namespace fr::cache
