// One scene through both hiders: REYES, and camera rays. Each gets a cache of its own, so neither profits
// from what the other diced.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "imaging/film.h"
#include "reyes/renderer.h"
#include "tracer/render.h"

namespace fr::test {

/// All channels of a frame, before exposure: R G B A Z, then output variables.
struct Channels {
  int width = 0, height = 0;
  std::vector<std::vector<float>> values;
  float at(size_t channel, size_t pixel) const { return values[channel][pixel]; }
};

struct HiderPair {
  Channels reyes, rays;
};

/// The scene by one hider; `options` but for its callbacks and displays. Messages of any kind, and frames
/// that cannot be made, fail the test, unless `reports` wants them. `shaders`: RSL source by name, beside the
/// standard ones.
Channels renderByReyes(const std::string& rib, const std::map<std::string, std::string>& shaders = {},
                       const RenderOptions& options = {}, std::vector<Error>* reports = nullptr,
                       FrameStatistics* statistics = nullptr);
Channels renderByRays(const std::string& rib, const std::map<std::string, std::string>& shaders = {},
                      const tracer::TraceRenderOptions& options = {},
                      tracer::TraceRenderStatistics* statistics = nullptr,
                      std::vector<Error>* reports = nullptr);
HiderPair renderBoth(const std::string& rib, const std::map<std::string, std::string>& shaders = {},
                     std::vector<Error>* reports = nullptr);

/// How the pixels of two pictures differ.
struct Difference {
  size_t pixels = 0, covered = 0;
  size_t alpha = 0;         // pixels whose coverage differs
  size_t depth = 0;         // pixels that both see something in, at different depths
  double worstDepth = 0;    // relative, of those that agree
  double colorRms = 0;      // over all pixels and colours
  double alphaSum[2] = {};  // of REYES, of rays
  size_t outline = 0;       // pixels at a border of coverage or at a jump of depth: where noise can be
};
Difference compare(const HiderPair& pair, double depthTolerance);

}  // namespace fr::test
