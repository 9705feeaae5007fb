// What has been seen not long ago, by a hash of its content. Internal to SkeletonWriter.
#pragma once

#include <cstddef>
#include <cstdint>
#include <unordered_map>
#include <utility>

namespace fr::cache {

struct ContentHash {
  uint64_t low, high;
  bool operator==(const ContentHash&) const = default;
};
struct HashOfHash {
  std::size_t operator()(const ContentHash& h) const { return std::size_t(h.low); }
};

/// Remembers at least the last kGeneration contents that were looked for, and at most twice as many: equal
/// content is stored once where it comes again soon enough, and a scene of any size takes some megabytes.
/// What is remembered depends on what was asked alone.
template <class Value>
class RecentContent {
 public:
  static constexpr std::size_t kGeneration = 1 << 16;

  /// The value of equal content, or nullptr. Dies with the next add.
  const Value* find(const ContentHash& key) {
    if (const auto it = young_.find(key); it != young_.end()) return &it->second;
    const auto it = old_.find(key);
    if (it == old_.end()) return nullptr;
    const Value value = it->second;
    return add(key, value);
  }
  const Value* add(const ContentHash& key, const Value& value) {
    if (young_.size() >= kGeneration) {
      old_ = std::move(young_);
      young_.clear();
    }
    return &(young_[key] = value);
  }

 private:
  std::unordered_map<ContentHash, Value, HashOfHash> young_, old_;
};

}  // namespace fr::cache
