#include "scene_cache/primitive_run.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace fr::cache {
namespace {

/// A message about a primitive names the first request of its run, and culling knows boxes of patches: a run
/// needs no end for its own sake. But nothing of a scene waits here for long.
constexpr uint32_t kMostRequests = 16384;

bool isRunnable(const ri::Primitive& p) {
  return std::holds_alternative<ri::Polygon>(p) || std::holds_alternative<ri::Patch>(p);
}

bool isPosition(const ri::Param& v) { return v.name == "P" || v.name == "Pw"; }

/// One primitive may be left out for a position that is no number; its neighbours may not.
bool isFinite(const std::vector<float>& values) {
  return std::all_of(values.begin(), values.end(), [](float x) { return std::isfinite(x); });
}

/// Whether values of several requests can stand one behind the other.
bool isJoinable(const ri::Param& v, const ri::ValueCounts& counts) {
  const ri::Declaration& d = v.declaration;
  return d.storage != ri::StorageClass::kConstant && v.strings.empty() &&
         v.elementCount() == counts.of(d.storage) * d.width() && v.name != "Pz" &&
         (!isPosition(v) || isFinite(v.floats));
}

/// Rows of `side` values from each request, as rows of one mesh.
template <class T>
std::vector<T> interleaved(const std::vector<T>& values, size_t side, size_t width, size_t requests) {
  if (values.size() != requests * side * side * width) return values;
  std::vector<T> mesh;
  mesh.reserve(values.size());
  for (size_t row = 0; row < side; ++row)
    for (size_t r = 0; r < requests; ++r) {
      const auto from = values.begin() + std::ptrdiff_t((r * side + row) * side * width);
      mesh.insert(mesh.end(), from, from + std::ptrdiff_t(side * width));
    }
  return mesh;
}

}  // namespace

bool PrimitiveRun::continues(const ri::PlacedPrimitive& p, uint8_t sides) const {
  const ri::MovingPrimitive &a = *first_.source, &b = *p.source;
  if (requests_ >= kMostRequests || sides != sides_ || p.attributes != first_.attributes ||
      p.objectToWorld != first_.objectToWorld || a.location.file != b.location.file)
    return false;
  const ri::Primitive &like = a.samples.front(), &one = b.samples.front();
  if (like.index() != one.index()) return false;
  if (const auto* patch = std::get_if<ri::Patch>(&one)) {
    if (patch->bicubic != std::get<ri::Patch>(like).bicubic) return false;
    if (patch->bicubic && a.basis != b.basis && (a.basis->u != b.basis->u || a.basis->v != b.basis->v))
      return false;
  }
  const ri::ParamList &x = ri::paramsOf(like), &y = ri::paramsOf(one);
  return std::equal(x.begin(), x.end(), y.begin(), y.end(), [](const ri::Param& l, const ri::Param& r) {
    return l.name == r.name && l.declaration == r.declaration;
  });
}

bool PrimitiveRun::take(const ri::PlacedPrimitive& p, uint8_t sides) {
  const ri::MovingPrimitive& source = *p.source;
  const ri::Primitive& one = source.samples.front();
  if (source.samples.size() != 1 || !isRunnable(one)) return false;
  const ri::ParamList& params = ri::paramsOf(one);
  if (!std::all_of(params.begin(), params.end(),
                   [&](const ri::Param& v) { return isJoinable(v, source.counts); }) ||
      std::none_of(params.begin(), params.end(), isPosition))
    return false;
  if (empty()) {
    first_ = p, sides_ = sides;
    variables_.clear(), sizes_.clear();
  } else if (!continues(p, sides)) {
    return false;
  }
  if (++requests_ == 2) {
    const ri::ParamList& like = ri::paramsOf(first_.source->samples.front());
    variables_.assign(like.begin(), like.end());
    sizes_.push_back(int(first_.source->counts.vertex));
  }
  if (requests_ < 2) return true;
  sizes_.push_back(int(source.counts.vertex));
  for (size_t i = 0; i < params.size(); ++i) {
    ri::Param& all = variables_[i];
    all.floats.insert(all.floats.end(), params[i].floats.begin(), params[i].floats.end());
    all.ints.insert(all.ints.end(), params[i].ints.begin(), params[i].ints.end());
  }
  return true;
}

ri::PlacedPrimitive PrimitiveRun::end() {
  const size_t requests = std::exchange(requests_, 0);
  ri::PlacedPrimitive all = std::exchange(first_, {});
  if (requests < 2) return all;
  auto joined = std::make_shared<ri::MovingPrimitive>();
  joined->basis = all.source->basis, joined->trimCurve = all.source->trimCurve;
  joined->location = all.source->location;
  if (const auto* patch = std::get_if<ri::Patch>(&all.source->samples.front())) {
    ri::PatchMesh mesh;
    mesh.bicubic = patch->bicubic, mesh.separate = true;
    const size_t side = patch->bicubic ? 4 : 2;
    mesh.nu = int(requests * side), mesh.nv = int(side);
    for (ri::Param& v : variables_) {
      const ri::StorageClass storage = v.declaration.storage;
      if (storage == ri::StorageClass::kVertex || storage == ri::StorageClass::kVarying) {
        const size_t row = storage == ri::StorageClass::kVertex ? side : 2;
        v.floats = interleaved(v.floats, row, v.declaration.width(), requests);
        v.ints = interleaved(v.ints, row, v.declaration.width(), requests);
      }
      mesh.params.set(std::move(v));
    }
    joined->samples.emplace_back(std::move(mesh));
  } else {
    ri::PointsPolygons mesh;
    mesh.nverts = sizes_;
    mesh.verts.resize(size_t(std::accumulate(sizes_.begin(), sizes_.end(), 0)));
    std::iota(mesh.verts.begin(), mesh.verts.end(), 0);
    for (ri::Param& v : variables_) mesh.params.set(std::move(v));
    joined->samples.emplace_back(std::move(mesh));
  }
  const auto checked =
      ri::checkPrimitive(joined->samples.front(), {joined->basis->uStep, joined->basis->vStep});
  FR_CHECK(checked.ok());
  joined->counts = checked->counts;
  all.source = std::move(joined);
  return all;
}

}  // namespace fr::cache
