// texture() and bump(): OpenImageIO's anisotropic filter over the parallelogram that the changes of (s, t)
// span.
#include <algorithm>

#include "shading/textures/texture_cache.h"

namespace fr::textures {

OIIO::TextureOpt optionsOf(const FrTextureFile&, const FrTextureCall& call) {
  OIIO::TextureOpt o;
  o.firstchannel = std::max(0, call.firstChannel);
  o.fill = call.hasFill ? call.fill : 0.0f;
  o.interpmode = call.filter == FR_TEXTURE_SMOOTH    ? OIIO::TextureOpt::InterpSmartBicubic
                 : call.filter == FR_TEXTURE_NEAREST ? OIIO::TextureOpt::InterpClosest
                                                     : OIIO::TextureOpt::InterpBilinear;
  return o;
}

Channels channelsOf(const FrTextureFile& file, const FrTextureCall& call) {
  const bool grey =
      call.channelCount > 1 && !call.hasFill && call.firstChannel == 0 && file.info.channels < 3;
  return {grey ? 1 : std::clamp(call.channelCount, 1, 3), grey};
}

bool beyondChannels(const FrTextureFile& file, const FrTextureCall& call) {
  if (call.firstChannel < file.info.channels) return false;
  for (int c = 0; c < call.channelCount; ++c)
    std::fill_n(call.result + size_t(c) * call.resultStride, call.lanes, call.hasFill ? call.fill : 0.0f);
  return true;
}

std::string lookUpTexture(FrTextureFile& file, const FrTextureCall& call) {
  if (beyondChannels(file, call)) return "";
  OIIO::TextureSystem& system = *file.textures->system;
  auto* const thread = system.get_perthread_info();
  OIIO::TextureOpt options = optionsOf(file, call);
  const Channels channels = channelsOf(file, call);
  // A width of 0 is RISpec's way to ask for no filter at all.
  const float sWidth = std::max(0.0f, bounded(call.sWidth, 1e6f)),
              tWidth = std::max(0.0f, bounded(call.tWidth, 1e6f));
  const bool sloped = call.slope[0] && call.slope[1];
  uint64_t count = 0;
  bool failed = false;
  for (uint32_t i = 0; i < call.lanes; ++i) {
    if (call.active && !call.active[i]) continue;
    float texel[4] = {}, bySide[4] = {}, byHeight[4] = {};
    options.sblur = std::max(0.0f, boundedChange(at(call.sBlur, i)));
    options.tblur = std::max(0.0f, boundedChange(at(call.tBlur, i)));
    Footprint f{at(call.place[0], i),
                at(call.place[1], i),
                sWidth * at(call.placeDx[0], i),
                tWidth * at(call.placeDx[1], i),
                sWidth * at(call.placeDy[0], i),
                tWidth * at(call.placeDy[1], i)};
    condition(f);
    const bool ok =
        system.texture(file.texture, thread, options, f.s, f.t, f.dsdx, f.dtdx, f.dsdy, f.dtdy,
                       channels.asked, texel, sloped ? bySide : nullptr, sloped ? byHeight : nullptr);
    failed |= !ok;
    ++count;
    float* const to = call.result + i;
    for (int c = 0; c < call.channelCount; ++c)
      to[size_t(c) * call.resultStride] = bounded(texel[channels.grey ? 0 : std::min(c, 3)], kBrightest);
    if (sloped)
      call.slope[0][i] = bounded(bySide[0], kBrightest), call.slope[1][i] = bounded(byHeight[0], kBrightest);
  }
  file.textures->lookups.fetch_add(count, std::memory_order_relaxed);
  if (!failed) return "";
  const std::string why = system.geterror();
  return why.empty() ? "its texels cannot be read" : why;
}

}  // namespace fr::textures
