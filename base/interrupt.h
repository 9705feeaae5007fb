// The user's wish to end the program in order: Ctrl-C, kill.
#pragma once

namespace fr {

/// From now on abortRequested() is true. May be called by a signal handler.
void interrupt() noexcept;
bool interrupted() noexcept;

}  // namespace fr
