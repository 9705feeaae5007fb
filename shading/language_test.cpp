// What has been written in RSL since 1988: forms of the language one by one, and the shaders of tests/rsl.
// All compile without an error, run, and give the same bits by kernels and by machine code, finite ones.
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "shading/machine_fixture.h"

namespace fr {
namespace {

struct Form {
  const char* name;
  const char* source;
};

/// One thing each.
const std::vector<Form>& forms() {
  // clang-format off
  static const std::vector<Form> list = {
      {"untyped_fn", R"sl(twice(float x) { return 2 * x; } surface a() { Ci = twice(u); Oi = 1; })sl"},
      {"void_fn_out", R"sl(void f(output float x; float y) { x = y; } surface a() { float q; f(q, u); Ci = q; Oi = Os; })sl"},
      {"macro_cont", R"sl(#define ADD(x, y) \
  ((x) + \
   (y))
surface a() { Ci = ADD(u, v); Oi = 1; })sl"},
      {"nolint", R"sl(surface a() {
#pragma nolint 2
 float x = Du(u);
 Ci = x; Oi = 1; })sl"},
      {"string_concat_adj", R"sl(surface a(string s = "ab" "cd") { Ci = (s == "abcd") ? 1 : 0; Oi = 1; })sl"},
      {"comma_decl", R"sl(surface a() { float a1 = 1, b1 = a1 + 1, c1; color k = color (a1, b1, 0), m; c1 = 2; m = k * c1; Ci = m; Oi = 1; })sl"},
      {"chain_assign", R"sl(surface a() { float x, y, z; x = y = z = u; color c; c = Ci = x + y + z; Oi = c; })sl"},
      {"ternary_color", R"sl(surface a() { color c = (u > .5) ? color (1, 0, 0) : color "hsv" (.3, 1, 1); Ci = c; Oi = 1; })sl"},
      {"tuple_nocast", R"sl(surface a() { point p = (1, 2, 3); color c = (u, v, 0); vector q = (0, 0, 1); Ci = c + color (p . q); Oi = 1; })sl"},
      {"tex_cast", R"sl(surface a(string t1 = "x") { float f = texture(t1); color c = texture(t1, s, t); f += float texture(t1[2], s, t, s + .1, t, s, t + .1, s + .1, t + .1); Ci = c * f; Oi = 1; })sl"},
      {"uniform_fn_nested", R"sl(surface a() { uniform float n = 0; uniform float next() { extern uniform float n; n += 1; return cellnoise(n, 3); } varying color tint(float x) { return color (x, 0, 0); } Ci = tint(next() + next()); Oi = n; })sl"},
      {"shading_normal", R"sl(surface a() { normal n = shadingnormal(N); Ci = diffuse(n); Oi = 1; })sl"},
      {"bump_corners", R"sl(surface a(string b = "x") { N = bump(b[1], N, dPdu, dPdv, s, t, s + .1, t, s, t + .1, s + .1, t + .1, "blur", .1); Ci = N . N; Oi = 1; })sl"},
      {"turned_light", R"sl(light a(vector axis = vector "shader" (0, 0, 1)) { illuminate (point "shader" (0, 0, 0), axis, PI / 2) { Cl = 1; L = axis * length(L); } })sl"},
      {"env_all", R"sl(surface a(string e = "x") { Ci = environment(e, N) + color environment(e, N, N, N, N, "blur", .1) + environment(e[1], N); Oi = 1; })sl"},
      {"shadow_old", R"sl(light a(string sh = "x") { illuminate (point (0,0,0)) { Cl = 1 - shadow(sh, Ps, "samples", 16, "blur", .02, "bias", .1); } })sl"},
      {"bumpfn", R"sl(surface a(string b = "x") { N = bump(b, N, dPdu, dPdv, s, t); Ci = N . N; Oi = 1; })sl"},
      {"array_param", R"sl(surface a(float k[3] = {1, 2, 3}; uniform string n[2] = {"a", "b"}; varying point p[2] = {0, 1};) { Ci = k[1] * comp(color p[1], 0); Oi = 1; })sl"},
      {"array_fn", R"sl(float total(float a[]; float n) { float i, t = 0; for (i = 0; i < n; i += 1) t += a[i]; return t; } surface a() { float w[4] = {1, 2, 3, 4}; Ci = total(w, 4); Oi = 1; })sl"},
      {"nested_fn_extern", R"sl(surface a(float k = 2;) { float x = 3; float f(float y) { extern float x, k; return x * k * y; } Ci = f(u); Oi = 1; })sl"},
      {"for_empty", R"sl(surface a() { float i = 0; for (;;) { i += 1; if (i > 3) break; } Ci = i; Oi = 1; })sl"},
      {"while_noblock", R"sl(surface a() { float i = 0; while (i < 4) i += 1; Ci = i; Oi = 1; })sl"},
      {"if_dangling", R"sl(surface a() { float r = 0; if (u > .5) if (v > .5) r = 1; else r = 2; Ci = r; Oi = 1; })sl"},
      {"empty_stmt", R"sl(surface a() { ;; Ci = 1;; { } Oi = 1; })sl"},
      {"logic", R"sl(surface a() { float x = (u > .1 && v < .9) || !(u == v); Ci = x; Oi = 1; })sl"},
      {"neg_vec", R"sl(surface a() { vector V = -I; normal Nn = -N; point P2 = -P; Ci = color (V . Nn) + color (vector P2 . V); Oi = 1; })sl"},
      {"prec", R"sl(surface a() { Ci = N . I * 2 + -u * v; Oi = 1 - u ; vector w = N ^ I * 2; Ci += w . w; })sl"},
      {"matrix_lit", R"sl(surface a(matrix m = 1; matrix k = matrix "shader" 1; matrix j = matrix "world" (1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1)) { point p = transform(m * k / j, P); Ci = xcomp(p); Oi = 1; })sl"},
      {"mtransform", R"sl(surface a() { matrix m = mtransform("world", matrix 1); Ci = determinant(m) + comp(m, 0, 0); Oi = 1; })sl"},
      {"setcomps", R"sl(surface a() { color c = 0; point p = 0; setcomp(c, 1, u); setxcomp(p, u); setycomp(p, v); setzcomp(p, 1); Ci = c + color p; Oi = 1; })sl"},
      {"spline_str", R"sl(surface a(string basis = "b-spline") { Ci = spline("catmull-rom", u, color 0, color 0, color 1, color 1) + spline(basis, u, 0, 0, 1, 1); Oi = 1; })sl"},
      {"noise_forms", R"sl(surface a() { Ci = color noise(P) + color noise(u, v) + color noise(P, u) + float noise(u) + color (vector noise(P)) ; point q = point noise(P * 2); Ci += color cellnoise(q, u) + color pnoise(P, u, point (2, 2, 2), 3); Oi = 1; })sl"},
      {"printf", R"sl(surface a() { printf("u %f P %p c %c s %s m %m %d\n", u, P, Cs, "x", matrix 1, 3); Ci = 1; Oi = 1; })sl"},
      {"fmt", R"sl(surface a() { string s1 = format("tex.%d.tif", 3), s2 = concat("a", s1, "b"); Ci = match("tif", s2); Oi = 1; })sl"},
      {"illum_cat", R"sl(surface a() { color c = 0; illuminance ("key", P, N, PI/2) c += Cl; illuminance ("-key", P) { c += Cl * Ol; } Ci = c; Oi = 1; })sl"},
      {"illum_body_vars", R"sl(surface a() { color c = 0; illuminance (P, N, 1.57) { vector Ln = normalize(L); float d = Ln . N; c += Cl * d; } Ci = c; Oi = 1; })sl"},
      {"solar_noargs", R"sl(light a(color c = 1) { solar () { Cl = c; } })sl"},
      {"illum_cone", R"sl(light a() { illuminate (P, N, .5) { Cl = 1; Ol = 1; } })sl"},
      {"light_uses_surf", R"sl(light a() { illuminate (point "shader" (0,0,0)) { Cl = max(0, normalize(-L) . Ns) * (1 / (L . L)); } })sl"},
      {"volume_min", R"sl(volume a(color fog = .5; float d = 3) { Ci = mix(fog, Ci, exp(-length(I) / d)); Oi = 1; })sl"},
      {"imager_min", R"sl(imager a(color b = 1) { Ci += (1 - alpha) * b; alpha = 1; Oi = 1; })sl"},
      {"transformation", R"sl(transformation a(float k = 1) { P += k * N; })sl"},
      {"array_length", R"sl(float sum(float a[]) { float i, r = 0; for (i = 0; i < arraylength(a); i += 1) r += a[i]; return r; }
         surface a(float k[4] = {1, 2, 3, 4};) { Ci = sum(k); Oi = 1; })sl"},
      {"shadow_source", R"sl(light a(string sh = "x") { point c = point (0,0,0); illuminate (c) {
         Cl = 1 - shadow(sh, Ps, "source", c, c + vector (1, 0, 0), c + vector (0, 1, 0), c + vector (1, 1, 0), "gapbias", .1, "samples", 16)
            - .1 * shadow(sh, Ps, "blur", .1, "source", c, c, "samples", 4); } })sl"},
      {"param_changed", R"sl(surface a(float Kd = .5; color c = 1; float w[2] = {1, 2};) { Kd *= noise(P); c = mix(c, Cs, Kd); w[1] = s; Ci = c * w[1]; Oi = Kd; })sl"},
      {"output_class", R"sl(surface a(output float mask = 0; output color layer; output color set[2] = {0, 1}; output uniform float u1 = 0) {
         mask = s; layer = color (s, t, 0); set[1] = layer * mask; u1 = 2; Ci = set[1] * u1; Oi = 1; })sl"},
      {"shader_words", R"sl(surface a(float volume = 1) { color light = color (1, .3, .2), surface = .5; float displacement = 2, imager = 1; string class = "x";
         float got = surface("K", imager); Ci = light * surface * volume * displacement + got; Oi = 1; })sl"},
      {"tex_element", R"sl(surface a(string maps[2] = {"x", "y"};) { uniform float i; color c = 0; for (i = 0; i < 2; i += 1) c += color texture(maps[i], s, t) + texture(maps[i][1]);
         Ci = c + environment(maps[1], N, "blur", .1); Oi = 1; })sl"},
      {"class_surface", R"sl(class a(float Ka = 1; uniform color tint = color(1, .5, .2); output varying color direct = 0;) {
         varying normal Nn = 0; constant float gain = 2; private float twice(float x) { return x * gain; }
         public void construct() { gain = 3; }
         public void begin() { Nn = normalize(N); }
         public void displacement(output point P; output normal N) { P += .1 * normalize(N) * noise(P); N = calculatenormal(P); }
         public void opacity(output color Oi) { Oi = Os; }
         public void prelighting(output color Ci, Oi) { helper(); }
         void helper() { direct = tint * twice(.25); }
         public void lighting(output color c, o) { if (Ka == 0) return; c = direct * Ka * diffuse(Nn); o = 1; } })sl"},
      {"class_calls", R"sl(class a() { void lighting(output color Ci, Oi) { surface(Ci, Oi); } void surface(output color Ci, Oi) { Ci = 1; Oi = 1; } })sl"},
      {"class_light", R"sl(class a(float intensity = 1; point from = point "shader" (0, 0, 0); string __category = "";) {
         public void light(output vector L; output color Cl;) {
           illuminate (from) { Cl = intensity / (L . L); } } })sl"},
      {"class_disp", R"sl(class a(float Km = .1) { public void displacement(output point P; output normal N;) { P += Km * N; } })sl"},
      {"disp_old", R"sl(displacement a(float Km = .1) { P += Km * noise(10 * s, 10 * t) * normalize(N); N = normalize(calculatenormal(P)); })sl"},
      {"disp_surfN", R"sl(surface a() { normal NN = calculatenormal(P + .1 * normalize(N) * noise(P)); N = NN; Ci = NN . NN; Oi = Os; })sl"},
      {"output_params", R"sl(surface a(output varying color c1 = 0; output float f1 = 0; output varying normal n1 = 0) { c1 = Cs; f1 = 2; n1 = N; Ci = c1; Oi = 1; })sl"},
      {"fresnel4", R"sl(surface a() { float kr, kt; fresnel(normalize(I), normalize(N), 1 / 1.5, kr, kt); vector R, T; fresnel(normalize(I), normalize(N), .6, kr, kt, R, T); Ci = kr + R . T; Oi = 1; })sl"},
      {"ray_fns", R"sl(surface a() { float d = rayhittest(P, N, P, N); Ci = d; Oi = 1; })sl"},
      {"trace_opts", R"sl(surface a() { float d = trace(P, N); color c = trace(P, N, "maxdist", 10, "samplecone", .1, "samples", 2, "label", "x", "subset", "set1"); Ci = c * d; Oi = transmission(P, P + N, "samples", 2); })sl"},
      {"gather_else", R"sl(surface a() { color c = 0, h = 0; vector d = 0; gather ("illuminance", P, N, PI/2, 8, "surface:Ci", h, "ray:direction", d, "maxdist", 5) { c += h; } else { c += color environment("x", d); } Ci = c / 8; Oi = 1; })sl"},
      {"occ_opts", R"sl(surface a() { vector e = 0; color ec = 0; float o = occlusion(P, N, 16, "maxdist", 5, "falloff", 1, "falloffmode", 0, "environmentdir", e, "bias", .01, "coneangle", PI/3, "distribution", "cosine"); Ci = 1 - o + .01 * e . e; Oi = 1; })sl"},
      {"companions_ps", R"sl(surface a(varying vector x = dPdu;) { point corner = point "world" (0, 0, -4); Ci = length(corner - Ps) + length(x); Oi = 1; })sl"},
      {"no_more_params", R"sl(#define REST
surface a(; float Ka = 1;; REST; color c = 0;) { Ci = Ka + c; Oi = 1; })sl"},
      {"occ_map", R"sl(surface a(string map = "";) { normal n = normalize(N); float o = occlusion(map, P, n, 16) + occlusion("m.tx", P, n, 0, "maxdist", 5, "bias", .01); Ci = 1 - o; Oi = 1; })sl"},
      {"indirect", R"sl(surface a() { Ci = indirectdiffuse(P, N, 8, "maxdist", 3) + caustic(P, N); Oi = 1; })sl"},
      {"attr", R"sl(surface a() { float sr; uniform string nm = ""; uniform color rc = 0; attribute("ShadingRate", sr); attribute("identifier:name", nm); attribute("Ri:Color", rc); attribute("user:x", sr); Ci = rc * sr; Oi = 1; })sl"},
      {"defaults_expr", R"sl(surface a(float a1 = radians(30); point p1 = point "world" (0, 1, 0) + point (1, 0, 0); color c1 = 2 * color (.1, .2, .3); vector v1 = normalize(vector (1, 1, 0));) { Ci = c1 * a1; Oi = 1; })sl"},
      {"hex_floats", R"sl(surface a() { Ci = 1. + .5 + 1e-3 + 1E+2 + 0.25; Oi = 1; })sl"},
      {"cpp_comments", R"sl(// head
surface a() /* x */ { // y
 Ci = 1; /* multi
 line */ Oi = 1; })sl"},
      {"ifdefs", R"sl(#if defined(PRMAN) && !defined(BMRT)
broken here
#elif 1
surface a() { Ci = 1; Oi = 1; }
#endif)sl"},
      {"two_shaders_fn", R"sl(#define K 3
color c3() { return K; }
surface a() { Ci = c3(); Oi = 1; })sl"},
      {"return_void", R"sl(void f(float x; output color c) { if (x > .5) { c = 1; return; } c = 0; } surface a() { color k; f(u, k); Ci = k; Oi = 1; })sl"},
      {"return_early", R"sl(float f(float x) { if (x > .5) return 1; else return 2; } surface a() { Ci = f(u); Oi = 1; })sl"},
      {"uniform_ret", R"sl(uniform float f(uniform float x) { return x * 2; } surface a(float k = 2) { uniform float q = f(k); Ci = q; Oi = 1; })sl"},
      {"varying_kw_fn", R"sl(varying color f(varying point p) { return color noise(p); } surface a() { Ci = f(P); Oi = 1; })sl"},
      {"string_arr_param", R"sl(surface a(string names[3] = {"a", "b", "c"}) { uniform float i; color c = 0; for (i = 0; i < 3; i += 1) if (names[i] == "b") c += 1; Ci = c; Oi = 1; })sl"},
      {"msgs", R"sl(surface a() { float x = 0; color c = 0; displacement("x", x); atmosphere("c", c); incident("x", x); opposite("x", x); lightsource("x", x); surface("x", x); Ci = c + x; Oi = 1; })sl"},
      {"rotate_forms", R"sl(surface a() { point q = rotate(P, PI / 4, point (0,0,0), point (0,0,1)); Ci = color q; Oi = 1; })sl"},
      {"ctrans", R"sl(surface a() { Ci = ctransform("rgb", "hsv", Cs) + ctransform("hsv", Cs) + ctransform("YIQ", "rgb", Cs); Oi = 1; })sl"},
      {"depthfn", R"sl(surface a() { Ci = depth(P); Oi = 1; })sl"},
      {"deriv", R"sl(surface a() { Ci = Deriv(u * v, u) + length(Du(P)) + Du(Cs) + comp(Deriv(Cs, v), 0); Oi = 1; })sl"},
      {"area2", R"sl(surface a() { Ci = area(P) + area(P, "dicing"); Oi = 1; })sl"},
      {"filterstep_v", R"sl(surface a() { Ci = filterstep(.5, s) + filterstep(.5, s, s + .1) + filterstep(.5, s, "filter", "gaussian", "width", 2); Oi = 1; })sl"},
      {"minmax_many", R"sl(surface a() { Ci = min(u, v, s, t, .5) + max(Cs, Os, color .5) ; Oi = clamp(Os, color 0, color 1); })sl"},
      {"mix_color_t", R"sl(surface a() { Ci = mix(color 0, Cs, color (u, v, 0)); Oi = 1; })sl"},
      {"phong", R"sl(surface a() { Ci = phong(normalize(N), -normalize(I), 20) + specularbrdf(normalize(I), N, -I, .1); Oi = 1; })sl"},
      {"E_use", R"sl(surface a() { vector v1 = normalize(E - P); Ci = v1 . N + ncomps + time + dtime + dPdtime . dPdtime; Oi = 1; })sl"},
      {"break2", R"sl(surface a() { float i, j, r = 0; for (i = 0; i < 3; i += 1) for (j = 0; j < 3; j += 1) { if (i * j > u) break 2; r += 1; } Ci = r; Oi = 1; })sl"},
      {"cond_assign", R"sl(surface a() { float x = 0; if ((x = u) > .5) x += 1; Ci = x; Oi = 1; })sl"},
      {"string_ternary", R"sl(surface a(float k = 1) { string s1 = k > 0 ? "a" : "b"; Ci = s1 == "a"; Oi = 1; })sl"},
      {"pt_arith", R"sl(surface a() { point m = (P + point "world" (0,0,0)) / 2; vector d = P - m; point e = m + d * 2; Ci = color (e - P) ; Oi = 1; })sl"},
      {"color_idx", R"sl(surface a() { color c = Cs; c[0] = u; float q = c[1] + P[2]; Ci = c * q; Oi = 1; })sl"},
      {"fn_overload", R"sl(float f(float x) { return x; } color f(color x) { return x * 2; } surface a() { Ci = f(Cs) + f(u); Oi = 1; })sl"},
      {"shadow_lights", R"sl(light a(float intensity = 1; string shadowname = "raytrace") { uniform float i; illuminate (point "shader" (0,0,0), vector "shader" (0,0,1), .5) { Cl = intensity * (1 - float shadow(shadowname, Ps, "samples", 4)); } })sl"},
      {"fn_output_array", R"sl(void fill(output float a[]; float k) { a[0] = k; a[1] = 2 * k; } surface a() { float w[2]; fill(w, u); Ci = w[0] + w[1]; Oi = 1; })sl"},
      {"atmos_kw", R"sl(surface a() { string atmos = "x"; Ci = 1; Oi = 1; })sl"},
      {"op_assign_div", R"sl(surface a() { color c = 1; c /= 2; c *= Cs; c -= .1; point p = P; p += N; p -= vector (0,0,1); p *= 2; Ci = c + color p; Oi = 1; })sl"},
      {"missing_default", R"sl(surface a(float x) { Ci = x; Oi = 1; })sl"},
      {"ordered_by_floats", R"sl(surface a(string map = "x") { float r = 0; if (trace(P, N) > 1e30 && texture(map, s, t) <= .5) r = 1; Ci = r + (noise(P) > .5); Oi = 1; })sl"},
      {"rayinfo", R"sl(surface a() { uniform string t1 = ""; float d = 0; vector dir = 0; rayinfo("type", t1); rayinfo("depth", d); rayinfo("direction", dir); Ci = (t1 == "camera") ? d : dir . dir; Oi = 1; })sl"},
      {"raydepth", R"sl(surface a() { Ci = raydepth() + raylevel() + isshadowray(); Oi = 1; })sl"},
      {"substr", R"sl(surface a() { string q = substr("hello", 1, 3); Ci = strlen(q); Oi = 1; })sl"},
      {"texinfo", R"sl(surface a() { uniform float r[2] = {0, 0}; uniform string ty = ""; float f = textureinfo("x", "resolution", r); f += textureinfo("x", "type", ty); Ci = f + r[0]; Oi = 1; })sl"},
      {"tex3d", R"sl(surface a() { color c = 0; float ok = texture3d("x", P, N, "c", c); Ci = c * ok; Oi = 1; })sl"},
      {"bake", R"sl(surface a() { bake3d("x", "", P, N, "c", Cs); bake("y", s, t, Cs); Ci = 1; Oi = 1; })sl"},
      {"photonmap", R"sl(surface a() { Ci = photonmap("x", P, N, "estimator", 50); Oi = 1; })sl"},
      {"light_arrays", R"sl(light a(float ks[2] = {1, 2}) { illuminate (point (0,0,0)) Cl = ks[0] + ks[1]; })sl"},
      {"blackmagic_P", R"sl(displacement a() { point Po = transform("object", P); vector d = vtransform("object", vector normalize(N)); P = transform("object", "current", Po + d * .1); N = calculatenormal(P); })sl"},
      {"keyword_names", R"sl(surface a() { float radius = 1, distance1 = 2, scale1 = 3, color1 = 4; Ci = radius + distance1 + scale1 + color1; Oi = 1; })sl"},
      {"shadow_builtin_names", R"sl(surface a() { float step = .1, noise1 = 2, depth = 3, area = 1, distance = 4; Ci = step + depth + area + distance; Oi = 1; })sl"},
      {"declared_after", R"sl(surface a() { Ci = 0; float x = u; { float x = v; Ci += x; } Ci += x; Oi = 1; })sl"},
      {"log_ops", R"sl(surface a() { if (u && v || !s) Ci = 1; else Ci = 0; Oi = 1; })sl"},
      {"pow_color_scalar", R"sl(surface a() { color c = Cs; Ci = color (pow(comp(c, 0), 2), 0, 0); Oi = 1; })sl"},
      {"uniform_loop", R"sl(surface a() { uniform float i; color c = 0; for (i = 0; i < 4; i = i + 1) { c += color cellnoise(i); } Ci = c; Oi = 1; })sl"},
      {"crlf", "surface a()\r\n{\r\n Ci = 1;\r\n Oi = 1;\r\n}\r\n"},
      {"extern_globals", R"sl(color lit() { extern normal N; extern vector I; extern point P; color c = 0; illuminance (P, N, PI / 2) { extern color Cl; extern vector L; c += Cl * (normalize(L) . normalize(N)); } return c; } surface a() { Ci = lit(); Oi = 1; })sl"},
      {"fn_in_light", R"sl(light a() { float fall(float d) { return 1 / (d * d); } illuminate (point (0,0,0)) { Cl = fall(length(L)); } })sl"},
      {"string_default_empty", R"sl(surface a(string a1 = "", b1 = ""; float f = 1, g = 2;) { Ci = f + g; Oi = 1; })sl"},
      {"no_semicolon_params", R"sl(surface a(float a1 = 1; color c1 = 1; string s1 = "") { Ci = a1 * c1; Oi = 1; })sl"},
      {"typed_string_space", R"sl(surface a(string sp = "world") { point p = point "world" (0, 0, 0); point q = transform(sp, P); vector w = vtransform(sp, "object", N); Ci = color q + color (p + w); Oi = 1; })sl"},
  };
  // clang-format on
  return list;
}

/// Runs a shader of any type over a grid under a few lights; "" or what is wrong with the results.
std::string run(const std::string& source, const std::vector<std::string>& includePaths) {
  std::vector<float> results[2];
  for (const bool native : {false, true}) {
    MachineFixture m(16, 12);
    m.native = native;
    m.includePaths = includePaths;
    DerivativeStencil d;
    gridStencil(d, 16, 12, m.lanes, 1 / 16.0f, 1 / 12.0f);
    m.batch.stencil = &d;
    // A bent sheet; colours for volumes and imagers to change.
    const auto g = [&](GlobalId id) -> Operand& { return m.batch.globals[size_t(id)]; };
    for (uint32_t i = 0; i < m.lanes; ++i) {
      const float x = g(GlobalId::k_P).at(i, 0), y = g(GlobalId::k_P).at(i, 1);
      g(GlobalId::k_P).comp(2)[i] = g(GlobalId::k_I).comp(2)[i] = 2 + .3f * std::sin(3 * x) * std::cos(2 * y);
      g(GlobalId::k_N).comp(0)[i] = x - .5f, g(GlobalId::k_N).comp(1)[i] = .5f - y;
    }
    AlignedFloats more;
    more.reserve(size_t(m.lanes) * 10);
    std::fill_n(more.data(), size_t(m.lanes) * 10, .25f);
    g(GlobalId::k_Ci) = Operand{more.data(), m.lanes, ~0u};
    g(GlobalId::k_alpha) = Operand{more.data() + 3 * size_t(m.lanes), m.lanes, ~0u};
    g(GlobalId::k_dPdu) = Operand{more.data() + 4 * size_t(m.lanes), m.lanes, ~0u};
    g(GlobalId::k_dPdv) = Operand{more.data() + 7 * size_t(m.lanes), m.lanes, ~0u};
    for (const char* name : {"object", "raster", "screen", "NDC", "a", "b"}) m.host.spaces[name] = DMat4(1.0);
    m.oracle = [](PendingRays& r) {
      for (uint32_t k = 0; k < r.count; k += 2) r.hitDistance[k] = 2, r.color[1][k] = .5f, r.missDepth[k] = 0;
    };
    const auto shader = m.shader(source);
    if (!shader) return "not compiled: " + m.error;
    std::vector<const ShaderInstance*> lights;
    const auto light = [&](const std::string& text) {
      const auto l = m.shader(text);
      EXPECT_TRUE(l) << m.error;
      if (l) lights.push_back(l.get());
    };
    const ShaderInstance* first = shader.get();
    std::shared_ptr<const ShaderInstance> matte;
    light("light s() { illuminate (point (0, 1, -2), vector (.2, -.1, 1), .7) Cl = 6 / (L . L); }");
    light("light d() { solar (vector (.3, -1, 1), 0) Cl = .5; }");
    light("light a(float k = .1) { Cl = k; }");
    if (shader->program().type == ShaderType::kLight) {
      lights.push_back(first);
      matte =
          m.shader("surface m() { Ci = ambient() + diffuse(normalize(N)) + specular(N, -I, .2); Oi = Os; }");
      first = matte.get();
    }
    m.run(*first, lights);
    m.run(*first, lights);
    for (const char* name : {"Ci", "Oi", "P", "N"}) {
      const Operand o = m.machine.result(name);
      for (uint32_t i = 0; o.data && i < m.count; ++i)
        for (uint32_t c = 0; c < 3; ++c) results[native].push_back(o.at(i, c));
    }
  }
  for (size_t k = 0; k < results[0].size(); ++k) {
    if (!std::isfinite(results[0][k])) return fmt::format("value {} is {}", k, results[0][k]);
    if (std::memcmp(&results[0][k], &results[1][k], sizeof(float)) != 0)
      return fmt::format("value {}: {} by kernels, {} by machine code", k, results[0][k], results[1][k]);
  }
  return results[0].size() == results[1].size() ? "" : "other results";
}

TEST(Language, FormsCompileAndRun) {
  setReportSink([](const Error&) {});
  for (const Form& f : forms()) EXPECT_EQ(run(f.source, {}), "") << f.name << "\n" << f.source;
  setReportSink({});
}

TEST(Language, ShadersOfAllMannersCompileAndRun) {
  setReportSink([](const Error&) {});
  const std::filesystem::path folder = std::filesystem::path(FR_SOURCE_DIR) / "tests/rsl";
  int count = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (entry.path().extension() != ".sl") continue;
    ++count;
    std::stringstream text;
    text << std::ifstream(entry.path()).rdbuf();
    EXPECT_EQ(run(text.str(), {folder.string()}), "") << entry.path();
  }
  EXPECT_GE(count, 40);
  setReportSink({});
}

}  // namespace
}  // namespace fr
