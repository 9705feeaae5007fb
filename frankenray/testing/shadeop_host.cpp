// A renderer with DSO shadeops, as far as a DSO can see it. Uses nothing of ours; knows the two ways in which
// renderers drive DSOs:
//
//   aqsis   argc counts the result; strings are STRING_DESC; init for every (shader, entry); functions return
//   int;
//           arguments are copied in and copied back; one thread
//   pixie   argc without the result; strings are char*; one init with (0, NULL); functions return nothing;
//           arguments point into live data; any number of threads without a lock
//
// Usage: shadeop_host aqsis|pixie dso [threads]     commands on standard input, one a line:
//   <rettype> <function> <type>=<value>[,<value>,<value>] ...   calls; prints the result, then every argument
//   repeat <n> <call>       from every thread n times; prints one line if all answers are equal, else
//   "different" time <n> <call>         one thread; prints nanoseconds per call kill                    kill
//   -9 to all child processes children                number of child processes fork                    a
//   child runs the rest of the commands as well, its lines begin with "child: " shutdown                all
//   shutdowns so far owed
// A call that the table does not have exactly prints "no such entry".
//
// The host exports functions of its own under names that a DSO may be so careless as to export or look for:
// being called in there ends it.
#include <dirent.h>
#include <dlfcn.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <map>
#include <set>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#define TRAP(name)                                                           \
  extern "C" __attribute__((visibility("default"), used)) void name() {      \
    std::fputs("host: the DSO was bound to the host's " #name "\n", stderr); \
    _exit(99);                                                               \
  }
TRAP(RiBegin)
TRAP(RiEnd)
TRAP(RiWorldBegin)
TRAP(RiTransformPoints)
TRAP(frankenray_create)
TRAP(frankenray_ask)
TRAP(frankenray_answer)
TRAP(frankenray_line_open)
TRAP(rayserver_init)
TRAP(rayserver_trace)

namespace {

struct Entry {
  const char *spec, *init, *shutdown;
};
struct StringDesc {
  char* s;
  int bufflen;
};

struct Argument {
  std::string type;
  float f[16] = {};
  std::string s;
};
struct Call {
  std::string returned, function;
  std::vector<Argument> arguments;
};

void* library;
bool pixie;
struct Owed {
  void (*shutdown)(void*);
  void* data;
};
std::vector<Owed> owed;
std::set<std::string> loaded;           // "shader" of each function: one, for simplicity
std::map<std::string, void*> initData;  // by spec
const char* prefix = "";

std::vector<std::string> split(const std::string& s, char at) {
  std::vector<std::string> out;
  std::stringstream in(s);
  for (std::string part; std::getline(in, part, at);) out.push_back(part);
  return out;
}

std::string tight(const std::string& s) {
  std::string out;
  for (char c : s)
    if (c != ' ') out += c;
  return out;
}

/// "color rayserver_trace(point, vector)" by exact types; null when there is none.
const Entry* find(const Call& call) {
  const auto* table = static_cast<const Entry*>(dlsym(library, (call.function + "_shadeops").c_str()));
  if (!table) return nullptr;
  std::string types;
  for (const Argument& a : call.arguments) types += (types.empty() ? "" : ",") + a.type;
  // The table ends with a spec that is empty, and every string is one.
  for (const Entry* e = table; *e->spec; ++e) {
    const std::string spec = e->spec;
    if (!e->init || !e->shutdown) std::_Exit(98);
    const size_t blank = spec.find(' '), open = spec.find('('), close = spec.find(')');
    if (blank == std::string::npos || open == std::string::npos || close != spec.size() - 1) std::_Exit(97);
    if (spec.substr(0, blank) == call.returned && tight(spec.substr(open + 1, close - open - 1)) == types)
      return e;
  }
  return nullptr;
}

std::string functionOf(const Entry& e) {
  const std::string spec = e.spec;
  const size_t blank = spec.find(' ');
  return tight(spec.substr(blank, spec.find('(') - blank));
}

void initialise(const Entry& e) {
  if (!*e.init) return;
  auto* init = reinterpret_cast<void* (*)(int, void*)>(dlsym(library, e.init));
  auto* shutdown = reinterpret_cast<void (*)(void*)>(dlsym(library, e.shutdown));
  if (!init || !shutdown) std::_Exit(96);
  int textures = 0;
  void* const data = pixie ? init(0, nullptr) : init(7, &textures);
  initData[e.spec] = data;
  owed.push_back({shutdown, data});
}

void load(const Call& call, const Entry& chosen) {
  if (!loaded.insert(call.function).second) return;
  if (pixie) return initialise(chosen);
  for (auto* e = static_cast<const Entry*>(dlsym(library, (call.function + "_shadeops").c_str())); *e->spec;
       ++e)
    initialise(*e);
}

int width(const std::string& type) { return type == "float" ? 1 : type == "matrix" ? 16 : 3; }

/// One call at one point; the answer as text.
std::string invoke(const Entry& e, void* function, Call call) {
  std::vector<void*> argv;
  Argument result;
  result.type = call.returned;
  for (float& f : result.f) f = -7;
  argv.push_back(result.f);
  std::vector<StringDesc> strings(call.arguments.size());
  std::vector<char*> pointers(call.arguments.size());
  std::vector<Argument> copies = call.arguments;
  for (size_t i = 0; i < copies.size(); ++i) {
    Argument& a = pixie ? call.arguments[i] : copies[i];
    if (a.type == "string") {
      pointers[i] = a.s.data();
      strings[i] = {a.s.data(), int(a.s.size() + 1)};
      argv.push_back(pixie ? static_cast<void*>(&pointers[i]) : &strings[i]);
    } else {
      argv.push_back(a.f);
    }
  }
  const int arguments = int(call.arguments.size());
  argv.push_back(nullptr);  // what a DSO that counts wrongly would find
  void* const data = initData[e.spec];
  if (pixie)
    reinterpret_cast<void (*)(void*, int, void**)>(function)(data, arguments, argv.data());
  else
    reinterpret_cast<int (*)(void*, int, void**)>(function)(data, arguments + 1, argv.data());
  if (!pixie) call.arguments = copies;
  std::ostringstream out;
  out.precision(9);
  const auto print = [&](const Argument& a) {
    if (a.type == "string") out << a.s;
    for (int k = 0; a.type != "string" && k < width(a.type); ++k) out << (k ? " " : "") << a.f[k];
  };
  print(result);
  for (const Argument& a : call.arguments) out << " | ", print(a);
  return out.str();
}

bool parse(std::istream& in, Call& call) {
  if (!(in >> call.returned >> call.function)) return false;
  for (std::string word; in >> word;) {
    const size_t equals = word.find('=');
    Argument a;
    a.type = word.substr(0, equals);
    const std::string value = equals == std::string::npos ? "" : word.substr(equals + 1);
    if (a.type == "string") {
      a.s = value;
    } else {
      size_t k = 0;
      for (const std::string& number : split(value, ','))
        if (k < 16) a.f[k++] = std::strtof(number.c_str(), nullptr);
    }
    call.arguments.push_back(a);
  }
  return true;
}

std::vector<int> children() {
  std::vector<int> out;
  DIR* const tasks = opendir("/proc/self/task");
  if (!tasks) return out;
  while (dirent* t = readdir(tasks)) {
    std::FILE* f = std::fopen((std::string("/proc/self/task/") + t->d_name + "/children").c_str(), "r");
    if (!f) continue;
    for (int pid; std::fscanf(f, "%d", &pid) == 1;) {
      // Those that have ended and wait to be reaped do not count.
      std::FILE* stat = std::fopen(("/proc/" + std::to_string(pid) + "/stat").c_str(), "r");
      char state = 'Z';
      if (stat) {
        if (std::fscanf(stat, "%*d (%*[^)]) %c", &state) != 1) state = 'Z';
        std::fclose(stat);
      }
      if (state != 'Z') out.push_back(pid);
    }
    std::fclose(f);
  }
  closedir(tasks);
  return out;
}

void say(const std::string& line) {
  std::printf("%s%s\n", prefix, line.c_str());
  std::fflush(stdout);
}

void runCall(const std::string& mode, int n, int threads, std::istream& in) {
  Call call;
  if (!parse(in, call)) return say("cannot read the command");
  const Entry* const e = find(call);
  if (!e) return say("no such entry");
  void* const function = dlsym(library, functionOf(*e).c_str());
  if (!function) return say("no such function");
  load(call, *e);
  if (mode == "time") {
    invoke(*e, function, call);
    using Clock = std::chrono::steady_clock;
    // The bare call, as an interpreter's inner loop makes it.
    std::vector<void*> argv;
    Argument result;
    argv.push_back(result.f);
    for (Argument& a : call.arguments) argv.push_back(a.f);
    const auto begin = Clock::now();
    for (int i = 0; i < n; ++i)
      reinterpret_cast<int (*)(void*, int, void**)>(function)(initData[e->spec], int(argv.size()),
                                                              argv.data());
    const double ns = double(std::chrono::nanoseconds(Clock::now() - begin).count()) / n;
    return say(std::to_string(ns));
  }
  if (mode == "repeat") {
    std::vector<std::set<std::string>> answers{size_t(threads)};
    initData[e->spec];  // no thread inserts
    std::vector<std::thread> workers;
    for (int t = 0; t < threads; ++t)
      workers.emplace_back([&, t] {
        for (int i = 0; i < n; ++i) answers[size_t(t)].insert(invoke(*e, function, call));
      });
    for (std::thread& w : workers) w.join();
    std::set<std::string> all;
    for (const auto& a : answers) all.insert(a.begin(), a.end());
    return say(all.size() == 1 ? *all.begin() : "different");
  }
  say(invoke(*e, function, call));
}

void shutDown() {
  for (const Owed& o : owed) o.shutdown(o.data);
  owed.clear();
  loaded.clear();
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3) return 2;
  pixie = std::strcmp(argv[1], "pixie") == 0;
  const int threads = argc > 3 ? std::atoi(argv[3]) : 1;
  library = dlopen(argv[2], RTLD_NOW | RTLD_LOCAL);
  if (!library) {
    std::fprintf(stderr, "host: %s\n", dlerror());
    return 3;
  }
  std::string everything((std::istreambuf_iterator<char>(std::cin)), {});
  std::istringstream lines(everything);
  int child = 0;
  for (std::string line; std::getline(lines, line);) {
    std::istringstream in(line);
    std::string word;
    const auto start = in.tellg();
    if (!(in >> word)) continue;
    if (word == "kill") {
      for (int pid : children()) ::kill(pid, SIGKILL);
    } else if (word == "children") {
      say(std::to_string(children().size()));
    } else if (word == "shutdown") {
      shutDown();
    } else if (word == "fork") {
      child = fork();
      if (child == 0) prefix = "child: ";
    } else if (word == "repeat" || word == "time") {
      int n = 1;
      in >> n;
      runCall(word, n, threads, in);
    } else {
      in.seekg(start);
      runCall("", 1, 1, in);
    }
  }
  if (child > 0) waitpid(child, nullptr, 0);
  shutDown();
  dlclose(library);
  return 0;
}
