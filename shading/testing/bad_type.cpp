#include "shadeop.h"
SHADEOP_TABLE(broken) = {{"flot broken_call(float)", "", ""}, {"", "", ""}};
SHADEOP(broken_call) { return initdata && argc && argv; }
