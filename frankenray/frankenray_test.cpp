// libfrankenray as a program uses it, against a real server and a scene with known answers.
#include "frankenray/frankenray.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <random>
#include <span>
#include <thread>

#include "frankenray/testing/small_scene.h"

namespace fr::test {
namespace {

class Frankenray : public testing::TestWithParam<int> {  // the transport
 protected:
  void SetUp() override {
    setenv("FRANKENRAY_RENDRIB", rendrib().c_str(), 1);
    session_ = frankenray_create();
    options_.transport = GetParam();
  }
  void TearDown() override {
    frankenray_line_close(line_);
    frankenray_close(session_);
  }
  void start(std::string rib = {}) {
    if (rib.empty()) rib = scene_.rib();
    ASSERT_EQ(frankenray_start(session_, &options_, rib.c_str()), FRANKENRAY_OK)
        << frankenray_error_text(session_);
    line_ = frankenray_line_open(session_);
    ASSERT_NE(line_, nullptr);
  }
  /// Kills the server and waits until that is known.
  void killServer() {
    const int pid = frankenray_server_pid(session_);
    ASSERT_GT(pid, 1);
    ASSERT_EQ(kill(pid, SIGKILL), 0);
    while (frankenray_state(session_) == FRANKENRAY_OK) usleep(1000);
  }

  SmallScene scene_;
  frankenray_options options_ = FRANKENRAY_OPTIONS_INIT;
  frankenray_session* session_ = nullptr;
  frankenray_line* line_ = nullptr;
};

/// A sphere of radius 1 around the origin, coarse enough that its facets are seen; two walls in groups, one
/// behind the other, z = 3 and z = 4, 9 <= x <= 11; a wall at x = -10 whose colour tells the label of the
/// ray.
std::string writeSecondScene(const std::filesystem::path& folder) {
  std::ofstream(folder / "tag.sl")
      << "surface tag() { Oi = 1; Ci = raylabel() == \"mine\" ? color(0, 1, 0) : color(1, 0, 0); }";
  std::ofstream(folder / "second.rib") << R"(Display "none.exr" "file" "rgba"
Format 16 16 1
Projection "perspective" "fov" [40]
Option "searchpath" "string shader" [")"
                                       << folder.string() << R"(:&"]
Translate 0 0 100
WorldBegin
Surface "constant"
AttributeBegin
  ShadingRate 0.0001
  Sphere 1 -1 1 360
AttributeEnd
AttributeBegin
  Attribute "grouping" "string membership" ["front"]
  Polygon "P" [9 -1 3  9 1 3  11 1 3  11 -1 3]
  Attribute "grouping" "string membership" ["back,far"]
  Polygon "P" [9 -1 4  9 1 4  11 1 4  11 -1 4]
AttributeEnd
AttributeBegin
  Surface "tag"
  Polygon "P" [-10 -1 -1  -10 1 -1  -10 1 1  -10 -1 1]
AttributeEnd
WorldEnd
)";
  return (folder / "second.rib").string();
}

constexpr double kBehind[3] = {0, 0, -3}, kForward[3] = {0, 0, 2}, kBeyond[3] = {0, 0, 5};

/// Random rays around the scene, and where their answers go.
struct Many {
  std::vector<double> origin, target, position, missPosition;
  std::vector<float> direction, time, color, distance, normal, missDepth, missDirection;
  std::vector<uint64_t> seed;
  frankenray_rays rays = FRANKENRAY_RAYS_INIT;
  frankenray_answers answers = FRANKENRAY_ANSWERS_INIT;

  Many(int kind, size_t count) {
    std::mt19937 random(7);
    std::uniform_real_distribution<double> place(-3, 7), small(0, 1);
    for (size_t i = 0; i < count; ++i) {
      for (int c = 0; c < 3; ++c) {
        origin.push_back(place(random) - (c == 2 ? 3 : 0)), target.push_back(place(random));
        direction.push_back(float(target.back() - origin.back()));
      }
      time.push_back(float(small(random)));
      seed.push_back(random());
    }
    position.resize(3 * count), missPosition.resize(3 * count);
    color.resize(3 * count), distance.resize(count), normal.resize(3 * count);
    missDepth.resize(count), missDirection.resize(3 * count);
    rays.kind = kind, rays.count = count;
    rays.origin = {origin.data(), origin.data() + 1, origin.data() + 2, 3};
    rays.direction = {direction.data(), direction.data() + 1, direction.data() + 2, 3};
    rays.target = {target.data(), target.data() + 1, target.data() + 2, 3};
    rays.time = time.data(), rays.seed = seed.data();
    const auto points = [](std::vector<double>& v) {
      return frankenray_points_out{v.data(), v.data() + 1, v.data() + 2, 3};
    };
    const auto vectors = [](std::vector<float>& v) {
      return frankenray_vectors_out{v.data(), v.data() + 1, v.data() + 2, 3};
    };
    answers.color = vectors(color), answers.distance = distance.data(), answers.position = points(position);
    answers.normal = vectors(normal), answers.miss_depth = missDepth.data();
    answers.miss_position = points(missPosition), answers.miss_direction = vectors(missDirection);
  }
  frankenray_ray ray(size_t i) const {
    frankenray_ray r = FRANKENRAY_RAY_INIT;
    r.kind = rays.kind;
    for (size_t c = 0; c < 3; ++c) {
      r.origin[c] = origin[3 * i + c];
      r.direction[c] = rays.kind == FRANKENRAY_VISIBILITY ? target[3 * i + c] : double(direction[3 * i + c]);
    }
    r.time = time[i], r.seed = seed[i];
    return r;
  }
  frankenray_hit hit(size_t i) const {
    frankenray_hit h = FRANKENRAY_HIT_INIT;
    for (size_t c = 0; c < 3; ++c) {
      h.color[c] = color[3 * i + c], h.position[c] = position[3 * i + c], h.normal[c] = normal[3 * i + c];
      h.miss_position[c] = missPosition[3 * i + c], h.miss_direction[c] = missDirection[3 * i + c];
    }
    h.distance = distance[i], h.miss_depth = missDepth[i];
    return h;
  }
};

/// Bit by bit.
template <class Number>
bool sameBits(const Number (&a)[3], const Number (&b)[3]) {
  const auto x = std::as_bytes(std::span(a)), y = std::as_bytes(std::span(b));
  return std::equal(x.begin(), x.end(), y.begin());
}

bool same(const frankenray_hit& a, const frankenray_hit& b) {
  return sameBits(a.color, b.color) && a.distance == b.distance && sameBits(a.position, b.position) &&
         sameBits(a.normal, b.normal) && a.miss_depth == b.miss_depth &&
         sameBits(a.miss_position, b.miss_position) && sameBits(a.miss_direction, b.miss_direction);
}

TEST_P(Frankenray, SingleRaysHaveTheAnswersOfTheScene) {
  start();
  float color[3], distance = 0, normal[3];
  double position[3];
  const double side[3] = {0, 1, 0}, corner[3] = {5, 0, 0}, opposite[3] = {5, 0, 4};
  ASSERT_EQ(frankenray_trace(line_, kBehind, kForward, color), FRANKENRAY_OK)
      << frankenray_line_error_text(line_);
  EXPECT_NEAR(color[0], 1, 1e-5);
  EXPECT_NEAR(color[1], 0.5, 1e-5);
  EXPECT_NEAR(color[2], 0.25, 1e-5);
  ASSERT_EQ(frankenray_trace(line_, kBehind, side, color), FRANKENRAY_OK);
  EXPECT_EQ(color[0], 0);
  ASSERT_EQ(frankenray_visibility(line_, kBehind, kBeyond, color), FRANKENRAY_OK);
  EXPECT_EQ(color[1], 0);
  ASSERT_EQ(frankenray_visibility(line_, corner, opposite, color), FRANKENRAY_OK);
  EXPECT_NEAR(color[0], 0.75, 1e-5);
  EXPECT_NEAR(color[1], 0.5, 1e-5);
  EXPECT_NEAR(color[2], 0.25, 1e-5);
  ASSERT_EQ(frankenray_rayhittest(line_, kBehind, kForward, &distance, position, normal), FRANKENRAY_OK);
  EXPECT_NEAR(distance, 5, 1e-5) << "Euclidean, though the direction has length 2";
  EXPECT_NEAR(position[2], 2, 1e-5);
  EXPECT_NEAR(std::abs(normal[2]), 1, 1e-5);
  position[0] = 42;
  ASSERT_EQ(frankenray_rayhittest(line_, kBehind, side, &distance, position, nullptr), FRANKENRAY_OK);
  EXPECT_EQ(distance, FRANKENRAY_NO_HIT);
  EXPECT_EQ(position[0], 42);
  frankenray_hit hit = FRANKENRAY_HIT_INIT;
  ASSERT_EQ(frankenray_fulltrace(line_, kBehind, side, &hit), FRANKENRAY_OK);
  EXPECT_EQ(hit.miss_depth, 1);
  EXPECT_EQ(hit.distance, FRANKENRAY_NO_HIT_TRACE);
  EXPECT_NEAR(hit.miss_position[2], -3, 1e-5);
  EXPECT_NEAR(hit.miss_direction[1], 1, 1e-6);
}

TEST_P(Frankenray, BatchesAnswerAsSingleRaysDo) {
  start();
  for (int kind = FRANKENRAY_TRACE; kind <= FRANKENRAY_FULLTRACE; ++kind) {
    Many many(kind, 5000);
    ASSERT_EQ(frankenray_answer(line_, &many.rays, &many.answers), FRANKENRAY_OK)
        << frankenray_line_error_text(line_);
    size_t hits = 0;
    for (size_t i = 0; i < many.rays.count; i += 7) {
      const frankenray_ray ray = many.ray(i);
      frankenray_hit hit = FRANKENRAY_HIT_INIT;
      ASSERT_EQ(frankenray_ask(line_, &ray, &hit), FRANKENRAY_OK);
      ASSERT_TRUE(same(hit, many.hit(i))) << kind << " " << i;
      hits += kind == FRANKENRAY_VISIBILITY ? hit.color[0] < 1 : hit.distance < FRANKENRAY_NO_HIT_TRACE;
    }
    EXPECT_GT(hits, 5u) << "a test of misses alone";
  }
}

TEST_P(Frankenray, BatchesInFlightShareALine) {
  start();
  std::vector<std::unique_ptr<Many>> many;
  std::vector<frankenray_batch*> batches;
  const size_t counts[] = {0, 1, 3000, 1024, 20000, 7};
  for (size_t count : counts) {
    many.push_back(std::make_unique<Many>(FRANKENRAY_HITTEST, count));
    frankenray_batch* b = nullptr;
    ASSERT_EQ(frankenray_submit(line_, &many.back()->rays, &many.back()->answers, &b), FRANKENRAY_OK);
    batches.push_back(b);
  }
  float color[3];  // a single ray in between
  EXPECT_EQ(frankenray_trace(line_, kBehind, kForward, color), FRANKENRAY_OK)
      << frankenray_line_error_text(line_);
  EXPECT_EQ(frankenray_wait(batches[5]), FRANKENRAY_OK);
  while (frankenray_poll(batches[4]) == FRANKENRAY_PENDING) std::this_thread::yield();
  for (size_t k = 0; k < batches.size(); ++k) {
    EXPECT_EQ(frankenray_wait(batches[k]), FRANKENRAY_OK);
    EXPECT_EQ(frankenray_poll(batches[k]), FRANKENRAY_OK);
    Many alone(FRANKENRAY_HITTEST, counts[k]);
    ASSERT_EQ(frankenray_answer(line_, &alone.rays, &alone.answers), FRANKENRAY_OK);
    EXPECT_EQ(alone.distance, many[k]->distance);
    EXPECT_EQ(alone.position, many[k]->position);
    frankenray_release(batches[k]);
  }
  frankenray_statistics s;
  s.size = sizeof s;
  ASSERT_EQ(frankenray_read_statistics(session_, &s), FRANKENRAY_OK);
  EXPECT_EQ(s.rays[FRANKENRAY_HITTEST], 2u * (1 + 3000 + 1024 + 20000 + 7));
  EXPECT_EQ(s.single_rays, 1u);
  EXPECT_GE(s.blocks, 2u * (1 + 3 + 1 + 20 + 1));
  EXPECT_EQ(s.connections, 1u);
  EXPECT_GE(s.server_rays[FRANKENRAY_HITTEST], s.rays[FRANKENRAY_HITTEST]);
}

TEST_P(Frankenray, AnswersThatAreNotWantedAreLeftAlone) {
  start();
  Many many(FRANKENRAY_FULLTRACE, 300);
  many.answers.color = {}, many.answers.miss_depth = nullptr, many.answers.position = {};
  ASSERT_EQ(frankenray_answer(line_, &many.rays, &many.answers), FRANKENRAY_OK);
  EXPECT_EQ(many.color, std::vector<float>(900, 0.0f));
  // A caller of an interface with fewer fields: what it does not know is not wanted.
  frankenray_answers shorter = FRANKENRAY_ANSWERS_INIT;
  std::vector<float> color(900);
  shorter.size = offsetof(frankenray_answers, distance);
  shorter.color = {color.data(), color.data() + 300, color.data() + 600, 0};
  ASSERT_EQ(frankenray_answer(line_, &many.rays, &shorter), FRANKENRAY_OK);
  Many whole(FRANKENRAY_FULLTRACE, 300);
  ASSERT_EQ(frankenray_answer(line_, &whole.rays, &whole.answers), FRANKENRAY_OK);
  for (size_t i = 0; i < 300; ++i) EXPECT_EQ(color[i + 300], whole.color[3 * i + 1]);
}

TEST_P(Frankenray, RaysThatMakeNoSenseHitNothing) {
  start();
  const double nan = std::nan(""), huge = 1e300;
  const double strange[][3] = {{nan, 0, 0}, {huge, 0, 0}, {-INFINITY, 1, 0}, {1e-310, 0, 0}, {0, 0, 0}};
  for (const auto& s : strange) {
    frankenray_hit hit = FRANKENRAY_HIT_INIT;
    EXPECT_EQ(frankenray_fulltrace(line_, s, s, &hit), FRANKENRAY_OK) << s[0];
    EXPECT_EQ(hit.distance, FRANKENRAY_NO_HIT_TRACE);
    float color[3];
    EXPECT_EQ(frankenray_visibility(line_, s, s, color), FRANKENRAY_OK);
    EXPECT_EQ(color[0], 1);
  }
}

TEST_P(Frankenray, RaysSayWhatTheySeeAndWhatTheyAreCalled) {
  start(writeSecondScene(scene_.folder()));
  frankenray_ray ray = FRANKENRAY_RAY_INIT;
  ray.kind = FRANKENRAY_HITTEST;
  ray.origin[0] = 10, ray.direction[2] = 2;
  const auto distance = [&] {
    frankenray_hit hit = FRANKENRAY_HIT_INIT;
    EXPECT_EQ(frankenray_ask(line_, &ray, &hit), FRANKENRAY_OK) << frankenray_line_error_text(line_);
    // The same as a batch of two.
    const float z[2] = {2, 2}, zero[2] = {0, 0};
    const double ten[2] = {10, 10}, nought[2] = {0, 0};
    float distances[2];
    frankenray_rays rays = FRANKENRAY_RAYS_INIT;
    frankenray_answers answers = FRANKENRAY_ANSWERS_INIT;
    rays.kind = ray.kind, rays.count = 2, rays.label = ray.label, rays.subset = ray.subset;
    rays.exclude_subset = ray.exclude_subset, rays.max_distance = ray.max_distance;
    rays.origin = {ten, nought, nought, 1}, rays.direction = {zero, zero, z, 1};
    answers.distance = distances;
    EXPECT_EQ(frankenray_answer(line_, &rays, &answers), FRANKENRAY_OK) << frankenray_line_error_text(line_);
    EXPECT_EQ(distances[0], hit.distance);
    EXPECT_EQ(distances[1], hit.distance);
    return hit.distance;
  };
  EXPECT_NEAR(distance(), 3, 1e-5);
  ray.exclude_subset = "front";
  EXPECT_NEAR(distance(), 4, 1e-5);
  ray.exclude_subset = "front,far";
  EXPECT_EQ(distance(), FRANKENRAY_NO_HIT);
  ray.exclude_subset = nullptr, ray.subset = "back";
  EXPECT_NEAR(distance(), 4, 1e-5);
  ray.max_distance = 3.5f;
  EXPECT_EQ(distance(), FRANKENRAY_NO_HIT);
  ray.subset = nullptr;
  EXPECT_NEAR(distance(), 3, 1e-5);

  frankenray_ray seen = FRANKENRAY_RAY_INIT;
  seen.origin[0] = -5, seen.direction[0] = -1;
  frankenray_hit hit = FRANKENRAY_HIT_INIT;
  ASSERT_EQ(frankenray_ask(line_, &seen, &hit), FRANKENRAY_OK) << frankenray_line_error_text(line_);
  EXPECT_EQ(hit.color[0], 1);
  EXPECT_EQ(hit.color[1], 0);
  seen.label = "mine";
  ASSERT_EQ(frankenray_ask(line_, &seen, &hit), FRANKENRAY_OK);
  EXPECT_EQ(hit.color[0], 0);
  EXPECT_EQ(hit.color[1], 1);

  const std::string tooLong(64, 'x');
  seen.label = tooLong.c_str();
  EXPECT_EQ(frankenray_ask(line_, &seen, &hit), FRANKENRAY_ERROR_ARGUMENT);
  EXPECT_NE(std::strstr(frankenray_line_error_text(line_), "label"), nullptr);
  seen.label = nullptr, seen.subset = tooLong.c_str();
  EXPECT_EQ(frankenray_ask(line_, &seen, &hit), FRANKENRAY_ERROR_ARGUMENT);
  seen.subset = nullptr, seen.max_distance = -1;
  EXPECT_EQ(frankenray_ask(line_, &seen, &hit), FRANKENRAY_ERROR_ARGUMENT);
  seen.max_distance = std::nanf("");
  EXPECT_EQ(frankenray_ask(line_, &seen, &hit), FRANKENRAY_ERROR_ARGUMENT);
  seen.max_distance = 0, seen.ray_class = 2;
  EXPECT_EQ(frankenray_ask(line_, &seen, &hit), FRANKENRAY_ERROR_ARGUMENT);
}

/// Rays that leave a sphere from where others have hit it. Those that go outwards meet nothing; those that go
/// inwards meet the other side of the sphere, one chord away. Without the place, facets are in the way of
/// some.
TEST_P(Frankenray, RaysThatStartAtAPlaceLeaveTheirSurface) {
  start(writeSecondScene(scene_.folder()));
  constexpr size_t kCount = 3000;
  std::mt19937 random(11);
  std::normal_distribution<double> gauss;
  const auto unit = [&] {
    const double v[3] = {gauss(random), gauss(random), gauss(random)};
    const double length = std::hypot(v[0], v[1], v[2]);
    return std::array{v[0] / length, v[1] / length, v[2] / length};
  };
  Many there(FRANKENRAY_HITTEST, kCount);
  std::vector<frankenray_place> places(kCount);
  there.answers.place = places.data();
  for (size_t i = 0; i < kCount; ++i) {
    const auto d = unit();
    for (size_t c = 0; c < 3; ++c)
      there.origin[3 * i + c] = 2.5 * d[c], there.direction[3 * i + c] = float(-d[c]);
  }
  ASSERT_EQ(frankenray_answer(line_, &there.rays, &there.answers), FRANKENRAY_OK);
  Many onward(FRANKENRAY_HITTEST, kCount);
  std::vector<double> cosine(kCount);
  for (size_t i = 0; i < kCount; ++i) {
    ASSERT_NEAR(there.distance[i], 1.5, 0.1);
    EXPECT_NE(places[i].opaque[0], 0u);
    const auto d = unit();
    for (size_t c = 0; c < 3; ++c) {
      onward.origin[3 * i + c] = there.position[3 * i + c];
      onward.direction[3 * i + c] = float(d[c]);
      cosine[i] += d[c] * there.position[3 * i + c];
    }
  }
  // The traced facets of a sphere of radius 1 lie less than 1 % inside it here. Rays that graze it may be
  // taken for either.
  constexpr double kGrazing = 0.1;
  const auto wrong = [&] {
    size_t n = 0;
    for (size_t i = 0; i < kCount; ++i) {
      const bool hits = onward.distance[i] < FRANKENRAY_NO_HIT && onward.distance[i] < 5;
      if (cosine[i] > kGrazing) n += hits;
      if (cosine[i] < -kGrazing) n += !hits || std::abs(onward.distance[i] + 2 * cosine[i]) > 0.3;
    }
    return n;
  };
  ASSERT_EQ(frankenray_answer(line_, &onward.rays, &onward.answers), FRANKENRAY_OK);
  EXPECT_GT(wrong(), kCount / 100) << "facets are not in the way: the test shows nothing";
  onward.rays.start = places.data();
  std::vector<frankenray_place> next(kCount);
  onward.answers.place = next.data();
  ASSERT_EQ(frankenray_answer(line_, &onward.rays, &onward.answers), FRANKENRAY_OK);
  EXPECT_EQ(wrong(), 0u);
  for (size_t i = 0; i < kCount; i += 5) {
    frankenray_ray ray = onward.ray(i);
    ray.start = places[i];
    frankenray_hit hit = FRANKENRAY_HIT_INIT;
    ASSERT_EQ(frankenray_ask(line_, &ray, &hit), FRANKENRAY_OK);
    EXPECT_TRUE(same(hit, onward.hit(i))) << i;
    EXPECT_EQ(std::memcmp(&hit.place, &next[i], sizeof next[i]), 0);
    EXPECT_EQ(hit.place.opaque[0] != 0, hit.distance < FRANKENRAY_NO_HIT) << "nowhere on a miss";
  }
  // Places belong to the server that told them.
  ASSERT_EQ(frankenray_reconnect(session_), FRANKENRAY_OK);
  EXPECT_EQ(frankenray_answer(line_, &onward.rays, &onward.answers), FRANKENRAY_ERROR_ARGUMENT);
  EXPECT_NE(std::strstr(frankenray_line_error_text(line_), "another server"), nullptr);
  frankenray_ray ray = onward.ray(0);
  ray.start = places[0];
  frankenray_hit hit = FRANKENRAY_HIT_INIT;
  EXPECT_EQ(frankenray_ask(line_, &ray, &hit), FRANKENRAY_ERROR_ARGUMENT);
  // Whatever is in them.
  ASSERT_EQ(frankenray_answer(line_, &there.rays, &there.answers), FRANKENRAY_OK);
  for (size_t i = 0; i < kCount; ++i)
    for (size_t w = 1; w < 8; ++w) places[i].opaque[w] = uint32_t(random());
  EXPECT_EQ(frankenray_answer(line_, &onward.rays, &onward.answers), FRANKENRAY_OK);
}

TEST_P(Frankenray, WrongUseIsAnErrorWithAText) {
  float color[3];
  frankenray_line* early = frankenray_line_open(session_);
  EXPECT_EQ(frankenray_trace(early, kBehind, kForward, color), FRANKENRAY_ERROR_NOT_CONNECTED);
  EXPECT_STRNE(frankenray_line_error_text(early), "");
  EXPECT_EQ(frankenray_reconnect(session_), FRANKENRAY_ERROR_NOT_CONNECTED);
  EXPECT_EQ(frankenray_start(session_, &options_, "/nowhere/scene.rib"), FRANKENRAY_ERROR_NO_SERVER);
  EXPECT_NE(std::strstr(frankenray_error_text(session_), "/nowhere/scene.rib"), nullptr);
  EXPECT_EQ(frankenray_join(session_, nullptr, "no-such-server"), FRANKENRAY_ERROR_NO_SERVER);
  EXPECT_EQ(frankenray_start_command(session_, nullptr, " "), FRANKENRAY_ERROR_ARGUMENT);
  frankenray_options damaged = FRANKENRAY_OPTIONS_INIT;
  damaged.size = 0;
  EXPECT_EQ(frankenray_start(session_, &damaged, scene_.rib().c_str()), FRANKENRAY_ERROR_ARGUMENT);
  start();
  EXPECT_EQ(frankenray_start(session_, &options_, scene_.rib().c_str()), FRANKENRAY_ERROR_STATE);
  // The line from before there was a server goes on.
  EXPECT_EQ(frankenray_trace(early, kBehind, kForward, color), FRANKENRAY_OK)
      << frankenray_line_error_text(early);
  frankenray_line_close(early);
  Many many(FRANKENRAY_TRACE, 10);
  frankenray_batch* b = nullptr;
  many.rays.kind = 9;
  EXPECT_EQ(frankenray_submit(line_, &many.rays, &many.answers, &b), FRANKENRAY_ERROR_ARGUMENT);
  EXPECT_EQ(b, nullptr);
  many.rays.kind = FRANKENRAY_VISIBILITY, many.rays.target.y = nullptr;
  EXPECT_EQ(frankenray_answer(line_, &many.rays, &many.answers), FRANKENRAY_ERROR_ARGUMENT);
  many.rays.kind = FRANKENRAY_TRACE, many.answers.color.z = nullptr;
  EXPECT_EQ(frankenray_answer(line_, &many.rays, &many.answers), FRANKENRAY_ERROR_ARGUMENT);
  EXPECT_EQ(frankenray_answer(line_, nullptr, &many.answers), FRANKENRAY_ERROR_ARGUMENT);
  EXPECT_EQ(frankenray_ask(line_, nullptr, nullptr), FRANKENRAY_ERROR_ARGUMENT);
  EXPECT_EQ(frankenray_poll(nullptr), FRANKENRAY_ERROR_ARGUMENT);
  EXPECT_EQ(frankenray_state(nullptr), FRANKENRAY_ERROR_ARGUMENT);
  frankenray_release(nullptr);
  frankenray_line_close(nullptr);
  frankenray_close(nullptr);
  EXPECT_EQ(frankenray_trace(line_, kBehind, kForward, color), FRANKENRAY_OK);
  for (int s = -12; s <= 2; ++s) EXPECT_STRNE(frankenray_status_text(s), "");
}

TEST_P(Frankenray, AServerThatDiesIsAnErrorAndCanBeReplaced) {
  start();
  Many many(FRANKENRAY_VISIBILITY, 50000);
  frankenray_batch* b = nullptr;
  ASSERT_EQ(frankenray_submit(line_, &many.rays, &many.answers, &b), FRANKENRAY_OK);
  killServer();
  EXPECT_EQ(frankenray_wait(b), FRANKENRAY_ERROR_SERVER_GONE);
  EXPECT_NE(std::strstr(frankenray_line_error_text(line_), "killed"), nullptr)
      << frankenray_line_error_text(line_);
  EXPECT_EQ(many.color.back(), 1) << "what was not answered is clear";
  float color[3] = {9, 9, 9};
  EXPECT_EQ(frankenray_visibility(line_, kBehind, kBeyond, color), FRANKENRAY_ERROR_SERVER_GONE);
  EXPECT_EQ(color[0], 1);
  ASSERT_EQ(frankenray_reconnect(session_), FRANKENRAY_OK) << frankenray_error_text(session_);
  EXPECT_EQ(frankenray_poll(b), FRANKENRAY_ERROR_SERVER_GONE) << "an old batch stays failed";
  frankenray_release(b);
  ASSERT_EQ(frankenray_visibility(line_, kBehind, kBeyond, color), FRANKENRAY_OK);
  EXPECT_EQ(color[0], 0);
  // Reconnecting while rays fly: they end, with an error or with their answers.
  ASSERT_EQ(frankenray_submit(line_, &many.rays, &many.answers, &b), FRANKENRAY_OK);
  ASSERT_EQ(frankenray_reconnect(session_), FRANKENRAY_OK);
  EXPECT_EQ(frankenray_wait(b), FRANKENRAY_ERROR_SERVER_GONE);
  frankenray_release(b);
  EXPECT_EQ(frankenray_answer(line_, &many.rays, &many.answers), FRANKENRAY_OK);
}

TEST_P(Frankenray, HandlesEndInAnyOrder) {
  start();
  Many many(FRANKENRAY_HITTEST, 10000);
  frankenray_batch* b = nullptr;
  ASSERT_EQ(frankenray_submit(line_, &many.rays, &many.answers, &b), FRANKENRAY_OK);
  const int pid = frankenray_server_pid(session_);
  frankenray_close(session_);
  session_ = nullptr;
  const frankenray_status s = frankenray_wait(b);
  EXPECT_TRUE(s == FRANKENRAY_OK || s == FRANKENRAY_ERROR_NOT_CONNECTED || s == FRANKENRAY_ERROR_SERVER_GONE)
      << s;
  EXPECT_NE(kill(pid, 0), 0) << "closing the session ends its server";
  frankenray_line_close(line_);
  line_ = nullptr;
  EXPECT_EQ(frankenray_poll(b), s);
  frankenray_release(b);
}

TEST_P(Frankenray, EveryThreadHasALine) {
  start();
  Many whole(FRANKENRAY_TRACE, 2000);
  ASSERT_EQ(frankenray_answer(line_, &whole.rays, &whole.answers), FRANKENRAY_OK);
  std::vector<std::thread> threads;
  threads.reserve(6);
  std::atomic<int> wrong{0};
  for (int t = 0; t < 6; ++t)
    threads.emplace_back([&] {
      frankenray_line* const line = frankenray_line_open(session_);
      for (int k = 0; k < 5; ++k) {
        Many many(FRANKENRAY_TRACE, 2000);
        if (frankenray_answer(line, &many.rays, &many.answers) != FRANKENRAY_OK || many.color != whole.color)
          ++wrong;
      }
      frankenray_line_close(line);
    });
  for (std::thread& t : threads) t.join();
  EXPECT_EQ(wrong, 0);
}

TEST_P(Frankenray, AForkedChildLeavesTheParentAlone) {
  start();
  float color[3];
  ASSERT_EQ(frankenray_trace(line_, kBehind, kForward, color), FRANKENRAY_OK);
  const pid_t pid = fork();
  if (pid == 0) {
    int wrong = 0;
    wrong += frankenray_trace(line_, kBehind, kForward, color) != FRANKENRAY_ERROR_FORKED;
    wrong += frankenray_state(session_) != FRANKENRAY_ERROR_FORKED;
    frankenray_line_close(line_);
    frankenray_close(session_);
    frankenray_session* const own = frankenray_create();
    wrong += frankenray_start(own, &options_, scene_.rib().c_str()) != FRANKENRAY_OK;
    frankenray_line* const line = frankenray_line_open(own);
    wrong += frankenray_trace(line, kBehind, kForward, color) != FRANKENRAY_OK;
    frankenray_line_close(line);
    frankenray_close(own);
    _exit(wrong);
  }
  int status = 0;
  ASSERT_EQ(waitpid(pid, &status, 0), pid);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0) << status;
  EXPECT_EQ(frankenray_trace(line_, kBehind, kForward, color), FRANKENRAY_OK)
      << frankenray_line_error_text(line_);
  EXPECT_EQ(frankenray_state(session_), FRANKENRAY_OK);
}

INSTANTIATE_TEST_SUITE_P(Transports, Frankenray, testing::Values(FRANKENRAY_SHARED_MEMORY, FRANKENRAY_PIPE),
                         [](const auto& p) { return std::string(p.param ? "pipe" : "shm"); });

TEST(FrankenrayLibrary, KnowsItsVersion) {
  EXPECT_EQ(frankenray_interface(), FRANKENRAY_INTERFACE);
  EXPECT_STREQ(frankenray_version(), FR_VERSION);
}

}  // namespace
}  // namespace fr::test
