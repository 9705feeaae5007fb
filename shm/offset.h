// References inside shared memory: a checked byte offset, never a pointer.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <type_traits>

namespace fr::shm {

/// True when `count` elements of `elementBytes` that start at byte `offset` lie within `segmentBytes`. Never
/// overflows.
constexpr bool fitsInSegment(uint64_t offset, uint64_t count, uint64_t elementBytes, uint64_t segmentBytes) {
  if (offset > segmentBytes) return false;
  if (elementBytes == 0 || count == 0) return true;
  return count <= (segmentBytes - offset) / elementBytes;
}

/// Byte offset of a T (or an array of T) from the start of a segment. Trivially copyable, eight bytes, 0 =
/// none (every segment starts with a header, so nothing else lives there).
///
/// Read an Offset out of shared memory once, into a local, and use the local: the other process may change
/// the bytes between two reads. What `get` returns is in range; what it points at is still the other
/// process's.
template <class T>
struct Offset {
  uint64_t bytes = 0;

  constexpr explicit operator bool() const { return bytes != 0; }
  constexpr bool operator==(const Offset&) const = default;

  /// Pointer to `count` elements, or nullptr when the offset is none, out of range or misaligned for T.
  /// `base` must be aligned for T, as the start of every mapping is.
  template <class Byte>
  auto get(Byte* base, uint64_t segmentBytes, uint64_t count = 1) const {
    using Element = std::conditional_t<std::is_const_v<Byte>, const T, T>;
    static_assert(std::is_same_v<std::remove_const_t<Byte>, std::byte>);
    static_assert(std::is_standard_layout_v<T>, "shared types are standard layout");
    if (bytes == 0 || bytes % alignof(T) != 0 || !fitsInSegment(bytes, count, sizeof(T), segmentBytes)) {
      return static_cast<Element*>(nullptr);
    }
    return reinterpret_cast<Element*>(base + bytes);
  }
  /// The same as a span; empty when the check fails.
  template <class Byte>
  auto span(Byte* base, uint64_t segmentBytes, uint64_t count) const {
    auto* p = get(base, segmentBytes, count);
    return std::span(p, p ? size_t(count) : 0);
  }
};
static_assert(sizeof(Offset<int>) == 8 && std::is_trivially_copyable_v<Offset<int>>);

}  // namespace fr::shm
