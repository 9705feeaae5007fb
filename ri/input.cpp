#include "ri/input.h"

#include <fcntl.h>
#include <unistd.h>
#include <zlib.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <optional>
#include <utility>

namespace fr::ri {
namespace {

class DescriptorInput : public Input {
 public:
  DescriptorInput(int fd, bool owned, std::string name) : fd_(fd), owned_(owned), name_(std::move(name)) {}
  ~DescriptorInput() override {
    if (owned_) ::close(fd_);
  }
  Result<size_t> read(std::span<char> to) override {
    for (;;) {
      const ssize_t n = ::read(fd_, to.data(), to.size());
      if (n >= 0) return size_t(n);
      if (errno != EINTR)
        return makeError(RiError::kSystem, "cannot read {}: {}", name_, std::strerror(errno));
    }
  }

 private:
  int fd_;
  bool owned_;
  std::string name_;
};

class MemoryInput : public Input {
 public:
  explicit MemoryInput(std::string_view bytes) : left_(bytes) {}
  Result<size_t> read(std::span<char> to) override {
    const size_t n = std::min(to.size(), left_.size());
    std::memcpy(to.data(), left_.data(), n);
    left_.remove_prefix(n);
    return n;
  }

 private:
  std::string_view left_;
};

// Looks at the first two bytes and passes plain data through; gzip data are inflated, member after member.
class MaybeGzipInput : public Input {
 public:
  explicit MaybeGzipInput(std::unique_ptr<Input> raw) : raw_(std::move(raw)) {}
  ~MaybeGzipInput() override {
    if (mode_ == Mode::kGzip) inflateEnd(&z_);
  }
  Result<size_t> read(std::span<char> to) override {
    if (mode_ == Mode::kUnknown) {
      if (Result<void> r = detect(); !r) return r.error();
    }
    if (mode_ == Mode::kPlain) {
      if (have_ == 0) return raw_->read(to);
      const size_t n = std::min(to.size(), have_);
      std::memcpy(to.data(), in_.data() + at_, n);
      at_ += n, have_ -= n;
      return n;
    }
    return inflateSome(to);
  }

 private:
  enum class Mode { kUnknown, kPlain, kGzip };

  Result<void> detect() {
    while (have_ < 2) {
      Result<size_t> n = raw_->read({in_.data() + have_, in_.size() - have_});
      if (!n) return n.error();
      if (*n == 0) break;
      have_ += *n;
    }
    const bool gzip = have_ >= 2 && in_[0] == '\x1f' && in_[1] == '\x8b';
    if (gzip && inflateInit2(&z_, 16 + MAX_WBITS) != Z_OK) {
      return makeError(RiError::kNoMem, "cannot start zlib");
    }
    mode_ = gzip ? Mode::kGzip : Mode::kPlain;
    return {};
  }

  Result<size_t> inflateSome(std::span<char> to) {
    if (finished_) {
      if (pending_) return *std::exchange(pending_, std::nullopt);
      return size_t(0);
    }
    z_.next_out = reinterpret_cast<Bytef*>(to.data());
    z_.avail_out = uInt(std::min<size_t>(to.size(), 1u << 30));
    const uInt room = z_.avail_out;
    while (z_.avail_out == room) {
      if (have_ == 0) {
        Result<size_t> n = raw_->read(in_);
        if (!n) return n.error();
        at_ = 0;
        have_ = *n;
        if (have_ == 0) {
          finished_ = true;
          if (betweenMembers_) return size_t(0);
          return makeError(RiError::kBadFile, "the gzip data end too early");
        }
      }
      if (betweenMembers_) {
        if (in_[at_] != '\x1f') {  // padding or rubbish after the last member, ignored as gzip itself does
          finished_ = true;
          return size_t(0);
        }
        inflateReset(&z_);
        betweenMembers_ = false;
      }
      z_.next_in = reinterpret_cast<Bytef*>(in_.data() + at_);
      z_.avail_in = uInt(have_);
      const int rc = inflate(&z_, Z_NO_FLUSH);
      at_ += have_ - z_.avail_in;
      have_ = z_.avail_in;
      if (rc == Z_STREAM_END) {
        betweenMembers_ = true;
      } else if (rc != Z_OK && rc != Z_BUF_ERROR) {
        finished_ = true;
        pending_ = makeError(RiError::kBadFile, "broken gzip data: {}", z_.msg ? z_.msg : "zlib error");
        if (z_.avail_out == room) return *std::exchange(pending_, std::nullopt);
        break;  // what was inflated before comes first, the error with the next call
      }
    }
    return size_t(room - z_.avail_out);
  }

  std::unique_ptr<Input> raw_;
  Mode mode_ = Mode::kUnknown;
  z_stream z_{};
  bool betweenMembers_ = false, finished_ = false;
  std::optional<Error> pending_;
  size_t at_ = 0, have_ = 0;
  std::array<char, 64 * 1024> in_;
};

std::unique_ptr<Input> maybeGzip(std::unique_ptr<Input> raw) {
  return std::make_unique<MaybeGzipInput>(std::move(raw));
}

}  // namespace

Result<std::unique_ptr<Input>> openFile(const std::string& path) {
  const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) {
    const RiError code = errno == ENOENT || errno == ENOTDIR ? RiError::kNoFile : RiError::kSystem;
    return makeError(code, "cannot open {}: {}", path, std::strerror(errno));
  }
  return maybeGzip(std::make_unique<DescriptorInput>(fd, true, path));
}

Result<std::unique_ptr<Input>> openStdin() {
  return maybeGzip(std::make_unique<DescriptorInput>(STDIN_FILENO, false, "standard input"));
}

Result<std::unique_ptr<Input>> openDescriptor(int fd) {
  // No look-ahead for gzip: a program that waits for our next question may send one byte at a time.
  return std::unique_ptr<Input>(std::make_unique<DescriptorInput>(fd, false, "pipe"));
}

Result<std::unique_ptr<Input>> openMemory(std::string_view bytes) {
  return maybeGzip(std::make_unique<MemoryInput>(bytes));
}

}  // namespace fr::ri
