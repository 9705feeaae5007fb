// The other process: starting it, talking to it, noticing that it died.
#pragma once

#include <sys/types.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "base/error.h"
#include "shm/file_descriptor.h"

namespace fr::shm {

inline constexpr size_t kMaxMessageBytes = 4096;
inline constexpr size_t kMaxMessageDescriptors = 16;

struct PeerMessage {
  std::vector<std::byte> bytes;
  std::vector<FileDescriptor> descriptors;
};

/// A connected AF_UNIX SOCK_SEQPACKET socket: whole messages, descriptors with them, and a hang-up when the
/// last process at the other end is gone. Thread safety: send() and receive() from one thread each; alive()
/// from any. Crash of the peer: receive() drains what was sent, then says so; send() fails; alive() turns
/// false.
class PeerSocket {
 public:
  PeerSocket() = default;
  explicit PeerSocket(FileDescriptor fd) : fd_(std::move(fd)) {}
  /// Two connected ends in this process, close-on-exec.
  static Result<std::pair<PeerSocket, PeerSocket>> pair();

  bool valid() const { return fd_.valid(); }
  int descriptor() const { return fd_.get(); }
  void close() { fd_.reset(); }

  /// Sends one message; the descriptors stay the caller's. Blocks while the peer's queue is full, never
  /// longer than `timeout`. Errors: kRange (too large, empty), kSystem (peer gone, timed out).
  Result<void> send(std::span<const std::byte> bytes, std::span<const int> descriptors,
                    std::chrono::milliseconds timeout = std::chrono::seconds(10));
  /// The next message; nothing on time-out (negative: none, no timer runs). Errors: kSystem (peer gone),
  /// kBadFile (a message larger than we allow; what it carried is closed).
  Result<std::optional<PeerMessage>> receive(std::chrono::milliseconds timeout);
  /// False once the other end is closed by all its holders. A system call of about 0.3 us.
  bool alive() const;

 private:
  FileDescriptor fd_;
};

struct SpawnOptions {
  std::string program;                 // path, or name to look up in PATH
  std::vector<std::string> arguments;  // without the program itself
  /// Set in the child's environment to the number of its socket; empty: the child gets none.
  std::string socketVariable = "FR_PEER_SOCKET";
  /// Descriptors that become the child's standard input and output; -1: ours.
  int standardInput = -1, standardOutput = -1;
};

/// A child process with a socket to it.
/// Thread safety: none, but alive() from any thread. Ownership: the destructor closes the socket (which asks
/// the child to end), gives it `kGrace`, then kills it; it never leaves a zombie or a descriptor.
class ChildProcess {
 public:
  static constexpr std::chrono::milliseconds kGrace{2000};

  /// The child gets stdin, stdout, stderr, its socket, and no other descriptor of ours that is close-on-exec;
  /// default signal actions and an empty signal mask. Safe in a process with threads. Errors: kNoFile
  /// (program), kSystem.
  static Result<ChildProcess> spawn(const SpawnOptions& options);
  ChildProcess(ChildProcess&&) noexcept;
  ChildProcess& operator=(ChildProcess&&) = delete;
  ~ChildProcess();

  pid_t pid() const { return pid_; }
  PeerSocket& socket() { return socket_; }
  /// False once the process has ended (reaped or not) or has closed its socket, if it has one.
  bool alive() const;
  /// Waits for the end, at most `timeout`; true when it has ended. Reaps it.
  bool wait(std::chrono::milliseconds timeout);
  void signal(int number);
  /// "ended with status 3", "killed by signal 9 (Killed)", "running". Reaps.
  std::string statusText();
  /// Exit status 0 ... 255, -signal, or nothing while it runs or when another waiter of this process took the
  /// status.
  std::optional<int> exitStatus();

 private:
  ChildProcess(pid_t pid, FileDescriptor pidfd, PeerSocket socket);
  void reap(bool block);

  pid_t pid_ = -1;
  FileDescriptor pidfd_;
  PeerSocket socket_;
  bool hasSocket_ = true;
  std::atomic<bool> ended_{false};  // alive() reads it from any thread
  std::optional<int> waitStatus_;
};

/// In the child: the socket that spawn() gave us; also clears the variable and sets close-on-exec, so that
/// our own children do not keep it open. Errors: kBadHandle (not set, or not a socket). Not thread-safe: call
/// it early in main().
Result<PeerSocket> parentSocket(const char* socketVariable = "FR_PEER_SOCKET");

/// Asks the kernel to end this process with SIGTERM when the *thread* that started it ends: right when that
/// thread is the parent's main thread, wrong otherwise. An addition for a child that may hang; the orderly
/// way is the socket's hang-up.
void dieWithParentThread();

/// Text of a wait status as statusText() gives it.
std::string describeWaitStatus(int status);

}  // namespace fr::shm
