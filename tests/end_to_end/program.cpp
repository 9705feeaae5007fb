#include "tests/end_to_end/program.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <sstream>

namespace fr::test {

Outcome run(const std::string& name, const std::vector<std::string>& arguments,
            const std::filesystem::path& directory, const std::function<void(int)>& whileRunning,
            const std::map<std::string, std::string>& environment, const std::filesystem::path& standardInput,
            const std::function<void()>& inChild) {
  int out[2], err[2];
  Outcome result;
  if (pipe2(out, O_CLOEXEC) != 0) return result;
  if (pipe2(err, O_CLOEXEC) != 0) return result;
  const std::string program = name.starts_with('/') ? name : std::string(FR_BINARY_DIR) + "/bin/" + name;
  std::vector<char*> argv{const_cast<char*>(program.c_str())};
  for (const std::string& a : arguments) argv.push_back(const_cast<char*>(a.c_str()));
  argv.push_back(nullptr);
  const pid_t pid = fork();
  if (pid == 0) {
    dup2(out[1], 1);
    dup2(err[1], 2);
    if (!standardInput.empty()) dup2(open(standardInput.c_str(), O_RDONLY | O_CLOEXEC), 0);
    for (const auto& [k, v] : environment) setenv(k.c_str(), v.c_str(), 1);
    if (chdir(directory.c_str()) != 0) _exit(126);
    if (inChild) inChild();
    execv(program.c_str(), argv.data());
    _exit(127);
  }
  close(out[1]);
  close(err[1]);
  if (whileRunning) whileRunning(pid);
  pollfd fds[2] = {{out[0], POLLIN, 0}, {err[0], POLLIN, 0}};
  std::string* text[2] = {&result.out, &result.err};
  for (int left = 2; left > 0;) {
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
        --left;
      }
    }
  }
  int status = 0;
  waitpid(pid, &status, 0);
  if (WIFEXITED(status)) result.exitCode = WEXITSTATUS(status);
  if (WIFSIGNALED(status)) result.signal = WTERMSIG(status);
  return result;
}

Workspace::Workspace() {
  std::string pattern = (std::filesystem::temp_directory_path() / "frankenrender-test-XXXXXX").string();
  if (mkdtemp(pattern.data()) == nullptr) ADD_FAILURE() << "cannot make a temporary folder";
  path_ = pattern;
}
Workspace::~Workspace() {
  std::error_code ignored;
  std::filesystem::remove_all(path_, ignored);
}
std::filesystem::path Workspace::write(const std::string& file, const std::string& text) const {
  std::ofstream(path_ / file, std::ios::binary) << text;
  return path_ / file;
}

Picture readExr(const std::filesystem::path& file) {
  Picture p;
  try {
    Imf::InputFile in(file.c_str());
    const Imath::Box2i box = in.header().dataWindow();
    p.width = box.max.x - box.min.x + 1;
    p.height = box.max.y - box.min.y + 1;
    Imf::FrameBuffer frame;
    for (auto c = in.header().channels().begin(); c != in.header().channels().end(); ++c) {
      std::vector<float>& v = p.channels[c.name()];
      v.resize(size_t(p.width) * size_t(p.height));
      char* base = reinterpret_cast<char*>(v.data()) -
                   (ptrdiff_t(box.min.y) * p.width + box.min.x) * ptrdiff_t(sizeof(float));
      frame.insert(c.name(), Imf::Slice(Imf::FLOAT, base, sizeof(float), sizeof(float) * size_t(p.width)));
    }
    in.setFrameBuffer(frame);
    in.readPixels(box.min.y, box.max.y);
  } catch (const std::exception& e) {
    ADD_FAILURE() << file << ": " << e.what();
    return {};
  }
  return p;
}

namespace {
template <class F>
bool forEachPair(const Picture& a, const Picture& b, F f) {
  if (a.width != b.width || a.height != b.height || a.channels.size() != b.channels.size()) return false;
  for (const auto& [name, va] : a.channels) {
    const auto it = b.channels.find(name);
    if (it == b.channels.end()) return false;
    for (size_t i = 0; i < va.size(); ++i) f(double(va[i]), double(it->second[i]));
  }
  return true;
}
}  // namespace

double rmse(const Picture& a, const Picture& b) {
  double sum = 0;
  size_t n = 0;
  if (!forEachPair(a, b, [&](double x, double y) { sum += (x - y) * (x - y), ++n; }) || n == 0)
    return std::numeric_limits<double>::infinity();
  return std::sqrt(sum / double(n));
}

double worst(const Picture& a, const Picture& b) {
  double w = 0;
  if (!forEachPair(a, b,
                   [&](double x, double y) { w = std::max(w, std::isnan(x - y) ? 1e30 : std::abs(x - y)); }))
    return std::numeric_limits<double>::infinity();
  return w;
}

std::vector<int> childrenOf(int pid) {
  std::vector<int> children;
  std::error_code ignored;
  const std::string tasks = "/proc/" + std::to_string(pid) + "/task";
  for (const auto& task : std::filesystem::directory_iterator(tasks, ignored)) {
    std::ifstream in(task.path() / "children");
    for (int child; in >> child;) children.push_back(child);
  }
  return children;
}

}  // namespace fr::test
