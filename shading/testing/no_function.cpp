#include "shadeop.h"
SHADEOP_TABLE(broken) = {{"float missing_call(float)", "", ""}, {"", "", ""}};
