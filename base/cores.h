// How many processors this process may use.
#pragma once

namespace fr {

/// Processors that the scheduler lets this process run on (taskset, cpusets), at least 1: std::thread::
/// hardware_concurrency() counts those of the machine.
int availableCores();

}  // namespace fr
