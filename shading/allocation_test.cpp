// A running shader allocates nothing once its machine has seen a batch of that size.
//
// A program of its own: it replaces operator new to count its calls.
#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>
#include <new>

#include "shading/machine_fixture.h"

namespace {
std::atomic<uint64_t> allocations{0};
std::atomic<bool> counting{false};
void* allocate(std::size_t size, std::size_t alignment) {
  if (counting.load(std::memory_order_relaxed)) allocations.fetch_add(1, std::memory_order_relaxed);
  void* const p = alignment > alignof(std::max_align_t)
                      ? std::aligned_alloc(alignment, (size + alignment - 1) / alignment * alignment)
                      : std::malloc(size ? size : 1);
  if (!p) std::abort();
  return p;
}
}  // namespace

void* operator new(std::size_t size) { return allocate(size, 0); }
void* operator new[](std::size_t size) { return allocate(size, 0); }
void* operator new(std::size_t size, std::align_val_t a) { return allocate(size, std::size_t(a)); }
void* operator new[](std::size_t size, std::align_val_t a) { return allocate(size, std::size_t(a)); }
void operator delete(void* p) noexcept { std::free(p); }
void operator delete[](void* p) noexcept { std::free(p); }
void operator delete(void* p, std::size_t) noexcept { std::free(p); }
void operator delete[](void* p, std::size_t) noexcept { std::free(p); }
void operator delete(void* p, std::align_val_t) noexcept { std::free(p); }
void operator delete[](void* p, std::align_val_t) noexcept { std::free(p); }
void operator delete(void* p, std::size_t, std::align_val_t) noexcept { std::free(p); }
void operator delete[](void* p, std::size_t, std::align_val_t) noexcept { std::free(p); }

namespace fr {
namespace {

struct Light {
  const char* source;
  bool shadows = false;
};
const Light kPoint = {
    "light p(float k = 1; point from = point (.3, .4, -2)) { illuminate (from) Cl = k / (L . L); }"};
const Light kShadowed = {kPoint.source, true};
const Light kAmbient = {"light a(float k = .2) { Cl = k; }"};
const Light kSpot = {
    "light s(output float __nondiffuse = .5) { illuminate (point (0, 0, -2), vector (0, 0, 1), .5) Cl = 1; "
    "}"};

void expectNone(const std::string& name, const std::string& source, const std::vector<Light>& lights = {}) {
  SCOPED_TRACE(name);
  for (const bool native : {false, true}) {
    MachineFixture m(15, 15);
    m.native = native;
    DerivativeStencil d;
    gridStencil(d, 15, 15, m.lanes, 1 / 15.0f, 1 / 15.0f);
    m.batch.stencil = &d;
    const auto s = m.shader(source);
    ASSERT_TRUE(s) << m.error;
    std::vector<std::unique_ptr<ShaderInstance>> made;
    std::vector<const ShaderInstance*> bound;
    for (const Light& l : lights) {
      const auto light = m.shader(l.source);
      ASSERT_TRUE(light) << m.error;
      made.push_back(std::make_unique<ShaderInstance>(*light));
      made.back()->shadows = l.shadows;
      bound.push_back(made.back().get());
    }
    for (int batch = 0; batch < 8; ++batch) m.run(*s, bound);
    allocations = 0;
    counting = true;
    for (int batch = 0; batch < 4; ++batch) m.run(*s, bound);
    counting = false;
    EXPECT_EQ(allocations.load(), 0u) << (native ? "machine code" : "kernels");
  }
}

TEST(Allocations, AreSeen) {
  allocations = 0;
  counting = true;
  std::vector<int> v(1000);
  counting = false;
  EXPECT_GE(allocations.load() + uint64_t(v[0]), 1u);
}

TEST(Allocations, NoneInARunningShader) {
  const std::string plastic =
      "surface t(float roughness = .1) { normal Nf = faceforward(normalize(N), I); Oi = Os;"
      " Ci = Os * (Cs * (ambient() + diffuse(Nf)) + specular(Nf, -normalize(I), roughness)); }";
  expectNone("arithmetic", "surface t() { Ci = noise(P * 4) + sqrt(u); Oi = Os; }");
  expectNone("plastic", plastic, {kPoint, kAmbient, kSpot});
  expectNone("shadows", plastic, {kShadowed, kAmbient, kSpot});
  expectNone(
      "control flow",
      "surface t() { float f(float x) { if (x > .5) return 1; return noise(x * 9); } float i, r = 0;"
      " for (i = 0; i < 5; i += 1) { if (i > u * 5) break; if (f(v) < .3) continue; r += f(u); } Ci = r; }");
  expectNone("derivatives",
             "surface t() { float x = u * v; Ci = color (Du(x), area(P), filterstep(.5, x)); }");
  expectNone(
      "arrays and splines",
      "surface t() { float k[4] = {1, 2, 3, 4}; k[floor(3 * u)] = v; Ci = spline(u, color 0, color 0, Cs, Cs)"
      " * k[floor(3 * v)] * random(); }");
  expectNone(
      "rays",
      "surface t() { Ci = trace(P, reflect(I, N)) * visibility(P, P + N) + occlusion(P, N, 4); Oi = 1; }");
  expectNone("gather",
             "surface t() { color c = 0, sum = 0; gather (\"\", P, N, 1, 4, \"surface:Ci\", c) sum += c; "
             "else sum += .1;"
             " Ci = sum; }");
  expectNone(
      "illuminance",
      "surface t() { color c = 0; illuminance (P, N, PI / 2, \"lightcache\", \"refresh\") { float k = 0;"
      " lightsource(\"__nondiffuse\", k); if (k > 0) continue; c += Cl; } Ci = c; }",
      {kPoint, kShadowed, kSpot});
  expectNone("state",
             "surface t() { float d = 0; string n = \"\"; rayinfo(\"depth\", d); if (match(\"t\", "
             "shadername()) != 0)"
             " d += 1; Ci = transform(\"world\", P) * d; }");
}

}  // namespace
}  // namespace fr
