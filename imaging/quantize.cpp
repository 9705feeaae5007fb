#include "imaging/quantize.h"

#include <algorithm>
#include <cmath>

#include "base/random.h"

namespace fr {

size_t sampleBytes(SampleFormat f) {
  switch (f) {
    case SampleFormat::kU8:
      return 1;
    case SampleFormat::kU16:
      return 2;
    case SampleFormat::kU32:
    case SampleFormat::kFloat:
      break;
  }
  return 4;
}

SampleFormat Quantizer::format() const {
  if (isFloat()) return SampleFormat::kFloat;
  if (max <= 255) return SampleFormat::kU8;
  return max <= 65535 ? SampleFormat::kU16 : SampleFormat::kU32;
}

uint32_t Quantizer::quantize(float v, int x, int y, int channel, uint32_t seed) const {
  // In double: with 16 bits and more the product needs more than 24 bits before it is rounded.
  double q = double(one) * double(v);
  if (dither != 0) {
    uint64_t key = hashStep(seed, uint64_t(uint32_t(x)) | uint64_t(uint32_t(y)) << 32);
    key = hashStep(key, uint64_t(channel));
    q += double(dither) * (2.0 * double(toUnitFloat64(key)) - 1.0);
  }
  const double lowest = std::clamp(double(min), 0.0, 4294967295.0);
  const double highest = std::clamp(double(max), lowest, 4294967295.0);
  const double rounded = std::floor(q + 0.5);
  return uint32_t(rounded > lowest ? std::min(rounded, highest) : lowest);
}

float Exposure::apply(float c) const {
  c *= gain;
  if (gamma == 1) return c;
  return std::copysign(std::pow(std::abs(c), 1 / gamma), c);
}

}  // namespace fr
