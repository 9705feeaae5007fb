// The tracer process: answers the rays of the process that started it.
#pragma once

#include "base/error.h"
#include "shm/peer.h"

namespace fr::tracer {

/// Serves over `parent` until the client says goodbye or is gone: attaches the scene cache that it sends,
/// then runs the asked number of threads over its channels. Returns an error when the conversation could not
/// start or went wrong; the client has been told as far as it could be. Blocks; call once, from the main
/// thread.
Result<void> serveParent(shm::PeerSocket parent);

/// The program's argument that asks for this.
inline constexpr const char* kOracleArgument = "--oracle";

}  // namespace fr::tracer
