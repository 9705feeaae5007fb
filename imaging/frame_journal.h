// Finished pixels of a frame, kept beside its picture while it is rendered, so that a later run can go on
// where this one was stopped or killed.
//
// The file: a header, then records that are appended whole, each with a checksum. Whatever a kill leaves is a
// header and some whole records, and perhaps a torn one, which is cut off. The file comes from a stranger:
// nothing in it is trusted but what its checksums and the frame's own geometry confirm.
#pragma once

#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "base/error.h"
#include "imaging/film.h"

namespace fr {

/// Where the journal of a picture is: beside it.
std::string journalPath(const std::string& picture);

/// Thread safety: add() may be called by several threads.
class FrameJournal {
 public:
  /// `frame`: a number that differs between frames that differ (their scene, camera, seed ...). The journal
  /// of another frame is replaced, with a warning. Errors: kSystem; somebody else is writing this journal.
  static Result<std::unique_ptr<FrameJournal>> open(const std::string& path, uint64_t frame, size_t channels);
  ~FrameJournal();
  FrameJournal(const FrameJournal&) = delete;
  FrameJournal& operator=(const FrameJournal&) = delete;

  /// What an earlier run finished; once.
  std::vector<FilmTile> takeFinished() { return std::move(finished_); }
  /// Remembers pixels. A disk that is full costs the journal, with one warning, not the frame.
  void add(const FilmTile& pixels);
  /// The picture is complete.
  void remove();

 private:
  FrameJournal(std::string path, int fd, size_t channels)
      : path_(std::move(path)), fd_(fd), channels_(channels) {}
  Result<void> read(uint64_t frame);

  std::string path_;
  int fd_;
  size_t channels_;
  std::vector<FilmTile> finished_;
  std::mutex mutex_;  // guards all below and the file
  uint64_t size_ = 0;
  bool failed_ = false;
};

}  // namespace fr
