#include "shm/offset.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <vector>

namespace fr::shm {
namespace {

__extension__ using Wide = unsigned __int128;

struct alignas(16) Record {
  double a;
  uint32_t b;
};

TEST(Offset, GivesWhatLiesInTheSegmentAndNothingElse) {
  alignas(64) std::byte memory[256] = {};
  EXPECT_EQ(Offset<Record>{0}.get(memory, 256), nullptr) << "0 is no offset";
  EXPECT_EQ(Offset<Record>{16}.get(memory, 256), reinterpret_cast<Record*>(memory + 16));
  EXPECT_EQ(Offset<Record>{240}.get(memory, 256), reinterpret_cast<Record*>(memory + 240));
  EXPECT_EQ(Offset<Record>{256}.get(memory, 256), nullptr);
  EXPECT_EQ(Offset<Record>{248}.get(memory, 256), nullptr) << "misaligned";
  EXPECT_EQ(Offset<Record>{16}.get(memory, 256, 15), reinterpret_cast<Record*>(memory + 16));
  EXPECT_EQ(Offset<Record>{16}.get(memory, 256, 16), nullptr);
  EXPECT_EQ(Offset<Record>{16}.get(memory, 256, ~0ull / 16 + 2), nullptr) << "count * size overflows to 16";
  EXPECT_EQ(Offset<Record>{~0ull - 15}.get(memory, 256), nullptr);
  const std::byte* constant = memory;
  static_assert(std::is_same_v<decltype(Offset<Record>{}.get(constant, 1)), const Record*>);
  EXPECT_EQ(Offset<char>{255}.span(constant, 256, 1).size(), 1u);
  EXPECT_TRUE(Offset<char>{255}.span(constant, 256, 2).empty());
  EXPECT_EQ(Offset<char>{256}.span(constant, 256, 0).size(), 0u);
}

RC_GTEST_PROP(Offset, AgreesWithArithmeticInMoreBits, (uint64_t offset, uint64_t count, uint64_t segment)) {
  // Near the borders, where mistakes live.
  const uint64_t size = *rc::gen::inRange<uint64_t>(1, 64);
  if (*rc::gen::arbitrary<bool>()) offset = segment - *rc::gen::inRange<uint64_t>(0, 1000);
  if (*rc::gen::arbitrary<bool>()) count = (segment - offset) / size + *rc::gen::inRange<uint64_t>(0, 3);
  const bool expected = Wide(offset) + Wide(count) * size <= segment;
  RC_ASSERT(fitsInSegment(offset, count, size, segment) == expected);
}

}  // namespace
}  // namespace fr::shm
