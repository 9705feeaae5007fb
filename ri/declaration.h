// Types of RI data: "class type[n]" (RISpec 3.2, section 3 "Relationship to RIB" and Table 5.1).
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>

#include "base/error.h"

namespace fr::ri {

/// How many values a primitive variable has. kFaceVertex (an extension met in the wild) counts like
/// kFaceVarying and interpolates like kVertex.
enum class StorageClass : uint8_t { kConstant, kUniform, kVarying, kVertex, kFaceVarying, kFaceVertex };
enum class ValueType : uint8_t {
  kFloat,
  kInteger,
  kString,
  kColor,
  kPoint,
  kVector,
  kNormal,
  kHpoint,
  kMatrix
};

const char* storageClassName(StorageClass c);
const char* valueTypeName(ValueType t);
/// Numbers (or strings) in one value of the type: 1, 3, 4 or 16.
int componentCount(ValueType t);

struct Declaration {
  StorageClass storage = StorageClass::kUniform;
  ValueType type = ValueType::kFloat;
  /// Elements per value; 1 with isArray false for plain types.
  int arrayLength = 1;
  bool isArray = false;

  /// Numbers (or strings) in one value, array elements included.
  size_t width() const { return size_t(componentCount(type)) * size_t(arrayLength); }
  /// "uniform float[2]"
  std::string str() const;
  bool operator==(const Declaration&) const = default;
};

/// Parses "class type[n]"; the class may be missing (uniform). Case-insensitive. kSyntax on anything else.
Result<Declaration> parseDeclaration(std::string_view text);

/// A parameter token "[class type[n]] name" taken apart. `declaration` is empty for a bare name.
struct ParsedToken {
  std::optional<Declaration> declaration;
  std::string_view name;
};
Result<ParsedToken> parseToken(std::string_view token);

/// The names declared so far. Not thread-safe.
/// Look-up order for a bare name: Declare; built-in name of this context; built-in name.
class Dictionary {
 public:
  /// Declare request. kSyntax for a bad declaration, which changes nothing.
  Result<void> declare(std::string_view name, std::string_view declaration);
  /// `context` is what the parameter belongs to: the name of an option or attribute category
  /// ("displacementbound"), or "Display", "Hider", "Projection"; may be empty.
  std::optional<Declaration> find(std::string_view name, std::string_view context = {}) const;
  using Declarations = std::map<std::string, Declaration, std::less<>>;
  /// What Declare has said so far.
  const Declarations& declared() const { return user_; }

 private:
  Declarations user_;
};

}  // namespace fr::ri
