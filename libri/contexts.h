// The kinds of contexts.
#pragma once

#include "libri/context.h"

namespace fr::libri {

/// Requests become RIB; archives are written, not read.
class WritingContext : public Context {
 public:
  bool writes() const override { return true; }
  void readArchive(const std::string& name, ri::ParamList params, RtArchiveCallback) override {
    renderer().readArchive(name, std::move(params));
  }
  void verbatim(std::string text) override {
    // RIB writes lines; the text may bring its own end of line.
    while (text.ends_with('\n')) text.pop_back();
    renderer().archiveRecord(ri::RecordKind::kVerbatim, std::move(text));
  }
  void archiveBegin(ri::Handle name, ri::ParamList params) override {
    renderer().archiveBegin(std::move(name), std::move(params));
  }
  void archiveEnd() override { renderer().archiveEnd(); }
};

/// The context becomes the current one.
Context& adopt(std::unique_ptr<Context> context);

/// Renders every world when it ends, in this process.
Result<std::unique_ptr<Context>> makeSceneContext();
/// Writes RIB; "-" is standard output. kNoFile with the reason.
Result<std::unique_ptr<Context>> makeFileContext(const std::string& path, RibFormat format);

}  // namespace fr::libri
