// The tracer process: answers the rays of the process that started it.
#pragma once

#include "base/error.h"
#include "shm/peer.h"

namespace fr::tracer {

/// Exit statuses of a tracer process that could not do its work, for reasons that its successor would meet as
/// well.
inline constexpr int kOutOfMemoryStatus = 12;
inline constexpr int kUntraceableStatus = 13;

/// Serves over `parent` until the client says goodbye or is gone: attaches the scene cache that it sends,
/// then runs the asked number of threads over its channels. Returns an error when the conversation could not
/// start or went wrong; the client has been told as far as it could be. Blocks; call once, from the main
/// thread, in a process that does nothing else: it ends the whole process at once, in whatever it is doing,
/// when the client is gone, and with one of the statuses above when memory runs out or the scene cannot be
/// traced. SIGINT and SIGHUP, which a terminal sends to both processes, are left to the client.
Result<void> serveParent(shm::PeerSocket parent);

/// The program's argument that asks for this.
inline constexpr const char* kOracleArgument = "--oracle";

}  // namespace fr::tracer
