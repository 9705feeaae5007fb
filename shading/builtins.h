// The built-in functions of RSL: names, overloads, and the operations they become.
#pragma once

#include <span>
#include <string_view>

#include "shading/ir.h"

namespace fr {

/// How a call is turned into operations when it is not "result, outputs, inputs in order".
enum class Lowering : uint8_t {
  kPlain,
  kFoldLeft,      // min, max of many
  kComponent,     // xcomp ...: extra is the index
  kSetComponent,  // setxcomp ...
  kSetComp,       // setcomp
  kFaceforward2,  // Nref = Ng
  kAreaDefault,   // area(P): "shading"
  kFresnel2,      // no R, T asked
  kTransform,     // transform family; extra: 0 point, 1 vector, 2 normal
  kMTransform,
  kCTransform,
  kAverage,  // float of a color operation
  kSpline,
  kTexture,       // texture, environment, shadow, bump
  kPhotonMap,     // N = 0 when not given
  kOcclusionMap,  // a map in front is not read: rays are traced
  kArrayLength,   // known when compiling
  kIsOutput,      // a variable stands for its name
  kGetVar,        // the shader that is asked: null, or a string
};

/// Characters of `result`: f m s; c p v n; x nothing; t any triple the context wants; T type of the T
/// arguments. Characters of `arguments`: f m s; c p v n triples; t any triple; T triples that give the result
/// its type; o written float, O written triple, ! variable of any type; a array of floats; A array of
/// triples; ? any value;
/// + any number more like the one before; * optional "name", value pairs; . anything (checked by the
/// lowering).
struct Builtin {
  std::string_view name;
  std::string_view result;
  std::string_view arguments;
  Op op;
  Lowering lowering = Lowering::kPlain;
  uint8_t extra = 0;
  bool contextual = false;  // a context inside an operator counts too: color c = Kr * texture(...)
};

/// All overloads of `name`; the first is taken when nothing else decides.
std::span<const Builtin> findBuiltins(std::string_view name);
std::span<const Builtin> allBuiltins();

}  // namespace fr
