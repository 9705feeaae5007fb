// RSL functions that come with the compiler. They are parsed with every shader; those that a shader calls are
// expanded in it like its own, so that there is one kind of light loop.
#include "shading/passes.h"

namespace fr {

std::string_view preludeSource() {
  // __nondiffuse and __nonspecular: 1 leaves the light out, fractions scale it.
  return R"(color ambient() {
  extern point P;
  color sum = 0;
  __ambientlights (P) { sum += Cl; }
  return sum;
}
color diffuse(normal N) {
  extern point P;
  color sum = 0;
  illuminance (P, N, PI/2) {
    float skip = 0;
    lightsource("__nondiffuse", skip);
    if (skip < 1) sum += Cl * ((1 - skip) * (normalize(L) . N));
  }
  return sum;
}
color diffuse(point N) { return diffuse(normal N); }
color diffuse(normal N; float angle) {
  extern point P;
  color sum = 0;
  illuminance (P, N, angle) {
    float skip = 0;
    lightsource("__nondiffuse", skip);
    if (skip < 1) sum += Cl * ((1 - skip) * (normalize(L) . N));
  }
  return sum;
}
normal shadingnormal(normal N) {
  extern vector I;
  float sides = 2;
  attribute("Sides", sides);
  float depth = 0;
  rayinfo("depth", depth);
  normal n = normalize(N);
  return sides == 2 || depth > 0 ? faceforward(n, I, n) : n;
}
float __exponent(float roughness) {
  return (__prmanspecular != 0 ? 8 : 1) / max(roughness, 1e-4);
}
color specularbrdf(vector L; normal N; vector V; float roughness) {
  return color (pow(max(0, N . normalize(L + V)), __exponent(roughness)));
}
color specular(normal N; vector V; float roughness) {
  extern point P;
  color sum = 0;
  float e = __exponent(roughness);
  illuminance (P, N, PI/2) {
    float skip = 0;
    lightsource("__nonspecular", skip);
    if (skip < 1) sum += Cl * ((1 - skip) * pow(max(0, N . normalize(normalize(L) + V)), e));
  }
  return sum;
}
color phong(normal N; vector V; float size) {
  extern point P;
  color sum = 0;
  vector R = reflect(-V, N);
  illuminance (P, N, PI/2) {
    float skip = 0;
    lightsource("__nonspecular", skip);
    if (skip < 1) sum += Cl * ((1 - skip) * pow(max(0, R . normalize(L)), size));
  }
  return sum;
}
)";
}

}  // namespace fr
