// Parameter lists: the token/value pairs at the end of most RI requests.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "base/math.h"
#include "ri/declaration.h"

namespace fr::ri {

/// How a parameter's token was written.
enum class TokenForm : uint8_t {
  kInline,      ///< "uniform float Ks", or made by a program
  kBare,        ///< "Ks": the declaration is that of Declare or a built-in one
  kUndeclared,  ///< "Ks", and nobody declared it: the declaration is a guess from the value
};

/// One parameter. Exactly one of the three arrays is in use: strings for kString, ints for kInteger,
/// floats for all other types.
struct Param {
  std::string name;
  Declaration declaration;
  std::vector<float> floats;
  std::vector<int> ints;
  std::vector<std::string> strings;
  TokenForm form = TokenForm::kInline;

  /// Numbers or strings held.
  size_t elementCount() const;
  /// Whole values held: elementCount / declaration.width(), rounded down.
  size_t valueCount() const { return elementCount() / declaration.width(); }
  /// Equal values; how the token was written does not matter.
  bool operator==(const Param& o) const {
    return name == o.name && declaration == o.declaration && floats == o.floats && ints == o.ints &&
           strings == o.strings;
  }
};

/// Parameters in the order given; names are unique (a repeated name replaces the earlier value).
class ParamList {
 public:
  void set(Param p);
  const Param* find(std::string_view name) const;
  bool has(std::string_view name) const { return find(name) != nullptr; }

  /// Typed access with a default for "absent, empty or of another kind". Integers are accepted as floats
  /// and the other way round (truncated).
  float getFloat(std::string_view name, float otherwise) const;
  int getInt(std::string_view name, int otherwise) const;
  std::string getString(std::string_view name, std::string_view otherwise) const;

  bool empty() const { return params_.empty(); }
  size_t size() const { return params_.size(); }
  auto begin() const { return params_.begin(); }
  auto end() const { return params_.end(); }
  const Param& operator[](size_t i) const { return params_[i]; }
  /// The parameters themselves, to move large arrays out.
  std::vector<Param>& params() { return params_; }
  bool operator==(const ParamList&) const = default;

 private:
  std::vector<Param> params_;
};

/// Single values out of one parameter, as ParamList's accessors.
float toFloat(const Param& p, float otherwise, size_t index = 0);
int toInt(const Param& p, int otherwise, size_t index = 0);
Color toColor(const Param& p, const Color& otherwise);

}  // namespace fr::ri
