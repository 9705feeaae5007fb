// The displays of one frame: takes finished pixels in tiles, exposes, quantises, and writes every display's
// image.
#pragma once

#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <variant>
#include <vector>

#include "imaging/driver_search.h"
#include "imaging/film.h"
#include "imaging/quantize.h"

namespace fr {

/// A parameter of RiDisplay or a piece of metadata.
struct DisplayParameter {
  std::string name;
  std::variant<std::vector<float>, std::vector<int32_t>, std::vector<std::string>> values;
};

/// One RiDisplay.
struct DisplayRequest {
  std::string name, type, mode = "rgba";
  std::vector<DisplayParameter> parameters;
  Quantizer quantizer, depthQuantizer{0, 0, 0, 0};
  Exposure exposure;
  ChannelRule rule = ChannelRule::kFiltered;  // of shader variables: "filter" "min", "max", "average"
};

/// A channel that the renderer delivers. The first five are always R G B A Z; then those of
/// requiredOutputs().
struct OutputChannel {
  std::string variable;  // shader variable; "" for the first five
  int component = 0;
  ChannelRule rule = ChannelRule::kFiltered;
};
inline constexpr int kColorChannel = 0, kAlphaChannel = 3, kDepthChannel = 4, kFixedChannels = 5;

/// The pictures' common frame.
struct FrameGeometry {
  int fullWidth = 640, fullHeight = 480;
  PixelRect crop{0, 0, 640, 480};
  float pixelAspect = 1;
  std::vector<DisplayParameter> metadata;  // for every display
};

/// Shader output variables that the displays' modes name, one entry a component, in the order in which they
/// follow the fixed channels. Modes: "rgb" "rgba" "rgbz" "rgbaz" "a" "z" "az", or a variable, optionally with
/// its type ("color foo", "float x").
std::vector<OutputChannel> requiredOutputs(const std::vector<DisplayRequest>& displays);

/// Gives the variables of the modes their types where these are not said: `components(name)` knows how many
/// numbers a variable has, 0 for a name unknown to it.
void resolveOutputTypes(std::vector<DisplayRequest>& displays,
                        const std::function<int(std::string_view)>& components);

/// Displays keep whole pictures in memory. Error: kNoMem when that cannot be. Ask before anything is made for
/// the frame.
Result<void> checkPictureFits(const FrameGeometry& geometry, const std::vector<DisplayRequest>& displays);

/// n pixels: raster positions of their centres, colour and alpha in place; opacity starts as alpha and is the
/// imager's to write. False: nothing was done. Never called by two threads at once.
using ImagerFunction = std::function<bool(size_t n, const float* x, const float* y, float* const color[3],
                                          float* const opacity[3], float* alpha)>;

/// Thread safety: addTile() may be called by several threads. Files are complete or absent, unless
/// finishPartial() was asked: they are written under a temporary name and renamed by finish(). Without
/// finish() the destructor removes what was begun.
class FrameOutput {
 public:
  /// `searchPath` as of displaySearchPath(). Opens nothing.
  FrameOutput(FrameGeometry geometry, std::vector<DisplayRequest> displays,
              std::vector<std::string> searchPath);
  ~FrameOutput();
  FrameOutput(const FrameOutput&) = delete;
  FrameOutput& operator=(const FrameOutput&) = delete;

  void setImager(ImagerFunction imager) { imager_ = std::move(imager); }
  /// Opens every display. A display that cannot be opened is reported and left out. Errors: none could be
  /// opened.
  Result<void> open();
  /// Finished pixels of all channels, `tile.rect` inside the crop; each pixel once. Colours are
  /// premultiplied, not exposed. Failures to write are reported once a display, which is then dropped.
  void addTile(const FilmTile& tile);
  /// Closes all displays and gives the files their names. Errors: the first display that failed, now or
  /// before.
  Result<void> finish();
  /// The same for pictures that are not complete: pixels that have not come are 0. No addTile() at the same
  /// time.
  Result<void> finishPartial();
  /// File of the first display; "" when there is none. After open().
  std::string firstPath() const;

 private:
  struct Display;
  FrameGeometry geometry_;
  std::vector<std::unique_ptr<Display>> displays_;
  std::vector<std::string> searchPath_;
  ImagerFunction imager_;
  std::mutex imagerMutex_;
  std::mutex errorMutex_;
  std::optional<Error> firstError_;
  void fail(Display& display, Error error);
};

}  // namespace fr
