// Every request of RIB has its C functions.
#include <dlfcn.h>
#include <gtest/gtest.h>

#include <set>

#include "ri/request_parser.h"

namespace fr::ri {
namespace {

TEST(CBindingTable, EveryRequestHasItsFunction) {
  void* library = ::dlopen(FR_LIBRI, RTLD_NOW | RTLD_LOCAL);
  ASSERT_NE(library, nullptr) << ::dlerror();
  // Requests of RIB alone, and such that are read and ignored.
  const std::set<std::string_view> none = {"version", "EditBegin", "EditEnd", "VolumePixelSamples", "System"};
  for (const std::string_view name : requestNames()) {
    if (none.count(name)) continue;
    const std::string function = "Ri" + std::string(name);
    EXPECT_NE(::dlsym(library, function.c_str()), nullptr) << function;
  }
  ::dlclose(library);
}

}  // namespace
}  // namespace fr::ri
