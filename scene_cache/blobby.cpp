#include "scene_cache/blobby.h"

#include <algorithm>
#include <cmath>
#include <unordered_map>

namespace fr::cache {
namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();

BlobRange clean(double low, double high) {
  return {std::isnan(low) ? -kInf : low, std::isnan(high) ? kInf : high};
}

BlobRange product(BlobRange a, BlobRange b) {
  const double p[4] = {a.low * b.low, a.low * b.high, a.high * b.low, a.high * b.high};
  double low = kInf, high = -kInf;
  for (const double x : p) {
    if (std::isnan(x)) return {-kInf, kInf};
    low = std::min(low, x), high = std::max(high, x);
  }
  return {low, high};
}

/// (1 - r^2)^3 inside the unit sphere, else 0.
double bump(double square) {
  if (!(square < 1)) return 0;
  const double s = 1 - square;
  return s * s * s;
}

}  // namespace

Result<BlobField> BlobField::parse(const ri::Blobby& b, std::vector<std::string>* warnings) {
  BlobField f;
  const std::vector<int>& code = b.code;
  const auto bad = [](std::string message) { return makeError(RiError::kConsistency, "{}", message); };
  const auto matrixAt = [&](size_t at) {
    DMat4 m;
    for (int k = 0; k < 16; ++k) m[k / 4][k % 4] = double(b.floats[at + size_t(k)]);
    return m;
  };
  for (size_t at = 0; at < code.size();) {
    const int op = code[at++];
    const size_t left = code.size() - at;
    Instruction i{};
    const auto operand = [&](int index) -> bool {
      if (index < 0 || size_t(index) >= f.code_.size()) return false;
      f.operands_.push_back(uint32_t(index));
      return true;
    };
    i.first = uint32_t(f.operands_.size());
    if (op >= 0 && op <= 7) {
      size_t n = op == 4 || op == 5 ? 2 : 1;
      if (op <= 3) {
        if (left < 1 || code[at] < 1) return bad(fmt::format("opcode {} has no operands", op));
        n = size_t(code[at++]);
      }
      if (code.size() - at < n) return bad(fmt::format("opcode {} needs {} operands, the code ends", op, n));
      for (size_t k = 0; k < n; ++k) {
        if (!operand(code[at]))
          return bad(fmt::format("operand {} of opcode {} is not an earlier result", code[at], op));
        ++at;
      }
      i.count = uint32_t(n);
      i.op = Op(op);
      // RISpec's order: subtrahend, minuend.
      if (op == 4) std::swap(f.operands_[i.first], f.operands_[i.first + 1]);
    } else if (op >= 1000 && op <= 1003) {
      if (left < (op == 1003 ? 2u : 1u)) return bad(fmt::format("opcode {} has no operand", op));
      if (op == 1003) ++at;  // the string's index
      const int first = code[at++];
      const size_t n = op == 1000 ? 1 : op == 1001 ? 16 : op == 1002 ? 23 : 4;
      if (first < 0 || size_t(first) > b.floats.size() || b.floats.size() - size_t(first) < n)
        return bad(fmt::format("opcode {} reads floats {} to {} of {}", op, first,
                               int64_t(first) + int64_t(n) - 1, b.floats.size()));
      i.leaf = f.leaves_++;
      i.op = Op::kConstant;
      if (op == 1003) {
        warnings->push_back("repelling planes (opcode 1003) are not supported; they repel nothing");
      } else if (op == 1000) {
        i.constant = double(b.floats[size_t(first)]);
        if (!std::isfinite(i.constant)) return makeError(RiError::kRange, "a constant is not finite");
      } else {
        Shape s;
        size_t place = size_t(first);
        if (op == 1002) {
          s.a = DVec3(b.floats[place], b.floats[place + 1], b.floats[place + 2]);
          s.b = DVec3(b.floats[place + 3], b.floats[place + 4], b.floats[place + 5]);
          s.radius = std::abs(double(b.floats[place + 6]));
          place += 7;
        }
        const DMat4 m = matrixAt(place);
        const double determinant = glm::determinant(DMat3(m));
        s.toUnit = glm::inverse(m);
        bool good = determinant != 0 && s.radius > 0 && std::isfinite(s.radius) && std::isfinite(determinant);
        for (int k = 0; k < 16; ++k)
          good = good && std::isfinite(s.toUnit[k / 4][k % 4]) && std::isfinite(m[k / 4][k % 4]);
        Box3d box;
        if (op == 1001) {
          box.extend(DVec3(-1)), box.extend(DVec3(1));
        } else {
          box.extend(s.a), box.extend(s.b), box.grow(s.radius);
        }
        good = good && std::isfinite(box.min.x + box.min.y + box.min.z + box.max.x + box.max.y + box.max.z);
        if (good) {
          i.op = op == 1001 ? Op::kEllipsoid : Op::kSegment;
          s.bound = transformBox(m, box);
          const DVec3 columns(glm::length(DVec3(m[0])), glm::length(DVec3(m[1])), glm::length(DVec3(m[2])));
          s.size = std::min({columns.x, columns.y, columns.z}) * s.radius;
          i.shape = uint32_t(f.shapes_.size());
          f.shapes_.push_back(s);
        } else {
          warnings->push_back(
              fmt::format("leaf {} has no inverse matrix or no radius; it counts as 0", i.leaf));
        }
      }
    } else {
      return bad(fmt::format("opcode {} is not known", op));
    }
    f.code_.push_back(i);
  }
  if (f.code_.empty()) return bad("no opcodes");
  if (f.leaves_ != uint32_t(std::max(0, b.nleaf)))
    return bad(fmt::format("{} leaves are announced, the code has {}", b.nleaf, f.leaves_));
  return f;
}

BlobSample BlobField::shapeAt(const Instruction& i, const Shape& s, const DVec3& p) {
  const DVec3 q(s.toUnit * DVec4(p, 1.0));
  DVec3 d = q;
  double scale = 1;
  if (i.op == Op::kSegment) {
    const DVec3 along = s.b - s.a;
    const double length = glm::dot(along, along);
    const double t = length > 0 ? std::clamp(glm::dot(q - s.a, along) / length, 0.0, 1.0) : 0.0;
    d = q - (s.a + along * t);
    scale = 1 / (s.radius * s.radius);
  }
  const double square = glm::dot(d, d) * scale;
  BlobSample r;
  if (!(square < 1)) return r;
  r.value = bump(square);
  const double slope = -6 * (1 - square) * (1 - square) * scale;
  r.gradient = glm::transpose(DMat3(s.toUnit)) * (d * slope);
  return r;
}

BlobRange BlobField::shapeRange(const Instruction& i, const Shape& s, const Box3d& box) {
  const DVec3 c(s.toUnit * DVec4(box.center(), 1.0)), half = (box.max - box.min) * 0.5;
  const DMat3 m(s.toUnit);
  const DVec3 reach = glm::abs(m[0]) * half.x + glm::abs(m[1]) * half.y + glm::abs(m[2]) * half.z;
  double nearest = 0, farthest = 0;  // squared, in radii
  if (i.op == Op::kEllipsoid) {
    const DVec3 low = glm::max(glm::abs(c) - reach, DVec3(0)), high = glm::abs(c) + reach;
    nearest = glm::dot(low, low), farthest = glm::dot(high, high);
  } else {
    const DVec3 along = s.b - s.a;
    const double length = glm::dot(along, along);
    const double t = length > 0 ? std::clamp(glm::dot(c - s.a, along) / length, 0.0, 1.0) : 0.0;
    const double distance = glm::length(c - (s.a + along * t)), r = glm::length(reach);
    const double low = std::max(0.0, distance - r) / s.radius, high = (distance + r) / s.radius;
    nearest = low * low, farthest = high * high;
  }
  // Rounding: 0 only where it is 0 for certain.
  return clean(bump(farthest * (1 + 1e-9)),
               nearest > 1 + 1e-9 ? 0.0 : bump(nearest * (1 - 1e-9)) * (1 + 1e-9));
}

BlobSample BlobField::at(const DVec3& p) const {
  thread_local std::vector<BlobSample> r;
  r.resize(code_.size());
  for (size_t k = 0; k < code_.size(); ++k) {
    const Instruction& i = code_[k];
    const uint32_t* o = operands_.data() + i.first;
    BlobSample& x = r[k];
    switch (i.op) {
      case Op::kAdd:
        x = {};
        for (uint32_t n = 0; n < i.count; ++n) x.value += r[o[n]].value, x.gradient += r[o[n]].gradient;
        break;
      case Op::kMultiply:
        x = r[o[0]];
        for (uint32_t n = 1; n < i.count; ++n) {
          x.gradient = x.gradient * r[o[n]].value + r[o[n]].gradient * x.value;
          x.value *= r[o[n]].value;
        }
        break;
      case Op::kMaximum:
      case Op::kMinimum:
        x = r[o[0]];
        for (uint32_t n = 1; n < i.count; ++n) {
          if (i.op == Op::kMaximum ? r[o[n]].value > x.value : r[o[n]].value < x.value) x = r[o[n]];
        }
        break;
      case Op::kSubtract:
        x = {r[o[0]].value - r[o[1]].value, r[o[0]].gradient - r[o[1]].gradient};
        break;
      case Op::kDivide: {
        const BlobSample &a = r[o[0]], &b = r[o[1]];
        x.value = a.value / b.value;
        x.gradient = (a.gradient - b.gradient * x.value) / b.value;
        break;
      }
      case Op::kNegate:
        x = {-r[o[0]].value, -r[o[0]].gradient};
        break;
      case Op::kIdentity:
        x = r[o[0]];
        break;
      case Op::kConstant:
        x = {i.constant, DVec3(0)};
        break;
      default:
        x = shapeAt(i, shapes_[i.shape], p);
    }
  }
  return r.back();
}

BlobRange BlobField::over(const Box3d& box) const {
  thread_local std::vector<BlobRange> r;
  r.resize(code_.size());
  for (size_t k = 0; k < code_.size(); ++k) {
    const Instruction& i = code_[k];
    const uint32_t* o = operands_.data() + i.first;
    BlobRange x;
    switch (i.op) {
      case Op::kAdd:
        for (uint32_t n = 0; n < i.count; ++n) x = clean(x.low + r[o[n]].low, x.high + r[o[n]].high);
        // Sums in another order round otherwise.
        x.low -= 1e-12 * std::abs(x.low), x.high += 1e-12 * std::abs(x.high);
        break;
      case Op::kMultiply:
        x = r[o[0]];
        for (uint32_t n = 1; n < i.count; ++n) x = product(x, r[o[n]]);
        break;
      case Op::kMaximum:
        x = r[o[0]];
        for (uint32_t n = 1; n < i.count; ++n)
          x = {std::max(x.low, r[o[n]].low), std::max(x.high, r[o[n]].high)};
        break;
      case Op::kMinimum:
        x = r[o[0]];
        for (uint32_t n = 1; n < i.count; ++n)
          x = {std::min(x.low, r[o[n]].low), std::min(x.high, r[o[n]].high)};
        break;
      case Op::kSubtract:
        x = clean(r[o[0]].low - r[o[1]].high, r[o[0]].high - r[o[1]].low);
        break;
      case Op::kDivide: {
        const BlobRange b = r[o[1]];
        x = b.low <= 0 && b.high >= 0 ? BlobRange{-kInf, kInf} : product(r[o[0]], {1 / b.high, 1 / b.low});
        break;
      }
      case Op::kNegate:
        x = {-r[o[0]].high, -r[o[0]].low};
        break;
      case Op::kIdentity:
        x = r[o[0]];
        break;
      case Op::kConstant:
        x = {i.constant, i.constant};
        break;
      default:
        x = shapeRange(i, shapes_[i.shape], box);
    }
    r[k] = x;
  }
  return r.back();
}

BlobField BlobField::inside(const Box3d& box) const {
  BlobField f;
  f.leaves_ = leaves_;
  // Which results are 0 for certain; which are needed.
  std::vector<uint8_t> zero(code_.size(), 0), needed(code_.size(), 0);
  for (size_t k = 0; k < code_.size(); ++k) {
    const Instruction& i = code_[k];
    if (i.op == Op::kEllipsoid || i.op == Op::kSegment) {
      zero[k] = shapeRange(i, shapes_[i.shape], box).high == 0;
    } else if (i.op == Op::kConstant) {
      zero[k] = i.constant == 0;
    } else if (i.op == Op::kAdd) {
      zero[k] = 1;
      for (uint32_t n = 0; n < i.count; ++n) zero[k] &= zero[operands_[i.first + n]];
    }
  }
  needed.back() = 1;
  for (size_t k = code_.size(); k-- > 0;) {
    if (!needed[k] || zero[k]) continue;
    const Instruction& i = code_[k];
    for (uint32_t n = 0; n < i.count; ++n) needed[operands_[i.first + n]] = 1;
  }
  std::vector<uint32_t> place(code_.size(), 0);
  for (size_t k = 0; k < code_.size(); ++k) {
    if (!needed[k]) continue;
    Instruction i = code_[k];
    if (zero[k]) {
      i.op = Op::kConstant, i.constant = 0, i.count = 0;
    } else if (i.op == Op::kEllipsoid || i.op == Op::kSegment) {
      f.shapes_.push_back(shapes_[i.shape]);
      i.shape = uint32_t(f.shapes_.size() - 1);
    }
    const uint32_t first = uint32_t(f.operands_.size());
    for (uint32_t n = 0; n < i.count; ++n) {
      const uint32_t o = operands_[i.first + n];
      // Sums do without zeros.
      if (i.op == Op::kAdd && zero[o]) continue;
      f.operands_.push_back(place[o]);
    }
    i.first = first, i.count = uint32_t(f.operands_.size()) - first;
    place[k] = uint32_t(f.code_.size());
    f.code_.push_back(i);
  }
  return f;
}

void BlobField::weights(const DVec3& p, std::vector<std::pair<uint32_t, double>>& out) const {
  out.clear();
  for (const Instruction& i : code_) {
    if (i.op != Op::kEllipsoid && i.op != Op::kSegment) continue;
    const double w = shapeAt(i, shapes_[i.shape], p).value;
    if (w > 0) out.emplace_back(i.leaf, w);
  }
}

Box3d BlobField::support() const {
  Box3d box;
  for (const Shape& s : shapes_) box.extend(s.bound);
  return box;
}

double BlobField::smallestRadius() const {
  double r = kInf;
  for (const Shape& s : shapes_) r = std::min(r, s.size);
  return r;
}

namespace {

/// Cells a block of the lowest level is wide.
constexpr int kBlock = 4;

struct Cell {
  uint32_t vertex = 0;
  uint8_t inside = 0;  // bit c: corner c lies inside
};

class Polygoniser {
 public:
  Polygoniser(const Box3d& box, double cell, size_t most) : h_(cell), most_(most) {
    // One cell of margin: nothing crosses the border.
    origin_ = box.min - DVec3(1.5 * h_);
    int64_t largest = 0;
    for (int c = 0; c < 3; ++c)
      largest = std::max(largest, int64_t(std::ceil((box.max[c] - origin_[c]) / h_)) + 2);
    size_ = kBlock;
    while (size_ < largest && size_ < kMostCells) size_ *= 2;
  }

  bool run(const BlobField& field) { return descend(field, 0, 0, 0, size_); }

  BlobMesh finish() {
    order_.assign(cells_.begin(), cells_.end());
    std::sort(order_.begin(), order_.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
    for (const auto& [key, cell] : order_) {
      const int64_t at[3] = {int64_t(key >> 42), int64_t(key >> 21 & kMask), int64_t(key & kMask)};
      // The three edges from corner 0; each has four cells around it.
      for (int axis = 0; axis < 3; ++axis) {
        const bool from = cell.inside & 1, to = cell.inside >> (1 << axis) & 1;
        if (from == to) continue;
        const int b = (axis + 1) % 3, c = (axis + 2) % 3;
        static constexpr int kTurn[4][2] = {{-1, -1}, {0, -1}, {0, 0}, {-1, 0}};
        uint32_t v[4];
        bool whole = true;
        for (int k = 0; k < 4; ++k) {
          int64_t n[3] = {at[0], at[1], at[2]};
          n[b] += kTurn[k][0], n[c] += kTurn[k][1];
          const auto it = n[b] >= 0 && n[c] >= 0 ? cells_.find(keyOf(n[0], n[1], n[2])) : cells_.end();
          whole = whole && it != cells_.end();
          v[k] = it != cells_.end() ? it->second.vertex : 0;
        }
        if (!whole) continue;
        if (!from) std::swap(v[1], v[3]);  // the inside lies ahead: turn the face round
        // The shorter diagonal.
        const DVec3 d0 = mesh_.points[v[2]] - mesh_.points[v[0]],
                    d1 = mesh_.points[v[3]] - mesh_.points[v[1]];
        if (glm::dot(d0, d0) <= glm::dot(d1, d1))
          mesh_.triangles.insert(mesh_.triangles.end(), {v[0], v[1], v[2], v[0], v[2], v[3]});
        else
          mesh_.triangles.insert(mesh_.triangles.end(), {v[0], v[1], v[3], v[1], v[2], v[3]});
      }
    }
    return std::move(mesh_);
  }

 private:
  static constexpr int64_t kMostCells = 1 << 20;
  static constexpr uint64_t kMask = (1 << 21) - 1;
  static uint64_t keyOf(int64_t i, int64_t j, int64_t k) {
    return uint64_t(i) << 42 | uint64_t(j) << 21 | uint64_t(k);
  }
  DVec3 place(int64_t i, int64_t j, int64_t k) const {
    return origin_ + DVec3(double(i), double(j), double(k)) * h_;
  }

  bool descend(const BlobField& field, int64_t i, int64_t j, int64_t k, int64_t size) {
    Box3d box{place(i, j, k), place(i + size, j + size, k + size)};
    const BlobRange r = field.over(box);
    if (r.low > kBlobThreshold || r.high < kBlobThreshold) return true;
    const BlobField here = field.inside(box);
    if (size == kBlock) return block(here, i, j, k);
    const int64_t half = size / 2;
    for (int c = 0; c < 8; ++c) {
      if (!descend(here, i + (c & 1 ? half : 0), j + (c & 2 ? half : 0), k + (c & 4 ? half : 0), half))
        return false;
    }
    return true;
  }

  bool block(const BlobField& field, int64_t i0, int64_t j0, int64_t k0) {
    constexpr int n = kBlock + 1;
    double value[n][n][n];
    for (int k = 0; k < n; ++k) {
      for (int j = 0; j < n; ++j) {
        for (int i = 0; i < n; ++i)
          value[k][j][i] = field.at(place(i0 + i, j0 + j, k0 + k)).value - kBlobThreshold;
      }
    }
    for (int k = 0; k < kBlock; ++k) {
      for (int j = 0; j < kBlock; ++j) {
        for (int i = 0; i < kBlock; ++i) {
          uint8_t inside = 0;
          double corner[8];
          for (int c = 0; c < 8; ++c) {
            corner[c] = value[k + (c >> 2)][j + (c >> 1 & 1)][i + (c & 1)];
            inside = uint8_t(inside | (corner[c] > 0) << c);  // NaN is outside
          }
          if (inside == 0 || inside == 255) continue;
          if (mesh_.points.size() >= most_) return false;
          cells_[keyOf(i0 + i, j0 + j, k0 + k)] = {uint32_t(mesh_.points.size()), inside};
          addVertex(field, place(i0 + i, j0 + j, k0 + k), corner, inside);
        }
      }
    }
    return true;
  }

  void addVertex(const BlobField& field, const DVec3& low, const double corner[8], uint8_t inside) {
    DVec3 sum(0);
    int crossings = 0;
    for (int c = 0; c < 8; ++c) {
      for (int axis = 0; axis < 3; ++axis) {
        const int d = c | 1 << axis;
        if (d == c || ((inside >> c & 1) == (inside >> d & 1))) continue;
        double t = corner[c] / (corner[c] - corner[d]);
        if (!(t >= 0 && t <= 1)) t = 0.5;
        DVec3 p(c & 1, c >> 1 & 1, c >> 2 & 1);
        p[axis] = t;
        sum += p, ++crossings;
      }
    }
    const DVec3 start = low + sum * (h_ / std::max(1, crossings));
    DVec3 p = start, normal(0, 0, 1);
    for (int step = 0; step < 6; ++step) {
      const BlobSample s = field.at(p);
      const double square = glm::dot(s.gradient, s.gradient), off = s.value - kBlobThreshold;
      if (square > 0 && std::isfinite(square)) normal = -s.gradient / std::sqrt(square);
      if (!(square > 0) || !std::isfinite(square) || !std::isfinite(off)) break;
      DVec3 move = s.gradient * (-off / square);
      const double length = glm::length(move);
      if (length > 0.5 * h_) move *= 0.5 * h_ / length;
      const DVec3 next = p + move;
      // A vertex stays near its cell, or faces would turn over.
      bool near = true;
      for (int c = 0; c < 3; ++c) near = near && next[c] > low[c] - 0.5 * h_ && next[c] < low[c] + 1.5 * h_;
      if (!near) break;
      p = next;
      if (length < 1e-7 * h_) break;
    }
    mesh_.points.push_back(p);
    mesh_.normals.push_back(normal);
  }

  double h_;
  size_t most_;
  DVec3 origin_{0};
  int64_t size_ = kBlock;
  std::unordered_map<uint64_t, Cell> cells_;
  std::vector<std::pair<uint64_t, Cell>> order_;
  BlobMesh mesh_;
};

}  // namespace

BlobMesh polygonise(const BlobField& field, double cell, size_t mostCells) {
  const Box3d box = field.support();
  if (box.empty() || !(cell > 0) || !std::isfinite(cell)) return {};
  Polygoniser p(box, cell, mostCells);
  if (!p.run(field)) return {};
  return p.finish();
}

}  // namespace fr::cache
