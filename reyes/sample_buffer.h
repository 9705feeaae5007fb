// The visibility samples of one tile, structure of arrays.
//
// Samples of a pixel are contiguous, pixels of a row follow each other, so a micropolygon tests one run of
// samples per row of pixels it touches, or the groups of each pixel that it can reach. Rows are padded with
// samples that nothing can hit, so that kernels may read and test past the end of a run.
//
// When something moves or the lens has a size, samples also have times and lens positions, and blur_kernel.h
// reads them.
#pragma once

#include <cstdint>
#include <vector>

#include "imaging/pixel_rect.h"
#include "imaging/sample_pattern.h"
#include "imaging/sight_lines.h"
#include "reyes/blur_kernel.h"
#include "reyes/raster_space.h"

namespace fr::reyes {

/// What a sample sees: slot of the grid within the tile, and the triangle within the grid.
inline constexpr int kTriangleBits = 10;
inline constexpr uint32_t kTriangleMask = (1u << kTriangleBits) - 1;
inline constexpr uint32_t kMaxSlots = 0xffffffffu >> kTriangleBits;
inline constexpr uint32_t kNothing = 0xffffffffu;

/// Samples between rows and at the end that kernels may touch.
inline constexpr int kRunPadding = 16;

/// Which of the pattern's samples a tile is hidden for.
struct SampleRound {
  int first = 0, count = 0;         // of each pixel; count 0: all
  const uint8_t* wanted = nullptr;  // by pixel of the tile; nullptr: every pixel
};

class SampleBuffer {
 public:
  /// Places the samples of `rect` by the pixels' raster positions, so tiles do not matter. All see nothing,
  /// at depth `farKey`; samples that are not wanted are those that nothing can hit.
  void reset(const PixelRect& rect, const SamplePattern& pattern, float farKey,
             const SampleRound& round = {});

  /// After reset(): samples see only what is at the depths that clipping planes leave on their lines of
  /// sight.
  void limit(const SamplePattern& pattern, const SightLines& lines, const RasterSpace& space);
  /// True when some sample sees nothing before start(sample), a depth key.
  bool startsLate() const { return !start_.empty(); }
  float start(size_t sample) const { return start_.empty() ? -kInfinity : start_[sample]; }
  /// SamplePattern::chance() of a sample.
  float chance(size_t sample, const SamplePattern& pattern) const;

  const PixelRect& rect() const { return rect_; }
  int perPixel() const { return perPixel_; }
  int rowStride() const { return rowStride_; }
  size_t index(int column, int row) const {
    return size_t(row) * size_t(rowStride_) + size_t(column * perPixel_);
  }
  size_t size() const { return x.size(); }

  /// True when every sample of the tile within the bounds sees something opaque that is nearer than
  /// bounds.key.
  bool hides(const RasterBounds& bounds);
  /// Samples in these pixels (tile coordinates, inclusive) may have changed.
  void touched(int column0, int row0, int column1, int row1);

  std::vector<int32_t> x, y;              // subpixel steps from the tile's corner
  std::vector<uint32_t> xy;               // RasterTarget::xy
  std::vector<float> time, lensX, lensY;  // SamplePattern::Blur; empty without
  std::vector<float> depth;               // key of the nearest opaque hit
  std::vector<uint32_t> hit;              // what it is: slot << kTriangleBits | triangle

  /// Groups of rasterWidth() samples, one after another through a pixel; empty when pixels do not have whole
  /// ones.
  const std::vector<SampleGroup>& groups() const { return groups_; }

  bool blurred() const { return !time.empty(); }
  /// For the kernel; only when blurred().
  BlurSamples blurSamples();

 private:
  static constexpr int kBlock = 4;  // pixels a side of a block of the depth hierarchy
  float blockDepth(int block);

  void resetBlur(const SamplePattern& pattern);

  std::vector<SampleGroup> groups_;
  std::vector<SlotRange> slots_;
  std::vector<uint32_t> candidates_, sorted_;
  std::vector<BlurPair> pairs_;
  PixelRect rect_;
  size_t firstOfPixel_ = 0;  // of the pattern's
  int perPixel_ = 0, rowStride_ = 0, blocksX_ = 0, blocksY_ = 0;
  std::vector<float> blockDepth_;  // farthest depth in the block
  std::vector<uint8_t> blockStale_;
  std::vector<float> start_;
};

}  // namespace fr::reyes
