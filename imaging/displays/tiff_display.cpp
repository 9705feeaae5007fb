// Display driver for TIFF files, straight through libtiff: OpenImageIO's 260 shared objects take longer to
// load than small pictures to render.
//
// Parameters: string "compression" "none" "packbits" "lzw" "zip" (default); string "software", "artist",
// "copyright", "description"; float[16] "worldtocamera" and "worldtoscreen" become Pixar's tags.
#include <tiffio.h>

#include <cstdarg>
#include <cstring>
#include <memory>
#include <vector>

#include "imaging/displays/driver_border.h"

namespace {

using fr::display::find;
using fr::display::findString;

struct TiffImage {
  TIFF* file = nullptr;
  int height = 0, rowsWritten = 0;
  size_t rowBytes = 0;
  std::vector<char> row;
  std::string complaint;
  std::string failure() const { return complaint.empty() ? "libtiff failed" : complaint; }
  ~TiffImage() {
    if (file) TIFFClose(file);
  }
};

/// Keeps what libtiff complains about for the call that caused it.
int keepComplaint(TIFF*, void* image, const char* module, const char* format, va_list values) {
  char text[512];
  std::vsnprintf(text, sizeof text, format, values);
  static_cast<TiffImage*>(image)->complaint = module ? std::string(module) + ": " + text : text;
  return 1;  // nobody else is told
}
int ignoreWarning(TIFF*, void*, const char*, const char*, va_list) { return 1; }

/// As TIFFOpen(), with handlers of the file's own: the process's belong to whoever else uses libtiff.
TIFF* openFile(const char* path, const char* mode, TiffImage& image) {
  TIFFOpenOptions* const options = TIFFOpenOptionsAlloc();
  if (!options) return nullptr;
  TIFFOpenOptionsSetErrorHandlerExtR(options, keepComplaint, &image);
  TIFFOpenOptionsSetWarningHandlerExtR(options, ignoreWarning, nullptr);
  TIFF* const file = TIFFOpenExt(path, mode, options);
  TIFFOpenOptionsFree(options);
  return file;
}

uint16_t compressionNamed(const std::string& name) {
  if (name == "none") return COMPRESSION_NONE;
  if (name == "packbits") return COMPRESSION_PACKBITS;
  if (name == "lzw") return COMPRESSION_LZW;
  return COMPRESSION_ADOBE_DEFLATE;
}

/// Which of the channels beyond grey or colour is what.
void setChannels(const FrDisplayImage& image, TIFF* file) {
  const bool isColor = image.channelCount >= 3;
  const int colors = isColor ? 3 : 1;
  TIFFSetField(file, TIFFTAG_SAMPLESPERPIXEL, image.channelCount);
  TIFFSetField(file, TIFFTAG_PHOTOMETRIC, isColor ? PHOTOMETRIC_RGB : PHOTOMETRIC_MINISBLACK);
  std::vector<uint16_t> extra;
  for (int c = colors; c < image.channelCount; ++c)
    extra.push_back(std::strcmp(image.channelNames[c], "A") == 0 ? EXTRASAMPLE_ASSOCALPHA
                                                                 : EXTRASAMPLE_UNSPECIFIED);
  if (!extra.empty()) TIFFSetField(file, TIFFTAG_EXTRASAMPLES, int(extra.size()), extra.data());
}

void setFormat(int format, uint16_t compression, TIFF* file) {
  const bool isFloat = format != FR_DISPLAY_U8 && format != FR_DISPLAY_U16 && format != FR_DISPLAY_U32;
  const int bits = format == FR_DISPLAY_U8 ? 8 : format == FR_DISPLAY_U16 ? 16 : 32;
  TIFFSetField(file, TIFFTAG_BITSPERSAMPLE, bits);
  TIFFSetField(file, TIFFTAG_SAMPLEFORMAT, isFloat ? SAMPLEFORMAT_IEEEFP : SAMPLEFORMAT_UINT);
  TIFFSetField(file, TIFFTAG_COMPRESSION, compression);
  if (compression == COMPRESSION_LZW || compression == COMPRESSION_ADOBE_DEFLATE)
    TIFFSetField(file, TIFFTAG_PREDICTOR, isFloat ? PREDICTOR_FLOATINGPOINT : PREDICTOR_HORIZONTAL);
}

void setMetadata(const FrDisplayImage& image, TIFF* file) {
  constexpr struct {
    const char* name;
    uint32_t tag;
  } kTexts[] = {{"software", TIFFTAG_SOFTWARE},
                {"artist", TIFFTAG_ARTIST},
                {"copyright", TIFFTAG_COPYRIGHT},
                {"description", TIFFTAG_IMAGEDESCRIPTION}};
  for (const auto& [name, tag] : kTexts)
    if (const std::string text = findString(image, name, ""); !text.empty())
      TIFFSetField(file, tag, text.c_str());
  constexpr struct {
    const char* name;
    uint32_t tag;
  } kMatrices[] = {{"worldtocamera", TIFFTAG_PIXAR_MATRIX_WORLDTOCAMERA},
                   {"worldtoscreen", TIFFTAG_PIXAR_MATRIX_WORLDTOSCREEN}};
  for (const auto& [name, tag] : kMatrices)
    if (const FrDisplayParameter* p = find(image, name, FR_DISPLAY_TYPE_FLOAT); p && p->count == 16)
      TIFFSetField(file, tag, static_cast<const float*>(p->values));
  TIFFSetField(file, TIFFTAG_PIXAR_IMAGEFULLWIDTH, image.fullWidth);
  TIFFSetField(file, TIFFTAG_PIXAR_IMAGEFULLLENGTH, image.fullHeight);
  if (image.originX != 0 || image.originY != 0) {
    TIFFSetField(file, TIFFTAG_XPOSITION, float(image.originX));
    TIFFSetField(file, TIFFTAG_YPOSITION, float(image.originY));
  }
  // Samples an inch matter by their ratio alone: that of a pixel's height to its width.
  if (image.pixelAspect != 1 && image.pixelAspect > 0) {
    TIFFSetField(file, TIFFTAG_RESOLUTIONUNIT, RESUNIT_NONE);
    TIFFSetField(file, TIFFTAG_XRESOLUTION, 1.0f);
    TIFFSetField(file, TIFFTAG_YRESOLUTION, image.pixelAspect);
  }
}

int openTiff(const FrDisplayImage* image, void** handle, char* message, size_t size) {
  return fr::display::guarded(message, size, [&]() -> std::string {
    const int bytes = image->format == FR_DISPLAY_U8 ? 1 : image->format == FR_DISPLAY_U16 ? 2 : 4;
    auto tiff = std::make_unique<TiffImage>();
    tiff->height = image->height;
    tiff->rowBytes = size_t(image->width) * size_t(image->channelCount) * size_t(bytes);
    // Files beyond 4 GB need 64-bit offsets.
    const bool isBig = double(tiff->rowBytes) * image->height > 3.9e9;
    tiff->file = openFile(image->path, isBig ? "w8" : "w", *tiff);
    if (!tiff->file) return tiff->failure();
    TIFFSetField(tiff->file, TIFFTAG_IMAGEWIDTH, image->width);
    TIFFSetField(tiff->file, TIFFTAG_IMAGELENGTH, image->height);
    TIFFSetField(tiff->file, TIFFTAG_ORIENTATION, ORIENTATION_TOPLEFT);
    TIFFSetField(tiff->file, TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG);
    setChannels(*image, tiff->file);
    setFormat(image->format, compressionNamed(findString(*image, "compression", "zip")), tiff->file);
    TIFFSetField(tiff->file, TIFFTAG_ROWSPERSTRIP, 32);
    setMetadata(*image, tiff->file);
    *handle = tiff.release();
    return "";
  });
}

int writeTiff(void* handle, int, int y, int, int height, const void* pixels, size_t rowBytes, char* message,
              size_t size) {
  return fr::display::guarded(message, size, [&]() -> std::string {
    TiffImage& tiff = *static_cast<TiffImage*>(handle);
    for (int row = 0; row < height; ++row) {
      // A copy: libtiff turns rows into differences in place.
      const char* from = static_cast<const char*>(pixels) + size_t(row) * rowBytes;
      tiff.row.assign(from, from + tiff.rowBytes);
      if (TIFFWriteScanline(tiff.file, tiff.row.data(), uint32_t(y + row), 0) < 0) return tiff.failure();
    }
    tiff.rowsWritten += height;
    return "";
  });
}

int closeTiff(void* handle, int discard, char* message, size_t size) {
  return fr::display::guarded(message, size, [&]() -> std::string {
    const std::unique_ptr<TiffImage> tiff(static_cast<TiffImage*>(handle));
    if (!TIFFFlush(tiff->file) && !discard) return tiff->failure();
    return tiff->rowsWritten == tiff->height || discard ? "" : "not all rows were written";
  });
}

}  // namespace

extern "C" __attribute__((visibility("default"))) const FrDisplayDriver* frDisplayDriver(void) {
  static const FrDisplayDriver driver = {
      FR_DISPLAY_ABI,
      FR_DISPLAY_WRITES_FILE,
      1u << FR_DISPLAY_U8 | 1u << FR_DISPLAY_U16 | 1u << FR_DISPLAY_U32 | 1u << FR_DISPLAY_FLOAT,
      openTiff,
      writeTiff,
      closeTiff};
  return &driver;
}
