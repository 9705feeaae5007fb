// What the allocator does with memory that was freed.
#pragma once

namespace fr {

/// From now on large freed blocks go back to the system at once. Otherwise the C library learns from the
/// first large block that is freed to keep such blocks: a sixth of what a frame holds, in which nothing is.
/// For main(), before threads start.
void returnFreedMemory();

}  // namespace fr
