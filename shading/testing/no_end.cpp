#include "shadeop.h"
SHADEOP_TABLE(broken) = {{"float broken_call(float)", "", ""}};
SHADEOP(broken_call) { return initdata && argc && argv; }
