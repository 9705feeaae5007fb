// One request at a time: arguments by its signature, then the call. Internal to the reader.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "ri/lexer.h"
#include "ri/reader.h"
#include "ri/renderer.h"

namespace fr::ri {

/// Reads requests from one lexer. The current token when a function begins is the first argument; afterwards
/// it is what follows. The first failure of a request reports it and makes every later read of the request a
/// no-op, so that handlers read straight through and look at ok() once.
class RequestParser : public Locator {
 public:
  RequestParser(Reader& reader, Lexer& lexer);
  ~RequestParser() override;
  RequestParser(const RequestParser&) = delete;
  RequestParser& operator=(const RequestParser&) = delete;

  SourceLocation location() const override { return {lexer_.fileName(), line_, column_}; }

  /// Reads to the end of the input. Fails as Reader's functions do.
  Result<void> run();

  // For the request handlers.
  Renderer& renderer() { return renderer_; }
  Reader& reader() { return reader_; }
  Lexer& lexer() { return lexer_; }
  bool ok() const { return !failed_; }
  void fail(RiError code, std::string message);
  void warn(RiError code, std::string message);
  void warnOnce(RiError code, std::string message);
  bool atString() const { return lexer_.kind() == TokenKind::kString; }
  bool atNumber() const;
  bool atArray() const;

  std::string string();
  double number();
  int integer();
  bool boolean() { return integer() != 0; }
  Handle handle();
  /// Exactly out.size() numbers, with or without brackets.
  void numbers(std::span<double> out);
  DMat4 matrix();
  std::vector<float> floats();
  std::vector<int> ints();
  std::vector<std::string> strings();
  /// The rest of the request. `context` as in Dictionary::find. For primitives the counts are checked later
  /// by checkPrimitive; elsewhere every parameter is one value. A name that nobody declared takes its type
  /// from its value where the reader of the parameter may know better: shader parameters and "user" values
  /// become floats or strings, as many as there are.
  /// `first`: a name that has been read already.
  ParamList params(std::string_view context = {}, bool primitive = false, std::string first = {});

  /// Result of a handler that must stop the whole reading (archive depth, abort).
  void stop(Error e);

  /// With the current token after the name of ArchiveBegin: records up to ArchiveEnd.
  void recordArchive(const std::string& name);

  /// Passes the rest of the current request to the renderer as text (ReaderOptions::passThrough).
  void passVerbatim();

  // Conditional RIB.
  void ifBegin(const std::string& condition);
  void elseIf(const std::string& condition);
  void elseBranch();
  void ifEnd();

 private:
  struct Branch {
    bool taken = false;     // a branch of this If was read
    bool active = false;    // the current branch is being read
    bool enclosing = true;  // what surrounds the If is being read
  };

  void next();
  void request();
  void skipToRequest();
  void flushComments();
  bool skipping() const { return !branches_.empty() && !branches_.back().active; }
  bool condition(const std::string& text);
  bool value(Param& p);
  bool undeclaredValue(Param& p);
  void keepComment();
  void stringRead();
  void substitute();
  void skipValue();
  void skipRestOfValue();
  void complain(Severity severity, RiError code, std::string message);
  std::string describeToken() const;
  template <class T>
  std::vector<T> numberArray(const char* what);

  Reader& reader_;
  Renderer& renderer_;
  Lexer& lexer_;
  const Locator* outer_;
  std::string name_;
  int line_ = 0, column_ = 0;
  bool failed_ = false;
  bool inBracket_ = false;  // the value being read began with "["
  bool stopped_ = false;
  std::optional<Error> stopError_;
  std::vector<std::pair<RecordKind, std::string>> comments_;
  std::vector<Branch> branches_;
  std::vector<double> numbers_;  // of a fixed number in brackets
};

using RequestHandler = void (*)(RequestParser&);
/// nullptr for a name that is no request.
RequestHandler findRequest(std::string_view name);
/// The request that has this name but for upper and lower case; empty if there is none.
std::string_view requestInOtherCase(std::string_view name);
/// All names that findRequest knows, sorted.
std::vector<std::string_view> requestNames();

}  // namespace fr::ri
