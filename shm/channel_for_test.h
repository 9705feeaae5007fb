// A server that answers tests: each 32-bit word of a block plus one; a mail backwards.
#pragma once

#include <algorithm>
#include <cstring>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "shm/channel.h"
#include "shm/channel_server.h"

namespace fr::shm {

/// Asks of each block: word 0 = number of words n, then n words. The answer stands in the same words, each
/// plus one.
class AddOneHandler : public ChannelHandler {
 public:
  Served serveBlock(const ServedBlock& block) override {
    uint32_t n = 0;
    std::memcpy(&n, block.bytes.data(), 4);
    if (n > block.bytes.size() / 4 - 1) return Served::kFailed;
    std::byte* p = block.bytes.data() + 4;
    for (uint32_t i = 0; i < n; ++i, p += 4) {
      uint32_t w;
      std::memcpy(&w, p, 4);
      ++w;
      std::memcpy(p, &w, 4);
    }
    blocks.fetch_add(1);
    return Served::kDone;
  }
  int serveMail(uint64_t, void*, std::span<const std::byte> request,
                std::span<std::byte, kMailBytes> answer) override {
    if (request.size() == 13) return -1;  // the unlucky number
    std::reverse_copy(request.begin(), request.end(), answer.begin());
    mails.fetch_add(1);
    return int(request.size());
  }
  void channelEnded(uint64_t id, void*, const Error* error) override {
    const std::lock_guard lock(mutex);
    ended.emplace_back(id, error ? error->message : "");
  }
  std::vector<std::pair<uint64_t, std::string>> endedChannels() {
    const std::lock_guard lock(mutex);
    return ended;
  }

  std::atomic<uint64_t> blocks{0};
  std::atomic<uint64_t> mails{0};
  std::mutex mutex;
  std::vector<std::pair<uint64_t, std::string>> ended;
};

/// A server with its threads in this process.
class ServerForTest {
 public:
  explicit ServerForTest(ChannelHandler& handler, int threads) {
    server = std::move(*ChannelServer::create(handler));
    for (int i = 0; i < threads; ++i) {
      threads_.emplace_back([this] { server->run(); });
    }
  }
  ~ServerForTest() { stop(); }
  /// Ends the threads and the server.
  void stop() {
    if (!server) return;
    server->stop();
    for (std::thread& t : threads_) t.join();
    threads_.clear();
    server.reset();
  }
  ClientChannel connect(ClientChannel::Options options = {}) {
    Result<ClientChannel> c = ClientChannel::create(server->board(), std::move(options));
    FR_CHECK(c.ok());
    Result<FileDescriptor> fd = c->share();
    FR_CHECK(fd.ok());
    Result<uint64_t> id = server->add(std::move(*fd));
    FR_CHECK(id.ok());
    return std::move(*c);
  }
  std::unique_ptr<ChannelServer> server;

 private:
  std::vector<std::thread> threads_;
};

/// Writes a question of `words` words that start at `seed` into a block.
inline void fillQuestion(std::span<std::byte> block, uint32_t words, uint32_t seed) {
  std::memcpy(block.data(), &words, 4);
  for (uint32_t i = 0; i < words; ++i) {
    const uint32_t w = seed + i * 2654435761u;
    std::memcpy(block.data() + 4 + i * 4, &w, 4);
  }
}
inline bool answerIsRight(std::span<const std::byte> block, uint32_t words, uint32_t seed) {
  for (uint32_t i = 0; i < words; ++i) {
    uint32_t w;
    std::memcpy(&w, block.data() + 4 + i * 4, 4);
    if (w != seed + i * 2654435761u + 1) return false;
  }
  return true;
}

/// Sends `total` blocks through a channel with as many in flight as there are blocks; false on a wrong answer
/// or an error. Every fifth step is a mail.
inline bool exchange(ClientChannel& c, uint32_t total, uint32_t seed) {
  std::vector<uint32_t> flying;
  std::vector<uint32_t> seeds(c.blockCount());
  const uint32_t words = uint32_t(c.blockBytes() / 4 - 1);
  uint32_t sent = 0;
  uint32_t received = 0;
  while (received < total) {
    while (sent < total) {
      const std::optional<uint32_t> b = c.acquire();
      if (!b) break;
      seeds[*b] = seed + sent;
      fillQuestion(c.data(*b), words, seeds[*b]);
      if (!c.submit(*b)) return false;
      flying.push_back(*b);
      ++sent;
    }
    if (received % 5 == 0) {
      std::byte request[24];
      std::byte answer[24];
      for (size_t i = 0; i < sizeof request; ++i) request[i] = std::byte(received + i);
      const Result<uint32_t> n = c.call(request, answer);
      if (!n || *n != sizeof request ||
          !std::equal(std::begin(answer), std::end(answer), std::rbegin(request))) {
        return false;
      }
    }
    const Result<uint32_t> b = c.waitAny(flying);
    if (!b || !answerIsRight(c.data(*b), words, seeds[*b])) return false;
    c.release(*b);
    std::erase(flying, *b);
    ++received;
  }
  return true;
}

}  // namespace fr::shm
