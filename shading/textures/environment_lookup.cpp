// environment(): from directions to places on the map, for the three kinds of maps.
//
// Lat-long: s is the longitude, atan2(y, x) / 2 pi + 1/2; t goes from the north pole (+z) at 0 to the south
// pole at 1. Cube faces: as cameras see them in a left-handed world; x, z and -x, -z faces have +y up, the +y
// face -z, the -y face +z. Planar: a plain picture with matrices is projected by its camera. A plain picture
// without is taken as lat-long.
#include <algorithm>

#include "shading/textures/texture_cache.h"

namespace fr::textures {
namespace {

constexpr float kPi = 3.14159265358979f;

struct Vec {
  float x = 0, y = 0, z = 0;
  Vec operator+(const Vec& o) const { return {x + o.x, y + o.y, z + o.z}; }
  Vec operator*(float k) const { return {x * k, y * k, z * k}; }
  float dot(const Vec& o) const { return x * o.x + y * o.y + z * o.z; }
  float length() const { return std::sqrt(dot(*this)); }
};
Vec vecAt(const FrLanes (&l)[3], uint32_t i) { return {at(l[0], i), at(l[1], i), at(l[2], i)}; }
Vec cross(const Vec& a, const Vec& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/// Looks one footprint up and adds its texel, times `weight`.
struct Accumulator {
  FrTextureFile& file;
  OIIO::TextureOpt options;
  OIIO::TextureSystem::Perthread* thread;
  Channels channels;
  float sum[4] = {};
  uint64_t count = 0;
  bool failed = false;

  void add(Footprint f, float weight) {
    float texel[4] = {};
    condition(f);
    failed |= !file.textures->system->texture(file.texture, thread, options, f.s, f.t, f.dsdx, f.dtdx, f.dsdy,
                                              f.dtdy, channels.asked, texel);
    ++count;
    for (int c = 0; c < channels.asked; ++c) sum[c] += weight * texel[c];
  }
};

Footprint latLong(const Vec& r, const Vec& dx, const Vec& dy) {
  const float around = r.x * r.x + r.y * r.y, all = around + r.z * r.z;
  const float rho = std::sqrt(std::max(around, 1e-12f * all)), inverse = all > 0 ? 1 / all : 0.0f;
  Footprint f;
  f.s = std::atan2(r.y, r.x) / (2 * kPi) + 0.5f;
  f.t = 0.5f - std::atan2(r.z, std::sqrt(around)) / kPi;
  const auto ds = [&](const Vec& d) {
    return bounded(rho > 0 ? (r.x * d.y - r.y * d.x) / (rho * rho * 2 * kPi) : 0.0f, 1.0f);
  };
  const auto dt = [&](const Vec& d) {
    return bounded(rho > 0 ? (r.z * (r.x * d.x + r.y * d.y) / rho - rho * d.z) * inverse / kPi : 0.0f, 1.0f);
  };
  f.dsdx = ds(dx), f.dsdy = ds(dy), f.dtdx = dt(dx), f.dtdy = dt(dy);
  return f;
}

struct Face {
  Vec axis, right, up;
  int column, row;  // in the file
};
constexpr Face kFaces[6] = {
    {{1, 0, 0}, {0, 0, -1}, {0, 1, 0}, 0, 0}, {{-1, 0, 0}, {0, 0, 1}, {0, 1, 0}, 0, 1},
    {{0, 1, 0}, {1, 0, 0}, {0, 0, -1}, 1, 0}, {{0, -1, 0}, {1, 0, 0}, {0, 0, 1}, 1, 1},
    {{0, 0, 1}, {1, 0, 0}, {0, 1, 0}, 2, 0},  {{0, 0, -1}, {-1, 0, 0}, {0, 1, 0}, 2, 1},
};
int faceOf(const Vec& r) {
  const float x = std::fabs(r.x), y = std::fabs(r.y), z = std::fabs(r.z);
  if (x >= y && x >= z) return r.x >= 0 ? 0 : 1;
  if (y >= z) return r.y >= 0 ? 2 : 3;
  return r.z >= 0 ? 4 : 5;
}

/// Place within a face, 0..1 each way.
Footprint onFace(const Face& face, float scale, const Vec& r, const Vec& dx, const Vec& dy) {
  const float m = r.dot(face.axis), k = m > 0 ? 0.5f / (m * scale) : 0.0f;
  const float a = m > 0 ? r.dot(face.right) / m : 0.0f, b = m > 0 ? r.dot(face.up) / m : 0.0f;
  Footprint f;
  f.s = 0.5f + 0.5f * a / scale, f.t = 0.5f - 0.5f * b / scale;
  const auto ds = [&](const Vec& d) { return (d.dot(face.right) - a * d.dot(face.axis)) * k; };
  const auto dt = [&](const Vec& d) { return -(d.dot(face.up) - b * d.dot(face.axis)) * k; };
  f.dsdx = ds(dx), f.dsdy = ds(dy), f.dtdx = dt(dx), f.dtdy = dt(dy);
  return f;
}

float widthOf(const Footprint& f) {
  return std::max(std::fabs(f.dsdx) + std::fabs(f.dsdy), std::fabs(f.dtdx) + std::fabs(f.dtdy));
}

void addCube(Accumulator& all, const Vec& r, const Vec& dx, const Vec& dy) {
  const FrTextureInfo& info = all.file.info;
  const float texel = 1.0f / float(std::max(1, std::min(info.width, info.height)));
  const auto addOne = [&](const Vec& to, float part, float weight) {
    const Face& face = kFaces[faceOf(to)];
    Footprint f = onFace(face, info.faceScale, to, dx * part, dy * part);
    // The filter must not reach the neighbours in the file, which are not the neighbours on the cube.
    const float margin = std::clamp(0.5f * widthOf(f), 0.5f * texel, 0.5f);
    f.s = std::clamp(f.s, margin, 1 - margin), f.t = std::clamp(f.t, margin, 1 - margin);
    f.s = (f.s + float(face.column)) / 3, f.t = (f.t + float(face.row)) / 2;
    f.dsdx /= 3, f.dsdy /= 3, f.dtdx /= 2, f.dtdy /= 2;
    all.add(f, weight);
  };
  const Footprint whole = onFace(kFaces[faceOf(r)], info.faceScale, r, dx, dy);
  const float width = widthOf(whole);
  const float border = std::min(std::min(whole.s, 1 - whole.s), std::min(whole.t, 1 - whole.t));
  // Wide filters near an edge of the cube are cut into parts, each on its own face.
  if (width < 1.0f / 32 || border > 0.5f * width) return addOne(r, 1, 1);
  const int n = int(std::clamp(std::ceil(width * 32), 2.0f, 8.0f));
  const float part = 1 / float(n);
  for (int y = 0; y < n; ++y)
    for (int x = 0; x < n; ++x)
      addOne(r + dx * ((float(x) + 0.5f) * part - 0.5f) + dy * ((float(y) + 0.5f) * part - 0.5f), part,
             part * part);
}

void addLatLong(Accumulator& all, const Vec& r, const Vec& dx, const Vec& dy) {
  const Footprint whole = latLong(r, dx, dy);
  // Around a pole longitude changes without bounds: small parts, each with its own longitude.
  const float wide = std::fabs(whole.dsdx) + std::fabs(whole.dsdy);
  if (wide < 0.25f) return all.add(whole, 1);
  constexpr int n = 4;
  constexpr float part = 1.0f / n;
  for (int y = 0; y < n; ++y)
    for (int x = 0; x < n; ++x) {
      const Vec to = r + dx * ((float(x) + 0.5f) * part - 0.5f) + dy * ((float(y) + 0.5f) * part - 0.5f);
      all.add(latLong(to, dx * part, dy * part), part * part);
    }
}

bool project(const float m[16], const Vec& p, float& s, float& t) {
  const float x = p.x * m[0] + p.y * m[4] + p.z * m[8] + m[12];
  const float y = p.x * m[1] + p.y * m[5] + p.z * m[9] + m[13];
  const float w = p.x * m[3] + p.y * m[7] + p.z * m[11] + m[15];
  if (!(w > 1e-20f)) return false;
  s = 0.5f + 0.5f * x / w, t = 0.5f - 0.5f * y / w;
  return true;
}

void addPlanar(Accumulator& all, const Vec& p, const Vec& dx, const Vec& dy) {
  Footprint f;
  const float* const m = all.file.info.worldToScreen;
  if (!project(m, p, f.s, f.t)) return;  // behind the camera: black
  float s, t;
  if (project(m, p + dx, s, t)) f.dsdx = s - f.s, f.dtdx = t - f.t;
  if (project(m, p + dy, s, t)) f.dsdy = s - f.s, f.dtdy = t - f.t;
  all.add(f, 1);
}

/// Lengthens two changes of a direction by `blur`, a part of one unit sphere's quadrant.
void blurDirection(const Vec& r, Vec& dx, Vec& dy, float blur) {
  const float length = r.length();
  if (!(blur > 0) || !(length > 0)) return;
  const float reach = blur * 2 * length;
  const Vec unit = r * (1 / length);
  Vec a = dx + unit * -unit.dot(dx);
  if (!(a.length() > 1e-8f * length)) a = cross(unit, std::fabs(unit.x) < 0.7f ? Vec{1, 0, 0} : Vec{0, 1, 0});
  a = a * (1 / a.length());
  Vec b = cross(unit, a);
  if (b.dot(dy) < 0) b = b * -1.0f;
  dx = dx + a * reach, dy = dy + b * reach;
}

}  // namespace

std::string lookUpEnvironment(FrTextureFile& file, const FrTextureCall& call) {
  if (beyondChannels(file, call)) return "";
  OIIO::TextureSystem& system = *file.textures->system;
  Accumulator all{file, optionsOf(file, call), system.get_perthread_info(), channelsOf(file, call)};
  const bool cube = file.info.kind == FR_TEXTURE_CUBE;
  const bool planar = file.info.kind == FR_TEXTURE_PLAIN && file.info.hasCamera;
  if (!cube && !planar) {
    all.options.swrap = OIIO::TextureOpt::WrapPeriodic;
    all.options.twrap = OIIO::TextureOpt::WrapClamp;
  }
  // Widths are applied here, so that parts of a footprint keep their share.
  const float xWidth = std::max(0.0f, bounded(call.sWidth, 1e6f)),
              yWidth = std::max(0.0f, bounded(call.tWidth, 1e6f));
  for (uint32_t i = 0; i < call.lanes; ++i) {
    if (call.active && !call.active[i]) continue;
    Vec r = vecAt(call.place, i), dx = vecAt(call.placeDx, i) * xWidth, dy = vecAt(call.placeDy, i) * yWidth;
    const auto usable = [](const Vec& v) { return std::fabs(v.x) + std::fabs(v.y) + std::fabs(v.z) < 1e18f; };
    if (!usable(r)) r = {};
    if (!usable(dx)) dx = {};
    if (!usable(dy)) dy = {};
    std::fill_n(all.sum, 4, 0.0f);
    const float sBlur = std::max(0.0f, boundedChange(at(call.sBlur, i)));
    const float tBlur = std::max(0.0f, boundedChange(at(call.tBlur, i)));
    if (cube) {
      blurDirection(r, dx, dy, std::min(1.0f, std::max(sBlur, tBlur)));
      addCube(all, r, dx, dy);
    } else {
      all.options.sblur = sBlur, all.options.tblur = tBlur;
      if (planar) {
        addPlanar(all, r, dx, dy);
      } else {
        const auto zUp = [&](const Vec& v) { return file.info.yIsUp ? Vec{v.z, -v.x, v.y} : v; };
        addLatLong(all, zUp(r), zUp(dx), zUp(dy));
      }
    }
    for (int c = 0; c < call.channelCount; ++c)
      call.result[size_t(c) * call.resultStride + i] =
          bounded(all.sum[all.channels.grey ? 0 : c], kBrightest);
  }
  file.textures->lookups.fetch_add(all.count, std::memory_order_relaxed);
  if (!all.failed) return "";
  const std::string why = system.geterror();
  return why.empty() ? "its texels cannot be read" : why;
}

}  // namespace fr::textures
