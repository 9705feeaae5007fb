// Looking at a running ray server without being its client.
#pragma once

#include <string>
#include <string_view>

#include "oracle/server_counters.h"
#include "shm/peer.h"

namespace fr {

/// A connection that asked for nothing but the counters. Reading them is a look at shared memory.
struct ServerWatch {
  shm::PeerSocket socket;  // hangs up when the server ends
  CounterReader counters;
  std::string name;
  int processId = 0;
};

/// A server of this user by name. Errors: kNoFile (no such server), kVersion, kSystem (it does not answer).
Result<ServerWatch> watchServer(std::string_view name);
/// By process id, whatever its name. Errors: as above.
Result<ServerWatch> watchServerProcess(int processId);

}  // namespace fr
