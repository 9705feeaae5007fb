// Silence on one thread.
#pragma once

namespace fr {

/// While one lives, report() and reportOnce() do nothing on its thread: for what is read a second time.
class ReportMute {
 public:
  ReportMute();
  ~ReportMute();
  ReportMute(const ReportMute&) = delete;
  ReportMute& operator=(const ReportMute&) = delete;
};

}  // namespace fr
