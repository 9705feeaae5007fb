// Shared objects with shadeops: finding their tables, checking them, and what their functions need to be
// called.
//
// The compiler looks up types here, the virtual machine the functions. A shared object stays loaded once it
// is. Nothing guards against what the functions themselves do.
#pragma once

#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "base/error.h"
#include "shading/ir.h"
#include "shading/shadeop.h"

namespace fr {

struct ShadeopArgument {
  SlType type = SlType::kFloat;
  bool isArray = false;
  uint32_t arrayLength = 0;  // 0: any length
  bool output = false;
};

/// "float cname(point, output float, color[4])". `output` and arrays are extensions of ours.
struct ShadeopSpec {
  SlType result = SlType::kVoid;
  std::string function;
  std::vector<ShadeopArgument> arguments;
  bool marksOutputs = false;  // some argument is `output`: then the others are not
};
Result<ShadeopSpec> parseShadeopSpec(std::string_view text);

using ShadeopPointFunction = int (*)(void* initdata, int argc, void** argv);
using ShadeopBatchFunction = int (*)(void* initdata, const FrShadeopBatch* batch);
using ShadeopInit = void* (*)(int context, void* textures);
using ShadeopShutdown = void (*)(void* initdata);

/// One overload, bound. Lives as long as the process.
struct Shadeop {
  std::string path;  // of the library
  std::string name;  // in the shading language
  std::string text;  // opspec
  ShadeopSpec spec;
  ShadeopPointFunction point = nullptr;  // one of the two
  ShadeopBatchFunction batch = nullptr;
  ShadeopInit init = nullptr;
  ShadeopShutdown shutdown = nullptr;
  uint32_t index = 0;  // of this process
};

/// All overloads of `name` from the first library (*.so, by name) in `folders` that has a table of them; none
/// is no error. Errors: a library that has the table and cannot be opened, a table that is wrong, a function
/// that is missing. Only files that hold the table's name are opened. Thread-safe.
Result<std::span<const Shadeop* const>> findShadeops(const std::string& name,
                                                     const std::vector<std::string>& folders);
/// The entry of `name` with exactly this opspec; `path` as findShadeops() told. Thread-safe.
Result<const Shadeop*> bindShadeop(const std::string& path, const std::string& name, std::string_view opspec);
/// Looks for every library of the program: its file name in `folders`, then its own path; the program gets
/// the paths that hold. Errors: a library, a function or an overload that is not there.
Result<void> bindShadeops(ShaderProgram& program, const std::vector<std::string>& folders);

/// What init returned in this thread, which is now if this is its first call.
void* shadeopThreadData(const Shadeop& op);

/// While any of these lives, the data that init functions made do too; with the last one every shutdown
/// function is called. No shader may run at that time.
class ShadeopUser {
 public:
  ShadeopUser();
  ~ShadeopUser();
  ShadeopUser(const ShadeopUser&) = delete;
  ShadeopUser& operator=(const ShadeopUser&) = delete;
};

}  // namespace fr
