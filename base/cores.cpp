#include "base/cores.h"

#include <sched.h>

#include <algorithm>
#include <thread>

namespace fr {

int availableCores() {
  cpu_set_t set;
  if (::sched_getaffinity(0, sizeof(set), &set) == 0) return std::max(1, CPU_COUNT(&set));
  return std::max(1, int(std::thread::hardware_concurrency()));  // more processors than cpu_set_t holds
}

}  // namespace fr
