// What the virtual machine is measured against: the same computations written by hand in SIMD C++ over the
// same columns of points, once per instruction set. They know at compile time what a shader does, what lights
// do, and that points form a grid.
#pragma once

#include <cstdint>
#include <string_view>

namespace fr::bench {

/// A light as one who knows all kinds of lights would keep it. Colours are intensity times lightcolor.
struct HandLight {
  enum Kind : uint32_t { kAmbient, kDistant, kPoint, kSpot, kArea };
  Kind kind = kAmbient;
  float color[3] = {1, 1, 1};
  float from[3] = {0, 0, 0};  // of area lights: the emitters'
  float axis[3] = {0, 0, 1};  // unit; of distant lights: from the light, any length
  float cosOuter = 0, cosInner = 0, beam = 2;
};

/// Rays of one batch, structure of arrays, `count` of them; answers in place.
struct HandRays {
  uint32_t count = 0;
  float *origin[3], *direction[3], *radius, *spread;
  uint64_t* seed;
  uint32_t* lane;
  float *color[3], *hitDistance, *missDepth, *missR[3];
};

/// Points in a grid of `row` columns, and the numbers that shaders have as parameters. Columns are 64-byte
/// aligned and padded to 16 points; 16 floats before and after each may be read.
struct HandTask {
  uint32_t count = 0, row = 1, rows = 1;
  const float *P[3], *N[3], *I[3], *Cs[3], *Os[3], *s, *t;
  float *Ci[3], *Oi[3], *alpha, *outP[3], *outN[3];
  const HandLight* lights = nullptr;
  uint32_t lightCount = 0;
  const uint64_t* seed = nullptr;
  const uint32_t* calls = nullptr;  // of random(), by each point
  float* scratch = nullptr;         // 24 columns of 1024 + 32 floats
  HandRays* rays = nullptr;
  void (*ask)(HandRays&) = nullptr;
  /// A filtered colour of the texture for each point, `changes` per cell: s by u, t by u, s by v, t by v.
  void (*texture)(const HandTask&, const float* const changes[4], float* const color[3]) = nullptr;
  /// Points of an area light's geometry, their unit normals and what they dim the light by, for a pair of
  /// random numbers each.
  void (*emitters)(const HandTask&, const float* const pair[2], float* const P[3], float* const N[3],
                   float* factor) = nullptr;
  float Ka = 1, Kd = 1, Ks = 0.5f, Kr = 1, Kt = 1, roughness = 0.1f, ior = 1.5f;
  float specularColor[3] = {1, 1, 1}, color[3] = {0, 0, 0};  // the second: background, dark or mortar colour
  float frequency = 8, octaves = 10, samples = 4, distance = 1, nearClip = 1, farClip = 11, density = 0.2f,
        stepSize = 0.5f;
};

using HandShader = void (*)(const HandTask&);

/// nullptr when there is none of that name for the instruction set (0 sse4, 1 avx2, 2 avx512).
HandShader handShader(std::string_view name, int isa);

}  // namespace fr::bench
