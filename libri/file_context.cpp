// RiBegin("x.rib"), RiBegin("|program"): requests become a file, or go to a program.
#include "libri/contexts.h"
#include "ri/rib_file.h"
#include "ri/rib_writer.h"

namespace fr::libri {
namespace {

class FileContext final : public WritingContext {
 public:
  FileContext(std::string path, RibFormat format) : path_(std::move(path)), format_(format) {}

  Result<void> open() { return isCommand() ? Result<void>() : file_.open(path_, format_.gzip); }

  ri::StateRenderer& state() override { return state_; }

  bool setFormat(RibFormat f) override {
    if (writer_) return false;
    const bool again = f.gzip != format_.gzip;
    format_ = f;
    if (again)
      if (Result<void> r = open(); !r)
        complain(r.error().code, Severity::kSevere, "RiOption", r.error().message);
    return true;
  }
  RibFormat format() const override { return format_; }

  void close() override {
    static_cast<ri::RibWriter&>(renderer()).flush();
    if (Result<void> r = file_.finish(); !r)
      complain(r.error().code, Severity::kSevere, "RiEnd", r.error().message);
    state_.finish();
  }

 protected:
  ri::Renderer& renderer() override {
    if (!writer_) {
      // As in BMRT's libribout. Not before it is known how to write.
      if (isCommand())
        if (Result<void> r = file_.openCommand(path_.substr(1), format_.gzip); !r)
          complain(r.error().code, Severity::kSevere, "RiBegin", r.error().message);
      ri::RibWriterOptions o;
      o.binary = format_.binary, o.indent = 2, o.width = 100;
      o.keepBareNames = true;
      writer_ = std::make_unique<ri::RibWriter>([this](std::string_view s) { file_.write(s); }, o);
      writer_->archiveRecord(ri::RecordKind::kStructure, "RenderMan RIB-Structure 1.1");
      writer_->version(3.04);
    }
    return *writer_;
  }

 private:
  bool isCommand() const { return path_.starts_with('|'); }

  std::string path_;
  RibFormat format_;
  ri::RibFile file_;
  ri::StateRenderer state_;
  std::unique_ptr<ri::RibWriter> writer_;
};

}  // namespace

Result<std::unique_ptr<Context>> makeFileContext(const std::string& path, RibFormat format) {
  auto c = std::make_unique<FileContext>(path, format);
  if (Result<void> r = c->open(); !r) return r.error();
  return std::unique_ptr<Context>(std::move(c));
}

}  // namespace fr::libri
