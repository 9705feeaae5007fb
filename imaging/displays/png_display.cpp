// Display driver for PNG files of 8 and 16 bits (floats become 16 bits), straight through libpng; see
// tiff_display.cpp for why.
//
// One to four channels: grey or colour, each with or without alpha. PNG keeps colours that are not multiplied
// by alpha, so they are divided by it. String parameters "software", "artist", "copyright" and "description"
// become text chunks.
#include <png.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <memory>
#include <stdexcept>
#include <vector>

#include "imaging/displays/driver_border.h"

namespace {

using fr::display::findString;

struct PngImage {
  std::FILE* file = nullptr;
  png_structp png = nullptr;
  png_infop info = nullptr;
  int width = 0, height = 0, channels = 0, bits = 8, alpha = -1, rowsWritten = 0;
  bool isFloat = false;
  std::vector<uint8_t> row;
  ~PngImage() {
    if (png) png_destroy_write_struct(&png, &info);
    if (file) std::fclose(file);
  }
};

/// libpng's errors do not return: they become exceptions, which guarded() reports.
[[noreturn]] void fail(png_structp, png_const_charp why) {
  throw std::runtime_error(std::string("libpng: ") + why);
}
void ignore(png_structp, png_const_charp) {}

void setText(const FrDisplayImage& image, PngImage& p) {
  constexpr const char* kNames[][2] = {{"software", "Software"},
                                       {"artist", "Author"},
                                       {"copyright", "Copyright"},
                                       {"description", "Description"}};
  for (const auto& [name, keyword] : kNames) {
    std::string value = findString(image, name, "");
    if (value.empty()) continue;
    std::string key = keyword;
    png_text text{};
    text.compression = PNG_TEXT_COMPRESSION_NONE, text.key = key.data(), text.text = value.data();
    text.text_length = value.size();
    png_set_text(p.png, p.info, &text, 1);
  }
}

int openPng(const FrDisplayImage* image, void** handle, char* message, size_t size) {
  return fr::display::guarded(message, size, [&]() -> std::string {
    const int channels = image->channelCount;
    if (channels < 1 || channels > 4)
      return "a PNG file has one to four channels, not " + std::to_string(channels);
    auto p = std::make_unique<PngImage>();
    p->width = image->width, p->height = image->height, p->channels = channels;
    p->bits = image->format == FR_DISPLAY_U8 ? 8 : 16;
    p->isFloat = image->format != FR_DISPLAY_U8 && image->format != FR_DISPLAY_U16;
    for (int c = 0; c < channels; ++c)
      if (std::strcmp(image->channelNames[c], "A") == 0) p->alpha = c;
    p->file = std::fopen(image->path, "wb");
    if (!p->file) return std::strerror(errno);
    p->png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, fail, ignore);
    p->info = p->png ? png_create_info_struct(p->png) : nullptr;
    if (!p->info) return "libpng: out of memory";
    png_init_io(p->png, p->file);
    png_set_user_limits(p->png, PNG_UINT_31_MAX, PNG_UINT_31_MAX);
    constexpr int kTypes[] = {PNG_COLOR_TYPE_GRAY, PNG_COLOR_TYPE_GRAY_ALPHA, PNG_COLOR_TYPE_RGB,
                              PNG_COLOR_TYPE_RGB_ALPHA};
    png_set_IHDR(p->png, p->info, png_uint_32(image->width), png_uint_32(image->height), p->bits,
                 kTypes[channels - 1], PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
                 PNG_FILTER_TYPE_DEFAULT);
    if (image->pixelAspect != 1 && image->pixelAspect > 0)
      png_set_pHYs(p->png, p->info, 10000, png_uint_32(10000 * image->pixelAspect + 0.5f),
                   PNG_RESOLUTION_UNKNOWN);
    setText(*image, *p);
    png_write_info(p->png, p->info);
    p->row.resize(size_t(image->width) * size_t(channels) * size_t(p->bits / 8));
    *handle = p.release();
    return "";
  });
}

/// Steps of a channel's value.
unsigned steps(uint8_t v) { return v; }
unsigned steps(uint16_t v) { return v; }
unsigned steps(float v) { return v > 0 ? unsigned(std::lrint(std::min(v, 1.0f) * 65535)) : 0; }

/// A row of T as PNG has it: colours divided by alpha, the high byte first.
template <class T>
void convertRow(const char* from, PngImage& p) {
  constexpr unsigned kMost = sizeof(T) == 1 ? 255 : 65535;
  uint8_t* to = p.row.data();
  for (int x = 0; x < p.width; ++x) {
    T values[4] = {};
    std::memcpy(values, from, sizeof(T) * size_t(p.channels));
    from += sizeof(T) * size_t(p.channels);
    const unsigned alpha = p.alpha >= 0 ? steps(values[p.alpha]) : kMost;
    for (int c = 0; c < p.channels; ++c) {
      unsigned v = steps(values[c]);
      if (c != p.alpha && alpha > 0 && alpha < kMost)
        v = std::min(kMost, unsigned((uint64_t(v) * kMost + alpha / 2) / alpha));
      if constexpr (sizeof(T) > 1) *to++ = uint8_t(v >> 8);
      *to++ = uint8_t(v);
    }
  }
}

int writePng(void* handle, int, int, int, int height, const void* pixels, size_t rowBytes, char* message,
             size_t size) {
  return fr::display::guarded(message, size, [&]() -> std::string {
    PngImage& p = *static_cast<PngImage*>(handle);
    for (int row = 0; row < height; ++row) {
      const char* from = static_cast<const char*>(pixels) + size_t(row) * rowBytes;
      p.isFloat     ? convertRow<float>(from, p)
      : p.bits == 8 ? convertRow<uint8_t>(from, p)
                    : convertRow<uint16_t>(from, p);
      png_write_row(p.png, p.row.data());
    }
    p.rowsWritten += height;
    return "";
  });
}

int closePng(void* handle, int discard, char* message, size_t size) {
  return fr::display::guarded(message, size, [&]() -> std::string {
    const std::unique_ptr<PngImage> p(static_cast<PngImage*>(handle));
    const bool complete = p->rowsWritten == p->height;
    if (complete) png_write_end(p->png, p->info);
    if (complete && std::fflush(p->file) != 0) return std::strerror(errno);
    return complete || discard ? "" : "not all rows were written";
  });
}

}  // namespace

extern "C" __attribute__((visibility("default"))) const FrDisplayDriver* frDisplayDriver(void) {
  static const FrDisplayDriver driver = {
      FR_DISPLAY_ABI, FR_DISPLAY_WRITES_FILE, 1u << FR_DISPLAY_U8 | 1u << FR_DISPLAY_U16, openPng, writePng,
      closePng};
  return &driver;
}
