#include "scene_cache/procedural_request.h"

#include "base/install_folders.h"
#include "ri/rib_writer.h"

namespace fr::cache {
namespace {

using Kind = ProceduralRequest::Kind;

std::optional<ri::Bound> boundOf(const ri::ParamList& params) {
  const ri::Param* p = params.find("bound");
  if (!p) p = params.find("__bound");
  if (!p || p->elementCount() < 6) return {};
  ri::Bound b;
  for (size_t i = 0; i < 6; ++i) b[i] = double(ri::toFloat(*p, 0, i));
  return b;
}

}  // namespace

Result<ProceduralRequest> proceduralRequest(const ri::Procedural& p, const ri::AttributeState& attributes) {
  ProceduralRequest r;
  r.immediate = attributes.values.getInt("procedural:immediatesubdivide", 0) != 0;
  if (p.kind == ri::ProceduralKind::kProcedural2) {
    const std::string_view f = p.subdivide;
    const char* name = nullptr;
    if (f == "DelayedReadArchive" || f == "DelayedReadArchive2") {
      r.kind = Kind::kArchive, name = "filename";
    } else if (f == "DynamicLoad" || f == "DynamicLoad2") {
      r.kind = Kind::kSharedObject, name = "dsoname";
    } else if (f == "RunProgram" || f == "RunProgram2") {
      r.kind = Kind::kProgram, name = "programname";
    } else {
      return makeError(RiError::kBadToken, "Procedural2 knows no function \"{}\"", p.subdivide);
    }
    r.name = p.params.getString(name, "");
    r.data = p.params.getString("data", "");
    if (r.name.empty())
      return makeError(RiError::kMissingData, "Procedural2 \"{}\" without \"{}\"", p.subdivide, name);
    if (const auto b = boundOf(p.params)) r.bound = *b;
    r.immediate |= p.params.getFloat("immediatesubdivide", p.params.getFloat("__immediatesubdivide", 0)) != 0;
    return r;
  }
  switch (p.kind) {
    case ri::ProceduralKind::kDelayedReadArchive:
      r.kind = Kind::kArchive;
      break;
    case ri::ProceduralKind::kRunProgram:
      r.kind = Kind::kProgram;
      break;
    case ri::ProceduralKind::kDynamicLoad:
      r.kind = Kind::kSharedObject;
      break;
    default:
      return makeError(RiError::kBadToken, "there is no procedural \"{}\"", p.subdivide);
  }
  if (p.data.empty() || p.data[0].empty())
    return makeError(RiError::kMissingData, "Procedural \"{}\" without a name", p.subdivide);
  r.name = p.data[0];
  if (p.data.size() > 1) r.data = p.data[1];
  if (p.bound) r.bound = *p.bound;
  return r;
}

std::string sharedObjectQuestion(const ri::GraphicsState& state, const ri::Dictionary& dictionary,
                                 const ri::Procedural& p, double detail) {
  std::string text;
  {
    ri::RibWriter w([&](std::string_view s) { text += s; });
    for (const auto& [name, declaration] : dictionary.declared()) w.declare(name, declaration.str());
    ri::Param d;
    d.name = "detail";
    d.declaration = {};
    d.floats = {float(detail)};
    ri::ParamList detailList;
    detailList.set(std::move(d));
    w.option("procedural", std::move(detailList));

    const ri::Options& o = state.options();
    if (!o.nRgb.empty()) w.colorSamples(o.nRgb, o.rgbN);
    if (o.resolution) w.format((*o.resolution)[0], (*o.resolution)[1], o.pixelAspect);
    if (o.frameAspect) w.frameAspectRatio(*o.frameAspect);
    if (o.screenWindow) {
      const auto& s = *o.screenWindow;
      w.screenWindow(s[0], s[1], s[2], s[3]);
    }
    w.clipping(o.near, o.far);
    w.projection(o.projection, o.projectionParams);
    if (const ri::TransformPtr camera = state.worldToCamera()) w.transform(camera->matrices.front());
    w.worldBegin();
    w.transform(state.ctm().matrices.front());
    const ri::Basis& b = *state.attributes().basis;
    w.basis({"", b.u, b.uStep}, {"", b.v, b.vStep});
    w.procedural(p);
  }
  text += '\377';
  return text;
}

std::string sharedObjectProgram() { return installedFile("lib/frankenrender", "dsoprocedural"); }

}  // namespace fr::cache
