#include "scene_cache/procedural_programs.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <unistd.h>

#include <cstring>

#include "shm/no_sigpipe.h"
#include "shm/peer.h"

namespace fr::cache {

using std::chrono::milliseconds;
using Clock = std::chrono::steady_clock;

struct ProceduralPrograms::Running {
  shm::ChildProcess process;
  shm::FileDescriptor input, output;  // our ends
  std::shared_ptr<ri::BinaryTables> tables =
      std::make_shared<ri::BinaryTables>();  // one stream, many answers
};

/// The conversation of one question: writes what is left of it while it waits for the answer, since a program
/// may answer before it has read everything.
class ProceduralPrograms::Answer {
 public:
  Answer(Running& running, const Question& question)
      : running_(running), unsent_(question.text), patience_(question.patience) {}

  Result<size_t> read(std::span<char> to) {
    if (ended_ || silent_) return size_t(0);
    const Clock::time_point begin = Clock::now();
    for (;;) {
      pollfd p[2] = {{running_.output.get(), POLLIN, 0},
                     {unsent_.empty() ? -1 : running_.input.get(), POLLOUT, 0}};
      const int ready = ::poll(p, 2, 100);
      if (ready < 0 && errno != EINTR)
        return makeError(RiError::kSystem, "cannot wait for a program: {}", std::strerror(errno));
      if (ready > 0 && p[1].revents != 0) send();
      if (ready > 0 && p[0].revents != 0) {
        const ssize_t n = ::read(running_.output.get(), to.data(), to.size());
        if (n > 0) return anything_ = true, size_t(n);
        if (n < 0 && (errno == EINTR || errno == EAGAIN)) continue;
        ended_ = true;
        return size_t(0);
      }
      // Its own children may hold the pipe open. What it wrote last has come before it is seen dead.
      if (ready == 0 && !running_.process.alive() && ::poll(p, 1, 0) == 0) {
        ended_ = true;
        return size_t(0);
      }
      if (patience_.count() > 0 && Clock::now() - begin > patience_) {
        silent_ = true;
        return size_t(0);
      }
    }
  }

  bool ended() const { return ended_; }
  bool silent() const { return silent_; }
  bool anything() const { return anything_; }

 private:
  void send() {
    shm::NoSigpipe guard;
    const ssize_t n = ::write(running_.input.get(), unsent_.data(), unsent_.size());
    if (n > 0) unsent_.remove_prefix(size_t(n));
    if (n >= 0 || errno == EINTR || errno == EAGAIN) return;
    // Whoever closes its input may answer all the same.
    if (errno == EPIPE) guard.raised();
    unsent_ = {};
  }

  Running& running_;
  std::string_view unsent_;
  const milliseconds patience_;
  bool ended_ = false, silent_ = false, anything_ = false;
};

namespace {

/// What the reader owns: the conversation outlives it.
template <class Answer>
class AnswerInput final : public ri::Input {
 public:
  explicit AnswerInput(Answer& answer) : answer_(answer) {}
  Result<size_t> read(std::span<char> to) override { return answer_.read(to); }

 private:
  Answer& answer_;
};

Result<std::pair<shm::FileDescriptor, shm::FileDescriptor>> makePipe() {
  int fds[2];
  if (::pipe2(fds, O_CLOEXEC) != 0)
    return makeError(RiError::kSystem, "cannot make a pipe: {}", std::strerror(errno));
  return std::pair(shm::FileDescriptor(fds[0]), shm::FileDescriptor(fds[1]));
}

}  // namespace

ProceduralPrograms::ProceduralPrograms() = default;
ProceduralPrograms::~ProceduralPrograms() {
  // All are asked to leave before anyone is waited for.
  for (auto& [command, program] : programs_)
    if (program.running) program.running->input.reset(), program.running->output.reset();
}

Result<void> ProceduralPrograms::start(const Question& question, Program* program) {
  auto input = makePipe();
  if (!input) return std::move(input).error();
  auto output = makePipe();
  if (!output) return std::move(output).error();
  shm::SpawnOptions options;
  options.program = question.command[0];
  options.arguments.assign(question.command.begin() + 1, question.command.end());
  options.socketVariable.clear();
  options.standardInput = input->first.get();
  options.standardOutput = output->second.get();
  auto process = shm::ChildProcess::spawn(options);
  if (!process) return std::move(process).error();
  ::fcntl(input->second.get(), F_SETFL, O_NONBLOCK);
  program->running = std::make_unique<Running>(
      Running{std::move(process).value(), std::move(input->second), std::move(output->first)});
  ++started_;
  return {};
}

Result<void> ProceduralPrograms::ask(const Question& question, const Read& read) {
  FR_CHECK(!question.command.empty());
  Program& program = programs_[question.command];
  if (program.failuresInARow >= kMostFailures)
    return makeError(RiError::kSystem, "it failed {} times in a row and is not started again", kMostFailures);
  if (program.running && !program.running->process.alive()) program.running.reset();
  if (!program.running)
    if (Result<void> r = start(question, &program); !r) return ++program.failuresInARow, r;

  Answer answer(*program.running, question);
  const Result<void> result = read(std::make_unique<AnswerInput<Answer>>(answer), program.running->tables);
  if (result && !answer.ended() && !answer.silent()) {
    program.failuresInARow = 0;
    return {};
  }
  const std::unique_ptr<Running> last = std::move(program.running);
  last->input.reset();
  const bool left = answer.ended() && last->process.wait(shm::ChildProcess::kGrace);
  if (!left) last->process.signal(SIGKILL);
  if (!result) return result;
  if (left && last->process.exitStatus().value_or(0) == 0) {
    program.failuresInARow = 0;
    if (answer.anything()) return {};
    Error nothing = makeError(RiError::kMissingData, "the program ended without an answer");
    nothing.severity = Severity::kWarning;
    return nothing;
  }
  ++program.failuresInARow;
  if (left) return makeError(RiError::kSystem, "the program {}", last->process.statusText());
  if (answer.silent())
    return makeError(RiError::kSystem,
                     "the program said nothing for {} s and was killed (Option \"procedural\" \"patience\")",
                     double(question.patience.count()) / 1000);
  return makeError(RiError::kSystem, "the program closed its output, lived on and was killed");
}

std::vector<std::string> commandWords(std::string_view line) {
  std::vector<std::string> words;
  std::string word;
  bool inWord = false;
  char quote = 0;
  for (size_t i = 0; i < line.size(); ++i) {
    const char c = line[i];
    const bool more = i + 1 < line.size();
    if (quote ? c == quote : c == '"' || c == '\'') {
      quote = quote ? '\0' : c;
      inWord = true;
    } else if (c == '\\' && more &&
               (quote == 0 || (quote == '"' && (line[i + 1] == '"' || line[i + 1] == '\\')))) {
      word += line[++i];
      inWord = true;
    } else if (!quote && std::string_view(" \t\n\r").find(c) != std::string_view::npos) {
      if (inWord) words.push_back(std::move(word));
      word.clear();
      inWord = false;
    } else {
      word += c;
      inWord = true;
    }
  }
  if (quote) return {};
  if (inWord) words.push_back(std::move(word));
  return words;
}

}  // namespace fr::cache
