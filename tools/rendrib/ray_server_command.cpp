#include "tools/rendrib/ray_server_command.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <string_view>

#include "shm/named_socket.h"
#include "tools/frankenrender/command_line.h"

namespace fr::tools {
namespace {

constexpr const char* kDescription =
    "Loads a scene and answers ray queries about it instead of making a picture: trace, visibility,\n"
    "rayhittest and fulltrace, for any number of programs of this user at once over shared memory,\n"
    "and for the one that holds its standard input and output (as BMRT's ray server of 1998).";

constexpr const char* kFooter =
    R"(Files after -bmrt are seen by rays alone, files after -prman by no ray; -common ends both. A .fsc file
(see `scenecache build`) stands for a whole scene. Of several frames the first is served (see -frames).

Clients: libfrankenray and RayClient join by name; the DSO shadeops of rayserver.h and
frankenrender --pipe start a server with the command in RAYSERVER, e.g.

  export RAYSERVER="rendrib -rayserver teapots.rib"

RAYSERVER_JITTER_TIMES=1: the rays of the 1998 protocol get times inside the shutter; else at shutter open.

It ends with the program that started it: when its standard input, a pipe or a file, ends. Otherwise (a
terminal, /dev/null, or -name and nothing on the pipe) it serves until SIGTERM or SIGINT. A second signal
ends it at once. `raystat` shows what it does.

Exit status: 0 ended in order; 1 the scene could not be served, or the pipe client sent no ray queries;
2 wrong usage.)";

}  // namespace

ParsedRayServerCommand parseRayServerCommand(int argc, char** argv) {
  RayServerCommand c;
  CLI::App app{kDescription, "rendrib -rayserver"};
  app.footer(kFooter);
  app.set_version_flag("--version,-V", std::string("rendrib (frankenrender) ") + FR_VERSION);
  std::vector<int> frames, resolution;
  std::vector<double> samples;
  bool verbose = false;
  app.add_option("--name", c.name, "Name under which clients join (default: the process id)")
      ->type_name("NAME");
  app.add_option("--threads", c.threads, "Threads (default: all cores)")->check(CLI::Range(1, 1024));
  app.add_option("--patch_multiplier,--patch-multiplier", c.patchMultiplier,
                 "Tessellation rate of curved surfaces (default 0.5) where the scene has no\n"
                 "Attribute \"render\" \"patch_multiplier\"")
      ->check(CLI::Range(0.001, 64.0));
  app.add_option("--frames", frames, "Serve the first of these frames")->expected(2)->type_name("A B");
  app.add_option("--res", resolution, "Resolution if the scene has no Format: decides how fine it is diced")
      ->expected(2)
      ->type_name("X Y")
      ->check(CLI::Range(1, 65536));
  app.add_option("--samples", samples, "Accepted, of no effect")->expected(2)->type_name("X Y");
  app.add_option("--shaders", c.shaderPath, "Folders of shaders, colon-separated, searched first")
      ->type_name("PATH");
  app.add_flag("--deterministic", c.deterministic,
               "The same answers, bit for bit, on every machine: rays are traced with the instructions that\n"
               "all of them have, a little slower");
  std::string memory;
  app.add_option("--memory", memory,
                 "Most that the server may hold in memory: 512M, 2G. The scene goes to files in the scratch\n"
                 "folder then, and only what is in use stays in memory")
      ->type_name("SIZE");
  app.add_option("--scratch", c.memory.scratch,
                 "Folder on a disk for scenes that do not fit into memory (default with -memory: TMPDIR,\n"
                 "/var/tmp or /tmp). Nothing stays there")
      ->type_name("DIR")
      ->check(CLI::ExistingDirectory);
  app.add_flag("--silent,--quiet", c.silent, "Print errors only");
  app.add_flag("-v,--verbose", verbose, "Accepted, of no effect");

  std::vector<std::string> rest, same;
  bool asFrankenrender = false;
  uint8_t sides = cache::kForReyes | cache::kForTracer;
  int values = 0;
  for (int i = 1; i < argc; ++i) {
    std::string a = argv[i];
    if (asFrankenrender) {
      same.push_back(a);
    } else if (values > 0) {
      rest.push_back(a);
      --values;
    } else if (a == "-frankenrender") {
      // Internal, for frankenrender --pipe: what follows are frankenrender's own arguments, so that both load
      // the very same frame.
      asFrankenrender = true;
    } else if (a == "-rayserver" || a == "--rayserver") {
    } else if (a == "-bmrt" || a == "-prman" || a == "-common") {
      sides = a == "-bmrt"    ? uint8_t(cache::kForTracer)
              : a == "-prman" ? uint8_t(cache::kForReyes)
                              : uint8_t(cache::kForReyes | cache::kForTracer);
    } else if (a.size() > 1 && a[0] == '-') {
      if (a == "-h" || a == "-help") a = "--help";
      if (a.size() > 2 && a[1] != '-') a.insert(0, "-");  // the dash of 1998
      rest.push_back(a);
      if (const auto* option = app.get_option_no_throw(a); option && option->get_items_expected_max() > 0)
        values = option->get_items_expected_max();
    } else {
      c.inputs.push_back({a, sides});
    }
  }
  std::reverse(rest.begin(), rest.end());
  try {
    app.parse(rest);
  } catch (const CLI::ParseError& e) {
    return {std::nullopt, app.exit(e) == 0 ? 0 : 2};
  }
  if (asFrankenrender) {
    std::vector<char*> words;
    std::string program = "frankenrender";
    words.push_back(program.data());
    for (std::string& s : same) words.push_back(s.data());
    words.push_back(nullptr);
    ParsedCommandLine parsed = parseCommandLine(int(words.size()) - 1, words.data());
    if (!parsed.run) return {std::nullopt, 2};
    c.inputs = std::move(parsed.run->inputs);
    c.load = std::move(parsed.run->load);
    c.memory = std::move(parsed.run->memory);
    c.shaderPath = std::move(parsed.run->shaderPath);
    c.deterministic |= parsed.run->deterministic;
  }
  if (app.count("--memory") > 0) {
    const auto bytes = parseMemorySize(memory);
    if (!bytes) {
      std::fprintf(stderr, "rendrib -rayserver: -memory wants a size such as 512M or 2G; not \"%s\"\n",
                   memory.c_str());
      return {std::nullopt, 2};
    }
    c.memory.budget = *bytes;
  }
  if (c.inputs.empty()) {
    std::fputs("rendrib -rayserver: no scene given; try rendrib -rayserver --help\n", stderr);
    return {std::nullopt, 2};
  }
  for (const cache::RibInput& i : c.inputs)
    if (i.path == "-") {
      std::fputs("rendrib -rayserver: the scene cannot come from standard input: queries do\n", stderr);
      return {std::nullopt, 2};
    }
  if (!c.name.empty() && !shm::isSocketName(c.name)) {
    std::fputs("rendrib -rayserver: -name wants 1 to 64 letters, digits, '.', '_' and '-'\n", stderr);
    return {std::nullopt, 2};
  }
  if (!frames.empty()) c.load.frames = {frames[0], frames[1]};
  if (!resolution.empty()) c.load.defaults.resolution = {resolution[0], resolution[1]};
  return {std::move(c), 0};
}

}  // namespace fr::tools
