#include <csignal>

#include "base/freed_memory.h"
#include "base/interrupt.h"
#include "tools/frankenrender/command_line.h"
#include "tools/frankenrender/job.h"

namespace {

/// Ctrl-C and kill end the frame in order; a second one has its usual effect.
void endInOrder() {
  struct sigaction act {};
  act.sa_handler = [](int) { fr::interrupt(); };
  act.sa_flags = SA_RESTART | SA_RESETHAND;
  ::sigemptyset(&act.sa_mask);
  for (const int s : {SIGINT, SIGTERM}) {
    struct sigaction before {};
    if (::sigaction(s, nullptr, &before) == 0 && before.sa_handler != SIG_IGN) ::sigaction(s, &act, nullptr);
  }
}

}  // namespace

int main(int argc, char** argv) {
  fr::returnFreedMemory();
  // A file that would grow beyond the limit is a failing write, not a signal.
  std::signal(SIGXFSZ, SIG_IGN);
  const fr::tools::ParsedCommandLine parsed = fr::tools::parseCommandLine(argc, argv);
  if (parsed.run) endInOrder();
  return parsed.run ? fr::tools::runJob(*parsed.run) : parsed.exitCode;
}
