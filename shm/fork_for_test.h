// Running part of a test in another process.
#pragma once

#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <exception>

namespace fr::shm {

/// Forks; the child runs f() and ends with its result as exit status, without running the test program's own
/// ends.
template <class F>
pid_t forkChild(F&& f) {
  std::fflush(nullptr);
  const pid_t pid = ::fork();
  if (pid != 0) return pid;
  int status = 99;
  try {
    status = f();
  } catch (const std::exception& e) {
    std::fprintf(stderr, "child: %s\n", e.what());
  }
  ::_exit(status);
}

/// Waits for a child: its exit status, -signal when a signal ended it.
inline int joinChild(pid_t pid) {
  int status = 0;
  if (::waitpid(pid, &status, 0) != pid) return 1000;
  return WIFSIGNALED(status) ? -WTERMSIG(status) : WEXITSTATUS(status);
}

template <class F>
int runInChild(F&& f) {
  return joinChild(forkChild(std::forward<F>(f)));
}

/// In a child: a failed expectation ends it with the line number's low bits, never 0.
#define CHILD_EXPECT(cond)                                                   \
  do {                                                                       \
    if (!(cond)) {                                                           \
      std::fprintf(stderr, "%s:%d: child: %s\n", __FILE__, __LINE__, #cond); \
      return 1 + __LINE__ % 90;                                              \
    }                                                                        \
  } while (0)

}  // namespace fr::shm
