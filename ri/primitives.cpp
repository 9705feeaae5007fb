#include "ri/primitives.h"

#include <algorithm>
#include <cmath>
#include <optional>

namespace fr::ri {
namespace {

template <class... Ts>
struct Overloaded : Ts... {
  using Ts::operator()...;
};
template <class... Ts>
Overloaded(Ts...) -> Overloaded<Ts...>;

template <class... Args>
Error inconsistent(fmt::format_string<Args...> f, Args&&... args) {
  return makeError(RiError::kConsistency, f, std::forward<Args>(args)...);
}

/// Number of positions a primitive was given, in any of its forms; 0 = none.
uint64_t positionCount(const ParamList& params) {
  for (const char* name : {"P", "Pw", "Pz"}) {
    if (const Param* p = params.find(name)) return p->valueCount();
  }
  return 0;
}

struct IndexSummary {
  uint64_t sum = 0;  // entries that the counts ask for
  int64_t highest = -1;
};

Result<uint64_t> sumOfCounts(const std::vector<int>& counts, int least, const char* what) {
  uint64_t sum = 0;
  for (size_t i = 0; i < counts.size(); ++i) {
    if (counts[i] < least)
      return inconsistent("{} {} has {} vertices, at least {} are needed", what, i, counts[i], least);
    sum += uint64_t(counts[i]);
  }
  return sum;
}

Result<int64_t> highestIndex(const std::vector<int>& verts) {
  int highest = -1, lowest = 0;
  for (int v : verts) {
    highest = std::max(highest, v);
    lowest = std::min(lowest, v);
  }
  if (lowest < 0) return inconsistent("vertex index {} is negative", lowest);
  return int64_t(highest);
}

Result<ValueCounts> indexedCounts(const ParamList& params, const std::vector<int>& verts, uint64_t wanted,
                                  uint64_t faces) {
  if (verts.size() != wanted) {
    return inconsistent("the faces have {} vertices together but {} vertex indices are given", wanted,
                        verts.size());
  }
  Result<int64_t> highest = highestIndex(verts);
  if (!highest) return highest.error();
  ValueCounts c;
  c.uniform = faces;
  c.faceVarying = wanted;
  // Exporters write all points of a scene object even where the last ones are in no face.
  c.vertex = std::max(uint64_t(*highest + 1), positionCount(params));
  c.varying = c.vertex;
  return c;
}

struct MeshSide {
  uint64_t patches = 0, corners = 0;
};

// One direction of a PatchMesh (RISpec 3.2, section 5.2.2).
Result<MeshSide> meshSide(char name, bool bicubic, int n, bool periodic, int step) {
  MeshSide s;
  if (!bicubic) {
    const int least = 2;
    if (n < least) return inconsistent("n{} is {}, at least {} are needed", name, n, least);
    s.patches = uint64_t(periodic ? n : n - 1);
    s.corners = uint64_t(n);
    return s;
  }
  if (step < 1) return makeError(RiError::kRange, "the step of the {} basis is {}", name, step);
  if (n < 4 && !(periodic && n >= step)) return inconsistent("n{} is {}, at least 4 are needed", name, n);
  if (periodic ? n % step != 0 : (n - 4) % step != 0) {
    return inconsistent("n{} is {}, which does not fit a{} bicubic mesh with step {}", name, n,
                        periodic ? " periodic" : "", step);
  }
  s.patches = uint64_t(periodic ? n / step : (n - 4) / step + 1);
  s.corners = periodic ? s.patches : s.patches + 1;
  return s;
}

Result<ValueCounts> countsOf(const PatchMesh& m, BasisSteps steps) {
  if (m.separate) {
    const int side = m.bicubic ? 4 : 2;
    if (m.nu < side || m.nu % side != 0 || m.nv != side)
      return inconsistent("{} x {} values make no separate patches", m.nu, m.nv);
    ValueCounts c;
    c.uniform = uint64_t(m.nu / side);
    c.varying = c.faceVarying = 4 * c.uniform;
    c.vertex = uint64_t(m.nu) * uint64_t(m.nv);
    return c;
  }
  const Result<MeshSide> u = meshSide('u', m.bicubic, m.nu, m.uPeriodic, steps.u);
  if (!u) return u.error();
  const Result<MeshSide> v = meshSide('v', m.bicubic, m.nv, m.vPeriodic, steps.v);
  if (!v) return v.error();
  ValueCounts c;
  c.uniform = u->patches * v->patches;
  c.varying = u->corners * v->corners;
  c.vertex = uint64_t(m.nu) * uint64_t(m.nv);
  c.faceVarying = 4 * c.uniform;
  return c;
}

Result<void> checkKnots(char name, int n, int order, const std::vector<float>& knot, float min, float max) {
  if (order < 1) return makeError(RiError::kRange, "{}order is {}", name, order);
  if (n < order) return inconsistent("n{} is {}, less than {}order {}", name, n, name, order);
  const uint64_t expected = uint64_t(n) + uint64_t(order);
  if (knot.size() != expected)
    return inconsistent("{}knot has {} values, expected {}", name, knot.size(), expected);
  for (size_t i = 1; i < knot.size(); ++i) {
    if (!(knot[i - 1] <= knot[i])) return makeError(RiError::kRange, "{}knot decreases at value {}", name, i);
  }
  if (!(min < max)) return makeError(RiError::kRange, "{}min {} is not below {}max {}", name, min, name, max);
  const float lowest = knot[size_t(order) - 1], highest = knot[size_t(n)];
  if (!(min >= lowest) || !(max <= highest)) {
    return makeError(RiError::kRange, "{} range {} to {} leaves the knots' range {} to {}", name, min, max,
                     lowest, highest);
  }
  return {};
}

Result<ValueCounts> countsOf(const NuPatch& n) {
  if (auto r = checkKnots('u', n.nu, n.uOrder, n.uKnot, n.uMin, n.uMax); !r) return r.error();
  if (auto r = checkKnots('v', n.nv, n.vOrder, n.vKnot, n.vMin, n.vMax); !r) return r.error();
  const auto us = uint64_t(n.nu - n.uOrder + 1), vs = uint64_t(n.nv - n.vOrder + 1);
  ValueCounts c;
  c.uniform = us * vs;
  c.varying = (us + 1) * (vs + 1);
  c.vertex = uint64_t(n.nu) * uint64_t(n.nv);
  c.faceVarying = 4 * c.uniform;
  return c;
}

Result<ValueCounts> countsOf(const Curves& k, BasisSteps steps) {
  ValueCounts c;
  c.uniform = k.nverts.size();
  c.varying = 0;
  c.vertex = 0;
  if (k.cubic && steps.v < 1) return makeError(RiError::kRange, "the step of the v basis is {}", steps.v);
  for (size_t i = 0; i < k.nverts.size(); ++i) {
    const int n = k.nverts[i];
    const int least = k.cubic ? (k.periodic ? std::max(steps.v, 3) : 4) : 2;
    if (n < least) return inconsistent("curve {} has {} vertices, at least {} are needed", i, n, least);
    int segments = 0;
    if (!k.cubic) {
      segments = k.periodic ? n : n - 1;
    } else {
      if (k.periodic ? n % steps.v != 0 : (n - 4) % steps.v != 0) {
        return inconsistent("curve {} has {} vertices, which does not fit step {}", i, n, steps.v);
      }
      segments = k.periodic ? n / steps.v : (n - 4) / steps.v + 1;
    }
    c.varying += uint64_t(k.periodic ? segments : segments + 1);
    c.vertex += uint64_t(n);
  }
  c.faceVarying = c.varying;
  return c;
}

Result<ValueCounts> countsOf(const PointsGeneralPolygons& g) {
  Result<uint64_t> loops = sumOfCounts(g.nloops, 1, "polygon");
  if (!loops) return loops.error();
  if (*loops != g.nverts.size()) {
    return inconsistent("the polygons have {} loops together but {} vertex counts are given", *loops,
                        g.nverts.size());
  }
  Result<uint64_t> wanted = sumOfCounts(g.nverts, 3, "loop");
  if (!wanted) return wanted.error();
  return indexedCounts(g.params, g.verts, *wanted, g.nloops.size());
}

// Tags: the argument counts must fit the arrays; what each tag means is for the subdivision code.
Result<void> checkTags(const SubdivisionMesh& m) {
  const size_t perTag = m.hierarchical ? 3 : 2;
  if (m.nargs.size() != perTag * m.tags.size()) {
    return inconsistent("{} tags need {} argument counts, {} are given", m.tags.size(),
                        perTag * m.tags.size(), m.nargs.size());
  }
  uint64_t sums[3] = {0, 0, 0};
  for (size_t i = 0; i < m.nargs.size(); ++i) {
    if (m.nargs[i] < 0) return inconsistent("tag argument count {} is negative", m.nargs[i]);
    sums[i % perTag] += uint64_t(m.nargs[i]);
  }
  const size_t actual[3] = {m.intArgs.size(), m.floatArgs.size(), m.stringArgs.size()};
  const char* names[3] = {"integer", "float", "string"};
  for (size_t k = 0; k < perTag; ++k) {
    if (sums[k] != actual[k]) {
      return inconsistent("the tags ask for {} {} arguments, {} are given", sums[k], names[k], actual[k]);
    }
  }
  return {};
}

/// a * b, or the largest number.
uint64_t product(uint64_t a, uint64_t b) {
  uint64_t r = 0;
  return __builtin_mul_overflow(a, b, &r) ? ~uint64_t(0) : r;
}

/// Whether "P", "Pw" or "Pz" holds places: so many numbers each, one place a vertex. Older files call points
/// vectors, and arrays of as many floats do no harm.
bool holdsPositions(const Param& p, const ValueCounts& counts) {
  const Declaration& d = p.declaration;
  if (d.type == ValueType::kString || d.type == ValueType::kInteger || d.type == ValueType::kMatrix)
    return false;
  if (d.storage == StorageClass::kConstant || d.storage == StorageClass::kUniform) return false;
  if (counts.of(d.storage) != counts.vertex) return false;
  const bool rational = p.name == "Pw" || (p.name == "P" && d.type == ValueType::kHpoint);
  return d.width() == (rational ? 4u : p.name == "P" ? 3u : 1u);
}

ValueCounts allEqual(uint64_t n) {
  ValueCounts c;
  c.varying = c.vertex = c.faceVarying = n;
  return c;
}

bool needsPositions(const Primitive& p) {
  return !std::holds_alternative<Sphere>(p) && !std::holds_alternative<Cone>(p) &&
         !std::holds_alternative<Cylinder>(p) && !std::holds_alternative<Hyperboloid>(p) &&
         !std::holds_alternative<Paraboloid>(p) && !std::holds_alternative<Disk>(p) &&
         !std::holds_alternative<Torus>(p) && !std::holds_alternative<Blobby>(p) &&
         !std::holds_alternative<Geometry>(p);
}

bool takesPz(const Primitive& p) {
  return std::holds_alternative<Patch>(p) || std::holds_alternative<PatchMesh>(p);
}

Result<void> checkScalars(const Primitive& p) {
  const auto finite = [](std::initializer_list<double> values, const char* what) -> Result<void> {
    for (double v : values) {
      if (!std::isfinite(v)) return makeError(RiError::kMath, "{}: a number is not finite", what);
    }
    return {};
  };
  return std::visit(
      Overloaded{
          [&](const Sphere& s) -> Result<void> {
            if (s.radius == 0) return makeError(RiError::kRange, "Sphere: the radius is 0");
            return finite({s.radius, s.zmin, s.zmax, s.thetaMax}, "Sphere");
          },
          [&](const Cone& s) {
            return finite({s.height, s.radius, s.thetaMax}, "Cone");
          },
          [&](const Cylinder& s) {
            return finite({s.radius, s.zmin, s.zmax, s.thetaMax}, "Cylinder");
          },
          [&](const Hyperboloid& s) {
            return finite({s.p1[0], s.p1[1], s.p1[2], s.p2[0], s.p2[1], s.p2[2], s.thetaMax}, "Hyperboloid");
          },
          [&](const Paraboloid& s) -> Result<void> {
            if (!(s.zmax > 0))
              return makeError(RiError::kRange, "Paraboloid: zmax {} is not positive", s.zmax);
            return finite({s.rmax, s.zmin, s.zmax, s.thetaMax}, "Paraboloid");
          },
          [&](const Disk& s) {
            return finite({s.height, s.radius, s.thetaMax}, "Disk");
          },
          [&](const Torus& s) {
            return finite({s.majorRadius, s.minorRadius, s.phiMin, s.phiMax, s.thetaMax}, "Torus");
          },
          [](const auto&) -> Result<void> { return {}; }},
      p);
}

/// `"float[2] st" [8 numbers]`: without a class it is uniform (RISpec 3.2, section 3), which exporters that
/// write their types but no classes do not mean. A variable of the standard whose values fit its standard
/// class has it.
void takeStandardClass(Param& p, const ValueCounts& counts) {
  if (p.declaration.storage != StorageClass::kUniform) return;
  const uint64_t width = p.declaration.width(), actual = p.elementCount();
  if (actual == product(counts.uniform, width)) return;
  static const Dictionary& standard = *new Dictionary;
  const std::optional<Declaration> d = standard.find(p.name, "");
  if (!d || d->type != p.declaration.type || d->width() != width) return;
  for (const StorageClass c : {d->storage, StorageClass::kFaceVarying}) {
    if (actual != product(counts.of(c), width)) continue;
    p.declaration.storage = c;
    return;
  }
}

/// Another class that has as many values as were given: what was declared is wrong, what was meant is plain.
std::optional<StorageClass> classOf(uint64_t values, const ValueCounts& counts) {
  for (const StorageClass c : {StorageClass::kVarying, StorageClass::kVertex, StorageClass::kFaceVarying,
                               StorageClass::kUniform, StorageClass::kConstant})
    if (values == counts.of(c)) return c;
  return std::nullopt;
}

/// Exporters write each particle system, hair and mesh in every frame, whether there is anything in it or
/// not.
bool hasNothingInIt(const Primitive& p) {
  const Param* position = paramsOf(p).find("P");
  if (!position || position->elementCount() > 0) return false;
  if (const auto* m = std::get_if<PointsPolygons>(&p)) return m->nverts.empty() && m->verts.empty();
  if (const auto* m = std::get_if<PointsGeneralPolygons>(&p)) return m->nloops.empty() && m->verts.empty();
  if (const auto* m = std::get_if<SubdivisionMesh>(&p)) return m->nverts.empty() && m->verts.empty();
  if (const auto* c = std::get_if<Curves>(&p)) return c->nverts.empty();
  return std::holds_alternative<Points>(p);
}

}  // namespace

uint64_t ValueCounts::of(StorageClass c) const {
  switch (c) {
    case StorageClass::kConstant:
      return constant;
    case StorageClass::kUniform:
      return uniform;
    case StorageClass::kVarying:
      return varying;
    case StorageClass::kVertex:
      return vertex;
    case StorageClass::kFaceVarying:
    case StorageClass::kFaceVertex:
      return faceVarying;
  }
  return 1;
}

const char* primitiveName(const Primitive& p) {
  static constexpr const char* kNames[] = {
      "Polygon",    "GeneralPolygon", "PointsPolygons", "PointsGeneralPolygons",
      "Patch",      "PatchMesh",      "NuPatch",        "SubdivisionMesh",
      "Sphere",     "Cone",           "Cylinder",       "Hyperboloid",
      "Paraboloid", "Disk",           "Torus",          "Points",
      "Curves",     "Blobby",         "Geometry"};
  static_assert(std::size(kNames) == std::variant_size_v<Primitive>);
  if (const auto* m = std::get_if<SubdivisionMesh>(&p); m && m->hierarchical)
    return "HierarchicalSubdivisionMesh";
  return kNames[p.index()];
}

const ParamList& paramsOf(const Primitive& p) {
  return std::visit([](const auto& x) -> const ParamList& { return x.params; }, p);
}
ParamList& paramsOf(Primitive& p) {
  return std::visit([](auto& x) -> ParamList& { return x.params; }, p);
}

Result<ValueCounts> expectedCounts(const Primitive& p, BasisSteps steps) {
  using R = Result<ValueCounts>;
  return std::visit(Overloaded{[](const Polygon& s) -> R { return allEqual(positionCount(s.params)); },
                               [](const Points& s) -> R { return allEqual(positionCount(s.params)); },
                               [](const GeneralPolygon& s) -> R {
                                 Result<uint64_t> n = sumOfCounts(s.nverts, 3, "loop");
                                 if (!n) return n.error();
                                 return allEqual(*n);
                               },
                               [](const PointsPolygons& s) -> R {
                                 Result<uint64_t> n = sumOfCounts(s.nverts, 3, "polygon");
                                 if (!n) return n.error();
                                 return indexedCounts(s.params, s.verts, *n, s.nverts.size());
                               },
                               [](const PointsGeneralPolygons& s) -> R { return countsOf(s); },
                               [](const SubdivisionMesh& s) -> R {
                                 Result<uint64_t> n = sumOfCounts(s.nverts, 3, "face");
                                 if (!n) return n.error();
                                 if (auto r = checkTags(s); !r) return r.error();
                                 return indexedCounts(s.params, s.verts, *n, s.nverts.size());
                               },
                               [](const Patch& s) -> R {
                                 ValueCounts c = allEqual(4);
                                 if (s.bicubic) c.vertex = 16;
                                 return c;
                               },
                               [&](const PatchMesh& s) -> R { return countsOf(s, steps); },
                               [](const NuPatch& s) -> R { return countsOf(s); },
                               [&](const Curves& s) -> R { return countsOf(s, steps); },
                               [](const Blobby& s) -> R {
                                 if (s.nleaf < 1) return inconsistent("{} leaves", s.nleaf);
                                 return allEqual(uint64_t(s.nleaf));
                               },
                               [](const auto&) -> R { return allEqual(4); }},
                    p);
}

Result<PrimitiveCheck> checkPrimitive(Primitive& p, BasisSteps steps) {
  const char* name = primitiveName(p);
  if (Result<void> r = checkScalars(p); !r) return r.error();
  if (hasNothingInIt(p)) {
    Error e = makeError(RiError::kMissingData, "{}: there is nothing in it", name);
    e.severity = Severity::kWarning;
    return e;
  }
  Result<ValueCounts> counts = expectedCounts(p, steps);
  if (!counts) return std::move(counts).error().context(name);
  PrimitiveCheck check{*counts, {}};
  ParamList& params = paramsOf(p);

  if (needsPositions(p)) {
    const Param* position = params.find("P");
    if (!position) position = params.find("Pw");
    if (!position && takesPz(p)) position = params.find("Pz");
    if (!position || position->elementCount() == 0) {
      return makeError(RiError::kMissingData, "{}: \"P\" is missing", name);
    }
    if (std::holds_alternative<Polygon>(p) && position->valueCount() < 3) {
      return inconsistent("Polygon: {} vertices, at least 3 are needed", position->valueCount());
    }
  }

  std::vector<Param>& list = params.params();
  for (size_t i = 0; i < list.size();) {
    takeStandardClass(list[i], *counts);
    const Param& v = list[i];
    const uint64_t width = v.declaration.width();
    uint64_t expected = counts->of(v.declaration.storage);
    const uint64_t actual = v.elementCount();
    // Both readings of the specification are met for these (section 5 and common exporters).
    const bool perSegmentOrOne =
        std::holds_alternative<NuPatch>(p) && v.declaration.storage == StorageClass::kUniform;
    const bool perPointOrOne =
        std::holds_alternative<Points>(p) && v.declaration.storage == StorageClass::kUniform;
    const bool isPosition = v.name == "P" || v.name == "Pw" || v.name == "Pz";
    if (isPosition && needsPositions(p) && !holdsPositions(v, *counts))
      return inconsistent("{}: \"{} {}\" does not say where the vertices are", name, v.declaration.str(),
                          v.name);
    bool fits = actual == product(expected, width);
    if (!fits && perSegmentOrOne) fits = actual == width;
    if (!fits && perPointOrOne) fits = actual == product(counts->vertex, width);
    if (fits) {
      ++i;
      continue;
    }
    Error e = inconsistent("{}: \"{} {}\" has {} numbers, expected {} ({} values of {})", name,
                           v.declaration.str(), v.name, actual, product(expected, width), expected, width);
    if (isPosition) return e;
    const std::optional<StorageClass> meant =
        actual % width == 0 ? classOf(actual / width, *counts) : std::nullopt;
    if (!meant) {
      e.message += "; ignored";
      check.complaints.push_back(std::move(e));
      list.erase(list.begin() + ptrdiff_t(i));
      continue;
    }
    list[i].declaration.storage = *meant;
    e.message += fmt::format("; taken as {}", storageClassName(*meant));
    e.severity = Severity::kWarning;
    check.complaints.push_back(std::move(e));
    ++i;
  }
  return check;
}

}  // namespace fr::ri
