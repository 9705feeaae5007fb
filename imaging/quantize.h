// Exposure, quantisation and dither: RISpec 3.2, "Image display" (the last steps of the imaging pipeline).
#pragma once

#include <cstddef>
#include <cstdint>

namespace fr {

/// How a channel is stored in a file.
enum class SampleFormat : uint8_t { kU8, kU16, kU32, kFloat };
size_t sampleBytes(SampleFormat f);

/// RiQuantize: v -> clamp(round(one * v + dither * random), min, max), random in [-1, 1). one == 0: floats,
/// untouched.
struct Quantizer {
  float one = 255, min = 0, max = 255, dither = 0.5f;

  bool isFloat() const { return !(one > 0); }
  /// By the largest value: <= 255 is 8 bit, <= 65535 16 bit, else 32 bit; floats when one is 0.
  SampleFormat format() const;
  /// The quantised value of `v` in channel `channel` of raster pixel (x, y). The dither depends on these
  /// three and `seed` alone. Not for float formats. NaN becomes min.
  uint32_t quantize(float v, int x, int y, int channel, uint32_t seed) const;
};

/// RiExposure: c = (c * gain)^(1/gamma), colour channels only.
struct Exposure {
  float gain = 1, gamma = 1;

  bool isIdentity() const { return gain == 1 && gamma == 1; }
  /// Negative results of the gain keep their sign under the power: (-|c|^(1/gamma)).
  float apply(float c) const;
};

}  // namespace fr
