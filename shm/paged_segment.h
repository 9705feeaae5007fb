// A segment that this process's pager may let go of.
#pragma once

#include <utility>

#include "shm/pager.h"
#include "shm/segment.h"

namespace fr::shm {

/// Stays where it is: the pager holds its address.
class PagedSegment {
 public:
  explicit PagedSegment(Segment s)
      : segment(std::move(s)),
        paged_({segment.data(), [this] { return segment.size(); }, segment.descriptor(), 0}) {}
  PagedSegment(const PagedSegment&) = delete;
  PagedSegment& operator=(const PagedSegment&) = delete;

  Segment segment;

 private:
  PagedMapping paged_;  // ends before the mapping does
};

}  // namespace fr::shm
