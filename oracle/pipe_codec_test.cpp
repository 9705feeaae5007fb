#include "oracle/pipe_codec.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <random>

#include "oracle/ray_client.h"

namespace fr {
namespace {

using Bytes = std::vector<std::byte>;

TEST(PipeCodec, AQueryOf1998HasThe50BytesOfBmrt) {
  PipeQuery q;
  q.kind = RayKind::kVisibility;
  for (size_t i = 0; i < 12; ++i) q.values[i] = float(i) + 0.5f;
  Bytes out;
  putPipeQuery(out, q);
  ASSERT_EQ(out.size(), 50u);
  EXPECT_EQ(char(out[0]), 'b');
  EXPECT_EQ(char(out[1]), 'v');
  for (size_t i = 0; i < 12; ++i) {
    float f;
    std::memcpy(&f, out.data() + 2 + 4 * i, 4);
    EXPECT_EQ(f, float(i) + 0.5f);
  }
}

TEST(PipeCodec, QueriesAreReadWhateverThePieces) {
  Bytes stream;
  const char* letters = "tvh";
  for (int i = 0; i < 30; ++i) {
    PipeQuery q;
    q.kind = RayKind(i % 3);
    q.values[0] = float(i);
    putPipeQuery(stream, q);
    EXPECT_EQ(char(stream[stream.size() - 49]), letters[i % 3]);
  }
  for (size_t piece : {1u, 2u, 7u, 49u, 50u, 51u, 1500u}) {
    PipeReader reader(true);
    int seen = 0;
    for (size_t at = 0; at < stream.size(); at += piece) {
      reader.feed(std::span(stream).subspan(at, std::min(piece, stream.size() - at)));
      for (;;) {
        auto item = reader.next();
        ASSERT_TRUE(item);
        if (!*item) break;
        const auto& q = std::get<PipeQuery>(**item);
        EXPECT_EQ(q.kind, RayKind(seen % 3));
        EXPECT_EQ(q.values[0], float(seen));
        ++seen;
      }
    }
    EXPECT_EQ(seen, 30);
    EXPECT_EQ(reader.pending(), 0u);
  }
}

TEST(PipeCodec, RepliesAreWorldSpace) {
  const WorldSpace space(DVec3(1000, -2000, 3000));
  SingleAnswer a;
  a.color[0] = 0.1f, a.color[1] = 0.2f, a.color[2] = 0.3f;
  a.hitDistance = 7;
  a.hitP[0] = 1, a.hitP[1] = 2, a.hitP[2] = 3;
  a.hitN[2] = 1;
  for (RayKind kind : {RayKind::kTrace, RayKind::kVisibility, RayKind::kHitTest}) {
    Bytes out;
    putPipeReply(out, kind, a, space);
    ASSERT_EQ(out.size(), pipeReplyBytes(kind));
    SingleAnswer back;
    ASSERT_TRUE(readPipeReply(out, kind, space, back));
    EXPECT_FALSE(readPipeReply(std::span(out).first(out.size() - 1), kind, space, back));
    if (kind == RayKind::kHitTest) {
      float f[7];
      std::memcpy(f, out.data(), sizeof f);
      EXPECT_EQ(f[0], 7.f);
      EXPECT_EQ(f[1], 1001.f);
      EXPECT_EQ(f[2], -1998.f);
      EXPECT_EQ(f[3], 3003.f);
      EXPECT_EQ(f[6], 1.f);
      EXPECT_EQ(back.hitP[1], 2.f);
    } else {
      EXPECT_EQ(back.color[1], 0.2f);
    }
  }
  Bytes miss;
  SingleAnswer none;
  none.hitDistance = kNoHit;
  putPipeReply(miss, RayKind::kHitTest, none, space);
  float f[7];
  std::memcpy(f, miss.data(), sizeof f);
  EXPECT_EQ(f[0], 1e38f);
  for (int i = 1; i < 7; ++i) EXPECT_EQ(f[i], 0.f) << i;
}

TEST(PipeCodec, QueryRaysComeIntoCacheSpaceInDouble) {
  const WorldSpace space(DVec3(0.25, 0, 1e7));
  PipeQuery q;
  q.kind = RayKind::kVisibility;
  q.values = {1, 2, 1e7f, 4, 6, 1e7f + 8, 0.75f, 0.5f};
  const SingleRayMail m = pipeQueryRay(q, space, false);
  EXPECT_EQ(m.ray.origin[0], 0.75f);
  EXPECT_EQ(m.ray.origin[2], 0.f);
  EXPECT_EQ(m.ray.direction[0], 3.f);
  EXPECT_EQ(m.ray.direction[1], 4.f);
  EXPECT_EQ(m.ray.direction[2], 8.f);
  EXPECT_EQ(m.ray.time, 0.75f);
  EXPECT_EQ(m.start.node, 0xffffffffu);
  const SingleRayMail j = pipeQueryRay(q, space, true), k = pipeQueryRay(q, space, true);
  EXPECT_EQ(j.ray.time, k.ray.time) << "the same ray has the same time";
  EXPECT_GE(j.ray.time, 0.f);
  EXPECT_LT(j.ray.time, 1.f);
  double sum = 0;
  for (int i = 0; i < 1000; ++i) {
    q.values[0] = float(i);
    sum += double(pipeQueryRay(q, space, true).ray.time);
  }
  EXPECT_NEAR(sum / 1000, 0.5, 0.05);
}

TEST(PipeCodec, AHelloIsAQueryThatOldServersAnswer) {
  const PipeQuery hello = pipeHello();
  EXPECT_EQ(hello.kind, RayKind::kTrace);
  for (float f : hello.values) EXPECT_FALSE(std::isnan(f) && f == 0);
  const auto back = asPipeHello(hello);
  ASSERT_TRUE(back);
  EXPECT_EQ(back->version, kPipeVersion);
  EXPECT_EQ(back->fingerprint, pipeFingerprint());
  EXPECT_EQ(sizeof(PipeWelcome), pipeReplyBytes(hello.kind));
  EXPECT_FALSE(asPipeHello(PipeQuery{}));
}

std::unique_ptr<RayQuery> randomQuery(uint32_t seed) {
  std::mt19937 engine(seed);
  const auto random = [&] { return uint32_t(engine()); };
  auto q = std::make_unique<RayQuery>();
  std::memset(static_cast<void*>(q.get()), 0, sizeof *q);
  q->kind = RayKind(random() % 4);
  q->count = seed == 0 ? 0 : seed == 1 ? kMaxRays : random() % (kMaxRays + 1);
  q->level = random() % 5;
  const uint32_t parts = random();
  for (uint32_t i = 0; i < q->count; ++i) {
    auto f = [&] { return float(random()) * 1e-9f; };
    for (int c = 0; c < 3; ++c) q->origin[c][i] = f(), q->direction[c][i] = f();
    q->node[i] = 0xffffffffu, q->importance[i] = 0x3f800000u;
    if (parts & 1) q->time[i] = f();
    if (parts & 2) q->radius[i] = f(), q->spread[i] = f();
    if (parts & 4) {
      for (int c = 0; c < 3; ++c) q->normal[c][i] = f();
      q->node[i] = random(), q->cell[i] = random(), q->u[i] = f(), q->v[i] = f();
    }
    if (parts & 8) q->seed[i] = random();
    if (parts & 16) q->importance[i] = random();
    for (int c = 0; c < 3; ++c)
      q->color[c][i] = f(), q->hitP[c][i] = f(), q->hitN[c][i] = f(), q->missP[c][i] = f(),
      q->missR[c][i] = f();
    q->hitDistance[i] = f(), q->missDepth[i] = f();
    for (auto& column : q->extra) column[i] = f();
  }
  if (parts & 32) {
    q->terms.rayClass = RayClass::kDiffuse, q->terms.diffuseDepth = 2, q->terms.maxDistance = 0.5f;
    std::strcpy(q->terms.label, "label");
    if (parts & 64) std::strcpy(q->terms.extras, "1 primitive:s\n3 surface:x\n");
  }
  return q;
}

PipeFrame readFrame(const Bytes& stream) {
  PipeReader reader(true);
  reader.feed(stream);
  auto item = reader.next();
  EXPECT_TRUE(item && *item && reader.pending() == 0);
  return std::get<PipeFrame>(**item);
}

TEST(PipeCodec, FramesKeepEveryBitOfQuestionsAndAnswers) {
  for (uint32_t seed = 0; seed < 60; ++seed) {
    const auto q = randomQuery(seed);
    Bytes stream;
    putPipeRays(stream, 77, kPipeStartsAreRoots, *q);
    const PipeFrame frame = readFrame(stream);
    EXPECT_EQ(frame.id, 77u);
    EXPECT_EQ(frame.type, PipeFrameType::kRays);
    auto back = std::make_unique<RayQuery>();
    uint32_t flags = 0;
    ASSERT_TRUE(readPipeRays(frame.body, *back, flags));
    EXPECT_EQ(flags, kPipeStartsAreRoots);
    ASSERT_EQ(back->count, q->count);
    EXPECT_EQ(back->kind, q->kind);
    EXPECT_EQ(back->level, q->level);
    const auto sent = std::as_bytes(std::span(&q->terms, 1));
    EXPECT_TRUE(std::equal(sent.begin(), sent.end(), std::as_bytes(std::span(&back->terms, 1)).begin()));
    const size_t n = q->count * sizeof(float);
    for (int c = 0; c < 3; ++c) {
      EXPECT_EQ(std::memcmp(back->origin[c], q->origin[c], n), 0);
      EXPECT_EQ(std::memcmp(back->direction[c], q->direction[c], n), 0);
      EXPECT_EQ(std::memcmp(back->normal[c], q->normal[c], n), 0);
    }
    EXPECT_EQ(std::memcmp(back->time, q->time, n), 0);
    EXPECT_EQ(std::memcmp(back->radius, q->radius, n), 0);
    EXPECT_EQ(std::memcmp(back->spread, q->spread, n), 0);
    EXPECT_EQ(std::memcmp(back->node, q->node, n), 0);
    EXPECT_EQ(std::memcmp(back->cell, q->cell, n), 0);
    EXPECT_EQ(std::memcmp(back->u, q->u, n), 0);
    EXPECT_EQ(std::memcmp(back->seed, q->seed, 2 * n), 0);
    EXPECT_EQ(std::memcmp(back->importance, q->importance, n), 0);

    Bytes reply;
    putPipeAnswers(reply, 77, *q);
    const PipeFrame answers = readFrame(reply);
    auto got = std::make_unique<RayQuery>();
    got->terms = q->terms;
    ASSERT_TRUE(readPipeAnswers(answers.body, q->kind, q->count, *got));
    if (q->terms.extras[0] != 0 && q->kind != RayKind::kVisibility) {
      for (int k = 0; k < 4; ++k) EXPECT_EQ(std::memcmp(got->extra[k], q->extra[k], n), 0);
    }
    if (q->kind != RayKind::kHitTest) {
      EXPECT_EQ(std::memcmp(got->color[2], q->color[2], n), 0);
    }
    if (q->kind != RayKind::kVisibility) {
      EXPECT_EQ(std::memcmp(got->hitDistance, q->hitDistance, n), 0);
    }
    if (q->kind == RayKind::kFullTrace) {
      EXPECT_EQ(std::memcmp(got->missDepth, q->missDepth, n), 0);
      EXPECT_EQ(std::memcmp(got->missR[1], q->missR[1], n), 0);
      EXPECT_EQ(std::memcmp(got->hitN[2], q->hitN[2], n), 0);
    }
    // What was not asked is refused.
    if (q->count > 0) {
      EXPECT_FALSE(readPipeAnswers(answers.body, q->kind, q->count - 1, *got));
    }
    EXPECT_FALSE(readPipeAnswers(answers.body, RayKind((uint32_t(q->kind) + 1) % 4), q->count, *got));
  }
}

TEST(PipeCodec, FramesOfWrongSizeOrContentAreRefused) {
  const auto q = randomQuery(5);
  Bytes stream;
  putPipeRays(stream, 1, 0, *q);
  const PipeFrame frame = readFrame(stream);
  auto back = std::make_unique<RayQuery>();
  uint32_t flags;
  for (size_t cut : {size_t(0), size_t(31), frame.body.size() - 1})
    EXPECT_FALSE(readPipeRays(std::span(frame.body).first(cut), *back, flags)) << cut;
  Bytes longer = frame.body;
  longer.push_back({});
  EXPECT_FALSE(readPipeRays(longer, *back, flags));
  for (size_t word : {0u, 1u, 4u, 5u}) {
    Bytes wrong = frame.body;
    std::memset(wrong.data() + 4 * word, 0xff, 4);
    EXPECT_FALSE(readPipeRays(wrong, *back, flags)) << word;
  }
}

TEST(PipeCodec, GarbageEndsTheStreamWithItsPlace) {
  for (const std::string text : {"hello", "bx", "b\xff", "Content-Length: 3"}) {
    Bytes stream;
    putPipeQuery(stream, PipeQuery{});
    for (char c : text) stream.push_back(std::byte(c));
    PipeReader reader(true);
    reader.feed(stream);
    ASSERT_TRUE(reader.next());
    auto bad = reader.next();
    ASSERT_FALSE(bad) << text;
    EXPECT_NE(bad.error().message.find("byte 50"), std::string::npos) << bad.error().message;
    reader.feed(stream);
    EXPECT_FALSE(reader.next()) << "an error is for good";
  }
  // A frame that claims a gigabyte is refused before a byte of it has come.
  Bytes big;
  putPipeFrame(big, PipeFrameType::kRays, 1, {});
  const uint32_t huge = 1u << 30;
  std::memcpy(big.data() + 8, &huge, 4);
  PipeReader reader(true);
  reader.feed(big);
  EXPECT_FALSE(reader.next());
  // A client does not take queries.
  Bytes query;
  putPipeQuery(query, PipeQuery{});
  PipeReader client(false);
  client.feed(query);
  EXPECT_FALSE(client.next());
}

TEST(PipeCodec, RandomBytesNeverDoMoreThanFail) {
  std::mt19937 engine(1);
  const auto random = [&] { return uint32_t(engine()); };
  auto q = std::make_unique<RayQuery>();
  for (int round = 0; round < 3000; ++round) {
    Bytes bytes(random() % 300);
    for (auto& b : bytes) b = std::byte(random());
    if (bytes.size() > 4 && round % 2) {
      bytes[0] = std::byte{'b'};
      bytes[1] = std::byte("tvhF"[random() % 4]);
      if (bytes.size() > 16) bytes[2] = std::byte(random() % 9), bytes[3] = {}, bytes[10] = bytes[11] = {};
    }
    PipeReader reader(true);
    reader.feed(bytes);
    for (;;) {
      auto item = reader.next();
      if (!item || !*item) break;
      uint32_t flags;
      if (auto* f = std::get_if<PipeFrame>(&**item)) {
        (void)readPipeRays(f->body, *q, flags);
        (void)readPipeAnswers(f->body, RayKind(random() % 4), random() % 10, *q);
      }
    }
  }
}

TEST(CommandWords, AreDividedAsInAShell) {
  const auto words = splitCommandLine("  rendrib -rayserver 'a b.rib' \"c \\\"d\\\"\" e\\ f '' ");
  ASSERT_TRUE(words);
  EXPECT_EQ(*words, (std::vector<std::string>{"rendrib", "-rayserver", "a b.rib", "c \"d\"", "e f", ""}));
  EXPECT_FALSE(splitCommandLine("  "));
  EXPECT_FALSE(splitCommandLine("rendrib 'x"));
}

}  // namespace
}  // namespace fr
