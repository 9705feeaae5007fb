// A picture in memory, on its way to a texture file.
#pragma once

#include <OpenImageIO/imageio.h>

#include <string>
#include <vector>

namespace fr::textures {

struct Picture {
  int width = 0, height = 0, channels = 0;
  std::vector<float> texels;  // interleaved rows, from the top
  std::vector<std::string> channelNames;
  OIIO::TypeDesc type = OIIO::TypeDesc::FLOAT;  // as the file stores it
  bool hasCamera = false;
  float worldToCamera[16] = {}, worldToScreen[16] = {};

  float* at(int x, int y) {
    return texels.data() + (size_t(y) * size_t(width) + size_t(x)) * size_t(channels);
  }
  const float* at(int x, int y) const {
    return texels.data() + (size_t(y) * size_t(width) + size_t(x)) * size_t(channels);
  }
};

/// World to camera and world to screen ([-1, 1]), row vectors, as renderers leave them in their images.
/// False: not there.
bool takeCamera(const OIIO::ImageSpec& spec, float toCamera[16], float toScreen[16]);

enum class Wrap { kBlack, kClamp, kPeriodic };
/// RISpec's names; "" is black. False: unknown.
bool wrapNamed(const std::string& name, Wrap* wrap);
const char* wrapName(Wrap wrap);

/// Reads the whole display window of an image: 0 (`outside`) where the file has no data. Returns a reason for
/// failure or "".
std::string readPicture(const std::string& path, float outside, Picture* out);
/// Leaves one channel.
void keepChannel(int channel, Picture* picture);

/// A separable filter for making pictures smaller (or larger). Widths are full supports, in pixels of the
/// coarser of the two pictures. RI's filter names; those that are not separable are replaced by their product
/// form. False: unknown.
struct ReduceFilter {
  std::string name = "box";
  float sWidth = 1, tWidth = 1;
  Wrap sWrap = Wrap::kBlack, tWrap = Wrap::kBlack;
};
bool filterKnown(const std::string& name);
Picture resampled(const Picture& from, int width, int height, const ReduceFilter& filter);

}  // namespace fr::textures
