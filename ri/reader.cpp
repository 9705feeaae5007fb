#include "ri/reader.h"

#include <algorithm>
#include <filesystem>
#include <utility>

#include "ri/request_parser.h"
#include "ri/search_path.h"

namespace fr::ri {

Reader::Reader(Renderer& renderer, ReaderOptions options)
    : renderer_(renderer), options_(std::move(options)) {}
Reader::~Reader() = default;

Result<void> Reader::run(Lexer& lexer) {
  RequestParser parser(*this, lexer);
  return parser.run();
}

// Reads one input under its canonical name; the names of everything open at the moment show loops.
Result<void> Reader::nested(std::string canonical, Lexer& lexer) {
  if (open_.size() >= size_t(std::max(options_.maxArchiveDepth, 1))) {
    return makeError(RiError::kLimit, "archives are nested deeper than {}", options_.maxArchiveDepth);
  }
  if (std::find(open_.begin(), open_.end(), canonical) != open_.end()) {
    return makeError(RiError::kLimit, "\"{}\" reads itself", lexer.fileName());
  }
  open_.push_back(std::move(canonical));
  place_.reset();
  Result<void> r = run(lexer);
  open_.pop_back();
  place_.reset();
  return r;
}

Result<void> Reader::readFile(const std::string& path) {
  Result<std::unique_ptr<Input>> input = openFile(path);
  if (!input) return input.error();
  std::error_code ec;
  std::filesystem::path canonical = std::filesystem::weakly_canonical(path, ec);
  Lexer lexer(std::move(*input), path);
  return nested(ec ? path : canonical.string(), lexer);
}

Result<void> Reader::readStdin() {
  Result<std::unique_ptr<Input>> input = openStdin();
  if (!input) return input.error();
  Lexer lexer(std::move(*input), "<stdin>");
  return nested("<stdin>", lexer);
}

Result<void> Reader::readBuffer(std::string_view text, std::string name) {
  Result<std::unique_ptr<Input>> input = openMemory(text);
  if (!input) return input.error();
  Lexer lexer(std::move(*input), name);
  return nested(fmt::format("memory:{}:{}", static_cast<const void*>(text.data()), name), lexer);
}

Result<void> Reader::readDescriptor(int fd, std::string name) {
  Result<std::unique_ptr<Input>> input = openDescriptor(fd);
  if (!input) return input.error();
  Lexer lexer(std::move(*input), std::move(name));
  return nested(fmt::format("descriptor:{}", fd), lexer);
}

Result<void> Reader::readInput(std::unique_ptr<Input> input, std::string name,
                               std::shared_ptr<BinaryTables> tables) {
  Lexer lexer(std::move(input), std::move(name));
  if (tables) lexer.setTables(std::move(tables));
  return nested(fmt::format("input:{}", inputs_++), lexer);
}

Reader::Place Reader::place() {
  if (!place_) place_ = std::make_shared<const std::vector<std::string>>(open_);
  return place_;
}

Result<void> Reader::at(const Place& place, const std::function<Result<void>()>& f) {
  std::vector<std::string> outer = std::exchange(open_, *place);
  place_ = place;
  Result<void> r = f();
  open_ = std::move(outer);
  place_.reset();
  return r;
}

Result<void> Reader::readArchive(const std::string& name) {
  if (const auto it = inlineArchives_.find(name); it != inlineArchives_.end()) {
    const std::shared_ptr<InlineArchive> archive = it->second;  // lives on if it is recorded anew meanwhile
    Result<std::unique_ptr<Input>> input = openMemory(archive->text);
    if (!input) return input.error();
    Lexer lexer(std::move(*input), archive->file, archive->firstLine);
    lexer.setTables(std::make_shared<BinaryTables>(*archive->tables));
    return nested("archive:" + name, lexer);
  }
  std::vector<std::string> folders = renderer_.searchPath("archive");
  folders.insert(folders.end(), options_.archivePath.begin(), options_.archivePath.end());
  folders.emplace_back(".");
  // Where the main file is: archives often lie beside it, wherever the program was started.
  for (auto outer = open_.rbegin(); outer != open_.rend(); ++outer)
    if (outer->starts_with('/')) {  // the others are no files
      folders.push_back(std::filesystem::path(*outer).parent_path().string());
      break;
    }
  bool moved = false;
  const std::string path = findMovedFile(name, folders, moved);
  if (moved) reportWarning(RiError::kNoFile, "archive \"{}\" was not found; {} is read instead", name, path);
  if (path.empty()) {
    return makeError(RiError::kNoFile, "archive \"{}\" was not found in {}", name, fmt::join(folders, ":"));
  }
  return readFile(path);
}

void Reader::defineArchive(const std::string& name, std::string text) {
  auto archive = std::make_shared<InlineArchive>();
  archive->file = fmt::format("<archive {}>", name);
  archive->text = std::move(text);
  archive->tables = std::make_shared<BinaryTables>();
  inlineArchives_[name] = std::move(archive);
}

}  // namespace fr::ri
