// The ray server as the shadeops of one process see it.
//
// One session for the whole process, counted by the init and shutdown functions of the table and made at the
// first question; one line for every thread that asks, closed when the thread ends. Nothing here throws, ends
// the host or leaves it waiting. The host learns of trouble by one message on stderr; questions are then
// answered as if nothing were hit.
//
// Environment, read when a session is made:
//
// RAYSERVER: command line of the server to start ("rendrib -rayserver scene.rib"), or "@name" to join a
// running one.
//
// RAYSERVER_JITTER_TIMES: 1 gives rays times inside the shutter; 0 or unset, all at shutter open, as in 1998.
//
// RAYSERVER_BIAS: world units by which rays start ahead of their origin, default 0.01. The host's surface and
// the server's are different tessellations of the same thing.
//
// RAYSERVER_TRANSPORT: "pipe" for no shared memory.
#pragma once

#include <cstddef>
#include <cstdint>

#include "frankenray/frankenray.h"

namespace fr::shadeops {

/// Counts users of the session. Thread-safe.
void addUser();
/// The last one closes the session: the server ends if it was ours. A later question makes another.
void removeUser();

/// One ray, from this thread. False when there is no server or it went away for good; `hit` is then a miss.
/// Fills in time, seed and bias: ray.origin, direction, kind and level are the caller's. Distances count from
/// the given origin. Thread-safe.
bool ask(frankenray_ray& ray, frankenray_hit& hit);

/// Rays of one kind, FRANKENRAY_TRACE, that leave one point: the sum of their colours. False as above; the
/// sum is then 0. directions: count * 3 floats, of unit length.
bool sumOfTraces(const double origin[3], const float* directions, size_t count, float color[3]);

/// `text` to stderr with "rayserver: " before it, once in this process for each `key` (compared by address).
void sayOnce(const char* key, const char* text);

/// A hash of a ray: the path of its random numbers. The same ray gets the same answer from any thread.
uint64_t seedOf(const double origin[3], const double direction[3]);

}  // namespace fr::shadeops
