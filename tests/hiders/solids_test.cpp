// Constructive solid geometry in both hiders and under the rays of shaders, against closed forms.
//
// The reference knows nothing of meshes: along a line it finds where the primitives' surfaces can be (roots
// of quadratics and linear equations), and asks between them whether a point lies in the solid.
#include <gtest/gtest.h>

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <memory>
#include <numbers>
#include <random>

#include "tests/hiders/hider_pair.h"

namespace fr::test {
namespace {

// ---- solids that know their RIB and their points
// -------------------------------------------------------------

struct Solid {
  std::string rib;
  std::function<bool(const DVec3&)> holds;
  /// Adds every parameter t at which o + t d can cross a surface.
  std::function<void(const DVec3& o, const DVec3& d, std::vector<double>& t)> cross;
};

std::string numbers(std::initializer_list<double> n) {
  std::string s;
  for (double x : n) s += fmt::format("{} ", x);
  return s;
}
std::string placed(const DVec3& c, const std::string& what) {
  return "TransformBegin Translate " + numbers({c.x, c.y, c.z}) + what + "TransformEnd\n";
}
std::string leaf(const std::string& what) { return "SolidBegin \"primitive\"\n" + what + "SolidEnd\n"; }

void addRoots(double a, double b, double c, std::vector<double>& t) {
  const double d = b * b - 4 * a * c;
  if (a == 0 || d < 0) return;
  t.push_back((-b - std::sqrt(d)) / (2 * a));
  t.push_back((-b + std::sqrt(d)) / (2 * a));
}

Solid sphere(const DVec3& c, double r, const std::string& look = "") {
  return {leaf(look + placed(c, "Sphere " + numbers({r, -r, r, 360}) + "\n")),
          [=](const DVec3& p) { return glm::length(p - c) < r; },
          [=](const DVec3& o, const DVec3& d, std::vector<double>& t) {
            const DVec3 q = o - c;
            addRoots(glm::dot(d, d), 2 * glm::dot(q, d), glm::dot(q, q) - r * r, t);
          }};
}
/// From six polygons.
Solid box(const DVec3& lo, const DVec3& hi, const std::string& look = "") {
  std::string faces;
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side) {
      faces += "Polygon \"P\" [";
      for (int k = 0; k < 4; ++k) {
        DVec3 p = lo;
        p[axis] = side ? hi[axis] : lo[axis];
        const int u = (axis + 1) % 3, v = (axis + 2) % 3;
        if (k == 1 || k == 2) p[u] = hi[u];
        if (k >= 2) p[v] = hi[v];
        faces += numbers({p.x, p.y, p.z});
      }
      faces += "]\n";
    }
  return {leaf(look + faces),
          [=](const DVec3& p) {
            return p.x > lo.x && p.y > lo.y && p.z > lo.z && p.x < hi.x && p.y < hi.y && p.z < hi.z;
          },
          [=](const DVec3& o, const DVec3& d, std::vector<double>& t) {
            for (int a = 0; a < 3; ++a)
              if (d[a] != 0)
                for (const DVec3& p : {lo, hi}) t.push_back((p[a] - o[a]) / d[a]);
          }};
}
/// Along z, with its ends.
Solid rod(double x, double y, double r, double z0, double z1, const std::string& look = "") {
  return {
      leaf(look + placed({x, y, 0}, "Cylinder " + numbers({r, z0, z1, 360}) + "\nDisk " +
                                        numbers({z0, r, 360}) + "\nDisk " + numbers({z1, r, 360}) + "\n")),
      [=](const DVec3& p) { return std::hypot(p.x - x, p.y - y) < r && p.z > z0 && p.z < z1; },
      [=](const DVec3& o, const DVec3& d, std::vector<double>& t) {
        const double ox = o.x - x, oy = o.y - y;
        addRoots(d.x * d.x + d.y * d.y, 2 * (ox * d.x + oy * d.y), ox * ox + oy * oy - r * r, t);
        if (d.z != 0) t.push_back((z0 - o.z) / d.z), t.push_back((z1 - o.z) / d.z);
      }};
}

enum class Operation { kUnion, kIntersection, kDifference };

Solid combine(Operation operation, std::vector<Solid> parts) {
  static constexpr const char* kNames[] = {"union", "intersection", "difference"};
  std::string rib = fmt::format("SolidBegin \"{}\"\n", kNames[size_t(operation)]);
  for (const Solid& s : parts) rib += s.rib;
  const auto shared = std::make_shared<std::vector<Solid>>(std::move(parts));
  return {rib + "SolidEnd\n",
          [=](const DVec3& p) {
            size_t n = 0;
            for (const Solid& s : *shared) n += s.holds(p);
            if (operation == Operation::kUnion) return n > 0;
            if (operation == Operation::kIntersection) return n == shared->size();
            return n == 1 && shared->front().holds(p);
          },
          [=](const DVec3& o, const DVec3& d, std::vector<double>& t) {
            for (const Solid& s : *shared) s.cross(o, d, t);
          }};
}
template <class... S>
Solid unite(const S&... s) {
  return combine(Operation::kUnion, {s...});
}
template <class... S>
Solid intersect(const S&... s) {
  return combine(Operation::kIntersection, {s...});
}
template <class... S>
Solid subtract(const S&... s) {
  return combine(Operation::kDifference, {s...});
}

/// Parameters t > 0 at which o + t d enters or leaves the solid.
std::vector<double> surfaces(const Solid& s, const DVec3& o, const DVec3& d) {
  std::vector<double> t = {0}, found;
  s.cross(o, d, t);
  std::sort(t.begin(), t.end());
  t.push_back(t.back() + 1);
  for (size_t i = 1; i + 1 < t.size(); ++i) {
    if (t[i] <= 0 || t[i + 1] - t[i] < 1e-12) continue;
    // Equal roots: what lies before the first of them.
    size_t before = i;
    while (before > 0 && t[i] - t[before - 1] < 1e-12) --before;
    if (before == 0) continue;
    const auto at = [&](double u) { return s.holds(o + u * d); };
    if (at(0.5 * (t[before - 1] + t[before])) != at(0.5 * (t[i] + t[i + 1]))) found.push_back(t[i]);
  }
  return found;
}

// ---- pictures against the reference
// --------------------------------------------------------------------------

constexpr int kSize = 120;
constexpr double kFar = 10;  // from the camera to the world's origin

struct View {
  std::string options;
  std::function<void(double x, double y, DVec3* o, DVec3* d)> line;  // world space, d of one unit of depth
};
/// The window [-1.5, 1.5] squared, along z.
const View kOrthographic = {"Projection \"orthographic\"\nScreenWindow -1.5 1.5 -1.5 1.5\nTranslate 0 0 10\n",
                            [](double x, double y, DVec3* o, DVec3* d) {
                              *o = {3 * x / kSize - 1.5, 1.5 - 3 * y / kSize, -kFar}, *d = {0, 0, 1};
                            }};
View perspective(const DVec3& eye, double fov = 60) {
  return {fmt::format("Clipping 0.001 1000\nProjection \"perspective\" \"fov\" [{}]\nTranslate {} {} {}\n",
                      fov, -eye.x, -eye.y, -eye.z),
          [=](double x, double y, DVec3* o, DVec3* d) {
            const double w = std::tan(fov * std::numbers::pi / 360);
            *o = eye, *d = {w * (2 * x / kSize - 1), w * (1 - 2 * y / kSize), 1};
          }};
}

std::string picture(const View& view, const std::string& world) {
  return fmt::format(
             "Format {} {} 1\nPixelSamples 1 1\nPixelFilter \"box\" 1 1\nHider \"hidden\" \"jitter\" [0]\n"
             "ShadingRate 0.125\n",
             kSize, kSize) +
         view.options + "WorldBegin\nSurface \"constant\"\n" + world + "WorldEnd\n";
}

/// The solid half transparent, and opaque: coverage, depth and the number of surfaces at the centre of every
/// pixel. Pixels whose neighbourhood has an outline are left out; there are few.
void expectAsInReference(const Solid& s, const View& view, double depthTolerance = 2e-3,
                         double outlines = 0.2) {
  const HiderPair opaque = renderBoth(picture(view, s.rib));
  const HiderPair half = renderBoth(picture(view, "Opacity [0.5 0.5 0.5]\n" + s.rib));
  size_t outline = 0, covered = 0;
  int wrong[2] = {};
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x) {
      DVec3 o, d;
      const auto at = [&](double px, double py) {
        view.line(px, py, &o, &d);
        return surfaces(s, o, d);
      };
      const std::vector<double> here = at(x + 0.5, y + 0.5);
      bool clear = true;
      for (const auto& [dx, dy] : {std::pair{0.3, 0.0}, {-0.3, 0.0}, {0.0, 0.3}, {0.0, -0.3}}) {
        const std::vector<double> there = at(x + 0.5 + dx, y + 0.5 + dy);
        clear = clear && there.size() == here.size();
        for (size_t i = 0; clear && i < here.size(); ++i) clear = std::abs(there[i] - here[i]) < 0.08;
      }
      if (!clear) {
        ++outline;
        continue;
      }
      covered += !here.empty();
      const auto i = size_t(y * kSize + x);
      const double alpha = 1 - std::pow(0.5, double(here.size()));
      int which = 0;
      for (const auto& [a, b] : {std::pair{&opaque.reyes, &half.reyes}, {&opaque.rays, &half.rays}}) {
        const bool right = here.empty() ? a->at(3, i) == 0 && b->at(3, i) == 0
                                        : a->at(3, i) == 1 && std::abs(b->at(3, i) - alpha) < 1e-5 &&
                                              std::abs(a->at(4, i) - here[0]) < depthTolerance &&
                                              std::abs(b->at(4, i) - here[0]) < depthTolerance;
        if (!right && wrong[which]++ < 3)
          ADD_FAILURE() << (which ? "rays" : "REYES") << " at " << x << ", " << y << ": alpha " << a->at(3, i)
                        << ", depth " << a->at(4, i) << ", half " << b->at(3, i) << "; expected depth "
                        << (here.empty() ? 0 : here[0]) << " and " << here.size() << " surfaces";
        ++which;
      }
    }
  EXPECT_EQ(wrong[0], 0);
  EXPECT_EQ(wrong[1], 0);
  EXPECT_GT(covered, size_t(kSize * kSize / 100));
  EXPECT_LT(double(outline), outlines * kSize * kSize);
}

TEST(SolidPictures, SphereMinusSphere) {
  const Solid s = subtract(sphere({0, 0, 0}, 1), sphere({0.3, 0.2, -0.7}, 0.7));
  expectAsInReference(s, kOrthographic);
  expectAsInReference(s, perspective({0.5, 0.4, -4}));
}

TEST(SolidPictures, LensOfTwoSpheres) {
  expectAsInReference(intersect(sphere({0, 0, -1.2}, 1.5), sphere({0, 0, 1.2}, 1.5)), kOrthographic);
  expectAsInReference(intersect(sphere({-0.5, 0, 0}, 1), sphere({0.5, 0.1, 0.2}, 1)),
                      perspective({0, 0, -4}));
}

TEST(SolidPictures, UnionShowsNothingInside) {
  expectAsInReference(
      unite(sphere({-0.4, 0, 0}, 0.8), sphere({0.4, 0.1, 0.1}, 0.8), box({-1, -0.2, -0.3}, {1, 0.2, 0.3})),
      perspective({0, 0, -4}));
}

TEST(SolidPictures, DrilledCube) {
  const Solid cube = box({-0.9, -0.9, -0.9}, {0.9, 0.9, 0.9});
  expectAsInReference(subtract(cube, rod(0.1, -0.1, 0.5, -2, 2)), perspective({0.6, 0.8, -3.5}));
  // Blind, and flush at the front: its mouth lies in the cube's face.
  expectAsInReference(subtract(cube, rod(0, 0, 0.5, -0.9, 0.4)), perspective({0.3, 0.3, -3.5}));
  expectAsInReference(subtract(cube, rod(0, 0, 0.5, -0.9, 0.9)), kOrthographic);
}

TEST(SolidPictures, NestedDifferenceOfUnions) {
  const Solid body = unite(box({-1, -1, -0.5}, {1, 0.2, 0.5}), sphere({0, 0.4, 0}, 0.7));
  const Solid tool =
      subtract(unite(sphere({0, 0.4, -0.5}, 0.5), rod(-0.6, -0.5, 0.25, -3, 3), rod(0.6, -0.5, 0.3, -3, 0)),
               sphere({0, 0.5, -0.3}, 0.3));
  expectAsInReference(subtract(body, tool, sphere({0, -1, 0}, 0.4)), perspective({0.7, 0.9, -4}));
}

TEST(SolidPictures, RandomTrees) {
  std::mt19937 engine(3);
  const auto number = [&](double lo, double hi) {
    return std::uniform_real_distribution<double>(lo, hi)(engine);
  };
  const auto point = [&](double r) { return DVec3(number(-r, r), number(-r, r), number(-r, r)); };
  const std::function<Solid(int)> tree = [&](int depth) -> Solid {
    if (depth == 0 || engine() % 5 == 0) {
      switch (engine() % 3) {
        case 0:
          return sphere(point(0.7), number(0.3, 0.9));
        case 1:
          return rod(number(-0.7, 0.7), number(-0.7, 0.7), number(0.2, 0.6), number(-1.2, -0.1),
                     number(0.1, 1.2));
        default:
          return box(point(0.5) - DVec3(0.55), point(0.5) + DVec3(0.55));
      }
    }
    std::vector<Solid> parts;
    for (int n = 2 + int(engine() % 2); n > 0; --n) parts.push_back(tree(depth - 1));
    return combine(Operation(engine() % 3), std::move(parts));
  };
  for (int i = 0; i < 12; ++i) {
    SCOPED_TRACE(i);
    // Something is always seen of it: a ball in the midst.
    expectAsInReference(unite(tree(3), sphere({0, 0, 0}, 0.35)), perspective(point(0.5) + DVec3(0, 0, -4)),
                        2e-3, 0.5);
  }
}

TEST(SolidPictures, CameraInsideTheHole) {
  // In a hollow ball with a window, and half in the wall of a block.
  const Solid hollow = subtract(sphere({0, 0, 0}, 1), sphere({0, 0, 0}, 0.9), rod(0.2, 0.1, 0.3, 0, 2));
  expectAsInReference(hollow, perspective({0.1, 0, -0.2}));
}

TEST(SolidPictures, CameraInsideTheMatter) {
  // The line of sight starts inside of both, leaves the second, enters what is left.
  const Solid s = subtract(box({-3, -3, -3}, {3, 3, 3}), sphere({0, 0, 1.5}, 1), sphere({1.2, 0, 0.5}, 0.4));
  expectAsInReference(s, perspective({0, 0, -1}));
  expectAsInReference(unite(sphere({0, 0, 0}, 1), sphere({0.5, 0, 0.5}, 1)), perspective({0.2, 0.1, 0}));
}

TEST(SolidPictures, PlanesThatCutASolid) {
  // What lies before the near plane or behind the far one is not drawn, but counts: the near plane opens the
  // solid, so that its inside shows.
  const Solid s = subtract(sphere({0, 0, 0}, 1), rod(0, 0, 0.5, -2, 2), sphere({0.6, 0, 0}, 0.5));
  const double near = 9.6, far = 10.3;
  View view = kOrthographic;
  view.options = "Clipping 9.6 10.3\n" + view.options;
  const HiderPair pair = renderBoth(picture(view, s.rib));
  for (const Channels* c : {&pair.reyes, &pair.rays}) {
    size_t seen = 0, wrong = 0;
    for (int y = 0; y < kSize; ++y)
      for (int x = 0; x < kSize; ++x) {
        const auto first = [&](double px, double py) {
          DVec3 o, d;
          view.line(px, py, &o, &d);
          for (double t : surfaces(s, o, d))
            if (t > near) return t < far ? t : kRiInfinity;
          return double(kRiInfinity);
        };
        const double t = first(x + 0.5, y + 0.5);
        bool clear = true;
        for (double k : {-0.3, 0.3})
          clear = clear && std::abs(first(x + 0.5 + k, y + 0.5) - t) < 0.08 &&
                  std::abs(first(x + 0.5, y + 0.5 + k) - t) < 0.08;
        if (!clear) continue;
        const double z = double(c->at(4, size_t(y * kSize + x)));
        seen += t < far;
        wrong += !(std::abs(z - t) < 2e-3 || (z > 1e30 && t > 1e30));
      }
    EXPECT_GT(seen, 500u);
    EXPECT_EQ(wrong, 0u);
  }
}

TEST(SolidPictures, OrientationAndSidesDoNotChangeTheShape) {
  const Solid a = subtract(sphere({0, 0, 0}, 1), sphere({0.3, 0.2, -0.7}, 0.7), rod(-0.5, 0, 0.2, -2, 2));
  const Solid b = subtract(sphere({0, 0, 0}, 1, "ReverseOrientation\n"),
                           sphere({0.3, 0.2, -0.7}, 0.7, "Orientation \"inside\"\n"),
                           rod(-0.5, 0, 0.2, -2, 2, "Orientation \"rh\"\n"));
  const HiderPair one = renderBoth(picture(kOrthographic, a.rib)),
                  two = renderBoth(picture(kOrthographic, b.rib));
  EXPECT_EQ(one.reyes.values[3], two.reyes.values[3]);
  EXPECT_EQ(one.reyes.values[4], two.reyes.values[4]);
  EXPECT_EQ(one.rays.values[3], two.rays.values[3]);
  EXPECT_EQ(one.rays.values[4], two.rays.values[4]);
  // Of a one-sided solid every outer side shows, those of holes too: nothing changes for a camera outside.
  // (Disks look along z whatever they close, so spheres alone.)
  const Solid c = subtract(sphere({0, 0, 0}, 1), sphere({0.3, 0.2, -0.7}, 0.7));
  const HiderPair both = renderBoth(picture(kOrthographic, c.rib)),
                  single = renderBoth(picture(kOrthographic, "Sides 1\n" + c.rib));
  EXPECT_EQ(both.reyes.values[4], single.reyes.values[4]);
  EXPECT_EQ(both.rays.values[4], single.rays.values[4]);
}

TEST(SolidPictures, BucketsAndWallsInFrontChangeNoBits) {
  const std::string s =
      "Opacity [0.5 0.5 0.5]\n" + subtract(sphere({0, 0, 0}, 1), rod(-0.5, 0, 0.2, -2, 2)).rib +
      "Opacity [1 1 1]\n" +
      placed({0.2, 0.3, 0.1}, subtract(sphere({0, 0, 0}, 1), sphere({0.3, 0.2, -0.7}, 0.7)).rib);
  const std::string wall = "Polygon \"P\" [-2 -2 -1.5 0.1 -2 -1.5 0.3 2 -1.5 -2 2 -1.5]\n";
  const auto reyes = [&](int bucket, const std::string& world) {
    return renderBoth(fmt::format("Option \"limits\" \"int[2] bucketsize\" [{0} {0}]\n", bucket) +
                      picture(kOrthographic, world))
        .reyes;
  };
  EXPECT_EQ(reyes(16, s + wall).values, reyes(64, s + wall).values);
  // Whatever is drawn first: the wall comes before in one of the two.
  EXPECT_EQ(reyes(16, s + wall).values, reyes(16, wall + s).values);
}

TEST(SolidPictures, InvisiblePartsStillShapeTheWhole) {
  const std::string unseen = "Attribute \"visibility\" \"int camera\" [0]\n";
  const Solid s = subtract(sphere({0, 0, 0}, 1), box({-0.6, -0.6, -2}, {0.6, 0.6, -0.2}, unseen));
  const HiderPair pair = renderBoth(picture(kOrthographic, s.rib));
  for (const Channels* c : {&pair.reyes, &pair.rays}) {
    // Through the floor of the pit, which is not seen, to the far side of the ball.
    EXPECT_NEAR(c->at(4, kSize / 2 * kSize + kSize / 2), kFar + 1, 1e-3);
    EXPECT_EQ(c->at(3, kSize / 2 * kSize + kSize / 2), 1);
  }
}

TEST(SolidPictures, OrdinarySurfacesInFrontOfInsideAndBehind) {
  const Solid s = subtract(sphere({0, 0, 0}, 1), rod(0, 0, 0.5, -2, 2));
  const auto wall = [](double z) {
    return fmt::format("Color [1 0 0] Polygon \"P\" [-2 -2 {0} 2 -2 {0} 2 0 {0} -2 0 {0}]\n", z);
  };
  for (const double z : {-2.0, 0.0, 2.0}) {
    const HiderPair pair = renderBoth(picture(kOrthographic, "Color [0 1 0]\n" + s.rib + wall(z)));
    for (const Channels* c : {&pair.reyes, &pair.rays}) {
      const size_t hole = 65 * kSize + kSize / 2, side = 65 * kSize + kSize / 2 + 30;
      EXPECT_NEAR(c->at(4, hole), kFar + z, 1e-4);
      EXPECT_EQ(c->at(0, hole), 1);
      EXPECT_EQ(c->at(0, side), z < -1 ? 1 : 0);
    }
  }
}

TEST(SolidPictures, NormalsOfHolesLookOutOfTheMatter) {
  // The far wall of a pit that faces the camera: its normal comes towards us, and a displacement or a light
  // that trusts it is right.
  const Solid s = subtract(box({-1, -1, -1}, {1, 1, 1}), sphere({0, 0, -1}, 0.8));
  std::string rib = picture(kOrthographic, "Surface \"showN\"\n" + s.rib);
  const HiderPair pair = renderBoth(
      rib,
      {{"showN",
        "surface showN() { normal n = ntransform(\"world\", normalize(N)); Ci = color(n); Oi = 1; }\n"}});
  for (const Channels* c : {&pair.reyes, &pair.rays})
    for (int y = 50; y < 70; ++y)
      for (int x = 50; x < 70; ++x) {
        // From the middle of the sphere to the wall, turned over.
        const double px = 3 * (x + 0.5) / kSize - 1.5, py = 1.5 - 3 * (y + 0.5) / kSize;
        const DVec3 n = -DVec3(px, py, std::sqrt(0.64 - px * px - py * py)) / 0.8;
        const auto i = size_t(y * kSize + x);
        // Micropolygons of REYES have one normal each, half a pixel off at most: 0.0125 / 0.8.
        for (int k = 0; k < 3; ++k) ASSERT_NEAR(c->at(size_t(k), i), n[k], 0.02);
      }
}

TEST(SolidPictures, DisplacementMovesAPartAsIfItStoodAlone) {
  // A ball that grows by 0.15 in every direction takes more away.
  const std::string grow = "Attribute \"displacementbound\" \"float sphere\" [0.2]\nDisplacement \"grow\"\n";
  const Solid grown = sphere({0.1, 0.1, -1}, 0.7), drawn = sphere({0.1, 0.1, -1}, 0.55, grow);
  const Solid s = {"", grown.holds, grown.cross};
  const Solid ball = sphere({0, 0, 0}, 1);
  const Solid reference = subtract(ball, s);
  const std::map<std::string, std::string> shaders = {
      {"grow", "displacement grow() { P += 0.15 * normalize(N); N = calculatenormal(P); }\n"},
      {"bump", "displacement bump() { N = calculatenormal(P + 0.1 * normalize(N)); }\n"},
      {"showN",
       "surface showN() { normal n = ntransform(\"world\", normalize(N)); Ci = color(n); Oi = 1; }\n"}};
  const auto rib = [&](const std::string& tool) {
    return picture(kOrthographic,
                   "Surface \"showN\"\nSolidBegin \"difference\"\n" + ball.rib + tool + "SolidEnd\n");
  };
  const HiderPair moved = renderBoth(rib(drawn.rib), shaders);
  const HiderPair bumped =
      renderBoth(rib(sphere({0.1, 0.1, -1}, 0.7, "Displacement \"bump\"\n").rib), shaders);
  size_t n = 0;
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x) {
      DVec3 o, d;
      kOrthographic.line(x + 0.5, y + 0.5, &o, &d);
      if (std::hypot(o.x - 0.1, o.y - 0.1) > 0.55) continue;
      const double t = surfaces(reference, o, d).at(0);
      const DVec3 normal = (DVec3(0.1, 0.1, -1) - (o + t * d)) / 0.7;
      const auto i = size_t(y * kSize + x);
      ++n;
      for (const Channels* c : {&moved.reyes, &moved.rays, &bumped.reyes, &bumped.rays}) {
        ASSERT_NEAR(c->at(4, i), t, 3e-3);
        // Of facets, a few degrees off.
        for (int k = 0; k < 3; ++k) ASSERT_NEAR(c->at(size_t(k), i), normal[k], 0.06);
      }
    }
  EXPECT_GT(n, 1000u);
}

TEST(SolidPictures, InstancesOfSolids) {
  const Solid s = subtract(sphere({0, 0, 0}, 0.5), rod(0, 0, 0.25, -2, 2));
  const std::string world = "ObjectBegin 1\n" + s.rib + "ObjectEnd\n" +
                            placed({-0.7, 0, 0}, "ObjectInstance 1\n") +
                            placed({0.7, 0.3, 0}, "ObjectInstance 1\n");
  const std::string copies = placed({-0.7, 0, 0}, s.rib) + placed({0.7, 0.3, 0}, s.rib);
  const HiderPair a = renderBoth(picture(kOrthographic, world)),
                  b = renderBoth(picture(kOrthographic, copies));
  EXPECT_EQ(a.reyes.values, b.reyes.values);
  EXPECT_EQ(a.rays.values, b.rays.values);
  EXPECT_GT(std::count(a.reyes.values[3].begin(), a.reyes.values[3].end(), 1.0f), 500);
  // An object as one part of a solid.
  const std::string part = "ObjectBegin 1\nSphere 0.5 -0.5 0.5 360\nObjectEnd\nSolidBegin \"difference\"\n" +
                           sphere({0, 0, 0}, 1).rib + placed({0.4, 0, -0.8}, "ObjectInstance 1\n") +
                           "SolidEnd\n";
  const Solid same = subtract(sphere({0, 0, 0}, 1), sphere({0.4, 0, -0.8}, 0.5));
  EXPECT_EQ(renderBoth(picture(kOrthographic, part)).reyes.values[4],
            renderBoth(picture(kOrthographic, same.rib)).reyes.values[4]);
}

// ---- rays of shaders
// -----------------------------------------------------------------------------------------

const std::string kUnseen = "Attribute \"visibility\" \"int camera\" [0]\n";
/// A floor at z = 2 that fills the view of the orthographic camera and runs `shader`; above it, unseen, a
/// solid.
Channels probe(const Solid& s, const std::string& shader, const std::string& look = "") {
  return renderByRays(
      picture(kOrthographic,
              "AttributeBegin " + kUnseen + look + s.rib +
                  "AttributeEnd\nSurface \"probe\"\nPolygon \"P\" [-2 -2 2 -2 2 2 2 2 2 2 -2 2]\n"),
      {{"probe", "surface probe() { vector up = vector \"world\" (0, 0, -1); " + shader + " Oi = 1; }\n"}});
}

/// Compares a value of every pixel with that of the line from the floor upwards, where that is a number.
void expectAlongLines(const Channels& c, const Solid& s, double tolerance,
                      const std::function<double(const std::vector<double>&)>& value) {
  size_t wrong = 0, seen = 0;
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x) {
      const auto at = [&](double px, double py) {
        return surfaces(s, {3 * px / kSize - 1.5, 1.5 - 3 * py / kSize, 2}, {0, 0, -1});
      };
      const std::vector<double> here = at(x + 0.5, y + 0.5);
      bool clear = true;
      for (double k : {-0.3, 0.3})
        for (const auto& there : {at(x + 0.5 + k, y + 0.5), at(x + 0.5, y + 0.5 + k)}) {
          clear = clear && there.size() == here.size();
          for (size_t i = 0; clear && i < here.size(); ++i) clear = std::abs(there[i] - here[i]) < 0.08;
        }
      if (!clear) continue;
      seen += !here.empty();
      const double got = double(c.at(0, size_t(y * kSize + x))), expected = value(here);
      if (!std::isnan(expected) && !(std::abs(got - expected) <= tolerance) && wrong++ < 3)
        ADD_FAILURE() << got << " instead of " << expected << " at " << x << ", " << y;
    }
  EXPECT_EQ(wrong, 0u);
  EXPECT_GT(seen, 1000u);
}

const Solid kDrilled = subtract(unite(sphere({0, 0, 0}, 1), box({-0.2, -1.2, -0.4}, {0.2, 1.2, 0.4})),
                                rod(0, 0.3, 0.4, -2, 2), sphere({-0.5, -0.3, 0.3}, 0.4));

TEST(SolidRays, NearestSurface) {
  expectAlongLines(
      probe(kDrilled, "point h; normal n; float d = rayhittest(P, up, h, n); Ci = d > 1e6 ? 0 : d;"),
      kDrilled, 3e-3, [](const std::vector<double>& t) { return t.empty() ? 0 : t[0]; });
}

TEST(SolidRays, TransmissionCountsSurfaces) {
  expectAlongLines(probe(kDrilled, "Ci = transmission(P, P + 9 * up);", "Opacity [0.5 0.5 0.5]\n"), kDrilled,
                   1e-5, [](const std::vector<double>& t) { return std::pow(0.5, double(t.size())); });
  // To a point in the midst: only what lies before it. (A surface that may hold the end point is no
  // obstacle.)
  const double end = 2.05;
  expectAlongLines(probe(kDrilled, "Ci = visibility(P, P + 2.05 * up);", "Opacity [0.5 0.5 0.5]\n"), kDrilled,
                   1e-5, [&](const std::vector<double>& t) {
                     double through = 1;
                     for (double x : t)
                       through *= std::abs(x - end) < 0.02 ? std::nan("") : x < end ? 0.5 : 1;
                     return through;
                   });
  // Opaque: through the hole, or not at all.
  expectAlongLines(probe(kDrilled, "Ci = transmission(P, P + 9 * up);"), kDrilled, 0,
                   [](const std::vector<double>& t) { return t.empty() ? 1 : 0; });
}

TEST(SolidRays, TraceStepsThroughWhatIsTransparent) {
  // Each surface adds its light and lets half of the rest through.
  expectAlongLines(probe(kDrilled, "Ci = trace(P, up);", "Opacity [0.5 0.5 0.5]\n"), kDrilled, 1e-5,
                   [](const std::vector<double>& t) { return 1 - std::pow(0.5, double(t.size())); });
}

TEST(SolidRays, RaysThatStartInTheMatterOrInTheHole) {
  // From inside of the ball: half way up the floor's line.
  const Solid s = subtract(sphere({0, 0, 0}, 1.4), sphere({0, 0, -0.6}, 0.5));
  size_t n = 0;
  const Channels c = probe(s, "point h; normal m; point from = P + 2 * up; Ci = rayhittest(from, up, h, m);");
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x) {
      const DVec3 o(3 * (x + 0.5) / kSize - 1.5, 1.5 - 3 * (y + 0.5) / kSize, 0);
      const double r = std::hypot(o.x, o.y);
      if (r > 1.35 || std::abs(r - 0.5) < 0.05) continue;
      const auto t = surfaces(s, o, {0, 0, -1});
      ASSERT_FALSE(t.empty());
      EXPECT_NEAR(c.at(0, size_t(y * kSize + x)), t[0], 3e-3);
      ++n;
    }
  EXPECT_GT(n, 5000u);
}

TEST(SolidRays, HalfOfTheSkyIsSeenFromEverywhereInABowl) {
  // A hemisphere taken out of a block. From every point of a sphere, any other part of it is seen under the
  // share of its area: the open half is one half.
  const std::string block = unite(box({-1.4, -1.4, 0}, {1.4, 1.4, 2})).rib;
  const Solid bowl =
      subtract(box({-1.4, -1.4, 0}, {1.4, 1.4, 2}, "ShadingRate 0.125\n"), sphere({0, 0, 0}, 1));
  const Channels c = renderByRays(
      picture(kOrthographic, "Surface \"probe\"\n" + bowl.rib),
      {{"probe", "surface probe() { Ci = occlusion(P, faceforward(normalize(N), I), 256); Oi = 1; }\n"}});
  double sum = 0;
  size_t n = 0;
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x) {
      const double r = std::hypot(3 * (x + 0.5) / kSize - 1.5, 1.5 - 3 * (y + 0.5) / kSize);
      const double v = double(c.at(0, size_t(y * kSize + x)));
      if (r < 0.9) sum += v, ++n;
      if (r > 1.05 && r < 1.3) {
        EXPECT_EQ(v, 0) << "the rim is flat";
      }
    }
  // 256 stratified samples of about 4000 points: noise below 0.001; facets and their chords as much again.
  EXPECT_NEAR(sum / double(n), 0.5, 0.004);
}

TEST(SolidRays, LightThroughAHole) {
  // A lamp straight above: the lit disk on the floor is the hole.
  const Solid s = subtract(box({-1.4, -1.4, -0.5}, {1.4, 1.4, 0.5}), rod(0, 0, 0.6, -1, 1));
  const std::string world =
      "Attribute \"light\" \"string shadows\" [\"on\"]\nLightSource \"distantlight\" 1 \"from\" [0 0 -1] "
      "\"to\" [0 0 0]\n"
      "AttributeBegin " +
      kUnseen + s.rib +
      "AttributeEnd\nSurface \"matte\" \"Ka\" [0] \"Kd\" [1]\nPolygon \"P\" [-1.4 -1.4 2 -1.4 1.4 2 1.4 1.4 "
      "2 1.4 -1.4 2]\n";
  const HiderPair pair = renderBoth(picture(kOrthographic, world));
  const double pixels = std::numbers::pi * 0.36 * kSize * kSize / 9;
  for (const Channels* c : {&pair.reyes, &pair.rays}) {
    double lit = 0;
    for (float v : c->values[0]) lit += double(v);
    // REYES shades micropolygons of half a pixel; both have 150 pixels along the edge, each right on average.
    EXPECT_NEAR(lit, pixels, 4 * 0.3 * std::sqrt(150.0));
  }
}

}  // namespace
}  // namespace fr::test
