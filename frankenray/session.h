// What the handles of frankenray.h stand for. Internal.
#pragma once

#include <atomic>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "base/error.h"
#include "frankenray/frankenray.h"
#include "oracle/ray_client.h"

namespace fr::frankenray {

/// Forks of this process seen by this library: handles of an earlier number belong to the parent.
uint64_t forkNumber();

/// One server after the other, by the same recipe. Thread safety: everything under `mutex` but the atomics.
/// Lines share it; it ends with the last of them.
struct Session {
  const uint64_t fork = forkNumber();
  std::mutex mutex;
  std::unique_ptr<RayClient> client;  // null: not connected, or closed
  std::function<Result<std::unique_ptr<RayClient>>()> recipe;
  std::string error;
  frankenray_status lost = FRANKENRAY_ERROR_NOT_CONNECTED;  // what a line gets while there is no client
  /// Number of the current client, 0: none. Lines compare it with that of their connection.
  std::atomic<uint64_t> number{0};
  uint64_t connections = 0;

  std::atomic<uint64_t> rays[4] = {};
  std::atomic<uint64_t> singles{0}, blocks{0};

  ~Session();
};

/// The status for an error of the oracle. `otherwise`: for kSystem.
frankenray_status statusOf(const Error& e, frankenray_status otherwise);

/// Runs `body` so that nothing is thrown over the border; exceptions become a status.
template <class Body>
frankenray_status guarded(Body body) noexcept {
  try {
    return body();
  } catch (const std::bad_alloc&) {
    return FRANKENRAY_ERROR_MEMORY;
  } catch (...) {
    return FRANKENRAY_ERROR_INTERNAL;
  }
}

/// A copy of a structure of the caller's, who may know fewer or more fields. False when `size` makes no
/// sense.
template <class T>
bool readStructure(const T* from, T& to) {
  if (!from || from->size < sizeof(size_t) || from->size > 65536) return false;
  const size_t n = from->size < sizeof(T) ? from->size : sizeof(T);
  std::memcpy(static_cast<void*>(&to), from, n);
  to.size = sizeof(T);
  return true;
}

}  // namespace fr::frankenray

struct frankenray_session {
  std::shared_ptr<fr::frankenray::Session> shared;
};
