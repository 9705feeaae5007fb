#include "base/log.h"

#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <memory>

namespace fr {
namespace {

spdlog::logger& logger() {
  static spdlog::logger* l = [] {
    auto* made = new spdlog::logger("", std::make_shared<spdlog::sinks::stderr_sink_mt>());
    made->set_pattern("%v");
    return made;
  }();
  return *l;
}

}  // namespace

void setLogLevel(Severity lowest) {
  logger().set_level(lowest == Severity::kInfo      ? spdlog::level::info
                     : lowest == Severity::kWarning ? spdlog::level::warn
                                                    : spdlog::level::err);
}

void setLogName(std::string_view name) {
  logger().set_pattern(name.empty() ? std::string("%v") : std::string(name) + ": %v");
}

void logMessage(Severity severity, std::string_view line) {
  logger().log(severity == Severity::kInfo      ? spdlog::level::info
               : severity == Severity::kWarning ? spdlog::level::warn
                                                : spdlog::level::err,
               "{}", line);
}

}  // namespace fr
