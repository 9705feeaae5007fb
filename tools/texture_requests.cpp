#include "tools/texture_requests.h"

#include "ri/search_path.h"
#include "shading/texture_library.h"

namespace fr::tools {

void makeRequestedTexture(ri::MakeKind kind, const ri::MakeTextureArgs& args,
                          const std::vector<std::string>& folders, const SourceLocation& where) {
  TextureRequest r;
  const char* name = "MakeTexture";
  switch (kind) {
    case ri::MakeKind::kTexture:
      break;
    case ri::MakeKind::kBump:
      r.kind = FR_MAKE_BUMP, name = "MakeBump";
      break;
    case ri::MakeKind::kLatLongEnvironment:
      r.kind = FR_MAKE_LATLONG, name = "MakeLatLongEnvironment";
      break;
    case ri::MakeKind::kCubeFaceEnvironment:
      r.kind = FR_MAKE_CUBE, name = "MakeCubeFaceEnvironment";
      break;
    case ri::MakeKind::kShadow:
      r.kind = FR_MAKE_SHADOW, name = "MakeShadow";
      break;
    case ri::MakeKind::kOcclusion:
    case ri::MakeKind::kBrickMap:
      report(
          {RiError::kUnimplemented, Severity::kWarning, where,
           fmt::format("{} is not implemented; \"{}\" is not written",
                       kind == ri::MakeKind::kOcclusion ? "MakeOcclusion" : "MakeBrickMap", args.texture)});
      return;
  }
  for (const std::string& picture : args.pictures) {
    const std::string found = ri::findFile(picture, folders);
    r.pictures.push_back(found.empty() ? picture : found);
  }
  r.texture = args.texture;
  r.sWrap = args.sWrap, r.tWrap = args.tWrap, r.filter = args.filter;
  r.sWidth = args.sWidth, r.tWidth = args.tWidth;
  r.fov = args.fov;
  if (Result<void> made = makeTexture(r); !made) {
    Error e = std::move(made).error();
    e.where = where;
    report(std::move(e).context(name));
  }
}

}  // namespace fr::tools
