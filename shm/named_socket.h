// Meeting a process that is not our child: sockets with names, between processes of one user.
//
// The names are abstract ("@frankenrender-<uid>-<name>" in /proc/net/unix): they live in the kernel, not in a
// file system, so nothing stays behind whatever crashes. Both ends look at the other's credentials: anybody
// may use an abstract name, but only a process of our own user gets past accept() and connectNamed().
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "shm/peer.h"

namespace fr::shm {

/// What a name may be: 1 to 64 of letters, digits, '.', '_', '-'.
bool isSocketName(std::string_view name);
/// How messages call it: "@frankenrender-1000-name".
std::string socketAddressText(std::string_view name);

/// A listening socket. Thread safety: none. Ends with the object or the process.
class NamedListener {
 public:
  NamedListener() = default;
  /// Errors: kRange (not a name), kIllState (another process of ours listens there), kSystem.
  static Result<NamedListener> listen(std::string_view name);
  bool valid() const { return fd_.valid(); }
  int descriptor() const { return fd_.get(); }
  const std::string& name() const { return name_; }
  /// The next connection; never blocks: nothing when none waits. Errors: kSystem (no descriptors left);
  /// kBadHandle (another user's process; its connection is closed).
  Result<std::optional<PeerSocket>> accept();

 private:
  FileDescriptor fd_;
  std::string name_;
};

/// Errors: kRange, kNoFile (nobody listens there), kBadHandle (another user listens there), kSystem.
Result<PeerSocket> connectNamed(std::string_view name);

/// Process at the other end, as it was when the connection was made; 0 unknown. For messages.
int peerProcessId(const PeerSocket& socket);

/// Names at which processes of this user listen, sorted.
std::vector<std::string> listSocketNames();

}  // namespace fr::shm
