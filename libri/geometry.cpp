// Geometric primitives and procedurals.
#include <cstdlib>

#include "libri/context.h"

using namespace fr;
using namespace fr::libri;
using ri::Renderer;

namespace {

template <class T>
std::vector<T> array(const T* values, int64_t n) {
  if (!values || n <= 0) return {};
  return {values, values + n};
}
std::vector<std::string> strings(RtToken const* values, int64_t n) {
  std::vector<std::string> v;
  for (int64_t i = 0; values && i < n; ++i) v.push_back(text(values[i]));
  return v;
}
/// Sum of what is not negative; bad counts are found by the checks of the primitive.
int64_t sum(const std::vector<int>& v) {
  int64_t s = 0;
  for (const int i : v) s += std::max(i, 0);
  return s;
}
bool word(const char* request, RtToken given, const char* yes, const char* no, bool* bad) {
  const std::string s = text(given);
  if (s != yes && s != no) {
    complain(RiError::kBadToken, Severity::kError, request,
             fmt::format("\"{}\" is neither \"{}\" nor \"{}\"", s, yes, no));
    *bad = true;
  }
  return s == yes;
}

struct List {
  RtInt n;
  RtToken* tokens;
  RtPointer* values;
};

/// The primitive with its parameters, whose numbers of values follow from it.
void primitive(const char* request, ri::Primitive p, const List& list,
               std::optional<ri::ValueCounts> counts = {}) {
  withContext(request, [&](Context& c) {
    if (!counts) {
      const ri::Basis& basis = *c.state().state().attributes().basis;
      const Result<ri::ValueCounts> r = ri::expectedCounts(p, {basis.uStep, basis.vStep});
      if (!r) return complain(r.error().code, Severity::kError, request, r.error().message);
      counts = *r;
    }
    ri::paramsOf(p) = c.params(request, request + 2, list.n, list.tokens, list.values, *counts);
    c.out().primitive(std::move(p));
  });
}

ri::ValueCounts vertices(RtInt n) {
  ri::ValueCounts c;
  c.varying = c.vertex = c.faceVarying = uint64_t(std::max(n, 0));
  return c;
}

}  // namespace

extern "C" {

#define FR_RI_PARAMETERS RtInt n, RtToken tokens[], RtPointer parms[]
#define FR_RI_GIVEN \
  List { n, tokens, parms }

RtVoid RiPolygonV(RtInt nverts, FR_RI_PARAMETERS) {
  primitive("RiPolygon", ri::Polygon{}, FR_RI_GIVEN, vertices(nverts));
}
RtVoid RiPolygon(RtInt nverts, ...) { FR_RI_LIST(nverts, RiPolygonV(nverts, FR_RI_TAIL)); }

RtVoid RiGeneralPolygonV(RtInt nloops, RtInt nverts[], FR_RI_PARAMETERS) {
  primitive("RiGeneralPolygon", ri::GeneralPolygon{array(nverts, nloops), {}}, FR_RI_GIVEN);
}
RtVoid RiGeneralPolygon(RtInt nloops, RtInt nverts[], ...) {
  FR_RI_LIST(nverts, RiGeneralPolygonV(nloops, nverts, FR_RI_TAIL));
}

RtVoid RiPointsPolygonsV(RtInt npolys, RtInt nverts[], RtInt verts[], FR_RI_PARAMETERS) {
  ri::PointsPolygons p;
  p.nverts = array(nverts, npolys);
  p.verts = array(verts, sum(p.nverts));
  primitive("RiPointsPolygons", std::move(p), FR_RI_GIVEN);
}
RtVoid RiPointsPolygons(RtInt npolys, RtInt nverts[], RtInt verts[], ...) {
  FR_RI_LIST(verts, RiPointsPolygonsV(npolys, nverts, verts, FR_RI_TAIL));
}

RtVoid RiPointsGeneralPolygonsV(RtInt npolys, RtInt nloops[], RtInt nverts[], RtInt verts[],
                                FR_RI_PARAMETERS) {
  ri::PointsGeneralPolygons p;
  p.nloops = array(nloops, npolys);
  p.nverts = array(nverts, sum(p.nloops));
  p.verts = array(verts, sum(p.nverts));
  primitive("RiPointsGeneralPolygons", std::move(p), FR_RI_GIVEN);
}
RtVoid RiPointsGeneralPolygons(RtInt npolys, RtInt nloops[], RtInt nverts[], RtInt verts[], ...) {
  FR_RI_LIST(verts, RiPointsGeneralPolygonsV(npolys, nloops, nverts, verts, FR_RI_TAIL));
}

RtVoid RiPatchV(RtToken type, FR_RI_PARAMETERS) {
  bool bad = false;
  ri::Patch p;
  p.bicubic = word("RiPatch", type, "bicubic", "bilinear", &bad);
  if (!bad) primitive("RiPatch", std::move(p), FR_RI_GIVEN);
}
RtVoid RiPatch(RtToken type, ...) { FR_RI_LIST(type, RiPatchV(type, FR_RI_TAIL)); }

RtVoid RiPatchMeshV(RtToken type, RtInt nu, RtToken uwrap, RtInt nv, RtToken vwrap, FR_RI_PARAMETERS) {
  bool bad = false;
  ri::PatchMesh p;
  p.bicubic = word("RiPatchMesh", type, "bicubic", "bilinear", &bad);
  p.nu = nu, p.nv = nv;
  p.uPeriodic = word("RiPatchMesh", uwrap, "periodic", "nonperiodic", &bad);
  p.vPeriodic = word("RiPatchMesh", vwrap, "periodic", "nonperiodic", &bad);
  if (!bad) primitive("RiPatchMesh", std::move(p), FR_RI_GIVEN);
}
RtVoid RiPatchMesh(RtToken type, RtInt nu, RtToken uwrap, RtInt nv, RtToken vwrap, ...) {
  FR_RI_LIST(vwrap, RiPatchMeshV(type, nu, uwrap, nv, vwrap, FR_RI_TAIL));
}

RtVoid RiNuPatchV(RtInt nu, RtInt uorder, RtFloat uknot[], RtFloat umin, RtFloat umax, RtInt nv, RtInt vorder,
                  RtFloat vknot[], RtFloat vmin, RtFloat vmax, FR_RI_PARAMETERS) {
  ri::NuPatch p;
  p.nu = nu, p.uOrder = uorder, p.uKnot = array(uknot, int64_t(nu) + uorder), p.uMin = umin, p.uMax = umax;
  p.nv = nv, p.vOrder = vorder, p.vKnot = array(vknot, int64_t(nv) + vorder), p.vMin = vmin, p.vMax = vmax;
  primitive("RiNuPatch", std::move(p), FR_RI_GIVEN);
}
RtVoid RiNuPatch(RtInt nu, RtInt uorder, RtFloat uknot[], RtFloat umin, RtFloat umax, RtInt nv, RtInt vorder,
                 RtFloat vknot[], RtFloat vmin, RtFloat vmax, ...) {
  FR_RI_LIST(vmax, RiNuPatchV(nu, uorder, uknot, umin, umax, nv, vorder, vknot, vmin, vmax, FR_RI_TAIL));
}

RtVoid RiTrimCurve(RtInt nloops, RtInt ncurves[], RtInt order[], RtFloat knot[], RtFloat min[], RtFloat max[],
                   RtInt counts[], RtFloat u[], RtFloat v[], RtFloat w[]) {
  send("RiTrimCurve", [&](Renderer& r) {
    ri::TrimCurve t;
    t.ncurves = array(ncurves, nloops);
    const int64_t curves = sum(t.ncurves);
    t.order = array(order, curves), t.n = array(counts, curves);
    t.min = array(min, curves), t.max = array(max, curves);
    const int64_t points = sum(t.n);
    t.knot = array(knot, points + sum(t.order));
    t.u = array(u, points), t.v = array(v, points), t.w = array(w, points);
    r.trimCurve(std::move(t));
  });
}

RtVoid RiHierarchicalSubdivisionMeshV(RtToken scheme, RtInt nfaces, RtInt nverts[], RtInt verts[],
                                      RtInt ntags, RtToken tags[], RtInt nargs[], RtInt intargs[],
                                      RtFloat floatargs[], RtToken stringargs[], FR_RI_PARAMETERS) {
  ri::SubdivisionMesh p;
  p.scheme = text(scheme), p.hierarchical = true;
  p.nverts = array(nverts, nfaces), p.verts = array(verts, sum(p.nverts));
  p.tags = strings(tags, ntags), p.nargs = array(nargs, 3 * int64_t(ntags));
  int64_t counts[3] = {};
  for (size_t i = 0; i < p.nargs.size(); ++i) counts[i % 3] += std::max(p.nargs[i], 0);
  p.intArgs = array(intargs, counts[0]), p.floatArgs = array(floatargs, counts[1]);
  p.stringArgs = strings(stringargs, counts[2]);
  primitive("RiHierarchicalSubdivisionMesh", std::move(p), FR_RI_GIVEN);
}
RtVoid RiHierarchicalSubdivisionMesh(RtToken scheme, RtInt nfaces, RtInt nverts[], RtInt verts[], RtInt ntags,
                                     RtToken tags[], RtInt nargs[], RtInt intargs[], RtFloat floatargs[],
                                     RtToken stringargs[], ...) {
  FR_RI_LIST(stringargs, RiHierarchicalSubdivisionMeshV(scheme, nfaces, nverts, verts, ntags, tags, nargs,
                                                        intargs, floatargs, stringargs, FR_RI_TAIL));
}
RtVoid RiSubdivisionMeshV(RtToken scheme, RtInt nfaces, RtInt nverts[], RtInt verts[], RtInt ntags,
                          RtToken tags[], RtInt nargs[], RtInt intargs[], RtFloat floatargs[],
                          FR_RI_PARAMETERS) {
  ri::SubdivisionMesh p;
  p.scheme = text(scheme);
  p.nverts = array(nverts, nfaces), p.verts = array(verts, sum(p.nverts));
  p.tags = strings(tags, ntags), p.nargs = array(nargs, 2 * int64_t(ntags));
  int64_t counts[2] = {};
  for (size_t i = 0; i < p.nargs.size(); ++i) counts[i % 2] += std::max(p.nargs[i], 0);
  p.intArgs = array(intargs, counts[0]), p.floatArgs = array(floatargs, counts[1]);
  primitive("RiSubdivisionMesh", std::move(p), FR_RI_GIVEN);
}
RtVoid RiSubdivisionMesh(RtToken scheme, RtInt nfaces, RtInt nverts[], RtInt verts[], RtInt ntags,
                         RtToken tags[], RtInt nargs[], RtInt intargs[], RtFloat floatargs[], ...) {
  FR_RI_LIST(floatargs, RiSubdivisionMeshV(scheme, nfaces, nverts, verts, ntags, tags, nargs, intargs,
                                           floatargs, FR_RI_TAIL));
}

RtVoid RiSphereV(RtFloat radius, RtFloat zmin, RtFloat zmax, RtFloat thetamax, FR_RI_PARAMETERS) {
  primitive("RiSphere", ri::Sphere{decimal(radius), decimal(zmin), decimal(zmax), decimal(thetamax), {}},
            FR_RI_GIVEN);
}
RtVoid RiSphere(RtFloat radius, RtFloat zmin, RtFloat zmax, RtFloat thetamax, ...) {
  FR_RI_LIST(thetamax, RiSphereV(radius, zmin, zmax, thetamax, FR_RI_TAIL));
}
RtVoid RiConeV(RtFloat height, RtFloat radius, RtFloat thetamax, FR_RI_PARAMETERS) {
  primitive("RiCone", ri::Cone{decimal(height), decimal(radius), decimal(thetamax), {}}, FR_RI_GIVEN);
}
RtVoid RiCone(RtFloat height, RtFloat radius, RtFloat thetamax, ...) {
  FR_RI_LIST(thetamax, RiConeV(height, radius, thetamax, FR_RI_TAIL));
}
RtVoid RiCylinderV(RtFloat radius, RtFloat zmin, RtFloat zmax, RtFloat thetamax, FR_RI_PARAMETERS) {
  primitive("RiCylinder", ri::Cylinder{decimal(radius), decimal(zmin), decimal(zmax), decimal(thetamax), {}},
            FR_RI_GIVEN);
}
RtVoid RiCylinder(RtFloat radius, RtFloat zmin, RtFloat zmax, RtFloat thetamax, ...) {
  FR_RI_LIST(thetamax, RiCylinderV(radius, zmin, zmax, thetamax, FR_RI_TAIL));
}
RtVoid RiHyperboloidV(RtPoint point1, RtPoint point2, RtFloat thetamax, FR_RI_PARAMETERS) {
  if (!point1 || !point2)
    return complain(RiError::kMissingData, Severity::kError, "RiHyperboloid", "a point is NULL");
  primitive("RiHyperboloid",
            ri::Hyperboloid{{decimal(point1[0]), decimal(point1[1]), decimal(point1[2])},
                            {decimal(point2[0]), decimal(point2[1]), decimal(point2[2])},
                            decimal(thetamax),
                            {}},
            FR_RI_GIVEN);
}
RtVoid RiHyperboloid(RtPoint point1, RtPoint point2, RtFloat thetamax, ...) {
  FR_RI_LIST(thetamax, RiHyperboloidV(point1, point2, thetamax, FR_RI_TAIL));
}
RtVoid RiParaboloidV(RtFloat rmax, RtFloat zmin, RtFloat zmax, RtFloat thetamax, FR_RI_PARAMETERS) {
  primitive("RiParaboloid",
            ri::Paraboloid{decimal(rmax), decimal(zmin), decimal(zmax), decimal(thetamax), {}}, FR_RI_GIVEN);
}
RtVoid RiParaboloid(RtFloat rmax, RtFloat zmin, RtFloat zmax, RtFloat thetamax, ...) {
  FR_RI_LIST(thetamax, RiParaboloidV(rmax, zmin, zmax, thetamax, FR_RI_TAIL));
}
RtVoid RiDiskV(RtFloat height, RtFloat radius, RtFloat thetamax, FR_RI_PARAMETERS) {
  primitive("RiDisk", ri::Disk{decimal(height), decimal(radius), decimal(thetamax), {}}, FR_RI_GIVEN);
}
RtVoid RiDisk(RtFloat height, RtFloat radius, RtFloat thetamax, ...) {
  FR_RI_LIST(thetamax, RiDiskV(height, radius, thetamax, FR_RI_TAIL));
}
RtVoid RiTorusV(RtFloat majorradius, RtFloat minorradius, RtFloat phimin, RtFloat phimax, RtFloat thetamax,
                FR_RI_PARAMETERS) {
  primitive("RiTorus",
            ri::Torus{decimal(majorradius),
                      decimal(minorradius),
                      decimal(phimin),
                      decimal(phimax),
                      decimal(thetamax),
                      {}},
            FR_RI_GIVEN);
}
RtVoid RiTorus(RtFloat majorradius, RtFloat minorradius, RtFloat phimin, RtFloat phimax, RtFloat thetamax,
               ...) {
  FR_RI_LIST(thetamax, RiTorusV(majorradius, minorradius, phimin, phimax, thetamax, FR_RI_TAIL));
}

RtVoid RiPointsV(RtInt npoints, FR_RI_PARAMETERS) {
  primitive("RiPoints", ri::Points{}, FR_RI_GIVEN, vertices(npoints));
}
RtVoid RiPoints(RtInt npoints, ...) { FR_RI_LIST(npoints, RiPointsV(npoints, FR_RI_TAIL)); }

RtVoid RiCurvesV(RtToken type, RtInt ncurves, RtInt nvertices[], RtToken wrap, FR_RI_PARAMETERS) {
  bool bad = false;
  ri::Curves p;
  p.cubic = word("RiCurves", type, "cubic", "linear", &bad);
  p.nverts = array(nvertices, ncurves);
  p.periodic = word("RiCurves", wrap, "periodic", "nonperiodic", &bad);
  if (!bad) primitive("RiCurves", std::move(p), FR_RI_GIVEN);
}
RtVoid RiCurves(RtToken type, RtInt ncurves, RtInt nvertices[], RtToken wrap, ...) {
  FR_RI_LIST(wrap, RiCurvesV(type, ncurves, nvertices, wrap, FR_RI_TAIL));
}

RtVoid RiBlobbyV(RtInt nleaf, RtInt ncode, RtInt code[], RtInt nflt, RtFloat flt[], RtInt nstr, RtToken str[],
                 FR_RI_PARAMETERS) {
  primitive("RiBlobby", ri::Blobby{nleaf, array(code, ncode), array(flt, nflt), strings(str, nstr), {}},
            FR_RI_GIVEN, vertices(nleaf));
}
RtVoid RiBlobby(RtInt nleaf, RtInt ncode, RtInt code[], RtInt nflt, RtFloat flt[], RtInt nstr, RtToken str[],
                ...) {
  FR_RI_LIST(str, RiBlobbyV(nleaf, ncode, code, nflt, flt, nstr, str, FR_RI_TAIL));
}

RtVoid RiGeometryV(RtToken type, FR_RI_PARAMETERS) {
  primitive("RiGeometry", ri::Geometry{text(type), {}}, FR_RI_GIVEN, ri::ValueCounts{});
}
RtVoid RiGeometry(RtToken type, ...) { FR_RI_LIST(type, RiGeometryV(type, FR_RI_TAIL)); }

RtVoid RiProcedural2V(RtToken subdivide, RtToken bound, FR_RI_PARAMETERS) {
  withContext("RiProcedural2", [&](Context& c) {
    ri::Procedural p;
    p.kind = ri::ProceduralKind::kProcedural2;
    p.subdivide = text(subdivide), p.boundFunction = text(bound);
    p.params = c.params("RiProcedural2", "Procedural2", n, tokens, parms);
    c.out().procedural(std::move(p));
  });
}
RtVoid RiProcedural2(RtToken subdivide, RtToken bound, ...) {
  FR_RI_LIST(bound, RiProcedural2V(subdivide, bound, FR_RI_TAIL));
}

}  // extern "C"

namespace {

/// One of the three procedurals that RIB can name; nullptr for a function of the program's own.
const char* nameOf(RtProcSubdivFunc f) {
  return f == RiProcDelayedReadArchive ? "DelayedReadArchive"
         : f == RiProcRunProgram       ? "RunProgram"
         : f == RiProcDynamicLoad      ? "DynamicLoad"
                                       : nullptr;
}

void sendProcedural(Context& c, const char* name, RtPointer data, std::optional<ri::Bound> bound) {
  const auto* words = static_cast<RtString const*>(data);
  if (!words) return complain(RiError::kMissingData, Severity::kError, "RiProcedural", "the data are NULL");
  ri::Procedural p;
  p.subdivide = name;
  p.kind = p.subdivide == "DelayedReadArchive" ? ri::ProceduralKind::kDelayedReadArchive
           : p.subdivide == "RunProgram"       ? ri::ProceduralKind::kRunProgram
                                               : ri::ProceduralKind::kDynamicLoad;
  p.data.push_back(text(words[0]));
  if (p.kind != ri::ProceduralKind::kDelayedReadArchive) p.data.push_back(text(words[1]));
  p.bound = bound.value_or(ri::Bound{-1e30, 1e30, -1e30, 1e30, -1e30, 1e30});
  c.out().procedural(std::move(p));
}

}  // namespace

extern "C" {

RtVoid RiProcedural(RtPointer data, RtBound bound, RtProcSubdivFunc subdivfunc, RtProcFreeFunc freefunc) {
  withContext("RiProcedural", [&](Context& c) {
    if (!subdivfunc)
      return complain(RiError::kMissingData, Severity::kError, "RiProcedural", "there is no function");
    if (const char* name = nameOf(subdivfunc)) {
      std::optional<ri::Bound> b;
      if (bound) {
        b.emplace();
        std::transform(bound, bound + 6, b->begin(), decimal);
      }
      sendProcedural(c, name, data, b);
    } else {
      RiAttributeBegin();
      subdivfunc(data, RI_INFINITY);
      RiAttributeEnd();
    }
    if (freefunc) freefunc(data);
  });
}
RtVoid RiProcDelayedReadArchive(RtPointer data, RtFloat) {
  const auto* words = static_cast<RtString const*>(data);
  if (words) RiReadArchive(const_cast<RtToken>(words[0]), nullptr, RI_NULL);
}
RtVoid RiProcRunProgram(RtPointer data, RtFloat) {
  withContext("RiProcRunProgram", [&](Context& c) { sendProcedural(c, "RunProgram", data, {}); });
}
RtVoid RiProcDynamicLoad(RtPointer data, RtFloat) {
  withContext("RiProcDynamicLoad", [&](Context& c) { sendProcedural(c, "DynamicLoad", data, {}); });
}
RtVoid RiProcFree(RtPointer data) { std::free(data); }

}  // extern "C"
