// Evaluation of operations on constants. Only operations whose result is the same everywhere (plain
// arithmetic, correctly rounded functions) or which RISpec leaves free in the last bits.
#include <algorithm>
#include <cmath>

#include "base/math.h"
#include "shading/builder.h"

namespace fr {
namespace {

Vec3 triple(const float* p) { return {p[0], p[1], p[2]}; }

bool storeTriple(const Vec3& v, float* out) {
  out[0] = v.x;
  out[1] = v.y;
  out[2] = v.z;
  return true;
}

bool foldFloat(Op op, std::span<const float* const> in, float& r) {
  const float a = !in.empty() ? in[0][0] : 0, b = in.size() > 1 ? in[1][0] : 0,
              c = in.size() > 2 ? in[2][0] : 0;
  switch (op) {
    case Op::add_f:
      r = a + b;
      return true;
    case Op::sub_f:
      r = a - b;
      return true;
    case Op::mul_f:
      r = a * b;
      return true;
    case Op::div_f:
      r = a / b;
      return b != 0;
    case Op::neg_f:
      r = -a;
      return true;
    case Op::eq_f:
      r = a == b;
      return true;
    case Op::ne_f:
      r = a != b;
      return true;
    case Op::lt_f:
      r = a < b;
      return true;
    case Op::le_f:
      r = a <= b;
      return true;
    case Op::gt_f:
      r = a > b;
      return true;
    case Op::ge_f:
      r = a >= b;
      return true;
    case Op::and_f:
      r = a != 0 && b != 0;
      return true;
    case Op::or_f:
      r = a != 0 || b != 0;
      return true;
    case Op::not_f:
      r = a == 0;
      return true;
    case Op::select_f:
      r = a != 0 ? b : c;
      return true;
    case Op::radians:
      r = float(double(a) * (3.14159265358979323846 / 180));
      return true;
    case Op::degrees:
      r = float(double(a) * (180 / 3.14159265358979323846));
      return true;
    case Op::sqrt:
      r = a < 0 ? 0 : std::sqrt(a);
      return true;
    case Op::abs:
      r = std::fabs(a);
      return true;
    case Op::sign:
      r = a > 0 ? 1.0f : a < 0 ? -1.0f : 0.0f;
      return true;
    case Op::floor:
      r = std::floor(a);
      return true;
    case Op::ceil:
      r = std::ceil(a);
      return true;
    case Op::round:
      r = std::round(a);
      return true;
    case Op::min_f:
      r = std::min(a, b);
      return true;
    case Op::max_f:
      r = std::max(a, b);
      return true;
    case Op::clamp_f:
      r = std::max(std::min(a, c), b);
      return true;
    case Op::mix_f:
      r = a * (1 - c) + b * c;
      return true;
    case Op::step:
      r = b < a ? 0.0f : 1.0f;
      return true;
    case Op::mod:
      r = a - b * std::floor(a / b);
      return b != 0;
    default:
      return false;
  }
}

}  // namespace

bool foldConstant(Op op, std::span<const float* const> in, float* out) {
  bool known = foldFloat(op, in, out[0]);
  size_t n = 1;
  if (!known) {
    n = 3;
    const auto a = [&] { return triple(in[0]); };
    switch (op) {
      case Op::splat_t:
        known = storeTriple(Vec3(in[0][0]), out);
        break;
      case Op::make_t:
        known = storeTriple(Vec3(in[0][0], in[1][0], in[2][0]), out);
        break;
      case Op::add_t:
        known = storeTriple(a() + triple(in[1]), out);
        break;
      case Op::sub_t:
        known = storeTriple(a() - triple(in[1]), out);
        break;
      case Op::mul_t:
        known = storeTriple(a() * triple(in[1]), out);
        break;
      case Op::mul_tf:
        known = storeTriple(a() * in[1][0], out);
        break;
      case Op::div_tf:
        known = in[1][0] != 0 && storeTriple(a() / in[1][0], out);
        break;
      case Op::neg_t:
        known = storeTriple(-a(), out);
        break;
      case Op::average_t:
        known = true;
        n = 1;
        out[0] = (in[0][0] + in[0][1] + in[0][2]) / 3;
        break;
      case Op::dot:
        known = true;
        n = 1;
        out[0] = glm::dot(a(), triple(in[1]));
        break;
      case Op::cross:
        known = storeTriple(glm::cross(a(), triple(in[1])), out);
        break;
      case Op::comp_t:
        known = true;
        n = 1;
        out[0] = in[0][std::clamp(int(std::floor(std::clamp(in[1][0], 0.0f, 2.0f))), 0, 2)];
        break;
      case Op::select_t:
        known = storeTriple(in[0][0] != 0 ? triple(in[1]) : triple(in[2]), out);
        break;
      case Op::diagonal_m:
        n = 16;
        for (int i = 0; i < 16; ++i) out[i] = i % 5 == 0 ? in[0][0] : 0.0f;
        known = true;
        break;
      case Op::make_m:
        n = 16;
        for (int i = 0; i < 16; ++i) out[i] = in[i][0];
        known = true;
        break;
      default:
        return false;
    }
  }
  if (!known) return false;
  for (size_t i = 0; i < n; ++i)
    if (!std::isfinite(out[i])) return false;
  return true;
}

}  // namespace fr
