// The binary interface of DSO shadeops of PRMan 3.8-12, and what the renderers that took it over made of it.
//
// For a function foo() of the shading language a renderer looks in shared objects for the data symbol
// foo_shadeops: an array of entries, ended by one whose spec is "". A spec reads
// "rettype cname(type, type)"; it is matched exactly, types of all arguments included, and cname is the
// symbol to call. Hosts differ in whether argc counts the result, in how strings are passed and in what they
// expect a function to return: nothing here relies on any of it. argv[0] is the result, argv[1] ... are the
// arguments, in every host.
#pragma once

extern "C" {

/// One entry of a table. All three are strings, never null; init and shutdown are "" when there is none.
struct ShadeopEntry {
  const char* spec;
  const char* init;
  const char* shutdown;
};

using ShadeopFunction = int (*)(void* initdata, int argc, void** argv);
/// Called for every (shader, entry): the context is no thread, and the texture context may be null.
using ShadeopInit = void* (*)(int context, void* textures);
using ShadeopShutdown = void (*)(void* initdata);

}  // extern "C"

#define FR_SHADEOP_EXPORT extern "C" __attribute__((visibility("default")))
