// For tests: collects what is reported while it lives.
#pragma once

#include <string>
#include <vector>

#include "base/error.h"

namespace fr::ri {

class ReportCapture {
 public:
  ReportCapture() {
    setReportSink([this](const Error& e) { errors.push_back(e); });
  }
  ~ReportCapture() {
    setReportSink({});
    setErrorMode(ErrorMode::kPrint);
  }
  ReportCapture(const ReportCapture&) = delete;
  ReportCapture& operator=(const ReportCapture&) = delete;

  /// Number of reports with this code.
  int count(RiError code) const {
    int n = 0;
    for (const Error& e : errors) n += e.code == code;
    return n;
  }
  /// All of it, one per line, for messages of failed tests.
  std::string str() const {
    std::string s;
    for (const Error& e : errors) s += e.str() + "\n";
    return s;
  }

  std::vector<Error> errors;
};

}  // namespace fr::ri
