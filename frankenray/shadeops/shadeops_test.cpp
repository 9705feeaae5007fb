// rayserver.so in the hands of other renderers: testing/shadeop_host.cpp drives it as they do, against a real
// server.
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <set>

#include "frankenray/testing/small_scene.h"

namespace fr::test {
namespace {

/// The arguments that rayserver.h adds: current space is the world seen from 10 further down z, mirrored in
/// x.
constexpr const char* kFrame = " point=0,0,10 vector=-1,0,0 vector=0,1,0 vector=0,0,1";

class Shadeops : public testing::TestWithParam<const char*> {
 protected:
  Outcome host(const std::string& input, const std::map<std::string, std::string>& environment = {},
               int threads = 1) {
    return runProgram(
        {std::string(FR_BINARY_DIR) + "/tests/shadeop_host", GetParam(),
         std::string(FR_BINARY_DIR) + "/lib/frankenrender/shadeops/rayserver.so", std::to_string(threads)},
        input, environment, scene_.folder());
  }
  Outcome served(const std::string& input, int threads = 1,
                 std::map<std::string, std::string> environment = {}) {
    environment.emplace("RAYSERVER", scene_.command());
    environment.emplace("RAYSERVER_BIAS", "0");
    return host(input, environment, threads);
  }
  SmallScene scene_;
};

void expectNumbers(const std::string& line, const std::vector<double>& wanted) {
  const std::vector<double> got = numbers(line);
  ASSERT_EQ(got.size(), wanted.size()) << line;
  for (size_t i = 0; i < got.size(); ++i)
    EXPECT_NEAR(got[i], wanted[i], 2e-5 * std::max(1.0, std::abs(wanted[i]))) << i << " in " << line;
}

TEST_P(Shadeops, AnswersAreThoseOfTheScene) {
  const Outcome o =
      served(std::string("color rayserver_trace point=0,0,-3 vector=0,0,2\n"
                         "color rayserver_trace point=0,0,-3 vector=0,1,0\n"
                         "color rayserver_visibility point=0.5,0,0 point=0.5,0,4\n"
                         "color rayserver_visibility point=0.5,0,0 point=0.5,0,1.5\n"
                         "color rayserver_visibility point=5,0,0 point=5,0,4\n") +
             "float rayserver_rayhittest point=0.5,0.25,-3 vector=0,0,2 point=9,9,9 vector=8,8,8" + kFrame +
             "\nfloat rayserver_rayhittest point=0.5,0.25,-3 vector=0,0,-2 point=9,9,9 vector=8,8,8" +
             kFrame + "\n");
  ASSERT_EQ(o.exitCode, 0) << o.err;
  EXPECT_EQ(o.err, "");
  const auto lines = o.lines();
  ASSERT_EQ(lines.size(), 7u) << o.out;
  expectNumbers(lines[0], {1, 0.5, 0.25, 0, 0, -3, 0, 0, 2});
  expectNumbers(lines[1], {0, 0, 0, 0, 0, -3, 0, 1, 0});
  expectNumbers(lines[2], {0, 0, 0, 0.5, 0, 0, 0.5, 0, 4});
  expectNumbers(lines[3], {1, 1, 1, 0.5, 0, 0, 0.5, 0, 1.5});
  expectNumbers(lines[4], {0.75, 0.5, 0.25, 5, 0, 0, 5, 0, 4});
  // The hit comes back in current space; inputs come back as they were.
  std::vector<double> hit = numbers(lines[5]);
  ASSERT_EQ(hit.size(), 25u - 0u - 0u) << lines[5];
  EXPECT_NEAR(hit[0], 5, 1e-5);
  EXPECT_NEAR(hit[7], -0.5, 1e-5);
  EXPECT_NEAR(hit[8], 0.25, 1e-5);
  EXPECT_NEAR(hit[9], 12, 1e-4);
  EXPECT_NEAR(std::abs(hit[12]), 1, 1e-5);
  std::vector<double> miss = numbers(lines[6]);
  EXPECT_FLOAT_EQ(float(miss[0]), 1e38f);
  for (size_t i = 7; i < 13; ++i) EXPECT_EQ(miss[i], i < 10 ? 9 : 8);
}

TEST_P(Shadeops, FullTraceTellsWhereRaysLeft) {
  const std::string call = "float rayserver_fulltrace point=0,0,-3 vector=";
  const std::string outputs = " color=9,9,9 float=9 point=9,9,9 normal=9,9,9 point=9,9,9 vector=9,9,9";
  const Outcome o =
      served(call + "0,0,1" + outputs + kFrame + "\n" + call + "1,2,0" + outputs + kFrame + "\n");
  ASSERT_EQ(o.exitCode, 0) << o.err;
  const auto lines = o.lines();
  ASSERT_EQ(lines.size(), 2u) << o.out;
  // depth, from, direction, color, distance, Phit, Nhit, Pmiss, Rmiss, frame
  std::vector<double> hit = numbers(lines[0]), miss = numbers(lines[1]);
  ASSERT_EQ(hit.size(), 35u) << lines[0];
  EXPECT_EQ(hit[0], 0);
  EXPECT_NEAR(hit[7], 1, 1e-5);
  EXPECT_NEAR(hit[8], 0.5, 1e-5);
  EXPECT_NEAR(hit[9], 0.25, 1e-5);
  EXPECT_NEAR(hit[10], 5, 1e-5);
  EXPECT_NEAR(hit[13], 12, 1e-4);
  for (size_t i = 17; i < 23; ++i) EXPECT_EQ(hit[i], 9);
  EXPECT_EQ(miss[0], 1);
  EXPECT_FLOAT_EQ(float(miss[10]), 1e30f);
  for (size_t i = 7; i < 10; ++i) EXPECT_EQ(miss[i], 0);
  for (size_t i = 11; i < 17; ++i) EXPECT_EQ(miss[i], 9);
  EXPECT_NEAR(miss[17], 0, 1e-5);
  EXPECT_NEAR(miss[18], 0, 1e-5);
  EXPECT_NEAR(miss[19], 7, 1e-4);
  EXPECT_NEAR(miss[20], -1, 1e-5);
  EXPECT_NEAR(miss[21], 2, 1e-5);
  EXPECT_NEAR(miss[22], 0, 1e-5);
}

TEST_P(Shadeops, EveryMixOfGeometricTypes) {
  const char* const types[3] = {"point", "vector", "normal"};
  std::string input;
  for (const std::string a : types)
    for (const std::string b : types) {
      input += "color rayserver_trace " + a + "=0,0,-3 " + b + "=0,0,1\n";
      input += "color rayserver_visibility " + a + "=0,0,-3 " + b + "=0,0,1\n";
      input += "color rayserver_indirect " + a + "=0,0,-3 " + b + "=0,0,-1\n";
      for (const std::string c : types)
        for (const std::string d : types)
          input +=
              "float rayserver_rayhittest " + a + "=0,0,-3 " + b + "=0,0,1 " + c + " " + d + kFrame + "\n";
    }
  Outcome o = served(input);
  ASSERT_EQ(o.exitCode, 0) << o.err;
  EXPECT_EQ(o.lines().size(), 9u * (3 + 9));
  EXPECT_EQ(o.out.find("no such"), std::string::npos);

  input.clear();
  for (int k = 0; k < 729; ++k) {
    std::string t[6];
    for (int i = 0, rest = k; i < 6; ++i, rest /= 3) t[i] = types[rest % 3];
    input = "float rayserver_fulltrace " + t[0] + " " + t[1] + "=0,0,1 color float " + t[2] + " " + t[3] +
            " " + t[4] + " " + t[5] + kFrame + "\n" + input;
    if (k % 243 != 242) continue;
    o = served(input);
    ASSERT_EQ(o.exitCode, 0) << o.err;
    EXPECT_EQ(o.lines().size(), 243u);
    EXPECT_EQ(o.out.find("no such"), std::string::npos);
    input.clear();
  }
  // Types match exactly: what is not there is not found.
  EXPECT_EQ(served("color rayserver_trace point=0,0,0 color=0,0,1\n").out, "no such entry\n");
}

TEST_P(Shadeops, OldHeadersAndLevels) {
  const Outcome o = served(
      "float raylevel\nfloat isshadowray\n"
      "color rayserver point=0,0,-3 vector=0,0,2\n"
      "color rayserver point=5,0,0 point=5,0,4\n"
      "float rayserver point=0.5,0,-3 vector=0,0,2 point vector\n"
      "color rayserver point=0,0,0 float=4 string=lamp\n"
      "color rayserver point=0,0,0 float=4 string=lamp\n");
  ASSERT_EQ(o.exitCode, 0) << o.err;
  const auto lines = o.lines();
  ASSERT_EQ(lines.size(), 7u) << o.out;
  EXPECT_EQ(lines[0], "0");
  EXPECT_EQ(lines[1], "0");
  expectNumbers(lines[2], {1, 0.5, 0.25, 0, 0, -3, 0, 0, 2});
  expectNumbers(lines[3], {0.75, 0.5, 0.25, 5, 0, 0, 5, 0, 4});
  EXPECT_NEAR(numbers(lines[4])[7], 0.5, 1e-5);
  EXPECT_NEAR(numbers(lines[4])[9], 2, 1e-4);  // world space, as they had it
  EXPECT_EQ(lines[6].substr(0, 5), "1 1 1");
  EXPECT_EQ(lines[6].substr(lines[6].size() - 4), "lamp");
  EXPECT_NE(o.err.find("areashadow"), std::string::npos);
  EXPECT_EQ(o.err.find("areashadow"), o.err.rfind("areashadow")) << "said once";
}

TEST_P(Shadeops, IndirectIsTheMeanOverTheHemisphere) {
  // Close before the wall everything that comes is the wall's.
  const Outcome o = served(
      "color rayserver_indirect point=0,0,1.9999 normal=0,0,1\n"
      "color rayserver_indirect point=0,0,1.9999 normal=0,0,-3\n"
      "color rayserver_indirect point=0,0,0 normal=0,0,0\n");
  const auto lines = o.lines();
  ASSERT_EQ(lines.size(), 3u) << o.err;
  expectNumbers(lines[0], {1, 0.5, 0.25, 0, 0, 1.9999, 0, 0, 1});
  EXPECT_EQ(lines[1].substr(0, 5), "0 0 0");
  EXPECT_EQ(lines[2].substr(0, 5), "0 0 0");
}

TEST_P(Shadeops, StartsAheadByTheBias) {
  const std::string call =
      "float rayserver_rayhittest point=0,0,2 vector=0,0,1 point vector" + std::string(kFrame) + "\n";
  const std::string there =
      "float rayserver_rayhittest point=0,0,1 vector=0,0,1 point vector" + std::string(kFrame) + "\n";
  const std::string shadow = "color rayserver_visibility point=0,0,2 point=0,0,1\n";
  const Outcome o = served(call + there + shadow, 1, {{"RAYSERVER_BIAS", "0.01"}});
  const auto lines = o.lines();
  ASSERT_EQ(lines.size(), 3u) << o.err;
  EXPECT_FLOAT_EQ(float(numbers(lines[0])[0]), 1e38f);
  EXPECT_NEAR(numbers(lines[1])[0], 1, 1e-5) << "distances count from the shader's point";
  EXPECT_EQ(lines[2].substr(0, 5), "1 1 1");
}

TEST_P(Shadeops, TimesAreJitteredWhenAsked) {
  // A wall that goes from z = 2 to z = 3 while the shutter is open: the distance tells the time.
  std::ofstream(scene_.folder() / "time.rib")
      << "Shutter 0 1\nProjection \"perspective\"\nTranslate 0 0 100\nWorldBegin\n"
         "MotionBegin [0 1]\nTranslate 0 0 0\nTranslate 0 0 1\nMotionEnd\n"
         "Polygon \"P\" [-1 -1 2  -1 1 2  1 1 2  1 -1 2]\nWorldEnd\n";
  const std::string command = rendrib() + " -rayserver " + (scene_.folder() / "time.rib").string();
  std::string calls;
  for (int i = 0; i < 8; ++i)
    calls += "float rayserver_rayhittest point=0,0." + std::to_string(i) + ",-3 vector=0,0,2 point vector" +
             kFrame + "\n";
  const Outcome still = served(calls, 1, {{"RAYSERVER", command}, {"RAYSERVER_JITTER_TIMES", "0"}});
  for (const std::string& line : still.lines()) EXPECT_NEAR(numbers(line)[0], 5, 1e-5) << line;
  const std::map<std::string, std::string> asked{{"RAYSERVER", command}, {"RAYSERVER_JITTER_TIMES", "1"}};
  const Outcome jittered = served(calls, 1, asked);
  std::set<double> times;
  for (const std::string& line : jittered.lines()) {
    times.insert(numbers(line)[0]);
    EXPECT_GE(numbers(line)[0], 5);
    EXPECT_LT(numbers(line)[0], 6);
  }
  EXPECT_EQ(times.size(), 8u) << jittered.out << jittered.err;
  EXPECT_EQ(served(calls, 1, asked).out, jittered.out) << "a ray has one time, whoever asks and when";
}

TEST_P(Shadeops, OneServerForManyThreadsAndInits) {
  const int threads = std::string(GetParam()) == "pixie" ? 8 : 1;
  const Outcome o = served(
      "repeat 200 color rayserver_visibility point=5,0,0 point=5,0,4\n"
      "repeat 200 color rayserver_trace point=0,0,-3 vector=0,0,2\nchildren\n"
      "shutdown\nchildren\ncolor rayserver_trace point=0,0,-3 vector=0,0,2\nchildren\n",
      threads);
  ASSERT_EQ(o.exitCode, 0) << o.err;
  const auto lines = o.lines();
  ASSERT_EQ(lines.size(), 6u) << o.out;
  expectNumbers(lines[0], {0.75, 0.5, 0.25, 5, 0, 0, 5, 0, 4});
  expectNumbers(lines[1], {1, 0.5, 0.25, 0, 0, -3, 0, 0, 2});
  EXPECT_EQ(lines[2], "1");
  EXPECT_EQ(lines[3], "0") << "the last shutdown ends the server";
  expectNumbers(lines[4], {1, 0.5, 0.25, 0, 0, -3, 0, 0, 2});
  EXPECT_EQ(lines[5], "1");
}

TEST_P(Shadeops, AServerThatIsKilledIsReplaced) {
  const std::string call = "color rayserver_trace point=0,0,-3 vector=0,0,2\n";
  const Outcome o = served(call + "kill\n" + call + "kill\nrepeat 50 " + call + "children\n", 4);
  ASSERT_EQ(o.exitCode, 0) << o.err;
  const auto lines = o.lines();
  ASSERT_EQ(lines.size(), 4u) << o.out;
  for (int i = 0; i < 3; ++i) expectNumbers(lines[size_t(i)], {1, 0.5, 0.25, 0, 0, -3, 0, 0, 2});
  EXPECT_EQ(lines[3], "1");
  EXPECT_NE(o.err.find("killed"), std::string::npos) << o.err;
}

TEST_P(Shadeops, AServerThatKeepsDyingIsGivenUp) {
  const std::string call = "color rayserver_visibility point=0,0,-3 point=0,0,5\n";
  std::string input;
  for (int i = 0; i < 6; ++i) input += call + "kill\n";
  const Outcome o = served(input + call);
  ASSERT_EQ(o.exitCode, 0) << o.err;
  const auto lines = o.lines();
  ASSERT_EQ(lines.size(), 7u) << o.out;
  EXPECT_EQ(lines.front().substr(0, 5), "0 0 0");
  EXPECT_EQ(lines.back().substr(0, 5), "1 1 1");
  EXPECT_NE(o.err.find("keeps going away"), std::string::npos) << o.err;
}

TEST_P(Shadeops, WithoutAServerNothingIsHit) {
  const std::string calls =
      "color rayserver_trace point=0,0,-3 vector=0,0,2\n"
      "color rayserver_visibility point=0,0,-3 point=0,0,5\n"
      "float rayserver_rayhittest point=0,0,-3 vector=0,0,2 point=9,9,9 vector=8,8,8" +
      std::string(kFrame) +
      "\nfloat rayserver_fulltrace point=0,0,-3 vector=0,0,2 color float point=9,9,9 normal=9,9,9 point "
      "vector" +
      " point=0,0,0 vector=1,0,0 vector=0,1,0 vector=0,0,1\ncolor rayserver_indirect point=0,0,1 "
      "normal=0,0,1\n";
  const auto expectMisses = [&](const Outcome& o) {
    ASSERT_EQ(o.exitCode, 0) << o.err;
    const auto lines = o.lines();
    ASSERT_EQ(lines.size(), 5u) << o.out;
    EXPECT_EQ(lines[0].substr(0, 5), "0 0 0");
    EXPECT_EQ(lines[1].substr(0, 5), "1 1 1");
    EXPECT_FLOAT_EQ(float(numbers(lines[2])[0]), 1e38f);
    EXPECT_EQ(numbers(lines[2])[7], 9);
    const std::vector<double> full = numbers(lines[3]);
    EXPECT_EQ(full[0], 1);
    EXPECT_FLOAT_EQ(float(full[10]), 1e30f);
    EXPECT_EQ(full[19], -3);
    EXPECT_EQ(full[22], 2);
    EXPECT_EQ(lines[4].substr(0, 5), "0 0 0");
    EXPECT_NE(o.err.find("rayserver: no ray server"), std::string::npos);
    EXPECT_EQ(o.err.find("rayserver: no ray server"), o.err.rfind("rayserver: no ray server"))
        << "said once: " << o.err;
  };
  const Outcome unset = host(calls);
  expectMisses(unset);
  EXPECT_NE(unset.err.find("RAYSERVER is not set"), std::string::npos);
  const Outcome missing = host(calls, {{"RAYSERVER", "/nowhere/rendrib -rayserver scene.rib"}});
  expectMisses(missing);
  EXPECT_NE(missing.err.find("/nowhere/rendrib"), std::string::npos);
  expectMisses(host(calls, {{"RAYSERVER", "@no-such-server"}}));
  expectMisses(host(calls, {{"RAYSERVER", "/bin/true"}}));
  expectMisses(host(calls, {{"RAYSERVER", "   "}}));
  expectMisses(host(calls, {{"RAYSERVER", rendrib() + " -rayserver 'no end"}}));
}

TEST_P(Shadeops, AForkedChildHasAServerOfItsOwn) {
  const std::string call = "color rayserver_trace point=0,0,-3 vector=0,0,2\n";
  // A child leaves alone what it inherited, which belongs to its parent: LeakSanitizer would call that a
  // leak.
  const Outcome o = served(call + "fork\n" + call + call, 1, {{"ASAN_OPTIONS", "detect_leaks=0"}});
  ASSERT_EQ(o.exitCode, 0) << o.err;
  const auto lines = o.lines();
  ASSERT_EQ(lines.size(), 5u) << o.out;
  int child = 0;
  for (std::string line : lines) {
    if (line.starts_with("child: ")) line = line.substr(7), ++child;
    expectNumbers(line, {1, 0.5, 0.25, 0, 0, -3, 0, 0, 2});
  }
  EXPECT_EQ(child, 2);
  EXPECT_EQ(o.err, "");
}

TEST_P(Shadeops, PipeAnswersAreTheSame) {
  const std::string calls =
      "repeat 20 color rayserver_visibility point=5,0,0 point=5,0,4\n"
      "float rayserver_rayhittest point=0.123,0.7,-3 vector=0.1,-0.05,2 point vector" +
      std::string(kFrame) + "\nkill\ncolor rayserver_trace point=0,0,-3 vector=0,0,2\n";
  const Outcome shm = served(calls), pipe = served(calls, 1, {{"RAYSERVER_TRANSPORT", "pipe"}});
  EXPECT_EQ(pipe.exitCode, 0) << pipe.err;
  EXPECT_EQ(shm.lines().size(), 3u) << shm.err;
  EXPECT_EQ(shm.out, pipe.out);
}

INSTANTIATE_TEST_SUITE_P(Hosts, Shadeops, testing::Values("aqsis", "pixie"),
                         [](const auto& p) { return std::string(p.param); });

}  // namespace
}  // namespace fr::test
