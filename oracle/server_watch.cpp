#include "oracle/server_watch.h"

#include "oracle/control_message.h"
#include "shm/named_socket.h"

namespace fr {

Result<ServerWatch> watchServer(std::string_view name) {
  auto socket = shm::connectNamed(name);
  if (!socket) return std::move(socket).error();
  if (Result<void> r = sendControl(*socket, ControlType::kHello, {}, kWatcherName); !r)
    return std::move(r).error();
  auto got = receiveControl(*socket, controlFingerprint(), std::chrono::seconds(10), "the ray server");
  if (!got) return std::move(got).error();
  if (!*got) return makeError(RiError::kSystem, "the ray server '{}' does not answer", name);
  if ((**got).is(ControlType::kRefused))
    return makeError(RiError::kSystem, "the ray server '{}' refused: {}", name, (**got).text());
  if (!(**got).is(ControlType::kGreeting) || (**got).descriptors.size() != 1)
    return makeError(RiError::kBadFile, "the greeting of the ray server '{}' is damaged", name);
  auto counters = CounterReader::attach(std::move((**got).descriptors[0]));
  if (!counters) return std::move(counters).error();
  const int pid = counters->read().processId;
  return ServerWatch{std::move(socket).value(), std::move(counters).value(), std::string(name), pid};
}

Result<ServerWatch> watchServerProcess(int processId) {
  const std::string own = std::to_string(processId);
  for (const std::string& name : shm::listSocketNames()) {
    if (name == own) return watchServer(name);
    auto socket = shm::connectNamed(name);
    if (socket && shm::peerProcessId(*socket) == processId) return watchServer(name);
  }
  return makeError(RiError::kNoFile, "process {} is no ray server of yours", processId);
}

}  // namespace fr
