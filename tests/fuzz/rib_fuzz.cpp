// libFuzzer: any bytes through the RIB reader into the graphics state.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "ri/reader.h"
#include "ri/state_renderer.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  fr::setReportSink([](const fr::Error&) {});
  fr::ri::StateRenderer state;
  fr::ri::ReaderOptions options;
  options.maxArchiveDepth = 8;
  fr::ri::Reader reader(state, options);
  const fr::Result<void> r = reader.readBuffer({reinterpret_cast<const char*>(data), size});
  (void)r;  // failing is fine, crashing is not
  state.finish();
  fr::setErrorMode(fr::ErrorMode::kPrint);
  return 0;
}
