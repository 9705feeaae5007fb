// Functions for shadeop_test.cpp. Uses the header for authors and nothing else of ours.
#include <atomic>
#include <cstdlib>
#include <cstring>
#include <stdexcept>

#include "shadeop.h"

namespace {
std::atomic<int> inits{0}, shutdowns{0}, calls{0};
}

extern "C" __attribute__((visibility("default"))) int testShadeopCount(int what) {
  return what == 0 ? inits.load() : what == 1 ? shutdowns.load() : calls.load();
}

// Overloads: each says which it is.
SHADEOP_TABLE(which) = {{"float which_float(float)", "", ""},
                        {"float which_point(point)", "", ""},
                        {"float which_color(color)", "", ""},
                        {"float which_string(string)", "", ""},
                        {"color which_two(float, float)", "", ""},
                        {"float which_matrix(matrix)", "", ""},
                        {"", "", ""}};
#define WHICH(name, value)                 \
  SHADEOP(name) {                          \
    (void)initdata, (void)argc;            \
    *static_cast<float*>(argv[0]) = value; \
    return 0;                              \
  }
WHICH(which_float, 1)
WHICH(which_point, 2)
WHICH(which_color, 3)
WHICH(which_string, 4)
WHICH(which_matrix, 6)
SHADEOP(which_two) {
  (void)initdata, (void)argc;
  auto* r = static_cast<float*>(argv[0]);
  r[0] = *static_cast<float*>(argv[1]), r[1] = *static_cast<float*>(argv[2]), r[2] = float(argc);
  return 0;
}

// init data: one object for each thread.
SHADEOP_TABLE(counted) = {{"float counted_call(float)", "counted_init", "counted_shutdown"}, {"", "", ""}};
SHADEOP_INIT(counted_init) {
  (void)ctx, (void)texturectx;
  ++inits;
  return new int(40);
}
SHADEOP_SHUTDOWN(counted_shutdown) {
  ++shutdowns;
  delete static_cast<int*>(initdata);
}
SHADEOP(counted_call) {
  (void)argc;
  ++calls;
  *static_cast<float*>(argv[0]) = float(*static_cast<int*>(initdata)) + *static_cast<float*>(argv[1]);
  return 0;
}

// Results through arguments, in the old way: no mark in the table.
SHADEOP_TABLE(split) = {{"void split_call(point, float, color)", "", ""}, {"", "", ""}};
SHADEOP(split_call) {
  (void)initdata, (void)argc;
  auto* p = static_cast<float*>(argv[1]);
  *static_cast<float*>(argv[2]) = p[0];
  auto* c = static_cast<float*>(argv[3]);
  c[0] = p[2], c[1] = p[1], c[2] = p[0];
  p[0] = 99;  // a scribble: P itself must not move
  return 0;
}

// Strings: in, out by copying, out by realloc.
SHADEOP_TABLE(twice) = {{"string twice_call(string)", "", ""}, {"", "", ""}};
SHADEOP(twice_call) {
  (void)initdata, (void)argc;
  auto* out = static_cast<STRING_DESC*>(argv[0]);
  const auto* in = static_cast<STRING_DESC*>(argv[1]);
  const size_t n = std::strlen(in->s);
  if (size_t(out->bufflen) < 2 * n + 1) {
    out->s = static_cast<char*>(std::realloc(out->s, 2 * n + 1));
    out->bufflen = int(2 * n + 1);
  }
  std::memcpy(out->s, in->s, n);
  std::memcpy(out->s + n, in->s, n + 1);
  return 0;
}

// Arrays.
SHADEOP_TABLE(total) = {
    {"float total_three(float[3])", "", ""}, {"color total_colors(color[2])", "", ""}, {"", "", ""}};
SHADEOP(total_three) {
  (void)initdata, (void)argc;
  const auto* x = static_cast<float*>(argv[1]);
  *static_cast<float*>(argv[0]) = x[0] + x[1] + x[2];
  return 0;
}
SHADEOP(total_colors) {
  (void)initdata, (void)argc;
  const auto* x = static_cast<float*>(argv[1]);
  for (int c = 0; c < 3; ++c) static_cast<float*>(argv[0])[c] = x[c] + x[3 + c];
  return 0;
}

// A batch at once; also there point by point, which must not be taken.
SHADEOP_TABLE(scaled) = {{"color scaled_point(color, float)", "", ""}, {"", "", ""}};
WHICH(scaled_point, -1)
FR_SHADEOP_TABLE(scaled) = {{"color scaled_batch(color, float, output float, float[])", "", ""},
                            {"", "", ""}};
FR_SHADEOP(scaled_batch) {
  (void)initdata;
  ++calls;
  for (int i = 0; i < batch->lanes; ++i) {
    if (!batch->mask[i]) continue;
    const float f = *fr_shadeop_at(&batch->arg[2], 0, i);
    for (int c = 0; c < 3; ++c)
      *fr_shadeop_at(&batch->arg[0], c, i) = f * *fr_shadeop_at(&batch->arg[1], c, i);
    float sum = 0;
    for (int k = 0; k < batch->arg[4].components; ++k) sum += *fr_shadeop_at(&batch->arg[4], k, i);
    *fr_shadeop_at(&batch->arg[3], 0, i) = sum;
  }
  return batch->version == FR_SHADEOP_VERSION ? 0 : 1;
}

// Not what a renderer likes to get.
SHADEOP_TABLE(unfit) = {{"float unfit_call(float)", "", ""}, {"", "", ""}};
SHADEOP(unfit_call) {
  (void)initdata, (void)argc;
  const float x = *static_cast<float*>(argv[1]);
  if (x > 10) throw std::runtime_error("unfit");
  *static_cast<float*>(argv[0]) = x * 0.0f / 0.0f;
  return 0;
}
