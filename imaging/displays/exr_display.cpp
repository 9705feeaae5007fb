// Display driver for OpenEXR files, straight through the OpenEXR library.
//
// Parameters: string "exrpixeltype" "half" (default) or "float"; string "compression" (or "exrcompression")
// "none" "rle" "zips" "zip" (default) "piz" "pxr24". Depth is always float. float[16] "worldtocamera" and
// "worldtoscreen" become worldToCamera and worldToNDC.
#include <ImfChannelList.h>
#include <ImfFloatAttribute.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfMatrixAttribute.h>
#include <ImfOutputFile.h>
#include <ImfStringAttribute.h>
#include <half.h>

#include <cstring>
#include <memory>
#include <vector>

#include "imaging/displays/driver_border.h"

namespace {

using fr::display::findString;

struct ExrImage {
  std::unique_ptr<Imf::OutputFile> file;
  int originX = 0, originY = 0, width = 0, height = 0, channelCount = 0, rowsWritten = 0;
  std::vector<std::string> names;
  std::vector<bool> isHalf;
};

Imf::Compression compressionNamed(const std::string& name) {
  if (name == "none") return Imf::NO_COMPRESSION;
  if (name == "rle") return Imf::RLE_COMPRESSION;
  if (name == "zips") return Imf::ZIPS_COMPRESSION;
  if (name == "piz") return Imf::PIZ_COMPRESSION;
  if (name == "pxr24") return Imf::PXR24_COMPRESSION;
  return Imf::ZIP_COMPRESSION;
}

void addMetadata(const FrDisplayImage& image, Imf::Header& header) {
  for (int i = 0; i < image.parameterCount; ++i) {
    const FrDisplayParameter& p = image.parameters[i];
    const std::string name = p.name;
    if (p.type == FR_DISPLAY_TYPE_FLOAT && p.count == 16 &&
        (name == "worldtocamera" || name == "worldtoscreen")) {
      Imath::M44f m;
      std::memcpy(&m[0][0], p.values, 16 * sizeof(float));
      header.insert(name == "worldtocamera" ? "worldToCamera" : "worldToNDC", Imf::M44fAttribute(m));
    } else if (p.type == FR_DISPLAY_TYPE_STRING && p.count == 1 && name == "software") {
      header.insert("software", Imf::StringAttribute(*static_cast<const char* const*>(p.values)));
    }
  }
}

int openExr(const FrDisplayImage* image, void** handle, char* message, size_t size) {
  return fr::display::guarded(message, size, [&]() -> std::string {
    auto exr = std::make_unique<ExrImage>();
    exr->originX = image->originX, exr->originY = image->originY;
    exr->width = image->width, exr->height = image->height, exr->channelCount = image->channelCount;
    const Imath::Box2i display({0, 0}, {image->fullWidth - 1, image->fullHeight - 1});
    const Imath::Box2i data({image->originX, image->originY},
                            {image->originX + image->width - 1, image->originY + image->height - 1});
    Imf::Header header(display, data, image->pixelAspect);
    header.compression() =
        compressionNamed(findString(*image, "compression", findString(*image, "exrcompression", "zip")));
    const bool half = findString(*image, "exrpixeltype", "half") != "float";
    for (int c = 0; c < image->channelCount; ++c) {
      const std::string name = image->channelNames[c];
      const bool channelIsHalf = half && name != "Z";
      exr->names.push_back(name);
      exr->isHalf.push_back(channelIsHalf);
      header.channels().insert(name, Imf::Channel(channelIsHalf ? Imf::HALF : Imf::FLOAT));
    }
    addMetadata(*image, header);
    exr->file = std::make_unique<Imf::OutputFile>(image->path, header, 0);
    *handle = exr.release();
    return "";
  });
}

int writeExr(void* handle, int, int y, int, int height, const void* pixels, size_t rowBytes, char* message,
             size_t size) {
  return fr::display::guarded(message, size, [&]() -> std::string {
    ExrImage& exr = *static_cast<ExrImage*>(handle);
    const size_t width = size_t(exr.width), channels = size_t(exr.channelCount);
    std::vector<half> halves(width * channels * size_t(height));
    std::vector<float> floats(width * channels * size_t(height));
    Imf::FrameBuffer buffer;
    for (size_t c = 0; c < channels; ++c) {
      const size_t plane = c * width * size_t(height);
      for (int row = 0; row < height; ++row) {
        const auto* from =
            reinterpret_cast<const float*>(static_cast<const char*>(pixels) + size_t(row) * rowBytes) + c;
        const size_t to = plane + size_t(row) * width;
        for (size_t x = 0; x < width; ++x)
          if (exr.isHalf[c])
            halves[to + x] = half(from[x * channels]);
          else
            floats[to + x] = from[x * channels];
      }
      // OpenEXR wants the address of pixel (0, 0) of the full image.
      const size_t bytes = exr.isHalf[c] ? sizeof(half) : sizeof(float);
      char* base = exr.isHalf[c] ? reinterpret_cast<char*>(halves.data() + plane)
                                 : reinterpret_cast<char*>(floats.data() + plane);
      const ptrdiff_t toOrigin = ptrdiff_t(exr.originX) + ptrdiff_t(exr.originY + y) * ptrdiff_t(width);
      base -= toOrigin * ptrdiff_t(bytes);
      buffer.insert(exr.names[c],
                    Imf::Slice(exr.isHalf[c] ? Imf::HALF : Imf::FLOAT, base, bytes, bytes * width));
    }
    exr.file->setFrameBuffer(buffer);
    exr.file->writePixels(height);
    exr.rowsWritten += height;
    return "";
  });
}

int closeExr(void* handle, int discard, char* message, size_t size) {
  return fr::display::guarded(message, size, [&]() -> std::string {
    std::unique_ptr<ExrImage> exr(static_cast<ExrImage*>(handle));
    const bool complete = exr->rowsWritten == exr->height;
    exr->file.reset();
    return complete || discard ? "" : "not all rows were written";
  });
}

}  // namespace

extern "C" __attribute__((visibility("default"))) const FrDisplayDriver* frDisplayDriver(void) {
  static const FrDisplayDriver driver = {
      FR_DISPLAY_ABI, FR_DISPLAY_WRITES_FILE, 1u << FR_DISPLAY_FLOAT, openExr, writeExr, closeExr};
  return &driver;
}
