#include "base/error.h"

#include <gtest/gtest.h>

#include <vector>

#include "base/log.h"

namespace fr {
namespace {

TEST(Error, TextNamesPlaceSeverityAndCode) {
  Error e = makeError(RiError::kMissingData, "Sphere needs {}", "radius");
  e.where = {"a.rib", 3, 7};
  EXPECT_EQ(e.str(), "a.rib:3:7: error: Sphere needs radius [RIE_MISSINGDATA]");
  EXPECT_EQ(std::move(e).context("reading").message, "reading: Sphere needs radius");
}

TEST(Error, ReportsAreCountedAndOnceMeansOnce) {
  std::vector<Error> got;
  setReportSink([&](const Error& e) { got.push_back(e); });
  report(makeError(RiError::kRange, "x"));
  reportOnce("k", makeError(RiError::kRange, "y"));
  reportOnce("k", makeError(RiError::kRange, "y"));
  reportWarning(RiError::kMath, "w {}", 1);
  EXPECT_EQ(got.size(), 3u);
  EXPECT_EQ(reportCount(Severity::kWarning), 3);
  EXPECT_EQ(reportCount(Severity::kError), 2);
  EXPECT_EQ(lastError(), RiError::kMath);
  setReportSink({});
  EXPECT_EQ(reportCount(Severity::kInfo), 0);
}

TEST(Error, AHundredMessagesOfOneShapeAreEnough) {
  setReportSink({});
  setLogLevel(Severity::kError);  // --quiet
  testing::internal::CaptureStderr();
  for (int i = 0; i < 500; ++i)
    report(makeError(RiError::kNoFile, "there is no texture \"a{}\" in {}", i, i));
  report(makeError(RiError::kRange, "something else"));
  const std::string text = testing::internal::GetCapturedStderr();
  setLogLevel(Severity::kInfo);
  EXPECT_NE(text.find("\"a99\""), std::string::npos);
  EXPECT_EQ(text.find("\"a100\""), std::string::npos);
  EXPECT_NE(text.find("more messages like the last one"), std::string::npos) << "as loud as they are";
  EXPECT_NE(text.find("something else"), std::string::npos);
  EXPECT_EQ(reportCount(Severity::kError), 501);
  setReportSink({});
}

TEST(Error, AbortModeAsksToStopAtErrorsOnly) {
  setReportSink([](const Error&) {});
  setErrorMode(ErrorMode::kAbort);
  reportWarning(RiError::kRange, "w");
  EXPECT_FALSE(abortRequested());
  report(makeError(RiError::kRange, "e"));
  EXPECT_TRUE(abortRequested());
  setErrorMode(ErrorMode::kPrint);
  setReportSink({});
}

Result<int> half(int x) {
  if (x % 2) return makeError(RiError::kRange, "{} is odd", x);
  return x / 2;
}

TEST(Error, ResultHoldsValueOrError) {
  EXPECT_EQ(*half(4), 2);
  ASSERT_FALSE(half(3));
  EXPECT_EQ(half(3).error().message, "3 is odd");
}

}  // namespace
}  // namespace fr
