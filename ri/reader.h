// Reads RIB and calls a Renderer: files, memory, standard input; archives, inline archives, conditional RIB.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "base/error.h"
#include "ri/input.h"
#include "ri/lexer.h"
#include "ri/renderer.h"

namespace fr::ri {

struct ReaderOptions {
  /// Folders searched for archives after those of Option "searchpath" "archive".
  std::vector<std::string> archivePath;
  /// False: ReadArchive and inline archives are passed to the renderer as requests (RIB to RIB).
  bool expandArchives = true;
  /// False: the branches of conditional RIB are all read.
  bool evaluateConditions = true;
  /// Pass "#" comments to archiveRecord too.
  bool keepComments = false;
  /// RIB to RIB: conditions, error handlers, requests and parameters that nobody knows are passed to the
  /// renderer instead of being obeyed or dropped.
  bool passThrough = false;
  /// Archives within archives; beyond it kLimit.
  int maxArchiveDepth = 64;

  /// Everything is passed on as it stands: for programs that turn RIB into RIB.
  static ReaderOptions rewriting() {
    ReaderOptions o;
    o.expandArchives = false, o.evaluateConditions = false, o.keepComments = true, o.passThrough = true;
    return o;
  }
};

/// A text recorded by ArchiveBegin ... ArchiveEnd.
struct InlineArchive {
  std::string text;
  std::string file;  // where it was recorded, for messages
  int firstLine = 1;
  std::shared_ptr<BinaryTables> tables;
};

/// Feeds one renderer. Keep the reader for the whole session: procedurals read further archives through
/// it later, with the inline archives and options of the first file. Not thread-safe.
///
/// Every problem inside a file is report()ed with its place and reading goes on: a bad request is skipped up
/// to the next request name. The functions fail only when the file cannot be opened (kNoFile, kSystem), when
/// archives are nested too deep or in a loop, or when the error handler "abort" was triggered.
class Reader {
 public:
  explicit Reader(Renderer& renderer, ReaderOptions options = {});
  ~Reader();

  Result<void> readFile(const std::string& path);
  Result<void> readStdin();
  /// `name` stands for the file in messages.
  Result<void> readBuffer(std::string_view text, std::string name = "<memory>");
  /// Until the end or byte 0377: output of a RunProgram procedural.
  Result<void> readDescriptor(int fd, std::string name);
  /// As the request ReadArchive: an inline archive of that name, or a file found along the search path.
  Result<void> readArchive(const std::string& name);

  /// Any other source, until its end or byte 0377; `name` stands for it in messages. `tables`: what earlier
  /// pieces of the same binary stream have defined.
  Result<void> readInput(std::unique_ptr<Input> input, std::string name,
                         std::shared_ptr<BinaryTables> tables = nullptr);

  /// What is being read at the moment, outermost first: where archives are looked for, and which would be
  /// loops.
  using Place = std::shared_ptr<const std::vector<std::string>>;
  Place place();
  /// Calls f() as it would have been called there.
  Result<void> at(const Place& place, const std::function<Result<void>()>& f);

  /// As ArchiveBegin ... ArchiveEnd with this text between them.
  void defineArchive(const std::string& name, std::string text);

  const ReaderOptions& options() const { return options_; }
  /// Option "ribparse" "varsubst": the characters that begin a variable in strings; "" for none.
  void setSubstitution(std::string marks) { substitution_ = std::move(marks); }

 private:
  friend class RequestParser;
  Result<void> run(Lexer& lexer);
  Result<void> nested(std::string canonical, Lexer& lexer);

  Renderer& renderer_;
  ReaderOptions options_;
  std::map<std::string, std::shared_ptr<InlineArchive>, std::less<>> inlineArchives_;
  std::vector<std::string> open_;  // canonical names of what is being read, outermost first
  Place place_;                    // a copy of open_, or null
  uint64_t inputs_ = 0;
  std::set<std::string, std::less<>> warned_;
  int complaints_ = 0;
  std::string substitution_;
};

}  // namespace fr::ri
