// Bytes a face of every primitive type, everything included: what bench/memory measures must not get worse.
#include <gtest/gtest.h>

#include "bench/memory/cost.h"

namespace fr::test {
namespace {

TEST(MemoryCost, BytesAFaceStayWhatTheyAre) {
  for (const bench::MemoryCase& m : bench::memoryCases()) {
    const bench::MemoryCost c = bench::memoryCost(m.rib, 1);
    EXPECT_GT(c.faces, 50000u) << m.name;
    EXPECT_LE(c.all(), m.limit) << m.name << ": scene " << c.scene << ", nodes " << c.nodes << ", vertices "
                                << c.vertices << ", tree " << c.tree << ", records " << c.records;
  }
}

}  // namespace
}  // namespace fr::test
