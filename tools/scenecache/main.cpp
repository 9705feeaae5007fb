// scenecache: build, describe, check, compare and prune .fsc files.
#include <csignal>

#include "base/interrupt.h"
#include "base/log.h"
#include "tools/scenecache/commands.h"

namespace {

constexpr const char* kIntroduction = R"(Prepare, describe and check scene caches.

A scene cache (.fsc) holds one frame of a scene, tessellated: frankenrender and rendrib take it
in place of RIB files, and start without reading or dicing anything.)";

constexpr const char* kExamples = R"(Examples:
  scenecache build scene.rib -o scene.fsc      dice everything ahead of time
  scenecache build shot.rib --frame 2 -o shot.0002.fsc --reuse shot.0001.fsc
                                               only what differs from frame 1 is diced
  scenecache build city.rib -o city.fsc --memory 512M
                                               a scene larger than memory
  scenecache info scene.fsc                    what is in it and what it weighs
  scenecache ls scene.fsc --json | jq '.[] | select(.bytes > 1e6)'
  scenecache dump scene.fsc --object teapot -o teapot.obj
  scenecache diff a.fsc b.fsc                  objects added, removed, changed
  scenecache prune scene.fsc -o small.fsc --drop 'tree*'
  scenecache verify scene.fsc                  checksums, every record, every vertex

Each subcommand has a --help of its own. Data goes to standard output, messages to standard error.

Exit status: 0 done; 1 something is wrong with the input or the system, said on standard error
(diff: the caches differ); 2 the command line could not be understood (diff: trouble);
130 stopped by Ctrl-C.)";

/// Ctrl-C and kill end the work in order; a second one has its usual effect.
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
  using namespace fr::tools;
  // A file that would grow beyond the limit is a failing write, not a signal.
  std::signal(SIGXFSZ, SIG_IGN);
  CLI::App app{kIntroduction, "scenecache"};
  app.footer(kExamples);
  app.require_subcommand(1);
  app.set_version_flag("--version,-V", std::string("scenecache ") + FR_VERSION);
  Run run;
  addBuild(app, run);
  addInfo(app, run);
  addList(app, run);
  addVerify(app, run);
  addDump(app, run);
  addDiff(app, run);
  addPrune(app, run);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? kOk : kUsage;
  }
  fr::setLogName("scenecache");
  endInOrder();
  const int status = run();
  return fr::interrupted() ? 130 : status;
}
