// What shading_bench runs: a shader with its lights and parameters, and what the hand-written version is
// told.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "bench/shading/hand.h"
#include "shading/shader_instance.h"

namespace fr::bench {

struct LightCase {
  std::string shader;  // a standard one
  std::vector<ParameterSetting> settings;
  HandLight hand;
};

struct Case {
  std::string name;
  std::string source;  // RSL text; "": the standard shader `shader`
  std::string shader;
  std::vector<ParameterSetting> settings;
  std::vector<LightCase> lights;
  std::string hand;  // of hand_table.cpp
  std::function<void(HandTask&)> tell;
  double goal = 2.0;        // times hand-written at 256 points
  double tolerance = 1e-3;  // of the results, relative to 1 or more
  bool meansOnly = false;   // random numbers differ: the means of the batch are compared
  bool comparePN = false;   // displacement: P and N are the results
  bool usesTexture = false;
};

/// Every standard shader, and the patterns that shading is made of.
std::vector<Case> allCases(const std::string& textureFile);

}  // namespace fr::bench
