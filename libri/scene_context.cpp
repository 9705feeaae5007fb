// RiBegin(RI_NULL): requests build worlds, which are rendered when they end, in this process.
#include <thread>

#include "libri/contexts.h"
#include "libri/world_renderer.h"
#include "ri/reader.h"
#include "ri/rib_writer.h"
#include "scene_cache/rib_stream.h"
#include "tools/shader_traits.h"
#include "tools/texture_requests.h"

namespace fr::libri {
namespace {

/// Structure comments and user comments of archives go to the callback of RiReadArchive.
class Scene final : public cache::SceneBuilder {
 public:
  using SceneBuilder::SceneBuilder;
  RtArchiveCallback callback = nullptr;
  void archiveRecord(ri::RecordKind kind, std::string text) override {
    static char format[] = "%s";
    if (callback && kind != ri::RecordKind::kVerbatim)
      callback(kind == ri::RecordKind::kStructure ? RI_STRUCTURE : RI_COMMENT, format, text.c_str());
    SceneBuilder::archiveRecord(kind, std::move(text));
  }
};

cache::LoadOptions loadOptions() {
  cache::LoadOptions o;
  o.makeTexture = tools::makeRequestedTexture;
  o.defaults.display = cache::kDefaultDisplay;
  tools::ShaderTraits traits = tools::shaderTraits({}, {});
  o.asksRays = std::move(traits.asksRays), o.movesPoints = std::move(traits.movesPoints);
  o.takesString = std::move(traits.takesString);
  // The current folder: what "beside the RIB" is to a program.
  o.overrides.textureFolders.emplace_back(".");
  return o;
}

ri::ReaderOptions readerOptions() {
  ri::ReaderOptions o;
  o.keepComments = true;
  return o;
}

class SceneContext final : public Context {
 public:
  SceneContext()
      : scene_(
            loadOptions(), [](cache::Frame&& f) { return renderWorld(std::move(f)), true; },
            cache::environmentPaths()),
        reader_(scene_, readerOptions()) {
    scene_.setReader(&reader_);
  }

  ri::StateRenderer& state() override { return scene_; }
  bool writes() const override { return false; }

  void close() override {
    if (recorder_) archiveEnd();
    scene_.finish();
    if (scene_.failure())
      complain(scene_.failure()->code, Severity::kError, "RiEnd", scene_.failure()->message);
  }

  void readArchive(const std::string& name, ri::ParamList params, RtArchiveCallback callback) override {
    if (recorder_) return recorder_->readArchive(name, std::move(params));
    const RtArchiveCallback outer = std::exchange(scene_.callback, callback ? callback : scene_.callback);
    const Result<void> r = reader_.readArchive(name);
    scene_.callback = outer;
    if (!r) complain(r.error().code, Severity::kError, "RiReadArchive", r.error().message);
  }
  void verbatim(std::string text) override {
    if (recorder_) return recorder_->archiveRecord(ri::RecordKind::kVerbatim, std::move(text));
    if (const Result<void> r = reader_.readBuffer(text, "RiArchiveRecord"); !r)
      complain(r.error().code, Severity::kError, "RiArchiveRecord", r.error().message);
  }
  void archiveBegin(ri::Handle name, ri::ParamList params) override {
    if (recorder_) {
      ++depth_;
      return recorder_->archiveBegin(std::move(name), std::move(params));
    }
    recordedName_ = name.name;
    recorded_.clear();
    ri::RibWriterOptions o;
    o.keepBareNames = true;
    recorder_ = std::make_unique<ri::RibWriter>([this](std::string_view s) { recorded_ += s; }, o);
  }
  void archiveEnd() override {
    if (!recorder_)
      return complain(RiError::kNesting, Severity::kError, "RiArchiveEnd", "no RiArchiveBegin before it");
    if (depth_ > 0) {
      --depth_;
      return recorder_->archiveEnd();
    }
    recorder_.reset();  // flushes
    reader_.defineArchive(recordedName_, std::move(recorded_));
  }

 protected:
  ri::Renderer& renderer() override { return scene_; }

 private:
  Scene scene_;
  ri::Reader reader_;
  std::string recorded_, recordedName_;
  int depth_ = 0;
};

}  // namespace

Result<std::unique_ptr<Context>> makeSceneContext() { return std::unique_ptr<Context>(new SceneContext); }

}  // namespace fr::libri
