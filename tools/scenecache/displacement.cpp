#include "tools/scenecache/displacement.h"

#include <filesystem>
#include <map>
#include <set>

#define XXH_INLINE_ALL
#include <xxhash.h>

namespace fr::tools {
namespace {

namespace fs = std::filesystem;

std::vector<std::string> textureFolders(const cache::Skeleton& s) {
  std::vector<std::string> folders{"."};
  const std::string_view list = s.searchPaths().size() > 1 ? s.string(s.searchPaths()[1]) : "";
  for (size_t begin = 0; begin < list.size();) {
    const size_t end = std::min(list.find(':', begin), list.size());
    if (end > begin) folders.emplace_back(list.substr(begin, end - begin));
    begin = end + 1;
  }
  return folders;
}

}  // namespace

uint64_t displacementFingerprint(const cache::Skeleton& s, ShaderLibrary& library) {
  std::set<cache::ShaderId> shaders;
  for (const cache::ObjectRecord& o : s.objects()) {
    const cache::AttributeRecord& a = s.attributes()[o.attributes];
    for (const cache::ShaderId id : {a.displacement, a.deformation - 1})
      if (id != cache::kNone) shaders.insert(id);
  }
  const std::vector<std::string> folders = textureFolders(s);
  std::map<std::string, uint64_t> programs;  // by name: an order of its own
  std::set<std::string> strings;
  bool frameNumber = false;
  for (const cache::ShaderId id : shaders) {
    const std::string name(s.string(s.shaders()[id].name));
    const auto program = library.find(name);
    if (!program) return 0;
    programs[name] = (*program)->sourceHash;
    strings.insert((*program)->strings.begin(), (*program)->strings.end());
    frameNumber = frameNumber || strings.contains("Frame");
    for (const cache::ParamRecord& p : s.params(s.shaders()[id].params))
      for (const cache::StringId text : s.strings(p)) strings.emplace(s.string(text));
  }
  XXH3_state_t* state = XXH3_createState();
  XXH3_64bits_reset(state);
  const auto add = [&](const auto& v) { XXH3_64bits_update(state, &v, sizeof v); };
  for (const auto& [name, hash] : programs) {
    XXH3_64bits_update(state, name.data(), name.size());
    add(hash);
  }
  for (const std::string& text : strings) {
    if (text.empty()) continue;
    for (const std::string& folder : folders) {
      std::error_code failed;
      const fs::path file = fs::path(folder) / text;
      if (!fs::is_regular_file(file, failed)) continue;
      const uint64_t size = fs::file_size(file, failed);
      const int64_t time = fs::last_write_time(file, failed).time_since_epoch().count();
      XXH3_64bits_update(state, text.data(), text.size());
      add(size), add(time);
      break;
    }
  }
  if (frameNumber) add(s.options().frameNumber);
  const uint64_t value = XXH3_64bits_digest(state);
  XXH3_freeState(state);
  return value != 0 ? value : 1;
}

}  // namespace fr::tools
