// The subcommands of scenecache, one file each. add...() declares options and sets `run` when it is chosen.
#pragma once

#include <CLI/CLI.hpp>
#include <functional>

namespace fr::tools {

inline constexpr int kOk = 0, kFailed = 1, kUsage = 2;

using Run = std::function<int()>;
void addBuild(CLI::App& app, Run& run);
void addInfo(CLI::App& app, Run& run);
void addList(CLI::App& app, Run& run);
void addVerify(CLI::App& app, Run& run);
void addDump(CLI::App& app, Run& run);
void addDiff(CLI::App& app, Run& run);
void addPrune(CLI::App& app, Run& run);

}  // namespace fr::tools
