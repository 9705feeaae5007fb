// catrib: RIB to RIB, in other encodings; and a checker of RIB.
#include <CLI/CLI.hpp>
#include <csignal>
#include <cstdio>
#include <map>

#include "ri/reader.h"
#include "ri/rib_file.h"
#include "ri/rib_writer.h"
#include "ri/state_renderer.h"

namespace {

using namespace fr;

constexpr const char* kDescription =
    "Reads RIB (ASCII, binary, gzip, mixed) and writes it again, in another encoding. Nothing is lost:\n"
    "requests, comments, conditions, inline archives, requests and parameters that are not known here.";

constexpr const char* kFooter =
    R"(Several files are read as one stream; "-" (the default) is standard input. Messages go to standard
error, with file, line and column. A bad request is left out.

Exit status: 0 done; 1 something was wrong with the RIB or could not be written; 2 wrong usage.

Examples:
  catrib scene.rib                     pretty-printed, to standard output
  catrib --binary -o b.rib scene.rib   binary: smaller, and much faster to read
  catrib --gzip -o s.rib.gz scene.rib  compressed (all renderers read that)
  catrib --check scene.rib             only say what is wrong with it
  catrib --expand scene.rib            ReadArchive replaced by what the archives say)";

struct CommandLine {
  std::vector<std::string> inputs;
  std::string output = "-";
  bool ascii = false, binary = false, gzip = false, compact = false, check = false, expand = false,
       quiet = false;
  std::string archives;
};

/// Everything that is read, by the reader of `o`. False: a file was not there, or something ended it early.
bool readAll(const CommandLine& c, ri::Renderer& to, const ri::ReaderOptions& o) {
  ri::Reader reader(to, o);
  bool whole = true;
  for (const std::string& input : c.inputs) {
    if (const Result<void> r = input == "-" ? reader.readStdin() : reader.readFile(input); !r) {
      report(r.error());
      whole = false;
    }
  }
  return whole;
}

ri::ReaderOptions readerOptions(const CommandLine& c) {
  ri::ReaderOptions o = ri::ReaderOptions::rewriting();
  o.expandArchives = c.expand;
  std::string_view rest = c.archives;
  while (!rest.empty()) {
    const size_t colon = std::min(rest.find(':'), rest.size());
    if (colon > 0) o.archivePath.emplace_back(rest.substr(0, colon));
    rest.remove_prefix(std::min(colon + 1, rest.size()));
  }
  return o;
}

int check(const CommandLine& c) {
  // As a renderer reads it: archives, conditions, nesting, value counts.
  ri::ReaderOptions o;
  o.archivePath = readerOptions(c).archivePath;
  ri::StateRenderer state;
  const bool whole = readAll(c, state, o);
  state.finish();
  const int errors = reportCount(Severity::kError), all = reportCount(Severity::kWarning);
  if (!c.quiet)
    std::fprintf(stderr, "%s: %d error%s, %d warning%s\n",
                 c.inputs.size() == 1 ? c.inputs[0].c_str() : "all files", errors, errors == 1 ? "" : "s",
                 all - errors, all - errors == 1 ? "" : "s");
  return whole && all == 0 ? 0 : 1;
}

int rewrite(const CommandLine& c) {
  ri::RibFile file;
  if (const Result<void> r = file.open(c.output, c.gzip); !r) {
    report(r.error());
    return 1;
  }
  ri::RibWriterOptions options;
  options.binary = c.binary;
  options.keepBareNames = true;
  if (!c.compact) options.indent = 2, options.width = 100;
  ri::RibWriter writer([&](std::string_view bytes) { file.write(bytes); }, options);
  const bool whole = readAll(c, writer, readerOptions(c));
  writer.flush();
  if (const Result<void> r = file.finish(); !r) {
    report(r.error());
    return 1;
  }
  return whole && reportCount(Severity::kError) == 0 ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  CommandLine c;
  CLI::App app{kDescription, "catrib"};
  app.footer(kFooter);
  app.set_version_flag("--version,-V", std::string("catrib (frankenrender) ") + FR_VERSION);
  app.add_option("-o,--output", c.output, "File to write (default: standard output)")->type_name("FILE");
  auto* binary = app.add_flag("-b,--binary", c.binary, "Write binary RIB");
  app.add_flag("-a,--ascii", c.ascii, "Write ASCII RIB (default)")->excludes(binary);
  app.add_flag("-z,--gzip", c.gzip, "Compress the output");
  app.add_flag("--compact", c.compact, "ASCII: one request a line, not indented")->excludes(binary);
  app.add_flag("--expand", c.expand, "Put the contents of archives in place of ReadArchive");
  app.add_option("--archives", c.archives, "Folders of archives, colon-separated")->type_name("PATH");
  app.add_flag("--check", c.check,
               "Write nothing: read as a renderer does and say what is wrong; any warning is\n"
               "exit status 1");
  app.add_flag("--quiet", c.quiet, "--check: no summary");
  app.add_option("files", c.inputs, "RIB files")->type_name("FILE...");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 2;
  }
  if (c.inputs.empty()) c.inputs.emplace_back("-");
  std::signal(SIGPIPE, SIG_IGN);  // `catrib x | head` ends with a message about the pipe, not with a signal
  return c.check ? check(c) : rewrite(c);
}
