#include "tracer/inproc_oracle.h"

#include <array>

namespace fr::tracer {
namespace {

class InprocOracle : public RayOracle {
 public:
  explicit InprocOracle(RayTracer& tracer) : thread_(tracer) {}

  RayQuery* acquire() override {
    for (Slot& s : slots_) {
      if (s.used) continue;
      if (!s.query) s.query = std::make_unique<RayQuery>();
      s.used = true, s.answered = false;
      s.query->terms = RayTerms{};
      return s.query.get();
    }
    return nullptr;
  }
  Result<void> submit(RayQuery* q) override {
    Slot* s = find(q);
    if (!s) return makeError(RiError::kBadHandle, "a block of rays was submitted that was not acquired");
    thread_.answer(*q);
    s->answered = true;
    return {};
  }
  bool answered(const RayQuery* q) const override {
    const Slot* s = const_cast<InprocOracle*>(this)->find(q);
    return s && s->answered;
  }
  Result<void> wait() override {
    for (const Slot& s : slots_)
      if (s.used && s.answered) return {};
    return makeError(RiError::kIllState, "waiting for rays, but none were submitted");
  }
  void release(RayQuery* q) override {
    if (Slot* s = find(q)) s->used = false;
  }
  Result<SingleAnswer> ask(const SingleRayMail& ray) override {
    SingleAnswer answer;
    if (!thread_.answerOne(ray, answer))
      return makeError(RiError::kRange, "{} is no kind of ray", ray.ray.kind);
    thread_.publishCounts();
    return answer;
  }

 private:
  struct Slot {
    std::unique_ptr<RayQuery> query;
    bool used = false, answered = false;
  };
  Slot* find(const RayQuery* q) {
    for (Slot& s : slots_)
      if (s.used && s.query.get() == q) return &s;
    return nullptr;
  }
  AnswerThread thread_;
  std::array<Slot, kBlocksPerLine> slots_;
};

}  // namespace

InprocOracleService::InprocOracleService(cache::SceneCache& cache, ShadingSystem& shading,
                                         RayTracerOptions options)
    : tracer_(cache, shading, options) {}
InprocOracleService::~InprocOracleService() = default;

Result<std::unique_ptr<RayOracle>> InprocOracleService::connect() {
  return std::unique_ptr<RayOracle>(std::make_unique<InprocOracle>(tracer_));
}

}  // namespace fr::tracer
