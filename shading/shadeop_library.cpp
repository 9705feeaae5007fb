#include "shading/shadeop_library.h"

#include <dlfcn.h>
#include <elf.h>
#include <fcntl.h>
#include <link.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cstring>
#include <filesystem>
#include <map>
#include <memory>
#include <mutex>

#include "shading/builder.h"

namespace fr {
namespace {

namespace fs = std::filesystem;

constexpr size_t kMostEntries = 4096;
constexpr size_t kMostArguments = 256;

/// Words and punctuation of an opspec.
class SpecReader {
 public:
  explicit SpecReader(std::string_view text) : text_(text) {}
  std::string_view next() {
    while (at_ < text_.size() && std::isspace(static_cast<unsigned char>(text_[at_]))) ++at_;
    const size_t begin = at_;
    const auto word = [&](size_t i) {
      return i < text_.size() && (std::isalnum(static_cast<unsigned char>(text_[i])) || text_[i] == '_');
    };
    while (word(at_)) ++at_;
    if (at_ == begin && at_ < text_.size()) ++at_;
    return text_.substr(begin, at_ - begin);
  }
  std::string_view peek() {
    const size_t here = at_;
    const std::string_view r = next();
    at_ = here;
    return r;
  }

 private:
  std::string_view text_;
  size_t at_ = 0;
};

bool typeNamed(std::string_view word, SlType& type) {
  for (unsigned t = 0; t <= unsigned(SlType::kVoid); ++t)
    if (word == slTypeName(SlType(t))) {
      type = SlType(t);
      return true;
    }
  return false;
}

struct Table {
  Result<void> state;
  std::vector<std::unique_ptr<Shadeop>> entries;
  std::vector<const Shadeop*> pointers;
};

struct Library {
  void* handle = nullptr;
  std::string error;
  std::map<std::string, Table, std::less<>> tables;  // by name of the function
};

/// What init functions made in one thread.
struct ThreadData {
  struct Slot {
    bool made = false;
    void* data = nullptr;
    ShadeopShutdown shutdown = nullptr;
  };
  std::vector<Slot> slots;  // by Shadeop::index
  int context = 0;
};

struct Registry {
  std::mutex mutex;
  std::map<std::string, Library> libraries;
  uint32_t count = 0;
  std::vector<std::unique_ptr<ThreadData>> threads;
  int users = 0;
};

Registry& registry() {
  static Registry* const r = new Registry;  // threads may end after the statics
  return *r;
}

thread_local ThreadData* threadData = nullptr;

/// True when the file holds the text, with the zero behind it.
bool fileHolds(const std::string& path, const std::string& text) {
  const int file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0) return false;
  struct stat st;
  bool found = false;
  if (::fstat(file, &st) == 0 && S_ISREG(st.st_mode) && st.st_size > 64) {
    const size_t size = size_t(st.st_size);
    void* const bytes = ::mmap(nullptr, size, PROT_READ, MAP_PRIVATE, file, 0);
    if (bytes != MAP_FAILED) {
      found = std::memcmp(bytes, ELFMAG, SELFMAG) == 0 &&
              ::memmem(bytes, size, text.c_str(), text.size() + 1) != nullptr;
      ::munmap(bytes, size);
    }
  }
  ::close(file);
  return found;
}

/// How many entries a table can have: the symbol's size.
size_t capacityOf(const void* table) {
  Dl_info info;
  ElfW(Sym)* symbol = nullptr;
  if (!::dladdr1(table, &info, reinterpret_cast<void**>(&symbol), RTLD_DL_SYMENT) || !symbol ||
      symbol->st_size == 0)
    return kMostEntries;
  return std::min(kMostEntries, size_t(symbol->st_size) / sizeof(SHADEOP_SPEC));
}

/// REQUIRES the registry's mutex.
Result<void> readEntry(Library& library, const std::string& path, const std::string& name,
                       const SHADEOP_SPEC& e, bool batch, Table& table) {
  const auto wrong = [&](const std::string& why) {
    return makeError(RiError::kBadFile, "shadeop library '{}', {}(), \"{}\": {}", path, name, e.opspec, why);
  };
  auto op = std::make_unique<Shadeop>();
  op->path = path, op->name = name, op->text = e.opspec;
  Result<ShadeopSpec> spec = parseShadeopSpec(e.opspec);
  if (!spec) return wrong(spec.error().message);
  op->spec = std::move(*spec);
  const auto symbol = [&](const char* function, const char* what, void*& out) -> Result<void> {
    out = nullptr;
    if (!function || !*function) return {};
    out = ::dlsym(library.handle, function);
    if (!out) return wrong(fmt::format("the library has no {} '{}'", what, function));
    return {};
  };
  void *function = nullptr, *init = nullptr, *shutdown = nullptr;
  if (auto r = symbol(op->spec.function.c_str(), "function", function); !r) return r;
  if (auto r = symbol(e.init, "init function", init); !r) return r;
  if (auto r = symbol(e.shutdown, "shutdown function", shutdown); !r) return r;
  if (batch)
    op->batch = reinterpret_cast<ShadeopBatchFunction>(function);
  else
    op->point = reinterpret_cast<ShadeopPointFunction>(function);
  op->init = reinterpret_cast<ShadeopInit>(init);
  op->shutdown = reinterpret_cast<ShadeopShutdown>(shutdown);
  op->index = registry().count++;
  table.pointers.push_back(op.get());
  table.entries.push_back(std::move(op));
  return {};
}

/// REQUIRES the registry's mutex. nullptr: the library has no such table.
Table* tableOf(const std::string& path, const std::string& name) {
  Library& library = registry().libraries[path];
  if (auto it = library.tables.find(name); it != library.tables.end()) return &it->second;
  if (!library.handle) {
    library.handle = ::dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE);
    if (!library.handle) {
      const char* const why = ::dlerror();
      library.error = why ? why : "unknown error";
      Table& t = library.tables[name];
      t.state =
          makeError(RiError::kBadFile, "shadeop library '{}' cannot be opened: {}", path, library.error);
      return &t;
    }
  }
  bool batch = true;
  const void* symbol = ::dlsym(library.handle, (name + "_fr_shadeops").c_str());
  if (!symbol) {
    batch = false;
    symbol = ::dlsym(library.handle, (name + "_shadeops").c_str());
  }
  if (!symbol) return nullptr;
  Table& t = library.tables[name];
  const auto* const entries = static_cast<const SHADEOP_SPEC*>(symbol);
  const size_t capacity = capacityOf(symbol);
  size_t i = 0;
  for (; t.state.ok() && i < capacity && entries[i].opspec && *entries[i].opspec; ++i)
    t.state = readEntry(library, path, name, entries[i], batch, t);
  if (t.state.ok() && i == capacity)
    t.state = makeError(RiError::kBadFile,
                        "shadeop library '{}': the table of {}() does not end with {{\"\"}}", path, name);
  return &t;
}

std::vector<std::string> librariesIn(const std::string& folder) {
  std::vector<std::string> r;
  std::error_code ec;
  for (fs::directory_iterator it(folder.empty() ? "." : folder, ec), end; !ec && it != end; it.increment(ec))
    if (it->path().extension() == ".so" && it->is_regular_file(ec)) r.push_back(it->path().string());
  std::sort(r.begin(), r.end());
  return r;
}

std::string canonical(const std::string& path) {
  std::error_code ec;
  const fs::path p = fs::canonical(path, ec);
  return ec ? path : p.string();
}

}  // namespace

Result<ShadeopSpec> parseShadeopSpec(std::string_view text) {
  SpecReader in(text);
  ShadeopSpec s;
  const auto bad = [](std::string what) { return makeError(RiError::kSyntax, "{}", what); };
  const auto type = [&](SlType& t) -> Result<void> {
    const std::string word(in.next());
    if (!typeNamed(word, t)) return bad(fmt::format("'{}' is not a type", word));
    return {};
  };
  if (auto r = type(s.result); !r) return std::move(r).error();
  s.function = in.next();
  if (s.function.empty() ||
      !(std::isalpha(static_cast<unsigned char>(s.function[0])) || s.function[0] == '_'))
    return bad(fmt::format("'{}' is not the name of a function", s.function));
  if (in.next() != "(") return bad("'(' is missing");
  if (in.peek() == ")") {
    in.next();
  } else if (in.peek() == "void") {
    in.next();
    if (in.next() != ")") return bad("')' is missing after void");
  } else {
    for (;;) {
      ShadeopArgument a;
      if (in.peek() == "output") in.next(), a.output = s.marksOutputs = true;
      if (auto r = type(a.type); !r) return std::move(r).error();
      if (a.type == SlType::kVoid) return bad("an argument cannot be void");
      if (in.peek() == "[") {
        in.next();
        a.isArray = true;
        if (in.peek() != "]") {
          const std::string number(in.next());
          const bool digits =
              !number.empty() && number.size() < 7 &&
              std::all_of(number.begin(), number.end(), [](char c) { return c >= '0' && c <= '9'; });
          a.arrayLength = digits ? uint32_t(std::stoul(number)) : 0;
          if (a.arrayLength == 0 || a.arrayLength > kMaxArrayLength)
            return bad(fmt::format("'{}' is not the length of an array", number));
        }
        if (in.next() != "]") return bad("']' is missing");
        if (a.type == SlType::kString) return bad("arrays of strings cannot be passed");
      }
      s.arguments.push_back(a);
      if (s.arguments.size() > kMostArguments)
        return bad(fmt::format("there are more than {} arguments", kMostArguments));
      const std::string_view end = in.next();
      if (end == ")") break;
      if (end != ",") return bad("')' is missing");
    }
  }
  if (!in.next().empty()) return bad("something follows the ')'");
  return s;
}

Result<std::span<const Shadeop* const>> findShadeops(const std::string& name,
                                                     const std::vector<std::string>& folders) {
  const std::string symbols[] = {name + "_fr_shadeops", name + "_shadeops"};
  Registry& r = registry();
  for (const std::string& folder : folders) {
    for (const std::string& file : librariesIn(folder)) {
      if (!fileHolds(file, symbols[0]) && !fileHolds(file, symbols[1])) continue;
      const std::lock_guard lock(r.mutex);
      const Table* const t = tableOf(canonical(file), name);
      if (!t) continue;
      if (!t->state.ok()) return t->state.error();
      return std::span<const Shadeop* const>(t->pointers);
    }
  }
  return std::span<const Shadeop* const>();
}

Result<const Shadeop*> bindShadeop(const std::string& path, const std::string& name,
                                   std::string_view opspec) {
  Registry& r = registry();
  const std::lock_guard lock(r.mutex);
  const Table* const t = tableOf(path, name);
  if (!t) return makeError(RiError::kBadFile, "shadeop library '{}' has no table '{}_shadeops'", path, name);
  if (!t->state.ok()) return t->state.error();
  for (const Shadeop* op : t->pointers)
    if (op->text == opspec) return op;
  return makeError(RiError::kBadFile, "shadeop library '{}' has no \"{}\" in the table of {}()", path, opspec,
                   name);
}

Result<void> bindShadeops(ShaderProgram& p, const std::vector<std::string>& folders) {
  const size_t count = p.code.size();
  for (size_t i = 0; i < count; ++i) {
    if (p.code[i].op != Op::dso_call) continue;
    const auto o = p.operands(p.code[i]);
    std::string texts[3];
    for (uint32_t k = 0; k < 3; ++k) texts[k] = p.strings[p.symbol(o[k + 1]).data];
    const std::string own = texts[0], file = fs::path(own).filename().string();
    std::vector<std::string> candidates;
    std::error_code ec;
    for (const std::string& folder : folders)
      candidates.push_back((folder.empty() ? "." : folder) + "/" + file);
    candidates.push_back(own);
    std::string found;
    Result<void> failure;
    for (const std::string& c : candidates) {
      if (!fs::is_regular_file(c, ec)) continue;
      const std::string path = canonical(c);
      Result<const Shadeop*> op = bindShadeop(path, texts[1], texts[2]);
      if (op) {
        found = path;
        break;
      }
      if (failure.ok()) failure = std::move(op).error();
    }
    if (found.empty()) {
      if (!failure.ok()) return failure;
      return makeError(RiError::kNoFile,
                       "shader '{}' calls {}() of the shadeop library '{}', which is not there", p.name,
                       texts[1], file);
    }
    if (found == own) continue;
    // A constant of its own: other instructions may use the text for something else.
    Symbol s = p.symbol(o[1]);
    s.data = uint32_t(p.strings.size());
    p.strings.push_back(found);
    const uint32_t index = uint32_t(p.symbols.size());
    p.symbols.push_back(s);
    uint32_t& a = p.args[p.code[i].firstArg + 1];
    a = (a & ~kArgIndex) | index;
  }
  return {};
}

void* shadeopThreadData(const Shadeop& op) {
  if (!op.init && !op.shutdown) return nullptr;
  ThreadData* t = threadData;
  if (t && op.index < t->slots.size() && t->slots[op.index].made) return t->slots[op.index].data;
  Registry& r = registry();
  {
    const std::lock_guard lock(r.mutex);
    if (!t) {
      r.threads.push_back(std::make_unique<ThreadData>());
      t = threadData = r.threads.back().get();
      t->context = int(r.threads.size()) - 1;
    }
    if (t->slots.size() <= op.index) t->slots.resize(op.index + 1);
  }
  void* data = nullptr;
  if (op.init) {
    try {
      data = op.init(t->context, nullptr);
    } catch (...) {
      reportOnce("shadeop.init." + op.path + op.name,
                 makeError(RiError::kSystem, "shadeop {}() of '{}': its init function threw an exception",
                           op.name, op.path));
    }
  }
  const std::lock_guard lock(r.mutex);
  t->slots[op.index] = {true, data, op.shutdown};
  return data;
}

ShadeopUser::ShadeopUser() {
  Registry& r = registry();
  const std::lock_guard lock(r.mutex);
  ++r.users;
}

ShadeopUser::~ShadeopUser() {
  Registry& r = registry();
  std::vector<ThreadData::Slot> owed;
  {
    const std::lock_guard lock(r.mutex);
    if (--r.users > 0) return;
    for (const auto& t : r.threads)
      for (ThreadData::Slot& s : t->slots) {
        if (s.made) owed.push_back(s);
        s = {};
      }
  }
  for (const ThreadData::Slot& s : owed) {
    if (!s.shutdown) continue;
    try {
      s.shutdown(s.data);
    } catch (...) {  // nothing to be done about it now
    }
  }
}

}  // namespace fr
