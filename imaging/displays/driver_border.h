// What the drivers written in C++ share: exceptions stop here.
#pragma once

#include <cstdio>
#include <exception>
#include <string>

#include "imaging/display_driver.h"

namespace fr::display {

inline int fail(char* message, size_t size, const std::string& what) {
  if (size > 0) std::snprintf(message, size, "%s", what.c_str());
  return 1;
}

/// Runs f, which returns a reason for failure or "".
template <class F>
int guarded(char* message, size_t size, F&& f) {
  try {
    const std::string reason = f();
    return reason.empty() ? 0 : fail(message, size, reason);
  } catch (const std::exception& e) {
    return fail(message, size, e.what());
  } catch (...) {
    return fail(message, size, "unknown exception");
  }
}

inline const FrDisplayParameter* find(const FrDisplayImage& image, const std::string& name, int type) {
  for (int i = 0; i < image.parameterCount; ++i)
    if (image.parameters[i].type == type && name == image.parameters[i].name && image.parameters[i].count > 0)
      return &image.parameters[i];
  return nullptr;
}
inline std::string findString(const FrDisplayImage& image, const std::string& name,
                              const std::string& otherwise) {
  const FrDisplayParameter* p = find(image, name, FR_DISPLAY_TYPE_STRING);
  return p ? static_cast<const char* const*>(p->values)[0] : otherwise;
}

}  // namespace fr::display
