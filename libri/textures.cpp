// RiMake...: textures of pictures.
#include "libri/context.h"

using namespace fr;
using namespace fr::libri;

namespace {

void make(const char* request, ri::MakeKind kind, ri::MakeTextureArgs a, RtInt n, RtToken* tokens,
          RtPointer* values) {
  withContext(request, [&](Context& c) {
    a.params = c.params(request, "MakeTexture", n, tokens, values);
    c.out().makeTexture(kind, std::move(a));
  });
}

ri::MakeTextureArgs filtered(const char* request, std::vector<std::string> pictures, RtString texture,
                             RtFilterFunc filter, RtFloat sWidth, RtFloat tWidth) {
  ri::MakeTextureArgs a;
  a.pictures = std::move(pictures), a.texture = text(texture);
  a.filter = filterNameOf(request, filter);
  a.sWidth = decimal(sWidth), a.tWidth = decimal(tWidth);
  return a;
}

ri::MakeTextureArgs listed(RtInt n, RtString const* pictures, RtString texture) {
  ri::MakeTextureArgs a;
  for (RtInt i = 0; pictures && i < n; ++i) a.pictures.push_back(text(pictures[i]));
  a.texture = text(texture);
  return a;
}

}  // namespace

extern "C" {

RtVoid RiMakeTextureV(RtString picture, RtString texture, RtToken swrap, RtToken twrap,
                      RtFilterFunc filterfunc, RtFloat swidth, RtFloat twidth, RtInt n, RtToken tokens[],
                      RtPointer parms[]) {
  auto a = filtered("RiMakeTexture", {text(picture)}, texture, filterfunc, swidth, twidth);
  a.sWrap = text(swrap), a.tWrap = text(twrap);
  make("RiMakeTexture", ri::MakeKind::kTexture, std::move(a), n, tokens, parms);
}
RtVoid RiMakeTexture(RtString picture, RtString texture, RtToken swrap, RtToken twrap,
                     RtFilterFunc filterfunc, RtFloat swidth, RtFloat twidth, ...) {
  FR_RI_LIST(twidth, RiMakeTextureV(picture, texture, swrap, twrap, filterfunc, swidth, twidth, FR_RI_TAIL));
}
RtVoid RiMakeBumpV(RtString picture, RtString texture, RtToken swrap, RtToken twrap, RtFilterFunc filterfunc,
                   RtFloat swidth, RtFloat twidth, RtInt n, RtToken tokens[], RtPointer parms[]) {
  auto a = filtered("RiMakeBump", {text(picture)}, texture, filterfunc, swidth, twidth);
  a.sWrap = text(swrap), a.tWrap = text(twrap);
  make("RiMakeBump", ri::MakeKind::kBump, std::move(a), n, tokens, parms);
}
RtVoid RiMakeBump(RtString picture, RtString texture, RtToken swrap, RtToken twrap, RtFilterFunc filterfunc,
                  RtFloat swidth, RtFloat twidth, ...) {
  FR_RI_LIST(twidth, RiMakeBumpV(picture, texture, swrap, twrap, filterfunc, swidth, twidth, FR_RI_TAIL));
}
RtVoid RiMakeLatLongEnvironmentV(RtString picture, RtString texture, RtFilterFunc filterfunc, RtFloat swidth,
                                 RtFloat twidth, RtInt n, RtToken tokens[], RtPointer parms[]) {
  make("RiMakeLatLongEnvironment", ri::MakeKind::kLatLongEnvironment,
       filtered("RiMakeLatLongEnvironment", {text(picture)}, texture, filterfunc, swidth, twidth), n, tokens,
       parms);
}
RtVoid RiMakeLatLongEnvironment(RtString picture, RtString texture, RtFilterFunc filterfunc, RtFloat swidth,
                                RtFloat twidth, ...) {
  FR_RI_LIST(twidth, RiMakeLatLongEnvironmentV(picture, texture, filterfunc, swidth, twidth, FR_RI_TAIL));
}
RtVoid RiMakeCubeFaceEnvironmentV(RtString px, RtString nx, RtString py, RtString ny, RtString pz,
                                  RtString nz, RtString texture, RtFloat fov, RtFilterFunc filterfunc,
                                  RtFloat swidth, RtFloat twidth, RtInt n, RtToken tokens[],
                                  RtPointer parms[]) {
  auto a = filtered("RiMakeCubeFaceEnvironment", {text(px), text(nx), text(py), text(ny), text(pz), text(nz)},
                    texture, filterfunc, swidth, twidth);
  a.fov = decimal(fov);
  make("RiMakeCubeFaceEnvironment", ri::MakeKind::kCubeFaceEnvironment, std::move(a), n, tokens, parms);
}
RtVoid RiMakeCubeFaceEnvironment(RtString px, RtString nx, RtString py, RtString ny, RtString pz, RtString nz,
                                 RtString texture, RtFloat fov, RtFilterFunc filterfunc, RtFloat swidth,
                                 RtFloat twidth, ...) {
  FR_RI_LIST(twidth, RiMakeCubeFaceEnvironmentV(px, nx, py, ny, pz, nz, texture, fov, filterfunc, swidth,
                                                twidth, FR_RI_TAIL));
}
RtVoid RiMakeShadowV(RtString picture, RtString texture, RtInt n, RtToken tokens[], RtPointer parms[]) {
  RtString one[] = {picture};
  make("RiMakeShadow", ri::MakeKind::kShadow, listed(1, one, texture), n, tokens, parms);
}
RtVoid RiMakeShadow(RtString picture, RtString texture, ...) {
  FR_RI_LIST(texture, RiMakeShadowV(picture, texture, FR_RI_TAIL));
}
RtVoid RiMakeOcclusionV(RtInt npictures, RtString pictures[], RtString texture, RtInt n, RtToken tokens[],
                        RtPointer parms[]) {
  make("RiMakeOcclusion", ri::MakeKind::kOcclusion, listed(npictures, pictures, texture), n, tokens, parms);
}
RtVoid RiMakeOcclusion(RtInt npictures, RtString pictures[], RtString texture, ...) {
  FR_RI_LIST(texture, RiMakeOcclusionV(npictures, pictures, texture, FR_RI_TAIL));
}
RtVoid RiMakeBrickMapV(RtInt nclouds, RtString clouds[], RtString brickmap, RtInt n, RtToken tokens[],
                       RtPointer parms[]) {
  make("RiMakeBrickMap", ri::MakeKind::kBrickMap, listed(nclouds, clouds, brickmap), n, tokens, parms);
}
RtVoid RiMakeBrickMap(RtInt nclouds, RtString clouds[], RtString brickmap, ...) {
  FR_RI_LIST(brickmap, RiMakeBrickMapV(nclouds, clouds, brickmap, FR_RI_TAIL));
}

}  // extern "C"
