// scenecache dump: grids as a RIB or OBJ file, for a look.
#include <fmt/format.h>

#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <memory>
#include <system_error>

#include "base/whole_file.h"
#include "tools/scenecache/commands.h"
#include "tools/scenecache/contents.h"

namespace fr::tools {
using namespace cache;
namespace {

struct DumpOptions {
  std::string file, output, format;
  std::vector<std::string> objects;
  std::vector<uint32_t> patches;
  int level = 0;
};

/// One diced patch as a rectangle of vertices or as triangles, world space.
struct Piece {
  std::vector<DVec3> points;
  uint32_t columns = 0, rows = 0;  // vertices; 0: triangles
  std::vector<uint32_t> triangles;
};

Piece pieceOf(const SceneCache& c, const GridRecord& g, int level) {
  const DVec3 origin = c.skeleton().header().cacheOrigin;
  const GridView v = c.view(g);
  Piece p;
  if (g.kind == GridKind::kMeshlet) {
    for (uint32_t i = 0; i < g.nu; ++i) p.points.push_back(DVec3(v.vertex(i)) + origin);
    for (size_t i = 0; i < size_t(g.nv) * 3; ++i) p.triangles.push_back(v.indices[i]);
    return p;
  }
  const uint32_t stride = 1u << std::min<int>(level, g.levels - 1);
  p.columns = g.nu / stride + 1, p.rows = g.nv / stride + 1;
  for (uint32_t j = 0; j <= g.nv; j += stride)
    for (uint32_t i = 0; i <= g.nu; i += stride)
      p.points.push_back(DVec3(v.vertex(size_t(j) * g.rowStride + i)) + origin);
  return p;
}

class Output {
 public:
  virtual ~Output() = default;
  virtual void begin(const Skeleton&) = 0;
  virtual void object(const std::string& name, PrimitiveType type) = 0;
  virtual void piece(const Piece& p) = 0;
  virtual void end() = 0;
};

class Obj : public Output {
 public:
  explicit Obj(std::FILE* f) : f_(f) {}
  void begin(const Skeleton&) override { fmt::print(f_, "# world space\n"); }
  void object(const std::string& name, PrimitiveType type) override {
    fmt::print(f_, "o {}\n# {}\n", name, typeName(type));
  }
  void piece(const Piece& p) override {
    for (const DVec3& q : p.points) fmt::print(f_, "v {:.9g} {:.9g} {:.9g}\n", q.x, q.y, q.z);
    for (uint32_t j = 0; j + 1 < p.rows; ++j)
      for (uint32_t i = 0; i + 1 < p.columns; ++i) {
        const uint64_t a = next_ + uint64_t(j) * p.columns + i;
        fmt::print(f_, "f {} {} {} {}\n", a, a + 1, a + p.columns + 1, a + p.columns);
      }
    for (size_t t = 0; t + 2 < p.triangles.size(); t += 3)
      fmt::print(f_, "f {} {} {}\n", next_ + p.triangles[t], next_ + p.triangles[t + 1],
                 next_ + p.triangles[t + 2]);
    next_ += p.points.size();
  }
  void end() override {}

 private:
  std::FILE* f_;
  uint64_t next_ = 1;
};

/// A whole scene, under the cache's own camera.
class Rib : public Output {
 public:
  explicit Rib(std::FILE* f) : f_(f) {}
  void begin(const Skeleton& s) override {
    const CameraRecord& c = s.camera();
    fmt::print(f_, "##RenderMan RIB-Structure 1.1\nversion 3.03\nFormat {} {} {:.9g}\n", c.resolution[0],
               c.resolution[1], c.pixelAspect);
    if (c.projection == ProjectionType::kPerspective)
      fmt::print(f_, "Projection \"perspective\" \"float fov\" [{:.9g}]\n", c.fov);
    else
      fmt::print(f_, "Projection \"orthographic\"\n");
    fmt::print(f_, "ScreenWindow {:.9g} {:.9g} {:.9g} {:.9g}\nConcatTransform [", c.screenWindow[0],
               c.screenWindow[1], c.screenWindow[2], c.screenWindow[3]);
    const DMat4 m = s.worldToCamera(c.shutter[0]);
    for (int row = 0; row < 4; ++row)
      for (int k = 0; k < 4; ++k) fmt::print(f_, " {:.17g}", m[row][k]);
    fmt::print(f_, " ]\nWorldBegin\nSides 2\n");
  }
  void object(const std::string& name, PrimitiveType type) override {
    fmt::print(f_, "# {}\nAttribute \"identifier\" \"string name\" [\"", typeName(type));
    for (const char ch : name) fmt::print(f_, "{}{}", ch == '"' || ch == '\\' ? "\\" : "", ch);
    fmt::print(f_, "\"]\n");
  }
  void piece(const Piece& p) override {
    if (p.columns) {
      fmt::print(f_, "PatchMesh \"bilinear\" {} \"nonperiodic\" {} \"nonperiodic\" \"P\" [", p.columns,
                 p.rows);
    } else {
      fmt::print(f_, "PointsPolygons [");
      for (size_t t = 0; t + 2 < p.triangles.size(); t += 3) fmt::print(f_, " 3");
      fmt::print(f_, " ] [");
      for (const uint32_t i : p.triangles) fmt::print(f_, " {}", i);
      fmt::print(f_, " ] \"P\" [");
    }
    for (const DVec3& q : p.points) fmt::print(f_, "\n{:.9g} {:.9g} {:.9g}", q.x, q.y, q.z);
    fmt::print(f_, "]\n");
  }
  void end() override { fmt::print(f_, "WorldEnd\n"); }

 private:
  std::FILE* f_;
};

int writeDump(const SceneCache& c, const DumpOptions& o, Output& out) {
  const Skeleton& s = c.skeleton();
  std::vector<bool> wanted(s.rootPatches().size(), o.objects.empty() && o.patches.empty());
  for (const uint32_t p : o.patches) {
    if (p < wanted.size()) {
      wanted[p] = true;
      continue;
    }
    report(makeError(RiError::kRange, "{}: no patch {}: there are {}", o.file, p, wanted.size()));
    return kFailed;
  }
  for (const std::string& pattern : o.objects) {
    bool any = false;
    for (ObjectId i = 0; i < s.objects().size(); ++i) {
      if (!matches(pattern, objectName(s, i), i)) continue;
      any = true;
      for (uint32_t k = 0; k < s.objects()[i].patchCount; ++k) wanted[s.objects()[i].firstPatch + k] = true;
    }
    if (any) continue;
    report(makeError(RiError::kMissingData, "{}: no object '{}'", o.file, pattern));
    return kFailed;
  }
  out.begin(s);
  uint64_t grids = 0;
  for (ObjectId i = 0; i < s.objects().size(); ++i) {
    const ObjectRecord& object = s.objects()[i];
    // Prototypes stand nowhere; their instances do.
    if (object.sides == 0 && o.objects.empty() && o.patches.empty()) continue;
    bool named = false;
    for (uint32_t k = 0; k < object.patchCount; ++k) {
      if (!wanted[object.firstPatch + k]) continue;
      forEachGrid(c, object.firstPatch + k, [&](NodeId, const GridRecord& g) {
        if ((g.flags & kGridAbsent) != 0) return;
        if (!named) out.object(objectName(s, i), object.type);
        named = true;
        out.piece(pieceOf(c, g, o.level));
        ++grids;
      });
    }
    c.letGo();
  }
  out.end();
  if (grids > 0) return kOk;
  report(makeError(RiError::kMissingData, "{}: nothing of this is diced", o.file));
  return kFailed;
}

int dump(const DumpOptions& o) {
  std::string format = o.format;
  if (format.empty()) format = o.output.ends_with(".rib") ? "rib" : "obj";
  auto opened = SceneCache::openMapped(o.file);
  if (!opened) {
    report(opened.error());
    return kFailed;
  }
  WholeFile whole;
  std::FILE* f = stdout;
  const auto cannotWrite = [&](int number) {
    Error e = makeError(number == ENOSPC || number == EFBIG ? RiError::kDiskFull : RiError::kSystem,
                        "cannot write: {}", std::strerror(number));
    e.where.file = o.output.empty() ? "standard output" : o.output;
    report(e);
    return kFailed;
  };
  if (!o.output.empty()) {
    if (const int e = whole.open(o.output)) return cannotWrite(e);
    f = fdopen(dup(whole.descriptor()), "w");
    if (!f) return cannotWrite(errno);
  }
  std::unique_ptr<Output> out;
  if (format == "rib")
    out = std::make_unique<Rib>(f);
  else
    out = std::make_unique<Obj>(f);
  int status = kFailed, number = 0;
  try {
    status = writeDump(**opened, o, *out);
  } catch (const std::system_error& e) {  // fmt::print
    number = e.code().value();
  }
  if (f == stdout ? std::fflush(f) != 0 : std::fclose(f) != 0) number = number ? number : errno;
  if (number) return cannotWrite(number);
  if (status == kOk && !o.output.empty())
    if (const int e = whole.finish()) return cannotWrite(e);
  return status;
}

}  // namespace

void addDump(CLI::App& app, Run& run) {
  auto o = std::make_shared<DumpOptions>();
  CLI::App* d = app.add_subcommand("dump", "Grids as OBJ or RIB, for a look");
  d->footer(
      "World space, at shutter open. Without --object and --patch: everything. A RIB is a whole scene under\n"
      "the cache's camera: frankenrender -o look.exr dump.rib");
  d->add_option("scene.fsc", o->file)->required();
  d->add_option("-o,--output", o->output, "Default: standard output");
  d->add_option("--object", o->objects, "Names with * and ?, or numbers as '#12' (see ls)");
  d->add_option("--patch", o->patches, "Numbers of root patches");
  d->add_option("--level", o->level,
                "0: as diced; 1 to 4: every 2nd, 4th, 8th, 16th row and column, as far as a grid has them")
      ->check(CLI::Range(0, kLevels - 1));
  d->add_option("--format", o->format, "Default: by the name of the output, else obj")
      ->check(CLI::IsMember({"obj", "rib"}));
  d->callback([o, &run] { run = [o] { return dump(*o); }; });
}

}  // namespace fr::tools
