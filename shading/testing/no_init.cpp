#include "shadeop.h"
SHADEOP_TABLE(broken) = {{"float broken_call(float)", "missing_init", ""}, {"", "", ""}};
SHADEOP(broken_call) { return initdata && argc && argv; }
