#include <csignal>

#include "tools/frankenrender/command_line.h"
#include "tools/frankenrender/job.h"

int main(int argc, char** argv) {
  // A file that would grow beyond the limit is a failing write, not a signal.
  std::signal(SIGXFSZ, SIG_IGN);
  const fr::tools::ParsedCommandLine parsed = fr::tools::parseCommandLine(argc, argv);
  return parsed.run ? fr::tools::runJob(*parsed.run) : parsed.exitCode;
}
