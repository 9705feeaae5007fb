#include "scene_cache/rib_stream.h"

#include "base/report_mute.h"
#include "ri/reader.h"

namespace fr::cache {
namespace {

std::string folderOf(const std::string& path) {
  const size_t slash = path.find_last_of('/');
  if (slash == std::string::npos) return ".";
  return slash == 0 ? "/" : path.substr(0, slash);
}

}  // namespace

Result<void> readStream(SceneBuilder& builder, std::span<const RibInput> inputs, uint8_t side,
                        const std::string* standardInput, bool mute) {
  ri::ReaderOptions options;
  for (const RibInput& in : inputs)
    if ((in.sides & side) && in.path != "-") options.archivePath.push_back(folderOf(in.path));
  ri::Reader reader(builder, options);
  builder.setReader(&reader);
  std::optional<Error> first;
  for (const RibInput& in : inputs) {
    if (!(in.sides & side)) continue;
    if (builder.stopped() || builder.failure()) break;
    builder.setSides(in.sides);
    std::optional<ReportMute> muted;
    if (mute && in.sides != side) muted.emplace();
    auto r = in.path != "-"  ? reader.readFile(in.path)
             : standardInput ? reader.readBuffer(*standardInput, "<stdin>")
                             : reader.readStdin();
    if (!r) {
      if (first) report(r.error());
      if (!first && !muted) first = std::move(r).error();
    }
  }
  builder.finish();
  builder.setReader(nullptr);
  if (first) return std::move(*first);
  return {};
}

}  // namespace fr::cache
