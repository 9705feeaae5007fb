#include "scene_cache/subdivision.h"

#include <opensubdiv/bfr/refinerSurfaceFactory.h>
#include <opensubdiv/bfr/surface.h>
#include <opensubdiv/far/topologyDescriptor.h>
#include <opensubdiv/far/topologyRefinerFactory.h>

#include <algorithm>
#include <atomic>
#include <map>
#include <mutex>
#include <shared_mutex>

#include "scene_cache/cache_impl.h"
#include "scene_cache/face_varying.h"
#include "scene_cache/patch_basis.h"
#include "scene_cache/primvar.h"

namespace fr::cache {

namespace osd = OpenSubdiv::OPENSUBDIV_VERSION;

namespace {

using FactoryCache =
    osd::Bfr::SurfaceFactoryCacheThreaded<std::shared_mutex, std::shared_lock<std::shared_mutex>,
                                          std::unique_lock<std::shared_mutex>>;
using Factory = osd::Bfr::RefinerSurfaceFactory<FactoryCache>;
using FaceSurface = osd::Bfr::Surface<float>;
using Points = FaceSurface::PointDescriptor;

std::atomic<uint64_t> nextId{1};

/// PRMan's two tags in OpenSubdiv's terms (OpenSubdiv, "Compatibility with OpenSubdiv 2.x": the numbers of
/// the tag are those of the RIB, not Hbr's).
osd::Sdc::Options::FVarLinearInterpolation faceVaryingRule(const SubdivisionMeshData& m) {
  using Options = osd::Sdc::Options;
  switch (m.faceVaryingInterpolateBoundary) {
    case 1:
      return m.faceVaryingPropagateCorners ? Options::FVAR_LINEAR_CORNERS_PLUS2
                                           : Options::FVAR_LINEAR_CORNERS_PLUS1;
    case 2:
      return Options::FVAR_LINEAR_NONE;
    case 3:
      return Options::FVAR_LINEAR_BOUNDARIES;
    default:
      return Options::FVAR_LINEAR_ALL;
  }
}

/// A face-varying variable that the topology interpolates smoothly: its channel is its place in the list.
struct SmoothVariable {
  StringId name{};
  uint32_t width = 0;
  std::vector<uint32_t> cornerOfValue;
};

/// Faces whose limit is that of a regular grid of quadrilaterals without edges, creases or corners nearby.
std::vector<bool> regularFaces(const osd::Far::TopologyRefiner& refiner) {
  const osd::Far::TopologyLevel& mesh = refiner.GetLevel(0);
  std::vector<bool> vertex(size_t(mesh.GetNumVertices()));
  for (int v = 0; v < mesh.GetNumVertices(); ++v) {
    const auto edges = mesh.GetVertexEdges(v);
    const auto faces = mesh.GetVertexFaces(v);
    bool regular = faces.size() == 4 && edges.size() == 4 && !mesh.IsVertexBoundary(v) &&
                   !mesh.IsVertexNonManifold(v) && !(mesh.GetVertexSharpness(v) > 0);
    for (int e = 0; regular && e < edges.size(); ++e) regular = !(mesh.GetEdgeSharpness(edges[e]) > 0);
    for (int f = 0; regular && f < faces.size(); ++f) regular = mesh.GetFaceVertices(faces[f]).size() == 4;
    vertex[size_t(v)] = regular;
  }
  std::vector<bool> face(size_t(mesh.GetNumFaces()));
  for (int f = 0; f < mesh.GetNumFaces(); ++f) {
    const auto corners = mesh.GetFaceVertices(f);
    bool regular = corners.size() == 4 && !mesh.IsFaceHole(f);
    for (int c = 0; regular && c < corners.size(); ++c) regular = vertex[size_t(corners[c])];
    face[size_t(f)] = regular;
  }
  return face;
}

}  // namespace

struct SubdivisionTopology::Impl {
  std::unique_ptr<osd::Far::TopologyRefiner> refiner;
  std::unique_ptr<Factory> factory;
  SubdivisionScheme scheme = SubdivisionScheme::kCatmullClark;
  uint32_t pieces = 0;
  std::vector<uint32_t> firstCorner;  // of each face
  std::span<const uint32_t> sizes, vertices;
  std::vector<SmoothVariable> smooth;
  std::vector<bool> regularFace;  // its limit patch is one uniform bicubic B-spline; empty: none is

  uint32_t sizeOf(uint32_t face) const { return firstCorner[face + 1] - firstCorner[face]; }
};

SubdivisionTopology::SubdivisionTopology() : impl(std::make_unique<Impl>()) {}
SubdivisionTopology::~SubdivisionTopology() = default;

std::shared_ptr<SubdivisionTopology> SubdivisionTopology::create(const SubdivisionMeshData& m) {
  std::shared_ptr<SubdivisionTopology> t(new SubdivisionTopology);
  Impl& d = *t->impl;
  d.scheme = m.scheme;
  d.pieces = m.pieces;
  d.sizes = m.faceSizes, d.vertices = m.faceVertices;
  d.firstCorner.resize(m.faceSizes.size() + 1);
  for (size_t f = 0; f < m.faceSizes.size(); ++f) d.firstCorner[f + 1] = d.firstCorner[f] + m.faceSizes[f];

  // OpenSubdiv takes ints; the arrays' values are in range.
  const auto ints = [](std::span<const uint32_t> s) { return reinterpret_cast<const int*>(s.data()); };
  osd::Far::TopologyDescriptor desc;
  desc.numVertices = int(m.vertexCount);
  desc.numFaces = int(m.faceSizes.size());
  desc.numVertsPerFace = ints(m.faceSizes);
  desc.vertIndicesPerFace = ints(m.faceVertices);
  desc.numCreases = int(m.creaseSharpness.size());
  desc.creaseVertexIndexPairs = ints(m.creaseVertices);
  desc.creaseWeights = m.creaseSharpness.data();
  desc.numCorners = int(m.cornerSharpness.size());
  desc.cornerVertexIndices = ints(m.cornerVertices);
  desc.cornerWeights = m.cornerSharpness.data();
  desc.numHoles = int(m.holes.size());
  desc.holeIndices = ints(m.holes);
  osd::Sdc::Options options;
  options.SetVtxBoundaryInterpolation(m.interpolateBoundary == 0 ? osd::Sdc::Options::VTX_BOUNDARY_NONE
                                      : m.interpolateBoundary == 1
                                          ? osd::Sdc::Options::VTX_BOUNDARY_EDGE_AND_CORNER
                                          : osd::Sdc::Options::VTX_BOUNDARY_EDGE_ONLY);
  options.SetFVarLinearInterpolation(faceVaryingRule(m));
  options.SetCreasingMethod(m.chaikinCreases ? osd::Sdc::Options::CREASE_CHAIKIN
                                             : osd::Sdc::Options::CREASE_UNIFORM);
  options.SetTriangleSubdivision(m.smoothTriangles ? osd::Sdc::Options::TRI_SUB_SMOOTH
                                                   : osd::Sdc::Options::TRI_SUB_CATMARK);
  std::vector<osd::Far::TopologyDescriptor::FVarChannel> channels(m.channels.size());
  for (size_t i = 0; i < channels.size(); ++i) {
    channels[i].numValues = int(m.channels[i].values);
    channels[i].valueIndices = ints(m.channels[i].valueOfCorner);
  }
  desc.numFVarChannels = int(channels.size());
  desc.fvarChannels = channels.data();
  const osd::Sdc::SchemeType type = m.scheme == SubdivisionScheme::kLoop       ? osd::Sdc::SCHEME_LOOP
                                    : m.scheme == SubdivisionScheme::kBilinear ? osd::Sdc::SCHEME_BILINEAR
                                                                               : osd::Sdc::SCHEME_CATMARK;
  using RefinerFactory = osd::Far::TopologyRefinerFactory<osd::Far::TopologyDescriptor>;
  d.refiner.reset(RefinerFactory::Create(desc, RefinerFactory::Options(type, options)));
  if (!d.refiner) return nullptr;
  d.factory = std::make_unique<Factory>(*d.refiner);
  if (m.scheme == SubdivisionScheme::kCatmullClark && !m.pieces) d.regularFace = regularFaces(*d.refiner);
  return t;
}

bool SubdivisionTopology::hasLimit(uint32_t face) const {
  return impl->factory->FaceHasLimitSurface(int(face));
}

namespace {

/// A face's limit surface with its patch points, in a small cache of each thread: most calls ask for the same
/// few faces.
struct PreparedFace {
  uint64_t id = 0;
  uint32_t face = 0;
  bool valid = false;
  FaceSurface surface;
  std::vector<float> points;
};

const PreparedFace& preparedFace(const SubdivisionTopology::Impl& t, uint64_t id, uint32_t face,
                                 const float* meshPoints) {
  thread_local PreparedFace faces[32];
  PreparedFace& p = faces[(uint64_t(face) + id * 7) % 32];
  if (p.id == id && p.face == face) return p;
  p.id = id, p.face = face;
  p.valid = t.factory->InitVertexSurface(int(face), &p.surface);
  if (p.valid) {
    p.points.resize(size_t(p.surface.GetNumPatchPoints()) * 3);
    p.surface.PreparePatchPoints(meshPoints, Points(3), p.points.data(), Points(3));
  }
  return p;
}

/// Root patch parameters to the face's own: coordinates and the matrix d(face)/d(patch).
struct FacePlace {
  float uv[2];
  float uu = 1, uv_ = 0, vu = 0, vv = 1;  // d face.u / d u, d face.u / d v, d face.v / d u, d face.v / d v
};
FacePlace facePlace(const SubdivisionTopology::Impl& t, const SubdivisionPatch& patch,
                    const osd::Bfr::Parameterization& face, float u, float v) {
  FacePlace r{{u, v}};
  if (t.scheme == SubdivisionScheme::kLoop) {
    // A quad with its upper edge collapsed into the third vertex.
    r.uv[0] = u * (1 - v), r.uv[1] = v;
    r.uu = 1 - v, r.uv_ = -u;
    return r;
  }
  if (!t.pieces) return r;
  if (face.HasSubFaces()) {
    const float local[2] = {u, v};
    face.ConvertNormalizedSubFaceToCoord(int(patch.corner), local, r.uv);
    r.uu = r.vv = 0.5f;
    return r;
  }
  const float hu = 0.5f * u, hv = 0.5f * v;
  r.uu = r.vv = 0;
  switch (patch.corner & 3) {
    case 0:
      r.uv[0] = hu, r.uv[1] = hv, r.uu = 0.5f, r.vv = 0.5f;
      break;
    case 1:
      r.uv[0] = 1 - hv, r.uv[1] = hu, r.uv_ = -0.5f, r.vu = 0.5f;
      break;
    case 2:
      r.uv[0] = 1 - hu, r.uv[1] = 1 - hv, r.uu = -0.5f, r.vv = -0.5f;
      break;
    default:
      r.uv[0] = hv, r.uv[1] = 1 - hu, r.uv_ = 0.5f, r.vu = -0.5f;
      break;
  }
  return r;
}

}  // namespace

Vec3 SubdivisionSurface::point(uint32_t patch, float u, float v) const {
  if (base) return Vec3(transformPoint(placement, DVec3(base->point(patch, u, v))));
  Vec3 p(0);
  const SubdivisionPatch& s = patches[patch];
  if (s.face >= topology->impl->sizes.size()) return p;
  const PreparedFace& f = preparedFace(*topology->impl, id, s.face, points.data());
  if (!f.valid) return p;
  const FacePlace at = facePlace(*topology->impl, s, f.surface.GetParameterization(), u, v);
  f.surface.Evaluate(at.uv, f.points.data(), Points(3), &p.x);
  return p;
}

Vec3 SubdivisionSurface::derivatives(uint32_t patch, float u, float v, Vec3& du, Vec3& dv) const {
  if (base) {
    const Vec3 p = base->derivatives(patch, u, v, du, dv);
    du = Vec3(transformVector(placement, DVec3(du))), dv = Vec3(transformVector(placement, DVec3(dv)));
    return Vec3(transformPoint(placement, DVec3(p)));
  }
  Vec3 p(0), a(0), b(0);
  du = dv = p;
  const SubdivisionPatch& s = patches[patch];
  if (s.face >= topology->impl->sizes.size()) return p;
  const PreparedFace& f = preparedFace(*topology->impl, id, s.face, points.data());
  if (!f.valid) return p;
  const FacePlace at = facePlace(*topology->impl, s, f.surface.GetParameterization(), u, v);
  f.surface.Evaluate(at.uv, f.points.data(), Points(3), &p.x, &a.x, &b.x);
  du = a * at.uu + b * at.vu;
  dv = a * at.uv_ + b * at.vv;
  return p;
}

bool SubdivisionSurface::bezier(uint32_t patch, double (&points_)[48], DMat4* toCache) const {
  if (base) {
    if (!base->bezier(patch, points_, toCache)) return false;
    *toCache = placement;
    return true;
  }
  const std::vector<bool>& regular = topology->impl->regularFace;
  const uint32_t face = patches[patch].face;
  if (face >= regular.size() || !regular[face]) return false;
  const PreparedFace& f = preparedFace(*topology->impl, id, face, points.data());
  if (!f.valid || !f.surface.IsRegular() || f.points.size() != 48) return false;
  std::copy(f.points.begin(), f.points.end(), points_);
  static const BezierConversion kSpline = [] {
    static constexpr float kBasis[16] = {-1 / 6.f, 3 / 6.f, -3 / 6.f, 1 / 6.f, 3 / 6.f, -6 / 6.f, 3 / 6.f, 0,
                                         -3 / 6.f, 0,       3 / 6.f,  0,       1 / 6.f, 4 / 6.f,  1 / 6.f, 0};
    return bezierConversion(kBasis);
  }();
  convertToBezier(kSpline, kSpline, 3, points_);
  *toCache = DMat4(1);
  return true;
}

struct SubdivisionStore::Impl {
  Skeleton skeleton;
  std::shared_mutex mutex;
  std::map<ObjectId, std::shared_ptr<const SubdivisionTopology>> topologies;
  std::map<std::pair<ObjectId, float>, std::unique_ptr<SubdivisionSurface>> surfaces;

  std::shared_ptr<const SubdivisionTopology> topology(ObjectId object, const SubdivisionSource& s);
  std::vector<SmoothVariable> smoothVariables(ObjectId object, SubdivisionMeshData* mesh,
                                              std::vector<std::vector<uint32_t>>* valueOfCorner) const;
};

SubdivisionStore::SubdivisionStore(const Skeleton& skeleton) : impl_(std::make_unique<Impl>()) {
  impl_->skeleton = skeleton;
}
SubdivisionStore::~SubdivisionStore() = default;

/// The object's face-varying variables that its rules make smooth; sets the mesh's rule and channels.
std::vector<SmoothVariable> SubdivisionStore::Impl::smoothVariables(
    ObjectId object, SubdivisionMeshData* mesh, std::vector<std::vector<uint32_t>>* valueOfCorner) const {
  std::vector<SmoothVariable> found;
  const bool all = mesh->faceVaryingInterpolateBoundary != 0;
  // "facevertex" without the tag: corners are as sharp as those of the surface.
  if (!all) mesh->faceVaryingInterpolateBoundary = mesh->interpolateBoundary == 2 ? 2 : 1;
  for (const ParamRecord& p : skeleton.params(skeleton.objects()[object].primvars)) {
    if (p.storage != ParamClass::kFaceVertex && !(all && p.storage == ParamClass::kFaceVarying)) continue;
    const uint32_t width = floatsPerValue(p);
    const auto values = skeleton.floats(p);
    if (width == 0 || values.size() / width < mesh->faceVertices.size()) continue;
    WeldedFaceVarying welded = weldFaceVarying(values, width, mesh->faceVertices);
    found.push_back({p.name, width, std::move(welded.cornerOfValue)});
    valueOfCorner->push_back(std::move(welded.valueOfCorner));
  }
  return found;
}

std::shared_ptr<const SubdivisionTopology> SubdivisionStore::Impl::topology(ObjectId object,
                                                                            const SubdivisionSource& s) {
  auto& t = topologies[object];
  if (t) return t;
  SubdivisionMeshData m;
  m.scheme = s.scheme;
  m.interpolateBoundary = s.interpolateBoundary;
  m.vertexCount = uint32_t(std::min<uint64_t>(s.positions.perKey, 0x7fffffff));
  m.pieces = s.pieces;
  m.faceVaryingInterpolateBoundary = s.faceVaryingInterpolateBoundary;
  m.faceVaryingPropagateCorners = s.faceVaryingPropagateCorners != 0;
  m.chaikinCreases = s.chaikinCreases != 0, m.smoothTriangles = s.smoothTriangles != 0;
  m.faceSizes = sourceArray<uint32_t>(skeleton, s.faceSizes);
  m.faceVertices = sourceArray<uint32_t>(skeleton, s.faceVertices);
  m.creaseVertices = sourceArray<uint32_t>(skeleton, s.creaseVertices);
  m.creaseSharpness = sourceArray<float>(skeleton, s.creaseSharpness);
  m.cornerVertices = sourceArray<uint32_t>(skeleton, s.cornerVertices);
  m.cornerSharpness = sourceArray<float>(skeleton, s.cornerSharpness);
  m.holes = sourceArray<uint32_t>(skeleton, s.holes);
  // A file may be damaged: OpenSubdiv trusts what it is given.
  uint64_t corners = 0;
  for (const uint32_t n : m.faceSizes) {
    if (n < 3 || (m.scheme == SubdivisionScheme::kLoop && n != 3)) return nullptr;
    corners += n;
  }
  const auto inRange = [](std::span<const uint32_t> v, uint64_t count) {
    return std::all_of(v.begin(), v.end(), [count](uint32_t i) { return i < count; });
  };
  if (corners != m.faceVertices.size() || corners > 0x7fffffff || !inRange(m.faceVertices, m.vertexCount) ||
      m.creaseVertices.size() != m.creaseSharpness.size() * 2 || !inRange(m.creaseVertices, m.vertexCount) ||
      m.cornerVertices.size() != m.cornerSharpness.size() || !inRange(m.cornerVertices, m.vertexCount) ||
      !inRange(m.holes, m.faceSizes.size()))
    return nullptr;
  std::vector<std::vector<uint32_t>> valueOfCorner;
  std::vector<SmoothVariable> smooth = smoothVariables(object, &m, &valueOfCorner);
  std::vector<FaceVaryingChannel> channels;
  for (size_t i = 0; i < smooth.size(); ++i)
    channels.push_back({uint32_t(smooth[i].cornerOfValue.size()), valueOfCorner[i]});
  m.channels = channels;
  auto made = SubdivisionTopology::create(m);
  if (made) made->impl->smooth = std::move(smooth);
  t = std::move(made);
  return t;
}

const SubdivisionSurface* SubdivisionStore::surface(ObjectId object, float time) {
  const std::pair<ObjectId, float> key{object, time};
  {
    std::shared_lock lock(impl_->mutex);
    const auto it = impl_->surfaces.find(key);
    if (it != impl_->surfaces.end()) return it->second.get();
  }
  const Skeleton& s = impl_->skeleton;
  const ObjectRecord& o = s.objects()[object];
  const SubdivisionSurface* base = o.prototype != kNone ? surface(o.prototype, time) : nullptr;
  std::unique_lock lock(impl_->mutex);
  auto& slot = impl_->surfaces[key];
  if (slot) return slot.get();
  if (base) {
    slot = std::make_unique<SubdivisionSurface>();
    slot->topology = base->topology, slot->patches = base->patches;
    slot->base = base, slot->placement = s.placement(o);
    return slot.get();
  }
  const auto* source = sourceRecord<SubdivisionSource>(s, o);
  if (!source) return nullptr;
  const PositionKeys p = positionsAt(s, source->positions, time);
  auto topology = impl_->topology(object, *source);
  if (!topology || !p.a) return nullptr;
  auto made = std::make_unique<SubdivisionSurface>();
  made->id = nextId.fetch_add(1);
  made->topology = std::move(topology);
  made->patches = sourceArray<SubdivisionPatch>(s, source->patches);
  made->points.resize(p.count * 3);
  const DMat4 toCache = s.toCache(o.transform, time);
  for (uint64_t i = 0; i < p.count; ++i) {
    const DVec3 q = transformPoint(toCache, p.at(i));
    for (uint64_t c = 0; c < 3; ++c) made->points[i * 3 + c] = float(q[int(c)]);
  }
  slot = std::move(made);
  return slot.get();
}

namespace {

/// A limit surface of `width` floats at n points of a root patch, from its patch points.
void evaluatePoints(const SubdivisionTopology::Impl& t, const SubdivisionPatch& place, const FaceSurface& f,
                    const std::vector<float>& points, uint32_t width, size_t n, const float* u,
                    const float* v, float* const* out) {
  std::vector<float> result(width);
  for (size_t i = 0; i < n; ++i) {
    const FacePlace at = facePlace(t, place, f.GetParameterization(), u[i], v[i]);
    f.Evaluate(at.uv, points.data(), Points(int(width)), result.data());
    for (uint32_t c = 0; c < width; ++c) out[c][i] = result[c];
  }
}

}  // namespace

bool SubdivisionStore::evaluate(ObjectId object, uint32_t patch, const ParamRecord& param,
                                std::span<const float> values, uint32_t width, size_t n, const float* u,
                                const float* v, float* const* out) {
  const SubdivisionSurface* s = surface(object, impl_->skeleton.camera().shutter[0]);
  if (s && s->base) s = s->base;
  if (!s || !s->hasPatch(patch)) return false;
  const SubdivisionPatch place = s->patches[patch];
  const SubdivisionTopology::Impl& t = *s->topology->impl;
  if (place.face >= t.sizes.size()) return false;
  const uint64_t count = values.size() / width;
  const auto row = [&](uint64_t i) { return values.data() + std::min(i, count - 1) * width; };
  if (param.storage == ParamClass::kUniform) {
    for (uint32_t c = 0; c < width; ++c) std::fill_n(out[c], n, row(place.face)[c]);
    return true;
  }
  if (param.storage == ParamClass::kVertex && count * 3 >= s->points.size()) {
    // The surface's own limit, on these values instead of positions.
    FaceSurface f;
    if (!t.factory->InitVertexSurface(int(place.face), &f)) return false;
    std::vector<float> points(size_t(f.GetNumPatchPoints()) * width);
    f.PreparePatchPoints(values.data(), Points(int(width)), points.data(), Points(int(width)));
    evaluatePoints(t, place, f, points, width, n, u, v, out);
    return true;
  }
  for (size_t channel = 0; channel < t.smooth.size(); ++channel) {
    const SmoothVariable& smooth = t.smooth[channel];
    if (smooth.name != param.name || smooth.width != width || count < t.vertices.size()) continue;
    FaceSurface f;
    if (!t.factory->InitFaceVaryingSurface(int(place.face), &f, osd::Bfr::SurfaceFactory::FVarID(channel)))
      return false;
    // OpenSubdiv reads only the face's neighbourhood: gathering that beats copying all values for each patch.
    std::vector<int> near(size_t(f.GetNumControlPoints()));
    f.GetControlPointIndices(near.data());
    std::vector<float> points(size_t(f.GetNumPatchPoints()) * width);
    for (size_t i = 0; i < near.size(); ++i)
      std::copy_n(row(smooth.cornerOfValue[size_t(near[i])]), width, points.data() + i * width);
    f.ComputePatchPoints(points.data(), Points(int(width)));
    evaluatePoints(t, place, f, points, width, n, u, v, out);
    return true;
  }
  // Varying, and facevarying where no tag makes it smooth: linear over the face.
  const uint32_t size = t.sizeOf(place.face), first = t.firstCorner[place.face];
  const auto corner = [&](uint32_t k) {
    const uint64_t at = first + k % size;
    return row(param.storage == ParamClass::kVarying || param.storage == ParamClass::kVertex ? t.vertices[at]
                                                                                             : at);
  };
  std::vector<float> quad(size_t(width) * 4);
  for (uint32_t c = 0; c < width; ++c) {
    float* q = quad.data() + c * 4;  // (0,0) (1,0) (0,1) (1,1)
    if (t.scheme == SubdivisionScheme::kLoop) {
      q[0] = corner(0)[c], q[1] = corner(1)[c], q[2] = q[3] = corner(2)[c];
    } else if (!t.pieces) {
      q[0] = corner(0)[c], q[1] = corner(1)[c], q[2] = corner(3)[c], q[3] = corner(2)[c];
    } else {
      float sum = 0;
      for (uint32_t k = 0; k < size; ++k) sum += corner(k)[c];
      const uint32_t k = place.corner % size;
      q[0] = corner(k)[c];
      q[1] = 0.5f * (corner(k)[c] + corner(k + 1)[c]);
      q[2] = 0.5f * (corner(k)[c] + corner(k + size - 1)[c]);
      q[3] = sum / float(size);
    }
    for (size_t i = 0; i < n; ++i) {
      const float low = (1 - u[i]) * q[0] + u[i] * q[1], high = (1 - u[i]) * q[2] + u[i] * q[3];
      out[c][i] = (1 - v[i]) * low + v[i] * high;
    }
  }
  return true;
}

}  // namespace fr::cache
