#include "tools/rendrib/command_line.h"

#include <fmt/format.h>
#include <sys/utsname.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <span>
#include <string_view>

namespace fr::tools {
namespace {

constexpr std::string_view kIntroduction =
    R"(Usage: rendrib [options] [scene.rib ... | scene.fsc]
       rendrib -rayserver [options] scene.rib ... | scene.fsc     (see rendrib -rayserver -help)

Renders RIB scenes by rays alone: the ray tracing half of frankenrender as a renderer of its own. It reads the
same files, runs the same shaders, and writes the pictures that the scene's Display requests ask for.
The files are read in order as one stream; without a file, or for "-", standard input is read.
A .fsc file (see `scenecache build`) stands for a whole scene, already tessellated.

)";

constexpr std::string_view kEpilogue =
    R"(
Every option may be written with two dashes. -res and -samples do not override a RIB that says Format or
PixelSamples itself; the other options do override it.

~/.rendribrc and ./.rendribrc are read before the scene, if they exist: RIB for search paths and defaults.
Search paths besides Option "searchpath": SHADERS, TEXTURES, ARCHIVES, PROCEDURALS, DISPLAYS
(colon-separated). Shaders are also looked for beside the RIB; missing or stale .slx files are compiled.

Exit status: 0 rendered; 1 something failed or was replaced by a default; 2 wrong usage.

Examples:
  rendrib scene.rib                        render
  rendrib -res 320 180 -stats scene.rib    a quick look (when the RIB has no Format), with figures
  rendrib -var 0.0005 4 64 scene.rib       4 samples a pixel, up to 64 where the picture is not smooth
  rendrib -crop 0.4 0.6 0.4 0.6 -of part.png scene.rib
  myprogram | rendrib                      a program that writes RIB
)";

struct Parser;
struct Option {
  std::string_view name;    // without dashes
  std::string_view values;  // shown by -help
  int least, most;          // values; optional ones must be numbers
  std::string_view help;
  bool (*take)(Parser&, std::span<const std::string_view>);  // false: usage error, already said
};

struct Parser {
  RendribCommandLine c;
  std::string_view name;  // of the option being taken, as typed
  std::optional<int> exitCode;
  bool readRc = true;
  std::string displayFile;

  bool fail(std::string_view what) const {
    fmt::print(stderr, "rendrib: {}; see rendrib -help\n", what);
    return false;
  }
  bool number(std::string_view text, double low, double high, double& out) const {
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), out);
    if (error == std::errc() && end == text.data() + text.size() && out >= low && out <= high) return true;
    return fail(fmt::format("{}: \"{}\" should be a number from {} to {}", name, text, low, high));
  }
  bool number(std::string_view text, int low, int high, int& out) const {
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), out);
    if (error == std::errc() && end == text.data() + text.size() && out >= low && out <= high) return true;
    return fail(fmt::format("{}: \"{}\" should be a whole number from {} to {}", name, text, low, high));
  }
};

using Values = std::span<const std::string_view>;
constexpr int kMostFrames = 1 << 30;

bool takeCrop(Parser& p, Values v) {
  std::array<double, 4> w{};
  for (size_t i = 0; i < 4; ++i)
    if (!p.number(v[i], 0, 1, w[i])) return false;
  if (!(w[0] < w[1] && w[2] < w[3])) return p.fail("-crop wants x1 < x2 and y1 < y2");
  p.c.load.overrides.crop = w;
  return true;
}

bool takeAdaptive(Parser& p, Values v) {
  double variance = 0;
  AdaptiveSampling a;
  if (!p.number(v[0], 0, 1e6, variance) || !p.number(v[1], 1, 4096, a.minSamples) ||
      !p.number(v[2], 1, 4096, a.maxSamples))
    return false;
  if (a.minSamples > a.maxSamples) return p.fail("-var wants min <= max");
  a.variance = float(variance);
  p.c.adaptive = a;
  return true;
}

std::string architecture() {
  utsname u{};
  if (uname(&u) != 0) return "unknown";
  std::string code = fmt::format("{}_{}", u.sysname, u.machine);
  std::transform(code.begin(), code.end(), code.begin(),
                 [](unsigned char ch) { return char(std::tolower(ch)); });
  return code;
}

std::string help();

const Option kOptions[] = {
    {"res", "x y", 2, 2, "resolution if the RIB has no Format (else 640 480)",
     [](Parser& p, Values v) {
       std::array<int, 2> r{};
       if (!p.number(v[0], 1, 65536, r[0]) || !p.number(v[1], 1, 65536, r[1])) return false;
       p.c.load.defaults.resolution = r;
       return true;
     }},
    {"samples", "x y", 2, 2, "samples a pixel if the RIB has no PixelSamples (else 2 2)",
     [](Parser& p, Values v) {
       std::array<double, 2> r{};
       if (!p.number(v[0], 1, 64, r[0]) || !p.number(v[1], 1, 64, r[1])) return false;
       p.c.load.defaults.pixelSamples = r;
       return true;
     }},
    {"var", "v min max", 3, 3,
     "adaptive sampling: min samples a pixel, then more, up to max, until the estimated variance\n"
     "of the pixel is at most v",
     takeAdaptive},
    {"error", "e", 1, 1,
     "adaptive sampling: as many samples as the picture needs to have about this error (RMSE, white\n"
     "is 1), where it needs them, up to 1024 a pixel",
     [](Parser& p, Values v) {
       double error = 0;
       if (!p.number(v[0], 1e-6, 1, error)) return false;
       p.c.adaptive = AdaptiveSampling::toError(error);
       return true;
     }},
    {"crop", "x1 x2 y1 y2", 4, 4, "part of the frame, 0 to 1, y down", takeCrop},
    {"frames", "f1 f2", 2, 2, "only frames f1 to f2",
     [](Parser& p, Values v) {
       std::pair<int, int> f;
       if (!p.number(v[0], -kMostFrames, kMostFrames, f.first) ||
           !p.number(v[1], -kMostFrames, kMostFrames, f.second))
         return false;
       p.c.load.frames = f;
       return true;
     }},
    {"of", "file", 1, 1, "one picture, to this file (format by its ending), instead of the Displays",
     [](Parser& p, Values v) {
       p.displayFile = v[0];
       return true;
     }},
    {"safe", "", 0, 0, "keep existing pictures: what has one already is not rendered",
     [](Parser& p, Values) { return p.c.safe = true; }},
    {"d", "[interleave]", 0, 1, "of 1998: show a window. There is none: the pictures go to files",
     [](Parser& p, Values) { return p.c.window = true; }},
    {"pos", "x y", 2, 2, "of 1998: where that window is. Ignored",
     [](Parser& p, Values v) {
       int at = 0;
       return p.number(v[0], -65536, 65536, at) && p.number(v[1], -65536, 65536, at);
     }},
    {"radio", "n", 1, 1, "radiosity steps. Not built yet: ignored with a warning",
     [](Parser& p, Values v) {
       int steps = 0;
       if (!p.number(v[0], 0, 1 << 30, steps)) return false;
       p.c.radiosity = steps > 0;
       return true;
     }},
    {"threads", "n", 1, 1, "threads (default: all cores)",
     [](Parser& p, Values v) { return p.number(v[0], 1, 1024, p.c.threads); }},
    {"deterministic", "", 0, 0,
     "the same picture, bit for bit, on every machine: rays are traced with the instructions that all\n"
     "of them have, a little slower. (On one machine it is the same anyway)",
     [](Parser& p, Values) { return p.c.deterministic = true; }},
    {"patch_multiplier", "m", 1, 1,
     "tessellation rate of curved surfaces where the RIB has no Attribute \"render\"\n"
     "\"patch_multiplier\": 1 (default) traces them as fine as frankenrender draws them; 0.5 every\n"
     "second vertex, and so on",
     [](Parser& p, Values v) {
       double m = 1;
       if (!p.number(v[0], 1e-3, 64, m)) return false;
       p.c.patchMultiplier = float(m);
       return true;
     }},
    {"memory", "size", 1, 1,
     "most that may be held in memory: 512M, 2G. The scene goes to files in the scratch folder then,\n"
     "and only what is in use stays in memory",
     [](Parser& p, Values v) {
       const auto bytes = parseMemorySize(v[0]);
       if (!bytes) return p.fail(fmt::format("{} wants a size such as 512M or 2G, at least 1M", p.name));
       p.c.memory.budget = *bytes;
       return true;
     }},
    {"scratch", "folder", 1, 1,
     "on a disk, for scenes that do not fit into memory (default with -memory: TMPDIR, /var/tmp or\n"
     "/tmp). Nothing stays there",
     [](Parser& p, Values v) {
       if (!std::filesystem::is_directory(v[0]))
         return p.fail(fmt::format("{}: \"{}\" is no folder", p.name, v[0]));
       p.c.memory.scratch = v[0];
       return true;
     }},
    {"shaders", "path", 1, 1, "folders of shaders, colon-separated, searched first",
     [](Parser& p, Values v) {
       p.c.shaderPath = v[0];
       return true;
     }},
    {"norc", "", 0, 0, "do not read .rendribrc",
     [](Parser& p, Values) {
       p.readRc = false;
       return true;
     }},
    {"v", "", 0, 0, "say what is being done", [](Parser& p, Values) { return p.c.verbose = true; }},
    {"stats", "", 0, 0, "statistics at the end of each frame",
     [](Parser& p, Values) { return p.c.stats = true; }},
    {"silent", "", 0, 0, "print errors only", [](Parser& p, Values) { return p.c.silent = true; }},
    {"Progress", "", 0, 0, "a line \"R90000 nn%\" for every percent (queue managers read them)",
     [](Parser& p, Values) { return p.c.progressLines = true; }},
    {"beep", "", 0, 0, "ring the terminal's bell at the end",
     [](Parser& p, Values) { return p.c.beep = true; }},
    {"arch", "", 0, 0, "print the code of this platform",
     [](Parser& p, Values) {
       std::puts(architecture().c_str());
       p.exitCode = 0;
       return true;
     }},
    {"version", "", 0, 0, "print the version",
     [](Parser& p, Values) {
       std::puts("rendrib (frankenrender) " FR_VERSION);
       p.exitCode = 0;
       return true;
     }},
    {"help", "", 0, 0, "print this text",
     [](Parser& p, Values) {
       std::fputs(help().c_str(), stdout);
       p.exitCode = 0;
       return true;
     }},
};

std::string help() {
  std::string text(kIntroduction);
  text += "Options:\n";
  for (const Option& o : kOptions) {
    std::string line = fmt::format("  {:<22}", fmt::format("-{} {}", o.name, o.values));
    for (char ch : o.help) {
      line += ch;
      if (ch == '\n') line += std::string(24, ' ');
    }
    text += line + "\n";
  }
  text += kEpilogue;
  return text;
}

const Option* find(std::string_view name) {
  // Names of 1998, and what fingers type today.
  if (name == "h" || name == "?") name = "help";
  if (name == "V") name = "version";
  if (name == "o" || name == "output") name = "of";
  if (name == "quiet") name = "silent";
  if (name == "progress") name = "Progress";
  if (name == "patch-multiplier") name = "patch_multiplier";
  for (const Option& o : kOptions)
    if (o.name == name) return &o;
  return nullptr;
}

bool isWholeNumber(std::string_view s) {
  return !s.empty() && std::all_of(s.begin(), s.end(), [](unsigned char ch) { return std::isdigit(ch); });
}

/// The user's defaults: ~/.rendribrc, then the one of this folder if it is another file.
std::vector<cache::RibInput> rcFiles() {
  namespace fs = std::filesystem;
  std::vector<cache::RibInput> files;
  std::error_code error;
  const char* home = std::getenv("HOME");
  const fs::path here = ".rendribrc", there = home && *home ? fs::path(home) / here : fs::path();
  if (!there.empty() && fs::is_regular_file(there, error)) files.push_back({there.string()});
  if (fs::is_regular_file(here, error) && (files.empty() || !fs::equivalent(here, there, error)))
    files.push_back({here.string()});
  return files;
}

}  // namespace

ParsedRendribCommandLine parseRendribCommandLine(int argc, char** argv) {
  Parser p;
  const std::vector<std::string_view> words(argv + std::min(1, argc), argv + argc);
  for (size_t i = 0; i < words.size();) {
    const std::string_view word = words[i++];
    if (word.size() < 2 || word[0] != '-') {
      p.c.inputs.push_back({std::string(word)});
      continue;
    }
    const Option* option = find(word.substr(word[1] == '-' ? 2 : 1));
    if (!option) {
      p.fail(fmt::format("unknown option {}", word));
      return {std::nullopt, 2};
    }
    p.name = word;
    size_t count = 0;
    while (count < size_t(option->least) && i + count < words.size()) ++count;
    if (count < size_t(option->least)) {
      p.fail(fmt::format("{} wants {}", word, option->values));
      return {std::nullopt, 2};
    }
    while (count < size_t(option->most) && i + count < words.size() && isWholeNumber(words[i + count]))
      ++count;
    if (!option->take(p, Values(words).subspan(i, count))) return {std::nullopt, 2};
    if (p.exitCode) return {std::nullopt, *p.exitCode};
    i += count;
  }
  if (p.c.inputs.empty()) {
    if (isatty(STDIN_FILENO)) {
      p.fail("no scene given");
      return {std::nullopt, 2};
    }
    p.c.inputs.push_back({"-"});
  }
  if (!p.displayFile.empty()) p.c.load.overrides.displays.push_back({p.displayFile, "file", "rgba"});
  if (p.readRc) {
    const std::vector<cache::RibInput> rc = rcFiles();
    p.c.inputs.insert(p.c.inputs.begin(), rc.begin(), rc.end());
  }
  return {std::move(p.c), 0};
}

}  // namespace fr::tools
