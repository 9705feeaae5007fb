// Display driver for every other format that OpenImageIO writes: JPEG, Targa, DPX, ...
//
// OpenImageIO brings some 260 shared objects with it, so this driver is opened only when such a file is asked
// for. Parameters are passed on as metadata, e.g. string "compression" "lzw".
#include <OpenImageIO/imageio.h>

#include <memory>

#include "imaging/displays/driver_border.h"

namespace {

struct OiioImage {
  std::unique_ptr<OIIO::ImageOutput> out;
  OIIO::TypeDesc type;
  int originX = 0, originY = 0;
  int rowsWritten = 0, height = 0;
  OIIO::stride_t pixelBytes = OIIO::AutoStride;  // more than the file's channels where alpha is left out
};

OIIO::TypeDesc typeOf(int format) {
  switch (format) {
    case FR_DISPLAY_U8:
      return OIIO::TypeDesc::UINT8;
    case FR_DISPLAY_U16:
      return OIIO::TypeDesc::UINT16;
    case FR_DISPLAY_U32:
      return OIIO::TypeDesc::UINT32;
    default:
      return OIIO::TypeDesc::FLOAT;
  }
}

void addMetadata(const FrDisplayImage& image, OIIO::ImageSpec& spec) {
  for (int i = 0; i < image.parameterCount; ++i) {
    const FrDisplayParameter& p = image.parameters[i];
    const std::string name = p.name;
    if (p.type == FR_DISPLAY_TYPE_FLOAT && p.count == 16)
      spec.attribute(name, OIIO::TypeDesc::TypeMatrix, p.values);
    else if (p.type == FR_DISPLAY_TYPE_FLOAT && p.count == 1)
      spec.attribute(name, *static_cast<const float*>(p.values));
    else if (p.type == FR_DISPLAY_TYPE_INTEGER && p.count == 1)
      spec.attribute(name, *static_cast<const int*>(p.values));
    else if (p.type == FR_DISPLAY_TYPE_STRING && p.count == 1)
      spec.attribute(name, std::string(*static_cast<const char* const*>(p.values)));
  }
}

int openOiio(const FrDisplayImage* image, void** handle, char* message, size_t size) {
  return fr::display::guarded(message, size, [&]() -> std::string {
    auto file = std::make_unique<OiioImage>();
    file->out = OIIO::ImageOutput::create(image->fileFormat);
    if (!file->out) return "OpenImageIO: " + OIIO::geterror();
    file->type = typeOf(image->format);
    OIIO::ImageSpec spec(image->width, image->height, image->channelCount, file->type);
    spec.channelnames.assign(image->channelNames, image->channelNames + image->channelCount);
    // HDR and PNM hold no alpha: colour alone is better than no image.
    if ((spec.nchannels == 2 || spec.nchannels == 4) && spec.channelnames.back() == "A" &&
        !file->out->supports("alpha")) {
      file->pixelBytes = OIIO::stride_t(spec.pixel_bytes());
      spec.channelnames.pop_back();
      --spec.nchannels;
    }
    spec.alpha_channel = spec.z_channel = -1;
    for (int c = 0; c < spec.nchannels; ++c) {
      if (spec.channelnames[size_t(c)] == "A") spec.alpha_channel = c;
      if (spec.channelnames[size_t(c)] == "Z") spec.z_channel = c;
    }
    if (file->out->supports("displaywindow") || file->out->supports("origin")) {
      spec.x = file->originX = image->originX;
      spec.y = file->originY = image->originY;
    }
    spec.full_x = spec.full_y = 0;
    spec.full_width = image->fullWidth, spec.full_height = image->fullHeight;
    if (image->pixelAspect != 1) spec.attribute("PixelAspectRatio", image->pixelAspect);
    addMetadata(*image, spec);
    if (!file->out->open(image->path, spec)) return file->out->geterror();
    file->height = image->height;
    *handle = file.release();
    return "";
  });
}

int writeOiio(void* handle, int, int y, int, int height, const void* pixels, size_t rowBytes, char* message,
              size_t size) {
  return fr::display::guarded(message, size, [&]() -> std::string {
    OiioImage& file = *static_cast<OiioImage*>(handle);
    const int first = y + file.originY;
    if (!file.out->write_scanlines(first, first + height, 0, file.type, pixels, file.pixelBytes,
                                   OIIO::stride_t(rowBytes)))
      return file.out->geterror();
    file.rowsWritten += height;
    return "";
  });
}

int closeOiio(void* handle, int discard, char* message, size_t size) {
  return fr::display::guarded(message, size, [&]() -> std::string {
    std::unique_ptr<OiioImage> file(static_cast<OiioImage*>(handle));
    const bool complete = file->rowsWritten == file->height;
    if (!file->out->close() && !discard) return file->out->geterror();
    return complete || discard ? "" : "not all rows were written";
  });
}

}  // namespace

extern "C" __attribute__((visibility("default"))) const FrDisplayDriver* frDisplayDriver(void) {
  static const FrDisplayDriver driver = {
      FR_DISPLAY_ABI,
      FR_DISPLAY_WRITES_FILE,
      1u << FR_DISPLAY_U8 | 1u << FR_DISPLAY_U16 | 1u << FR_DISPLAY_U32 | 1u << FR_DISPLAY_FLOAT,
      openOiio,
      writeOiio,
      closeOiio};
  return &driver;
}
