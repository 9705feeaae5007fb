// libFuzzer: anything as the contents of a block or a mailbox, against the code that answers it.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <memory>

#include "tracer/ray_tracer.h"
#include "tracer/testing/ray_batches.h"

namespace {

using namespace fr;

[[noreturn]] void broken(const char* what) {
  std::fprintf(stderr, "rays_fuzz: %s\n", what);
  std::abort();
}

/// A scene with every shader and way to cast shadows, and a thread that answers.
struct Answering {
  std::unique_ptr<cache::SceneCache> cache;
  std::unique_ptr<ShadingSystem> shading;
  std::unique_ptr<tracer::RayTracer> tracer;
  std::unique_ptr<tracer::AnswerThread> thread;

  Answering() {
    testing::AnalyticScene scene;
    testing::addZoo(scene);
    cache = scene.finish();
    shading = std::make_unique<ShadingSystem>(*cache, ShadingSystem::Options{});
    tracer::RayTracerOptions options;
    options.scene.threads = 1;
    tracer = std::make_unique<tracer::RayTracer>(*cache, *shading, options);
    thread = std::make_unique<tracer::AnswerThread>(*tracer);
  }
};

/// The input as the numbers that a client may write; zeros when it is used up.
class Bytes {
 public:
  Bytes(const uint8_t* data, size_t size) : at_(data), end_(data + size) {}
  template <class T>
  T take() {
    T value{};
    copy(&value, sizeof value);
    return value;
  }
  void copy(void* to, size_t bytes) {
    const size_t n = std::min(bytes, size_t(end_ - at_));
    std::memcpy(to, at_, n);
    at_ += n;
  }
  float number() {
    constexpr float kWild[] = {std::numeric_limits<float>::quiet_NaN(),
                               std::numeric_limits<float>::infinity(),
                               -std::numeric_limits<float>::infinity(),
                               1e38f,
                               -1e38f,
                               1e-42f,
                               3e19f,
                               0};
    const uint8_t how = take<uint8_t>();
    if (how < 8) return kWild[how];
    if (how < 200) return float(int(how) - 104) * 0.1f;
    return take<float>();
  }

 private:
  const uint8_t *at_, *end_;
};

void answerBlock(Answering& a, Bytes& in) {
  static const auto block = std::make_unique<RayQuery>();
  RayQuery& q = *block;
  const uint8_t flags = in.take<uint8_t>();
  q.kind = RayKind(in.take<uint8_t>() % 6);
  q.count = flags & 1 ? in.take<uint32_t>() : in.take<uint8_t>() % 32;
  q.level = flags & 2 ? in.take<uint32_t>() : 1 + in.take<uint8_t>() % 4;
  q.terms = RayTerms{};
  if (flags & 4) in.copy(static_cast<void*>(&q.terms), sizeof q.terms);
  if (flags & 8) {
    std::strcpy(q.terms.extras, "3 surface:Ci\n1 primitive:s\n3 ray:transmission\n");
    in.copy(q.terms.extras, in.take<uint8_t>());
  }
  if (flags & 16) q.terms.flags |= RayTerms::kWantsNode;
  // Rays beyond those that the input holds repeat them.
  constexpr uint32_t kOwn = 16;
  for (uint32_t i = 0; i < kOwn; ++i) {
    for (int c = 0; c < 3; ++c) {
      q.origin[c][i] = in.number(), q.direction[c][i] = in.number();
      q.normal[c][i] = flags & 32 ? in.number() : 0.0f;
    }
    q.time[i] = in.number(), q.radius[i] = in.number(), q.spread[i] = in.number();
    q.node[i] = flags & 64 ? in.take<uint32_t>() : in.take<uint8_t>();
    q.cell[i] = in.take<uint8_t>(), q.u[i] = in.number(), q.v[i] = in.number(),
    q.seed[i] = in.take<uint8_t>();
  }
  for (uint32_t i = kOwn; i < std::min(q.count, kMaxRays); ++i) {
    const uint32_t k = i % kOwn;
    for (int c = 0; c < 3; ++c)
      q.origin[c][i] = q.origin[c][k], q.direction[c][i] = q.direction[c][k], q.normal[c][i] = q.normal[c][k];
    q.time[i] = q.time[k], q.radius[i] = q.radius[k], q.spread[i] = q.spread[k];
    q.node[i] = q.node[k], q.cell[i] = q.cell[k], q.u[i] = q.u[k], q.v[i] = q.v[k], q.seed[i] = q.seed[k];
  }
  a.thread->answer(q);
  if (uint32_t(q.kind) > uint32_t(RayKind::kFullTrace)) return;
  for (uint32_t i = 0; i < std::min(q.count, kMaxRays); ++i) {
    for (int c = 0; c < 3; ++c)
      if (q.kind != RayKind::kHitTest && !std::isfinite(q.color[c][i])) broken("a colour that is no number");
    if (q.kind != RayKind::kVisibility && !(q.hitDistance[i] >= 0)) broken("a distance that is none");
  }
}

void answerMail(Answering& a, Bytes& in) {
  std::byte bytes[kSingleRayMailBytes];
  in.copy(bytes, sizeof bytes);
  SingleRayMail mail;
  SingleAnswer answer;
  const size_t size = in.take<uint8_t>() & 1 ? kSingleRayBytes : in.take<uint8_t>() % (sizeof bytes + 1);
  if (!readSingleRay(std::span(bytes).first(size), mail) || !a.thread->answerOne(mail, answer)) return;
  for (const float c : answer.color)
    if (!std::isfinite(c)) broken("a colour that is no number");
  a.thread->publishCounts();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static Answering answering;
  Bytes in(data, size);
  if (in.take<uint8_t>() & 1)
    answerMail(answering, in);
  else
    answerBlock(answering, in);
  return 0;
}
