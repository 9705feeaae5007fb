/* The border between the renderer and its display drivers: a C interface, so that a driver can be built by
 * any compiler and opened on demand. A driver is a shared object "fr_display_<name>.so" that exports
 * frDisplayDriver().
 *
 * The host calls open, then write with every pixel of the image once, then close, one call at a time. Each
 * function returns 0, or anything else after writing a zero-terminated reason into `message`. Drivers let no
 * exception out. */
#pragma once

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define FR_DISPLAY_ABI 1u
#define FR_DISPLAY_ENTRY "frDisplayDriver"

enum FrDisplayFormat { FR_DISPLAY_U8 = 0, FR_DISPLAY_U16 = 1, FR_DISPLAY_U32 = 2, FR_DISPLAY_FLOAT = 3 };
enum FrDisplayType { FR_DISPLAY_TYPE_FLOAT = 0, FR_DISPLAY_TYPE_INTEGER = 1, FR_DISPLAY_TYPE_STRING = 2 };
enum FrDisplayFlags {
  /* The driver writes one file at `path`: the host passes a temporary path and names the file after a clean
     close. It is often "/proc/self/fd/N": open it, do not rename, remove or take it apart. */
  FR_DISPLAY_WRITES_FILE = 1,
  /* Reserved: rectangles may come in any order and shape as they are finished. Today whole rows come, from
     the top. */
  FR_DISPLAY_ANY_ORDER = 2
};

struct FrDisplayParameter {
  const char* name;
  int type; /* FrDisplayType */
  int count;
  const void* values; /* float[count], int32_t[count] or const char*[count] */
};

struct FrDisplayImage {
  const char* path;
  const char* fileFormat; /* "tiff", "openexr", ... or "" */
  int originX, originY;   /* of the data within the full image */
  int width, height;      /* of the data */
  int fullWidth, fullHeight;
  float pixelAspect;
  int channelCount;
  const char* const* channelNames;
  int format; /* FrDisplayFormat of every channel, interleaved */
  int parameterCount;
  const struct FrDisplayParameter* parameters;
};

struct FrDisplayDriver {
  uint32_t abi;   /* FR_DISPLAY_ABI */
  uint32_t flags; /* FrDisplayFlags */
  uint32_t
      acceptedFormats; /* bit 1 << FrDisplayFormat; floats are delivered for a format that is not accepted */
  int (*open)(const struct FrDisplayImage* image, void** handle, char* message, size_t messageSize);
  /* Pixels [x, x + width) x [y, y + height) of the data (0,0 is its top left). */
  int (*write)(void* handle, int x, int y, int width, int height, const void* pixels, size_t rowBytes,
               char* message, size_t messageSize);
  /* Ends the image and frees the handle in any case. discard: the image is incomplete and will be removed. */
  int (*close)(void* handle, int discard, char* message, size_t messageSize);
};

typedef const struct FrDisplayDriver* (*FrDisplayEntry)(void);

#ifdef __cplusplus
}
#endif
