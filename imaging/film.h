// From samples to pixels: the filter step, for renderers that sample in tiles, in any order, on any thread.
//
// Each target pixel is the sum, over the source pixels in its filter's reach in raster order, of what the
// samples of that source pixel contribute, divided by the sum of the weights. A source pixel's contributions
// to the (2 reach + 1)^2 pixels around it are computed by the tile that holds it and stay in memory until all
// tiles that need them are filtered. So an image depends neither on the order of tiles nor on their size, bit
// for bit; and what is held does not grow with the number of samples.
#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <mutex>
#include <vector>

#include "imaging/pixel_filter.h"
#include "imaging/pixel_rect.h"

namespace fr {

/// Which samples a channel of the film is made of.
enum class ChannelRule : uint8_t {
  kFiltered,  // weighted mean
  kMinimum,   // smallest sample of the pixel itself (depth)
  kMaximum,   // its largest
  kAverage,   // mean of the pixel's own samples; infinite ones (RI_INFINITY, nothing there) are left out
};

/// The samples of one tile. Pixels in rows, the samples of a pixel side by side.
struct TileSamples {
  int samplesPerPixel = 0;
  /// Adaptive sampling: how many samples each pixel has (at least 1), in place of samplesPerPixel. Every
  /// pixel then counts alike in the filter, however many samples stand for it.
  const int* counts = nullptr;
  const float* x = nullptr;  // within the sample's pixel, [0, 1)
  const float* y = nullptr;
  const float* const* channels = nullptr;  // one array a channel
};

/// Finished pixels, channel by channel, rows of `rect`.
struct FilmTile {
  PixelRect rect;
  std::vector<std::vector<float>> channels;
};

/// Thread safety: addTile() may be called by several threads, once per tile.
class Film {
 public:
  using Emit = std::function<void(FilmTile&&)>;

  /// `crop`: pixels of the image. Samples are wanted in crop grown by the filter's reach. tileSize is raised
  /// to the reach.
  Film(const PixelRect& crop, const PixelFilter& filter, int tileSize, std::vector<ChannelRule> channels);
  ~Film();
  Film(const Film&) = delete;
  Film& operator=(const Film&) = delete;

  int tilesX() const { return tilesX_; }
  int tilesY() const { return tilesY_; }
  int tileCount() const { return tilesX_ * tilesY_; }
  int tileSize() const { return tileSize_; }
  /// All pixels that samples are wanted of.
  const PixelRect& sampledRect() const { return sampled_; }
  /// Those of tile `tile` (row by row from the top left). Never empty.
  PixelRect tileRect(int tile) const;

  /// Takes the samples of a tile; they are not needed afterwards. `emit` is called, on this thread, for every
  /// tile whose pixels are now complete; together the tiles cover the crop, each pixel once.
  void addTile(int tile, const TileSamples& samples, const Emit& emit);
  /// The pixels of tile `tile` are known from elsewhere: they are not emitted. Before the first addTile().
  void markKnown(int tile);
  bool isKnown(int tile) const { return known_[size_t(tile)] != 0; }
  /// Whether pixels that are not known need samples of tile `tile`. The others need not be added.
  bool needsTile(int tile) const;
  /// The tile that emits exactly these pixels, or -1.
  int tileOfPixels(const PixelRect& rect) const;
  /// Bytes held for neighbours now.
  size_t bytesHeld() const { return bytesHeld_.load(std::memory_order_relaxed); }

 private:
  struct Splats;
  std::unique_ptr<Splats> splat(const PixelRect& rect, const TileSamples& samples) const;
  FilmTile gather(int tile) const;
  template <class F>
  void forNeighbours(int tile, F&& f) const;

  /// Separable filters are tabulated: sample positions count as the middle of one of so many steps of a
  /// pixel.
  static constexpr int kWeightSteps = 512;

  PixelRect crop_, sampled_;
  PixelFilter filter_;
  std::vector<ChannelRule> rules_;
  int reachX_, reachY_, tileSize_, tilesX_, tilesY_, filteredCount_ = 0, ownCount_ = 0;
  /// [step][target], for targets in rows, padded for the kernel; empty when the filter is not separable or
  /// reaches too far for it.
  std::vector<float> weightsX_, weightsY_;
  size_t targets_ = 0;          // of a pixel, padding included
  std::vector<uint8_t> known_;  // by tile
  std::vector<std::unique_ptr<Splats>> splats_;
  /// Used splats: their arrays are large enough that the system would map and clear fresh pages for each.
  mutable std::mutex poolMutex_;
  mutable std::vector<std::unique_ptr<Splats>> pool_;
  std::unique_ptr<std::atomic<int>[]>
      missing_;  // tiles of the neighbourhood (itself included) that have not come
  std::unique_ptr<std::atomic<int>[]> users_;  // tiles of the neighbourhood that are not filtered
  std::atomic<size_t> bytesHeld_{0};
};

}  // namespace fr
