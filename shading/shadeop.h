/* DSO shadeops: functions of the shading language that are written in C or C++. For those who write them;
   docs/shadeops.md explains every line. Plain C, needs nothing else.

   A shader that calls foo() and has no function foo() gets it from a shared object with one of these tables:

     SHADEOP_TABLE(foo)      functions that are called for one point (the interface of PRMan 3.8-12)
     FR_SHADEOP_TABLE(foo)   functions that are called for a whole batch of points; preferred where both exist

   A function may run in several threads at once. init runs once in each thread before its first call,
   shutdown once for each init after the last frame. */
#ifndef FRANKENRENDER_SHADEOP_H
#define FRANKENRENDER_SHADEOP_H

#include <stddef.h>

#ifdef __cplusplus
#define FR_SHADEOP_C extern "C"
#else
#define FR_SHADEOP_C
#endif
#if defined(__GNUC__)
#define FR_SHADEOP_VISIBLE __attribute__((visibility("default")))
#else
#define FR_SHADEOP_VISIBLE
#endif

/* One overload: "float cname(point, float)", and the names of its init and shutdown functions or "". A table
   ends with an entry whose opspec is "". */
typedef struct {
  const char* opspec;
  const char* init;
  const char* shutdown;
} SHADEOP_SPEC;

/* A string argument. To return text: copy it to s if it has room (bufflen bytes, with the 0), else realloc s
   and set bufflen. */
typedef struct {
  char* s;
  int bufflen;
} STRING_DESC;

/* ---- one point a call ----
   argv[0] is the result, argv[1] .. the arguments: float*, float[3], float[16] (row vectors) or STRING_DESC*;
   arrays are consecutive elements. argc counts the result, also where it is void. Returns 0. */
#ifdef __cplusplus
#define SHADEOP_TABLE(name)                                           \
  extern "C" FR_SHADEOP_VISIBLE const SHADEOP_SPEC name##_shadeops[]; \
  const SHADEOP_SPEC name##_shadeops[]
#else
#define SHADEOP_TABLE(name) FR_SHADEOP_VISIBLE const SHADEOP_SPEC name##_shadeops[]
#endif
#define SHADEOP(method) FR_SHADEOP_C FR_SHADEOP_VISIBLE int method(void* initdata, int argc, void** argv)
#define SHADEOP_INIT(method) FR_SHADEOP_C FR_SHADEOP_VISIBLE void* method(int ctx, void* texturectx)
#define SHADEOP_SHUTDOWN(method) FR_SHADEOP_C FR_SHADEOP_VISIBLE void method(void* initdata)
#define SHADEOP_CLEANUP(method) SHADEOP_SHUTDOWN(method)

/* ---- a batch of points a call ---- */
#define FR_SHADEOP_VERSION 1

/* A column of values. Component c of lane i is data[c * component + (varying ? i : 0)]; see fr_shadeop_at().
 */
typedef struct {
  float* data;         /* null for strings; 64-byte aligned */
  size_t component;    /* floats from one component to the next */
  int components;      /* 1, 3 or 16, times the elements of an array */
  int varying;         /* 0: one value for all lanes */
  int written;         /* the result, or declared `output`: for active lanes only */
  STRING_DESC* string; /* null for numbers */
} FrShadeopArg;

typedef struct {
  int version;             /* FR_SHADEOP_VERSION */
  int lanes;               /* a multiple of 16, or 1 when nothing varies */
  const int* mask;         /* by lane: 0 is a point that is not to be touched */
  int argc;                /* counts the result */
  const FrShadeopArg* arg; /* [0] is the result */
  const char* shader;      /* its name, for messages */
} FrShadeopBatch;

#ifdef __cplusplus
#define FR_SHADEOP_TABLE(name)                                           \
  extern "C" FR_SHADEOP_VISIBLE const SHADEOP_SPEC name##_fr_shadeops[]; \
  const SHADEOP_SPEC name##_fr_shadeops[]
#else
#define FR_SHADEOP_TABLE(name) FR_SHADEOP_VISIBLE const SHADEOP_SPEC name##_fr_shadeops[]
#endif
/* Returns 0; anything else is reported once, and the results count nevertheless. */
#define FR_SHADEOP(method) \
  FR_SHADEOP_C FR_SHADEOP_VISIBLE int method(void* initdata, const FrShadeopBatch* batch)

static inline float* fr_shadeop_at(const FrShadeopArg* a, int component, int lane) {
  return a->data + (size_t)component * a->component + (a->varying ? lane : 0);
}

#endif
