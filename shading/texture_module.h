/* The border between shading and the texture system: a C interface to the shared object "fr_textures.so",
 * which alone links OpenImageIO. It is opened by the first texture call of a running shader, or to make a
 * texture.
 *
 * Lookups take whole batches: structure of arrays, one element a lane, in the registers' own layout. All
 * functions return 0, or anything else after writing a zero-terminated reason into `message`; none lets an
 * exception out. All are thread-safe; lookups lock nothing and allocate nothing of their own. */
#pragma once

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define FR_TEXTURE_ABI 2u
#define FR_TEXTURE_ENTRY "frTextureModule"

struct FrTextureFile; /* an open file; valid until the textures it came from are closed */
struct FrTextures;    /* all files of the process, one cache */

enum FrTextureKind {
  FR_TEXTURE_PLAIN = 0,
  FR_TEXTURE_LATLONG = 1,
  FR_TEXTURE_CUBE = 2, /* six faces in one picture: px py pz over nx ny nz */
  FR_TEXTURE_SHADOW = 3
};

struct FrTextureInfo {
  int width, height; /* of the finest level; a cube map: of one face */
  int channels, bits;
  int kind;      /* FrTextureKind */
  int yIsUp;     /* lat-long: the map's poles are on the y axis (OpenEXR) instead of the z axis */
  int hasCamera; /* the two matrices are there */
  float worldToCamera[16], worldToScreen[16]; /* row vectors; screen is [-1, 1] */
  float faceScale;                            /* cube: tan(fov / 2) */
};

/* Value of lane i: data[i & mask]. NULL data: 0 everywhere. */
struct FrLanes {
  const float* data;
  uint32_t mask;
};

enum FrTextureFilter {
  FR_TEXTURE_BOX = 0,    /* bilinear between texels */
  FR_TEXTURE_SMOOTH = 1, /* bicubic where texels are magnified */
  FR_TEXTURE_NEAREST = 2
};

struct FrTextureCall {
  uint32_t lanes;
  const int32_t* active;          /* per lane: 0 is left out. NULL: all */
  int firstChannel, channelCount; /* channelCount 1..3 */
  int filter;                     /* FrTextureFilter */
  int hasFill;
  float fill;           /* of channels that the file lacks; without it, grey files give grey colours */
  float sWidth, tWidth; /* multiply the filter's area */
  struct FrLanes sBlur, tBlur;
  /* texture: s, t, -. environment: direction (planar maps: point) in the map's world. shadow: point in
     current space. Dx, Dy: the change from one sample point to the next in u and in v. */
  struct FrLanes place[3], placeDx[3], placeDy[3];
  float* result; /* component c of lane i: result[c * resultStride + i] */
  uint32_t resultStride;
  float* slope[2]; /* texture: derivatives of the first channel by s and t, per lane; may be NULL */
  /* shadow only */
  int samples;
  struct FrLanes bias;          /* negative: biasLow to biasHigh, at random for each sample */
  float biasLow, biasHigh;      /* biasHigh negative: from the receiver's slope and the size of texels */
  const double* currentToWorld; /* 16, row vectors */
  const uint64_t* seed;         /* per lane; may be NULL */
  /* Corners of the light, in current space: 0 none, 2 a line, 4 an area, in the order of a patch. */
  int sourceCount;
  struct FrLanes source[4][3];
};

enum FrMakeKind {
  FR_MAKE_TEXTURE = 0,
  FR_MAKE_BUMP = 1,
  FR_MAKE_LATLONG = 2,
  FR_MAKE_CUBE = 3,
  FR_MAKE_SHADOW = 4
};
enum FrMakeResize { FR_RESIZE_NONE = 0, FR_RESIZE_UP = 1, FR_RESIZE_DOWN = 2, FR_RESIZE_ROUND = 3 };

struct FrMakeTexture {
  int kind; /* FrMakeKind */
  int pictureCount;
  const char* const* pictures; /* cube: px nx py ny pz nz */
  const char* texture;
  const char* sWrap; /* "black" "clamp" "periodic", "" is black */
  const char* tWrap;
  const char* filter;   /* RI's names, "" is box */
  float sWidth, tWidth; /* full supports, in pixels of the smaller picture */
  float fov;            /* cube: degrees */
  int resize;           /* FrMakeResize: to powers of two */
};

struct FrTextureStatistics {
  uint64_t files, lookups, bytesRead, heldBytes;
};

struct FrTextureModule {
  uint32_t abi; /* FR_TEXTURE_ABI */
  /* The textures of this process; every successful call is paired with one of close. Files that changed on
     the disk since are read again when nobody had the textures open. memoryKilobytes: of texels; the largest
     wish counts. */
  int (*open)(uint32_t memoryKilobytes, struct FrTextures** textures, char* message, size_t messageSize);
  void (*close)(struct FrTextures* textures);
  /* `path` is a file's name, nothing is searched. */
  int (*openFile)(struct FrTextures* textures, const char* path, struct FrTextureFile** file,
                  struct FrTextureInfo* info, char* message, size_t messageSize);
  int (*texture)(struct FrTextureFile* file, const struct FrTextureCall* call, char* message,
                 size_t messageSize);
  int (*environment)(struct FrTextureFile* file, const struct FrTextureCall* call, char* message,
                     size_t messageSize);
  /* Results: the fraction that is in shadow, -1 where the map does not see the point. */
  int (*shadow)(struct FrTextureFile* file, const struct FrTextureCall* call, char* message,
                size_t messageSize);
  /* Smallest and largest value of each channel; reads the whole file. */
  int (*range)(struct FrTextureFile* file, int channelCount, float* smallest, float* largest, char* message,
               size_t messageSize);
  int (*make)(const struct FrMakeTexture* make, char* message, size_t messageSize);
  void (*statistics)(struct FrTextures* textures, struct FrTextureStatistics* statistics);
};

typedef const struct FrTextureModule* (*FrTextureEntry)(void);

#ifdef __cplusplus
}
#endif
