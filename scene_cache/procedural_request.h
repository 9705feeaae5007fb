// What a Procedural or Procedural2 request asks for.
#pragma once

#include <string>

#include "ri/graphics_state.h"
#include "ri/renderer.h"

namespace fr::cache {

struct ProceduralRequest {
  enum class Kind { kArchive, kProgram, kSharedObject };
  Kind kind = Kind::kArchive;
  std::string name;  ///< archive, command line, or shared object
  std::string data;  ///< kProgram, and kSharedObject of Procedural
  /// Object space; infinite where the request does not say.
  ri::Bound bound{-kRiInfinity, kRiInfinity, -kRiInfinity, kRiInfinity, -kRiInfinity, kRiInfinity};
  /// To be expanded whether its bound is in view or not.
  bool immediate = false;
};

/// kBadToken for a subdivide function that nobody knows, kMissingData when a name is missing. Procedural2:
/// "DelayedReadArchive" (or "...2") with "filename", "DynamicLoad" (or "...2") with "dsoname", "RunProgram"
/// with "programname" and "data"; the bound is that of "SimpleBound", parameter "bound".
Result<ProceduralRequest> proceduralRequest(const ri::Procedural& p, const ri::AttributeState& attributes);

/// What the program behind shared objects is sent: RIB that brings about the graphics state of the procedural
/// (declarations, camera, transformation, basis, colour samples), then the request itself. `detail`: pixels.
std::string sharedObjectQuestion(const ri::GraphicsState& state, const ri::Dictionary& dictionary,
                                 const ri::Procedural& p, double detail);

/// The program that loads shared objects and answers their RIB, with the file to load.
std::string sharedObjectProgram();

}  // namespace fr::cache
