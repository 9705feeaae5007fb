// The programs behind procedural primitives.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "base/error.h"
#include "ri/input.h"
#include "ri/lexer.h"

namespace fr::cache {

/// Programs that answer text with RIB (RISpec 3.2, section 5.6 "RunProgram"): a question goes to the standard
/// input, the answer is read from the standard output up to byte 0377, and the program waits for the next
/// question. One that ends instead is started again for the next question. Standard error is ours.
///
/// A program that fails ends: one that says nothing for too long is killed, and whatever was read of its
/// answer stands. After kMostFailures failures in a row it is not started again. The destructor ends them
/// all: their input is closed, and who does not leave then is killed. Not thread-safe.
class ProceduralPrograms {
 public:
  static constexpr int kMostFailures = 5;

  struct Question {
    std::vector<std::string> command;  ///< program (a path, or a name of PATH) and its arguments
    std::string text;                  ///< as it goes to the standard input
    /// A silence that is too long, before and within the answer; 0: none is.
    std::chrono::milliseconds patience{0};
  };

  ProceduralPrograms();
  ~ProceduralPrograms();
  ProceduralPrograms(const ProceduralPrograms&) = delete;
  ProceduralPrograms& operator=(const ProceduralPrograms&) = delete;

  /// Receives an answer, and what earlier answers of the same process have defined for binary RIB. Must read
  /// up to 0377 or the end.
  using Read =
      std::function<Result<void>(std::unique_ptr<ri::Input>, std::shared_ptr<ri::BinaryTables> tables)>;
  /// Calls `read` with the answer; returns its error if it has one (the program is ended then: nobody knows
  /// where its next answer would begin). kNoFile: there is no such program; kSystem: it failed, with how; a
  /// warning of kMissingData: it left without a word.
  Result<void> ask(const Question& question, const Read& read);

  /// Processes started so far.
  uint64_t started() const { return started_; }

 private:
  struct Running;
  class Answer;
  struct Program {
    std::unique_ptr<Running> running;
    int failuresInARow = 0;
  };
  Result<void> start(const Question& question, Program* program);

  std::map<std::vector<std::string>, Program> programs_;
  uint64_t started_ = 0;
};

/// "program 'an argument' more" as words, by the rules of quotation marks and backslashes of a shell, without
/// anything else that a shell does. Empty when there is none or a quotation mark does not end.
std::vector<std::string> commandWords(std::string_view line);

}  // namespace fr::cache
