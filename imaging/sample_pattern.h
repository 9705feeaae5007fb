// Where the samples of a frame lie: within their pixels, in the shutter and on the lens. The same for every
// renderer, so that their images can be compared sample by sample.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace fr {

/// Raster positions are snapped to this many steps a pixel, so that coverage is decided in exact integers:
/// abutting micropolygons never leave a gap nor overlap.
inline constexpr int kSubpixelBits = 10;
inline constexpr int kSubpixels = 1 << kSubpixelBits;

/// What else than a place on the raster the samples of a pixel need, and the order in which they come.
struct SampleDimensions {
  bool time = false, lens = false;
  /// Samples come by time, or by place on the lens when there is no time: the n-th samples of all pixels then
  /// are close to each other in it. Adaptive sampling takes the first `firstRound` samples of a pixel, then
  /// doubles their number again and again: each of these parts is sorted for itself. 0: all together.
  /// With neither, samples come by their place, so that eight that follow each other lie close together.
  int firstRound = 0;
};

/// Owen-scrambled Sobol points, differently scrambled in each pixel of a block that repeats over the raster:
/// so the samples of a pixel do not depend on the tile. Without jitter: centres of nx x ny cells, times and
/// lens positions in equal steps. With jitter, the samples up to the end of each round are well spread by
/// themselves.
class SamplePattern {
 public:
  SamplePattern() = default;
  SamplePattern(int nx, int ny, bool jitter, uint32_t seed, SampleDimensions dimensions = {});
  int perPixel() const { return nx_ * ny_; }
  /// Index of the first sample of raster pixel (x, y) in offsets() and blurs().
  size_t first(int x, int y) const {
    return (size_t(y & (period_ - 1)) * size_t(period_) + size_t(x & (period_ - 1))) * size_t(nx_ * ny_);
  }
  /// Subpixel steps from the pixel's corner, always odd: a sample never lies on the border of a pixel, where
  /// images and crop windows end.
  struct Offset {
    int16_t x, y;
  };
  const std::vector<Offset>& offsets() const { return offsets_; }
  /// Time: 0 shutter open ... 1 close. Lens: on the unit disk (all zero without that dimension).
  struct Blur {
    float time = 0, lensX = 0, lensY = 0;
  };
  /// As many as offsets(), or none when samples have a place on the raster alone.
  const std::vector<Blur>& blurs() const { return blurs_; }
  /// A number in [0, 1) of the sample with this index, which decides whether it sees a surface that only a
  /// share of all samples see. The numbers of a pixel's samples are spread evenly.
  float chance(size_t index) const;

 private:
  void addBlur(int sample, bool jitter, uint32_t seed, const SampleDimensions& dimensions);
  void sortByPlace(size_t first, size_t n);
  void sortByBlur(size_t first, size_t n, const SampleDimensions& dimensions);

  int nx_ = 1, ny_ = 1, period_ = 1;
  bool jitter_ = false;
  uint32_t seed_ = 0;
  std::vector<Offset> offsets_{{kSubpixels / 2 + 1, kSubpixels / 2 + 1}};
  std::vector<Blur> blurs_;
};

}  // namespace fr
