#include "tools/frankenrender/command_line.h"
#include "tools/frankenrender/job.h"

int main(int argc, char** argv) {
  const fr::tools::ParsedCommandLine parsed = fr::tools::parseCommandLine(argc, argv);
  return parsed.run ? fr::tools::runJob(*parsed.run) : parsed.exitCode;
}
