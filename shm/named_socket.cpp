#include "shm/named_socket.h"

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstring>
#include <fstream>

namespace fr::shm {
namespace {

constexpr int kBacklog = 128;

std::string prefix() { return fmt::format("frankenrender-{}-", ::geteuid()); }

struct Address {
  sockaddr_un bytes{};
  socklen_t size = 0;
};

Address addressOf(std::string_view name) {
  // sun_path[0] = 0 says "abstract"; the rest is the name, its length counts, nothing ends it.
  const std::string text = prefix() + std::string(name);
  Address a;
  a.bytes.sun_family = AF_UNIX;
  std::memcpy(a.bytes.sun_path + 1, text.data(), text.size());
  a.size = socklen_t(offsetof(sockaddr_un, sun_path) + 1 + text.size());
  return a;
}

std::optional<ucred> credentials(int fd) {
  ucred c{};
  socklen_t size = sizeof c;
  if (::getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &c, &size) != 0 || size != sizeof c) return std::nullopt;
  return c;
}

Result<void> checkUser(int fd, std::string_view what) {
  const std::optional<ucred> c = credentials(fd);
  if (c && c->uid == ::geteuid()) return {};
  return makeError(RiError::kBadHandle, "{} belongs to another user ({}): refused", what,
                   c ? fmt::format("user {}, process {}", c->uid, c->pid) : std::string("unknown"));
}

Error badName(std::string_view name) {
  return makeError(RiError::kRange,
                   "'{}' is not a name for a ray server: 1 to 64 letters, digits, '.', '_' and '-'", name);
}

Result<FileDescriptor> makeSocket(int flags) {
  FileDescriptor fd(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | flags, 0));
  if (!fd) return makeError(RiError::kSystem, "cannot create a socket: {}", std::strerror(errno));
  return fd;
}

}  // namespace

bool isSocketName(std::string_view name) {
  const auto allowed = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '.' ||
           c == '_' || c == '-';
  };
  return !name.empty() && name.size() <= 64 && std::all_of(name.begin(), name.end(), allowed);
}

std::string socketAddressText(std::string_view name) { return "@" + prefix() + std::string(name); }

Result<NamedListener> NamedListener::listen(std::string_view name) {
  if (!isSocketName(name)) return badName(name);
  Result<FileDescriptor> fd = makeSocket(SOCK_NONBLOCK);
  if (!fd) return std::move(fd).error();
  const Address a = addressOf(name);
  if (::bind(fd->get(), reinterpret_cast<const sockaddr*>(&a.bytes), a.size) != 0) {
    if (errno == EADDRINUSE)
      return makeError(RiError::kIllState, "another ray server is called '{}' ({})", name,
                       socketAddressText(name));
    return makeError(RiError::kSystem, "cannot listen at {}: {}", socketAddressText(name),
                     std::strerror(errno));
  }
  if (::listen(fd->get(), kBacklog) != 0)
    return makeError(RiError::kSystem, "cannot listen at {}: {}", socketAddressText(name),
                     std::strerror(errno));
  NamedListener l;
  l.fd_ = std::move(fd).value();
  l.name_ = std::string(name);
  return l;
}

Result<std::optional<PeerSocket>> NamedListener::accept() {
  FileDescriptor fd;
  for (;;) {
    fd = FileDescriptor(::accept4(fd_.get(), nullptr, nullptr, SOCK_CLOEXEC));
    if (fd) break;
    if (errno == EINTR || errno == ECONNABORTED) continue;
    if (errno == EAGAIN || errno == EWOULDBLOCK) return std::optional<PeerSocket>();
    return makeError(RiError::kSystem, "cannot accept a client: {}", std::strerror(errno));
  }
  if (Result<void> r = checkUser(fd.get(), "a client"); !r) return std::move(r).error();
  return std::optional<PeerSocket>(PeerSocket(std::move(fd)));
}

Result<PeerSocket> connectNamed(std::string_view name) {
  if (!isSocketName(name)) return badName(name);
  Result<FileDescriptor> fd = makeSocket(0);
  if (!fd) return std::move(fd).error();
  const Address a = addressOf(name);
  for (;;) {
    if (::connect(fd->get(), reinterpret_cast<const sockaddr*>(&a.bytes), a.size) == 0) break;
    if (errno == EINTR) continue;
    if (errno == ECONNREFUSED)
      return makeError(RiError::kNoFile, "no ray server is called '{}' ({})", name, socketAddressText(name));
    return makeError(RiError::kSystem, "cannot connect to {}: {}", socketAddressText(name),
                     std::strerror(errno));
  }
  if (Result<void> r = checkUser(fd->get(), socketAddressText(name)); !r) return std::move(r).error();
  return PeerSocket(std::move(fd).value());
}

int peerProcessId(const PeerSocket& socket) {
  const std::optional<ucred> c = credentials(socket.descriptor());
  return c ? int(c->pid) : 0;
}

std::vector<std::string> listSocketNames() {
  std::vector<std::string> names;
  std::ifstream table("/proc/net/unix");
  const std::string start = "@" + prefix();
  std::string line;
  while (std::getline(table, line)) {
    // Num RefCount Protocol Flags Type St Inode Path; flags 00010000: listening. Connections bear the name
    // too.
    const size_t at = line.find(start);
    if (at == std::string::npos || line.find(" 00010000 ") == std::string::npos) continue;
    std::string name = line.substr(at + start.size());
    if (isSocketName(name)) names.push_back(std::move(name));
  }
  std::sort(names.begin(), names.end());
  names.erase(std::unique(names.begin(), names.end()), names.end());
  return names;
}

}  // namespace fr::shm
