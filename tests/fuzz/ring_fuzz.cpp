// libFuzzer: anything in every shared word of a channel and of a server's board, against the real ends of the
// ring transport: a client that knows no rules against a server that also has an honest client, and a server
// that knows none against an honest client.
#include <algorithm>
#include <array>
#include <cstdlib>
#include <cstring>
#include <map>
#include <memory>
#include <set>
#include <vector>

#include "shm/channel.h"
#include "shm/channel_server.h"

namespace {

using namespace fr;
using namespace fr::shm;

[[noreturn]] void broken(const char* what) {
  std::fprintf(stderr, "ring_fuzz: %s\n", what);
  std::abort();
}

/// The input as numbers; zeros when it is used up.
class Bytes {
 public:
  Bytes(const uint8_t* data, size_t size) : at_(data), end_(data + size) {}
  bool any() const { return at_ < end_; }
  template <class T>
  T take() {
    T value{};
    const size_t n = std::min(sizeof value, size_t(end_ - at_));
    std::memcpy(&value, at_, n);
    at_ += n;
    return value;
  }
  uint32_t below(uint32_t n) { return take<uint16_t>() % n; }
  /// Words that break things are rare among random ones.
  uint64_t word() {
    const uint8_t how = take<uint8_t>();
    if (how < 96) return how % 24;
    if (how < 128) return ~uint64_t(0) - how % 8;
    if (how < 160) return uint64_t(1) << (how % 64);
    if (how < 192) return take<uint32_t>();
    return take<uint64_t>();
  }

 private:
  const uint8_t *at_, *end_;
};

/// A channel and its client's side without rules.
struct Channel {
  explicit Channel(const ChannelConfig& c) : config(c), memory(std::move(*ChannelMemory::create(c))) {}
  ChannelConfig config;
  ChannelMemory memory;
  uint64_t id = 0;
  uint64_t tail = 0, use = 0;
  uint32_t mail = 0;

  /// Bytes of everything but the blocks.
  uint64_t controlBytes() const {
    return uint64_t(memory.block(0).data() - reinterpret_cast<std::byte*>(&memory.control()));
  }
  void scribble(Bytes& in) {
    const uint64_t offset = in.take<uint16_t>() % controlBytes() & ~uint64_t(7);
    std::byte* const at = reinterpret_cast<std::byte*>(&memory.control()) + offset;
    std::atomic_ref<uint64_t>(*reinterpret_cast<uint64_t*>(at)).store(in.word());
  }
};

/// Uses what it is given, and notices when the server breaks its word.
class Handler : public ChannelHandler {
 public:
  std::map<uint64_t, ChannelConfig> configs;
  std::vector<ServedBlock> held;
  bool holds = false;
  std::set<uint64_t> ended;

  Served serveBlock(const ServedBlock& block) override {
    const ChannelConfig& c = configs.at(block.channelId);
    if (block.index >= c.blockCount || block.bytes.size() != c.blockBytes) broken("a block that is none");
    for (const ServedBlock& h : held)
      if (h.channelId == block.channelId && h.index == block.index) broken("a block ran twice at once");
    if (ended.count(block.channelId)) broken("a block of a channel that has ended");
    std::byte sum{};
    for (const std::byte b : block.bytes) sum ^= b;
    const std::span<std::byte> answers = block.bytes.subspan(c.questionBytes);
    std::fill(answers.begin(), answers.end(), sum);
    if (holds) {
      held.push_back(block);
      return Served::kDeferred;
    }
    return sum == std::byte(13) ? Served::kFailed : Served::kDone;
  }
  int serveMail(uint64_t, void*, std::span<const std::byte> request,
                std::span<std::byte, kMailBytes> answer) override {
    if (request.size() > kMailBytes) broken("a mail that is too long");
    std::reverse_copy(request.begin(), request.end(), answer.begin());
    return int(request.size());
  }
  void channelEnded(uint64_t id, void*, const Error*) override {
    if (!ended.insert(id).second) broken("a channel ended twice");
  }
};

/// One block of an honest client there and back.
void mustBeServed(ClientChannel& c, ChannelServer& server) {
  const auto block = c.acquire();
  if (!block) broken("an honest client has no block");
  std::memset(c.data(*block).data(), 5, c.data(*block).size());
  c.data(*block)[0] = std::byte(7);
  if (!c.submit(*block)) broken("an honest client cannot submit");
  for (int i = 0; i < 4 && c.poll(*block) == BlockStatus::kPending; ++i) server.serveOnce();
  if (c.poll(*block) != BlockStatus::kDone) broken("an honest client was not served");
  if (c.data(*block)[63] != (std::byte(7) ^ std::byte(5))) broken("an honest client got a wrong answer");
  c.release(*block);
}

void hostileClients(Bytes& in) {
  Handler handler;
  const auto server = std::move(*ChannelServer::create(handler, std::chrono::nanoseconds(0)));
  ClientChannel honest = std::move(*ClientChannel::create(server->board(), {.config = {2, 64}}));
  handler.configs[*server->add(std::move(*honest.share()))] = {2, 64};
  std::vector<std::unique_ptr<Channel>> hostile;
  for (int step = 0; in.any() && step < 400; ++step) {
    const uint8_t what = in.take<uint8_t>() % 16;
    if (hostile.empty() || (what == 0 && hostile.size() < 4)) {
      const uint64_t questions = in.take<uint8_t>() % 4 == 0 ? kQuestionPage : 0;
      auto c = std::make_unique<Channel>(
          ChannelConfig{1 + in.below(9), questions + 1 + in.take<uint8_t>(), questions});
      for (int n = in.take<uint8_t>() % 4; n > 1; --n) {  // a header that lies
        auto* const header = reinterpret_cast<uint64_t*>(&c->memory.control());
        header[in.below(sizeof(ChannelHeader) / 8)] = in.word();
      }
      auto id = server->add(std::move(*c->memory.share()));
      if (!id) continue;
      // A lie that fits the memory is as good as the truth: what was accepted is what the header says.
      c->id = *id;
      const ChannelHeader& said = c->memory.control().header;
      handler.configs[c->id] = {said.blockCount, said.blockBytes, said.questionBytes};
      hostile.push_back(std::move(c));
      continue;
    }
    Channel& c = *hostile[in.below(uint32_t(hostile.size()))];
    ChannelControl& control = c.memory.control();
    switch (what) {
      case 1:
      case 2:
      case 3: {  // as a client does it
        const uint32_t index = uint32_t(c.use % c.config.blockCount);
        c.memory.state(index).store(blockState(++c.use, BlockPhase::kSubmitted));
        c.memory.ringSlot(c.tail).store(index);
        control.tail.processor.store(uint32_t(in.take<uint8_t>()));
        control.tail.value.store(++c.tail);
        break;
      }
      case 4: {  // a mail, perhaps too long, perhaps out of turn
        control.mailbox.size.store(in.take<uint8_t>());
        c.mail += 1 + (in.take<uint8_t>() == 0);
        control.mailbox.state.store(c.mail);
        server->serveOnce();
        if (control.mailbox.state.load() == c.mail + 1) ++c.mail;
        break;
      }
      case 5:
      case 6:
      case 7:
        c.scribble(in);
        break;
      case 8: {
        const auto bytes = c.memory.block(in.below(c.config.blockCount));
        bytes[in.below(uint32_t(bytes.size()))] = in.take<std::byte>();
        break;
      }
      case 9: {
        const Doorbell bell = server->board()->bells().bell(in.take<uint8_t>());
        bell.sleepers.store(uint32_t(in.word())), bell.sequence.store(uint32_t(in.word()));
        break;
      }
      case 10:
        server->board()->serverState().store(uint32_t(in.word()));
        break;
      case 11:
        handler.holds = !handler.holds;
        break;
      case 12:
        if (!handler.held.empty()) {
          const ServedBlock block = handler.held.back();
          handler.held.pop_back();
          server->complete(block, in.take<uint8_t>() % 2 != 0);
          server->complete(block, true);  // does nothing
        }
        break;
      case 13:
        if (in.take<uint8_t>() % 4 == 0) server->remove(c.id);
        break;
      default:
        server->serveOnce();
    }
  }
  server->serveOnce();
  // Vandals on the board make honest clients believe that the server has left: nothing that they can be saved
  // from.
  if (server->board()->serverState().load() == uint32_t(SideState::kOpen)) {
    handler.holds = false;
    mustBeServed(honest, *server);
  }
}

void hostileServer(Bytes& in) {
  const auto board = std::move(*ServerBoard::create());
  bool alive = true;
  ClientChannel c = std::move(
      *ClientChannel::create(board, {.config = {1 + in.below(5), 64},
                                     .wait = {std::chrono::nanoseconds(0), std::chrono::nanoseconds(0)},
                                     .serverAlive = [&] { return alive; }}));
  const auto memory = std::move(*ChannelMemory::attach(std::move(*c.share()), ChannelSide::kServer));
  const uint64_t controlBytes =
      uint64_t(memory.block(0).data() - reinterpret_cast<std::byte*>(&memory.control()));
  std::vector<uint32_t> out;
  const auto settled = [&](uint32_t block) {
    if (block >= c.blockCount()) broken("a block that is none was answered");
    const auto bytes = c.data(block);
    if (bytes.size() != 64) broken("an answered block cannot be read");
    std::erase(out, block);
    c.release(block);
  };
  for (int step = 0; in.any() && step < 300; ++step) {
    switch (in.take<uint8_t>() % 8) {
      case 0:
      case 1:
        if (const auto b = c.acquire(); b && c.submit(*b)) out.push_back(*b);
        break;
      case 2: {
        const uint64_t offset = in.take<uint16_t>() % controlBytes & ~uint64_t(7);
        std::byte* const at = reinterpret_cast<std::byte*>(&memory.control()) + offset;
        std::atomic_ref<uint64_t>(*reinterpret_cast<uint64_t*>(at)).store(in.word());
        break;
      }
      case 3:  // as a server does it
        if (!out.empty()) {
          const uint32_t b = out[in.below(uint32_t(out.size()))];
          const uint64_t state = memory.state(b).load();
          memory.state(b).store((state & ~uint64_t(7)) | uint64_t(in.take<uint8_t>() % 8));
        }
        break;
      case 4:
        if (!out.empty()) {
          const uint32_t b = out[in.below(uint32_t(out.size()))];
          const BlockStatus s = c.poll(b);
          if (s == BlockStatus::kDone || s == BlockStatus::kFailed) settled(b);
        }
        break;
      case 5: {
        alive = false;  // or we wait for ever, as we should
        const auto b = c.waitAny(out);
        if (b) settled(*b);
        alive = true;
        break;
      }
      case 6: {
        alive = false;
        std::array<std::byte, kMailBytes> answer;
        const auto n = c.call(std::span(answer).first(in.below(kMailBytes + 2)), answer);
        if (n && *n > kMailBytes) broken("an answer that is too long");
        alive = true;
        break;
      }
      default:
        memory.control().mailbox.size.store(uint32_t(in.word()));
    }
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  Bytes in(data, size);
  if (in.take<uint8_t>() & 1)
    hostileServer(in);
  else
    hostileClients(in);
  return 0;
}
