// libFuzzer: any bytes as what a client sends to a ray server's standard input, and as what a server answers.
#include <cstddef>
#include <cstdint>
#include <memory>

#include "oracle/pipe_codec.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace fr;
  static const auto block = std::make_unique<RayQuery>();
  if (size < 2) return 0;
  const bool server = data[0] & 1;
  const size_t piece = size_t(data[1]) + 1;
  const auto bytes = std::as_bytes(std::span(data, size)).subspan(2);
  PipeReader reader(server);
  for (size_t at = 0; at < bytes.size(); at += piece) {
    reader.feed(bytes.subspan(at, std::min(piece, bytes.size() - at)));
    for (;;) {
      auto item = reader.next();
      if (!item || !*item) break;
      if (const auto* q = std::get_if<PipeQuery>(&**item)) {
        (void)asPipeHello(*q);
        (void)pipeQueryRay(*q, WorldSpace(DVec3(1, 2, 3)), data[0] & 2);
      } else if (const auto* f = std::get_if<PipeFrame>(&**item)) {
        uint32_t flags = 0;
        (void)readPipeRays(f->body, *block, flags);
        (void)readPipeAnswers(f->body, RayKind(data[0] >> 2 & 3), data[1], *block);
      }
    }
  }
  return 0;
}
