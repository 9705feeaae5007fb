#include "scene_cache/tracer_stream.h"

#include <condition_variable>
#include <mutex>
#include <thread>

#include "scene_cache/rib_stream.h"

namespace fr::cache {

/// SYNC: `turn` passes between the two threads under `mutex`; whoever has it may touch everything else.
struct TracerStream::Impl : WorldSource {
  enum class Turn { kImage, kTracer };

  Impl(std::span<const RibInput> in, const LoadOptions& o, const ri::StateRenderer::PathLists& paths,
       const std::string& text)
      : inputs(in), standardInput(text), builder(o, this, paths) {}

  // On the tracer's thread.
  std::pair<SkeletonWriter*, FrameCounts*> take() override {
    std::unique_lock lock(mutex);
    changed.wait(lock, [this] { return turn == Turn::kTracer; });
    if (quit) ++leftOver;
    return {writer, counts};
  }
  void giveBack() override {
    std::unique_lock lock(mutex);
    if (quit) return;  // reading over what is left; nobody waits
    turn = Turn::kImage;
    changed.notify_all();
    // Reads on only when the image's stream asks again, so that messages come in the same order every time.
    changed.wait(lock, [this] { return turn == Turn::kTracer; });
  }
  void run() {
    {
      std::unique_lock lock(mutex);
      changed.wait(lock, [this] { return turn == Turn::kTracer; });
    }
    auto r = readStream(builder, inputs, kForTracer, &standardInput, true);
    if (!r) report(r.error());
    const std::lock_guard lock(mutex);
    finished = true;
    turn = Turn::kImage;
    changed.notify_all();
  }

  const std::span<const RibInput> inputs;
  const std::string& standardInput;
  SceneBuilder builder;
  std::mutex mutex;
  std::condition_variable changed;
  Turn turn = Turn::kImage;
  SkeletonWriter* writer = nullptr;
  FrameCounts* counts = nullptr;
  bool quit = false, finished = false, saidFewer = false;
  int leftOver = 0;
  std::thread thread;
};

TracerStream::TracerStream(std::span<const RibInput> inputs, const LoadOptions& options,
                           const ri::StateRenderer::PathLists& standardPaths,
                           const std::string& standardInput)
    : impl_(std::make_unique<Impl>(inputs, options, standardPaths, standardInput)) {}

TracerStream::~TracerStream() {
  Impl& m = *impl_;
  if (!m.thread.joinable()) return;
  {
    const std::lock_guard lock(m.mutex);
    m.quit = true;
    m.writer = nullptr, m.counts = nullptr;
    m.turn = Impl::Turn::kTracer;
    m.changed.notify_all();
  }
  m.thread.join();
  if (m.leftOver > 0)
    report({RiError::kConsistency,
            Severity::kWarning,
            {},
            fmt::format("the ray tracer's files hold {} more worlds than the image's; ignored", m.leftOver)});
}

void TracerStream::fill(SkeletonWriter* writer, FrameCounts* counts) {
  Impl& m = *impl_;
  if (!m.thread.joinable()) m.thread = std::thread([&m] { m.run(); });
  std::unique_lock lock(m.mutex);
  if (!m.finished) {
    m.writer = writer, m.counts = counts;
    m.turn = Impl::Turn::kTracer;
    m.changed.notify_all();
    m.changed.wait(lock, [&m] { return m.turn == Impl::Turn::kImage; });
    m.writer = nullptr, m.counts = nullptr;
    if (!m.finished) return;
  }
  if (!writer || m.saidFewer) return;
  m.saidFewer = true;
  report({RiError::kConsistency,
          Severity::kWarning,
          {},
          "the ray tracer's files hold fewer worlds than the image's: it sees the common geometry alone"});
}

}  // namespace fr::cache
