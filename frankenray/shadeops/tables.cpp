// What renderers look up: for each function the overloads that a compiler may ask for.
//
// Types match exactly in a host, and some type expressions like normalize(I) or A - B as points: each
// geometric argument comes as point, vector and normal. The first entry is the usual mix: hosts search in
// order. A function of the shading language and its C function have different names where one serves several.
#include "frankenray/shadeops/shadeop_abi.h"

// One entry; the types stand in the text of the spec.
#define ENTRY(returned, function, arguments) \
  {returned " " function "(" arguments ")", "rayserver_init", "rayserver_shutdown"},
#define LAST \
  { "", "", "" }

// The world's origin and axes in current space (rayserver.h puts the casts in).
#define FRAME ", point, vector, vector, vector"

#define COLOR_OF_TWO(function, a, b) ENTRY("color", function, a ", " b)

#define HITTEST(a, b, c, d) ENTRY("float", "rayserver_rayhittest", a ", " b ", " c ", " d FRAME)
// Three at a time: what follows a macro's call is laid out anew by each run of clang-format when there is
// more.
#define HITTEST_3(a, b, c) HITTEST(a, b, c, "vector") HITTEST(a, b, c, "normal") HITTEST(a, b, c, "point")
#define HITTEST_OUT(a, b) HITTEST_3(a, b, "point") HITTEST_3(a, b, "vector") HITTEST_3(a, b, "normal")
#define FROM_3(M, a) M(a, "vector") M(a, "point") M(a, "normal")
#define FROM(M) FROM_3(M, "point") FROM_3(M, "vector") FROM_3(M, "normal")

#define FULLTRACE(a, b, c, d, e, f) \
  ENTRY("float", "rayserver_fulltrace", a ", " b ", color, float, " c ", " d ", " e ", " f FRAME)
#define FULLTRACE_4(a, b, c, d, e) \
  FULLTRACE(a, b, c, d, e, "vector") FULLTRACE(a, b, c, d, e, "point") FULLTRACE(a, b, c, d, e, "normal")
#define FULLTRACE_3(a, b, c, d) \
  FULLTRACE_4(a, b, c, d, "point") FULLTRACE_4(a, b, c, d, "vector") FULLTRACE_4(a, b, c, d, "normal")
#define FULLTRACE_2(a, b, c) \
  FULLTRACE_3(a, b, c, "vector") FULLTRACE_3(a, b, c, "normal") FULLTRACE_3(a, b, c, "point")
#define FULLTRACE_OUT(a, b) FULLTRACE_2(a, b, "point") FULLTRACE_2(a, b, "vector") FULLTRACE_2(a, b, "normal")

#define TRACE(a, b) COLOR_OF_TWO("rayserver_trace", a, b)
#define VISIBILITY(a, b) COLOR_OF_TWO("rayserver_visibility", a, b)
#define INDIRECT(a, b) COLOR_OF_TWO("rayserver_indirect", a, b)

FR_SHADEOP_EXPORT const ShadeopEntry rayserver_trace_shadeops[] = {FROM(TRACE) LAST};

FR_SHADEOP_EXPORT const ShadeopEntry rayserver_visibility_shadeops[] = {
    ENTRY("color", "rayserver_visibility", "point, point") FROM(VISIBILITY) LAST};

FR_SHADEOP_EXPORT const ShadeopEntry rayserver_indirect_shadeops[] = {
    ENTRY("color", "rayserver_indirect", "point, normal") FROM(INDIRECT) LAST};

FR_SHADEOP_EXPORT const ShadeopEntry rayserver_rayhittest_shadeops[] = {FROM(HITTEST_OUT) LAST};

FR_SHADEOP_EXPORT const ShadeopEntry rayserver_fulltrace_shadeops[] = {FROM(FULLTRACE_OUT) LAST};

FR_SHADEOP_EXPORT const ShadeopEntry raylevel_shadeops[] = {ENTRY("float", "rayserver_zero", "") LAST};
FR_SHADEOP_EXPORT const ShadeopEntry isshadowray_shadeops[] = {ENTRY("float", "rayserver_zero", "") LAST};

// Shaders that were compiled with a rayserver.h of 1998-2000: one name, told apart by its arguments.
#define HITTEST_1998(c, d) ENTRY("float", "rayserver_rayhittest_1998", "point, vector, " c ", " d)
#define FULLTRACE_1998(d, f) \
  ENTRY("float", "rayserver_fulltrace_1998", "point, vector, color, float, point, " d ", point, " f)

FR_SHADEOP_EXPORT const ShadeopEntry rayserver_shadeops[] = {
    ENTRY("color", "rayserver_trace", "point, vector") ENTRY("color", "rayserver_visibility", "point, point")
        HITTEST_1998("point", "vector") HITTEST_1998("point", "normal") FULLTRACE_1998("vector", "vector")
            FULLTRACE_1998("vector", "point") FULLTRACE_1998("normal", "vector") FULLTRACE_1998(
                "normal", "point") ENTRY("color", "rayserver_areashadow_1998", "point, float, string") LAST};

FR_SHADEOP_EXPORT const ShadeopEntry rayserver_photon_shadeops[] = {
    ENTRY("color", "rayserver_photon_1998", "point, vector, vector, vector")
        ENTRY("color", "rayserver_photon_1998", "point, vector, normal, vector") LAST};
