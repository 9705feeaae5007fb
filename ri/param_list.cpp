#include "ri/param_list.h"

#include <algorithm>
#include <cmath>

namespace fr::ri {

size_t Param::elementCount() const {
  switch (declaration.type) {
    case ValueType::kString:
      return strings.size();
    case ValueType::kInteger:
      return ints.size();
    default:
      return floats.size();
  }
}

void ParamList::set(Param p) {
  const auto it =
      std::find_if(params_.begin(), params_.end(), [&](const Param& q) { return q.name == p.name; });
  if (it != params_.end()) {
    *it = std::move(p);
  } else {
    params_.push_back(std::move(p));
  }
}

const Param* ParamList::find(std::string_view name) const {
  for (const Param& p : params_) {
    if (p.name == name) return &p;
  }
  return nullptr;
}

float toFloat(const Param& p, float otherwise, size_t index) {
  if (index < p.floats.size()) return p.floats[index];
  if (index < p.ints.size()) return float(p.ints[index]);
  return otherwise;
}

int toInt(const Param& p, int otherwise, size_t index) {
  if (index < p.ints.size()) return p.ints[index];
  if (index < p.floats.size() && std::abs(p.floats[index]) < 2147483520.f) return int(p.floats[index]);
  return otherwise;
}

Color toColor(const Param& p, const Color& otherwise) {
  if (p.floats.size() < 3) return otherwise;
  return {p.floats[0], p.floats[1], p.floats[2]};
}

float ParamList::getFloat(std::string_view name, float otherwise) const {
  const Param* p = find(name);
  return p ? toFloat(*p, otherwise) : otherwise;
}

int ParamList::getInt(std::string_view name, int otherwise) const {
  const Param* p = find(name);
  return p ? toInt(*p, otherwise) : otherwise;
}

std::string ParamList::getString(std::string_view name, std::string_view otherwise) const {
  const Param* p = find(name);
  return p && !p->strings.empty() ? p->strings[0] : std::string(otherwise);
}

}  // namespace fr::ri
