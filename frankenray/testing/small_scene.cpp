#include "frankenray/testing/small_scene.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <sstream>

namespace fr::test {

namespace {
constexpr const char* kScene = R"(Display "none.exr" "file" "rgba"
Format 16 16 1
Projection "perspective" "fov" [40]
Translate 0 0 100
WorldBegin
AttributeBegin
  Surface "constant"
  Color [1 0.5 0.25]
  Polygon "P" [-1 -1 2  -1 1 2  1 1 2  1 -1 2]
AttributeEnd
AttributeBegin
  Surface "constant"
  Opacity [0.25 0.5 0.75]
  Polygon "P" [4 -1 1  4 1 1  6 1 1  6 -1 1]
AttributeEnd
WorldEnd
)";
}  // namespace

SmallScene::SmallScene() {
  std::string pattern = (std::filesystem::temp_directory_path() / "frankenray-test-XXXXXX").string();
  if (mkdtemp(pattern.data()) == nullptr) ADD_FAILURE() << "cannot make a temporary folder";
  folder_ = pattern;
  std::ofstream(folder_ / "scene.rib") << kScene;
}

SmallScene::~SmallScene() {
  std::error_code ignored;
  std::filesystem::remove_all(folder_, ignored);
}

std::string rendrib() { return std::string(FR_BINARY_DIR) + "/bin/rendrib"; }

std::string SmallScene::command() const { return rendrib() + " -rayserver " + rib(); }

std::vector<std::string> Outcome::lines() const {
  std::vector<std::string> all;
  std::istringstream in(out);
  for (std::string line; std::getline(in, line);) all.push_back(line);
  return all;
}

Outcome runProgram(const std::vector<std::string>& words, const std::string& input,
                   const std::map<std::string, std::string>& environment,
                   const std::filesystem::path& folder) {
  Outcome result;
  int in[2], out[2], err[2];
  if (pipe2(in, O_CLOEXEC) != 0 || pipe2(out, O_CLOEXEC) != 0 || pipe2(err, O_CLOEXEC) != 0) return result;
  std::vector<char*> argv;
  for (const std::string& w : words) argv.push_back(const_cast<char*>(w.c_str()));
  argv.push_back(nullptr);
  const pid_t pid = fork();
  if (pid == 0) {
    dup2(in[0], 0);
    dup2(out[1], 1);
    dup2(err[1], 2);
    for (const char* name : {"RAYSERVER", "RAYSERVER_JITTER_TIMES", "RAYSERVER_BIAS", "RAYSERVER_TRANSPORT",
                             "FRANKENRAY_RENDRIB"})
      unsetenv(name);
    for (const auto& [name, value] : environment) setenv(name.c_str(), value.c_str(), 1);
    if (chdir(folder.c_str()) != 0) _exit(126);
    execvp(argv[0], argv.data());
    _exit(127);
  }
  close(in[0]);
  close(out[1]);
  close(err[1]);
  // Our inputs are shorter than a pipe.
  if (write(in[1], input.data(), input.size()) != ssize_t(input.size())) ADD_FAILURE() << "input is too long";
  close(in[1]);
  pollfd fds[2] = {{out[0], POLLIN, 0}, {err[0], POLLIN, 0}};
  std::string* text[2] = {&result.out, &result.err};
  for (int open = 2; open > 0;) {
    if (poll(fds, 2, -1) < 0) break;
    for (int i = 0; i < 2; ++i) {
      if (fds[i].fd < 0 || fds[i].revents == 0) continue;
      char buffer[4096];
      const ssize_t n = read(fds[i].fd, buffer, sizeof buffer);
      if (n > 0) {
        text[i]->append(buffer, size_t(n));
      } else {
        close(fds[i].fd);
        fds[i].fd = -1;
        --open;
      }
    }
  }
  int status = 0;
  waitpid(pid, &status, 0);
  if (WIFEXITED(status)) result.exitCode = WEXITSTATUS(status);
  return result;
}

std::vector<double> numbers(const std::string& line) {
  std::vector<double> all;
  std::istringstream in(line);
  for (std::string word; in >> word;)
    if (word != "|") all.push_back(std::strtod(word.c_str(), nullptr));
  return all;
}

}  // namespace fr::test
