/* A shadeop of the classic kind: called once for each point.

     float rings(point P, float frequency, float turbulence)      growth rings of a tree along z
     color palette(string name, float x)                          a named colour ramp

   Builds with any C compiler:  cc -shared -fPIC -O2 -I<include/frankenrender/shading> rings.c -o rings.so -lm
   The compiler of shaders and the renderers find rings.so in the shader search path. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "shadeop.h"

/* What an init function returns comes with every call of the thread that it ran in. Here: a table of phases. */
enum { kPhases = 64 };

SHADEOP_INIT(rings_init) {
  float* phase = malloc(kPhases * sizeof *phase);
  unsigned seed = 1;
  (void)ctx, (void)texturectx;
  for (int i = 0; phase && i < kPhases; ++i) {
    seed = seed * 1664525u + 1013904223u;
    phase[i] = (float)(seed >> 8) / 16777216.0f;
  }
  return phase;
}

SHADEOP_SHUTDOWN(rings_shutdown) { free(initdata); }

SHADEOP_TABLE(rings) = {{"float rings_of_point(point, float, float)", "rings_init", "rings_shutdown"},
                        {"float rings_of_radius(float, float, float)", "rings_init", "rings_shutdown"},
                        {"", "", ""}};

static float ring_at(const float* phase, float radius, float frequency, float turbulence) {
  const float x = radius * frequency;
  const int ring = (int)floorf(x) & (kPhases - 1);
  const float shift = phase ? turbulence * (phase[ring] - 0.5f) : 0;
  const float inside = x - floorf(x) + shift;
  return 0.5f - 0.5f * cosf(6.2831853f * inside);
}

SHADEOP(rings_of_point) {
  const float* P = argv[1];
  float* result = argv[0];
  (void)argc;
  *result = ring_at(initdata, sqrtf(P[0] * P[0] + P[1] * P[1]), *(float*)argv[2], *(float*)argv[3]);
  return 0;
}

SHADEOP(rings_of_radius) {
  (void)argc;
  *(float*)argv[0] = ring_at(initdata, *(float*)argv[1], *(float*)argv[2], *(float*)argv[3]);
  return 0;
}

SHADEOP_TABLE(palette) = {{"color palette_at(string, float)", "", ""}, {"", "", ""}};

SHADEOP(palette_at) {
  static const float kOak[2][3] = {{0.60f, 0.42f, 0.22f}, {0.32f, 0.18f, 0.08f}};
  static const float kPine[2][3] = {{0.85f, 0.69f, 0.45f}, {0.62f, 0.42f, 0.20f}};
  const STRING_DESC* name = argv[1];
  const float x = *(float*)argv[2];
  const float(*ramp)[3] = strcmp(name->s, "pine") == 0 ? kPine : kOak;
  float* result = argv[0];
  (void)argc, (void)initdata;
  for (int c = 0; c < 3; ++c) result[c] = ramp[0][c] + x * (ramp[1][c] - ramp[0][c]);
  return 0;
}
