// The virtual machine: runs shaders over one batch of points, with their lights, up to the next ray call.
//
// Knows nothing of the scene cache: points, parameters and lights come in as arrays, everything else is asked
// from a ShaderHost. Registers, masks and program counters live in Frames, so run() can return at any ray
// call, also one in a light shader that an illuminance loop in a user function called for.
#pragma once

#include <array>
#include <span>
#include <unordered_set>

#include "oracle/ray_query.h"
#include "shading/frame.h"

struct FrTextureCall;

namespace fr {

struct Texture;

/// Neighbours for derivatives: Du(x) at lane i is (x[uHi[i]] - x[uLo[i]]) * uScale[i]; the change over one
/// cell is that times uCell[i]. One table serves grids, meshlets and hits.
struct DerivativeStencil {
  std::vector<uint16_t> uLo, uHi, vLo, vHi;
  std::vector<float> uScale, vScale, uCell, vCell;
  uint32_t used = 0;  // lanes [0, used) are somebody's neighbours; the others are only their own
  void resize(size_t lanes);
};

/// Fills a stencil for (nu+1) x (nv+1) points in rows, cells of du by dv: central differences inside,
/// one-sided at the borders (RISpec 16).
void gridStencil(DerivativeStencil& s, uint32_t nu, uint32_t nv, uint32_t lanes, float du, float dv,
                 const float* u = nullptr, const float* v = nullptr);
/// For meshlets: the two other vertices of one triangle of each vertex; du = dv = 1.
void meshletStencil(DerivativeStencil& s, uint32_t vertices, uint32_t triangles, const uint8_t* indices,
                    uint32_t lanes);
/// For hits shaded as three points: lane i, its neighbour in u at period + i, in v at 2 period + i.
void tripleStencil(DerivativeStencil& s, uint32_t period, const float* du, const float* dv);

class PointVariables;

/// The points of one run. Arrays hold `lanes` floats (a multiple of kLanePad), belong to the caller, and stay
/// valid until the run is done.
struct Batch {
  uint32_t lanes = 0;
  uint32_t points = 0;  // lanes [0, points) are asked for; the others are padding or the neighbours of hits
  uint32_t asking = 0;  // lanes [0, asking) may ask rays; the rest gets a copy of lane i % copyPeriod
  uint32_t copyPeriod = 0;                         // 0: none
  const int32_t* mask = nullptr;                   // lanes to run
  Operand globals[size_t(GlobalId::kCount)] = {};  // data == nullptr: 0
  const DerivativeStencil* stencil = nullptr;      // nullptr: derivatives are 0
  float orientation = 1.0f;                        // calculatenormal() is (Du ^ Dv) times this
  const uint64_t* seed = nullptr;                  // per lane
  uint64_t batchSeed = 0;
  uint32_t level = 0;  // raylevel()
  // Of the rays that hit the points, and how deep rays may go on (Attribute "trace" "maxdiffusedepth",
  // "maxspeculardepth").
  RayClass rayClass = RayClass::kSpecular;
  uint32_t diffuseDepth = 0, shadowDepth = 0;
  uint32_t maxDiffuseDepth = 1, maxSpecularDepth = ~0u;
  float specularThreshold = 0.17453293f;  // gather() in a wider cone asks diffuse rays; radians
  bool shadowRay = false;
  bool raysAllowed = true;  // false: every ray misses, with one warning (displacement, imager)
  bool saysMisses = true;   // false: without it
  std::string_view rayLabel;
  uint32_t attributes = kNoIndex;
  const uint16_t* object = nullptr;  // per lane: index into objects; nullptr: all objects[0]
  std::span<const uint32_t> objects;
  // Where rays start, per lane; nullptr: nowhere in particular. Ng in current space, unit.
  Operand rayNormal;
  Operand footprint;  // radius of a point's surroundings; no data: from P's derivatives
  Operand spread;     // growth of the footprint per unit of distance
  struct Override {   // primitive variable that overrides a surface parameter
    uint32_t parameter;
    Operand values;
  };
  std::span<const Override> overrides;
  const PointVariables* variables = nullptr;  // for getvar(); nullptr: there are none
};

/// Rays that a run waits for: current space, one element a ray, rows as in RayQuery.
struct PendingRays {
  RayKind kind = RayKind::kTrace;
  uint32_t count = 0;
  uint32_t lane[kRayRow];
  bool inOrder = false;  // ray k is that of lane k
  float origin[3][kRayRow], direction[3][kRayRow];
  float radius[kRayRow], spread[kRayRow];
  uint64_t seed[kRayRow];
  int32_t onSurface[kRayRow];  // not 0: starts at the lane's own point; its patch and normal go with the ray
  bool single = false;         // one ray stands for all points: its operands were uniform
  RayTerms terms;              // lengths in current space
  float pair[2][kRayRow];      // the random numbers that chose the direction
  // Answers, written by the owner before run() is called again.
  float color[3][kRayRow];
  float hitDistance[kRayRow], missDepth[kRayRow];
  float hitP[3][kRayRow], hitN[3][kRayRow], missP[3][kRayRow], missR[3][kRayRow];
  float extra[kMaxExtraAnswers][kRayRow];
  /// The answers of an empty scene.
  void missAll();
};

/// Variables of the points that no column of the batch holds.
class PointVariables {
 public:
  virtual ~PointVariables() = default;
  /// One component of the primitive variable `name`, per lane, in current space; nullptr: there is none.
  virtual const float* variable(std::string_view name, uint32_t component) const = 0;
};

struct MachineStatistics {
  uint64_t steps = 0, lanesActive = 0, lanesTotal = 0, lightPoints = 0;
};

class Machine {
 public:
  enum class Status { kDone, kNeedsRays };
  explicit Machine(const ShaderHost& host);
  ~Machine();
  Machine(const Machine&) = delete;
  Machine& operator=(const Machine&) = delete;

  /// Starts `shader` with `lights` (may be empty); both stay alive until done. `messages`: the other shaders
  /// of the same primitive, for displacement() and atmosphere() and surface(); nullptr where there is none.
  struct Partners {
    const ShaderInstance* surface = nullptr;
    const ShaderInstance* displacement = nullptr;
    const ShaderInstance* atmosphere = nullptr;
    const ShaderInstance* interior = nullptr;
    const ShaderInstance* exterior = nullptr;
    Machine* ranSurface = nullptr;       // for volumes: the machine in which the surface shader has run
    Machine* ranDisplacement = nullptr;  // the same of the displacement shader, where its values are known
  };
  void begin(const Batch& batch, const ShaderInstance& shader, std::span<const ShaderInstance* const> lights,
             const Partners& partners);
  Status run();
  PendingRays& rays() { return *rays_; }
  const PendingRays& rays() const { return *rays_; }
  /// Register of a global or parameter of the shader that was begun; data == nullptr if there is none.
  Operand result(GlobalId id) const { return main_.global(id); }
  Operand result(std::string_view name) const;
  MachineStatistics& statistics() { return statistics_; }
  /// Machine code of the shader that was begun last, nullptr: it runs without. For tests.
  const NativeCode* code() const { return main_.native(); }

  /// Runs a parameter's default-value code at binding; reads values set so far, returns the new one.
  void beginDefaults(const ShaderInstance& shader);
  ShaderValue runDefault(const Parameter& p);

 private:
  struct LightState;
  enum class Next { kGo, kCall, kSuspend };

  // machine.cpp
  void beginWithKernels(const Batch& batch, const ShaderInstance& shader,
                        std::span<const ShaderInstance* const> lights, const Partners& partners);
  Next execute(Frame& f);
  Next control(Frame& f, const Step& s);
  void leave(Frame& f, uint32_t outermost);
  bool any(const int32_t* m) const;
  void setGlobals(Frame& f);
  const NativeCode* nativeCode(const ShaderInstance& shader);
  // machine_light.cpp
  void placeAtOrigin(LightState& l, uint32_t lanes);
  float* const* columnsWithLights(Frame& f);
  float* const* columnsWithDifferences(Frame& f, const NativeCode::Run& run);
  Next lightTurn(Frame& f);
  Next runLightsAhead(Frame& f, uint32_t loop);
  void beginLight(LightState& l);
  void collectLight(LightState& l, const int32_t* need);
  bool prepareShadowRays(Frame& f, Control& c, LightState& l);
  void applyShadowRays(Control& c, LightState& l);
  bool matchesCategory(const LightState& l, std::string_view category) const;
  void emit(Frame& f, const Step& s);
  bool sendToLight(Frame& f, const Step& s, LightState& l);
  void sampleEmitter(LightState& l, const Operand& Ps, const int32_t* need, const Operand& P,
                     const Operand& N, float* factor);
  void placeOnEmitter(LightState& l, const int32_t* need);
  bool aimEmitters(Frame& f, const Step& loop);
  void dimByEmitter(LightState& l, const int32_t* need);
  LightState* lightOf(const Frame& f) const;
  // machine_raycall.cpp
  Next rayOp(Frame& f, const Step& s);
  struct Question;
  struct RayCall;
  struct Term;
  void describe(Frame& f, const Step& s, RayCall& c);
  void chooseSums(const Frame& f, const Step& s, RayCall& c) const;
  void clearSums(const RayCall& c);
  void accumulate(const Frame& f, const RayCall& c);
  void averageSums(Frame& f, const Step& s, const RayCall& c);
  void finish(Frame& f, const Step& s, const RayCall& c, const int32_t* mask);
  void readTerms(Frame& f, const Step& s, uint32_t fixed, Question& q);
  bool aimAtLight(Frame& f, const RayCall& c);
  bool asksByMapName(Frame& f, const Step& s) const;
  // machine_gather.cpp
  Next gatherTurn(Frame& f);
  void describeGather(Frame& f, const Step& s, const Control& c, Question& q);
  void takeGathered(Frame& f, const Step& s, Control& c, const Question& q);
  void wantExtras(Frame& f, const Step& s, RayTerms& t);
  // machine_environment.cpp
  bool lookUpEnvironment(const Frame& f, std::string_view map, std::string_view spaceName);
  void answerEnvironment(const Frame& f, std::string_view map, std::string_view spaceName,
                         const Operand& out);
  // machine_ray.cpp
  uint32_t mostSamples(const Frame& f, const Question& q) const;
  void beginGroups(const int32_t* mask, const Question& q);
  bool nextGroup(Question& q);
  bool ask(Question& q);
  void computeFootprints();
  void listAsking(const Question& q);
  void listSamples(const Question& q);
  void hashSeeds(const Question& q, uint64_t* seeds, uint32_t* high) const;
  void choosePairs(SeedHash h, uint32_t index);
  void spreadOrigins(const Question& q, uint32_t sample, float* shift) const;
  void makeRays(const Question& q);
  void takeRays(const RayMaking& m, const uint64_t* seeds, uint32_t sample);
  template <uint32_t kMany>
  void takeAll(const RayMaking& m, const uint64_t* seeds);
  bool mayAsk(const Question& q);
  void answer(const Operand& out, uint32_t components, const float (*values)[kRayRow], const int32_t* mask);
  const Operand* option(const Frame& f, const Step& s, uint32_t fixed, std::string_view name) const;
  Term term(const Frame& f, const Step& s, uint32_t fixed, std::string_view name, float fallback) const;
  static uint32_t firstActive(const Frame& f);
  std::string_view optionString(Frame& f, const Step& s, uint32_t fixed, std::string_view name);
  float optionFloat(const Frame& f, const Step& s, uint32_t fixed, std::string_view name,
                    float fallback) const;
  // machine_call.cpp: everything without a kernel
  void call(Frame& f, const Step& s);
  void stringOp(Frame& f, const Step& s);
  void message(Frame& f, const Step& s);
  void transformOp(Frame& f, const Step& s);
  bool space(const Frame& f, std::string_view name, uint32_t object, DMat4& toCurrent) const;
  void randomOp(Frame& f, const Step& s);
  void splineOp(Frame& f, const Step& s);
  void arrayOp(Frame& f, const Step& s);
  // machine_derivative.cpp
  void derivativeOp(Frame& f, const Step& s);
  static void fillFromNeighbours(const Frame& f, const DerivativeStencil& d, const Operand& normal);
  void filterStep(Frame& f, const Step& s);
  void derivative(const Frame& f, Op op, const Operand& x, uint32_t components, const Operand& out) const;
  Difference differenceOf(const Frame& f, const Operand& x, bool alongV) const;
  void difference(const Frame& f, const Operand& x, uint32_t components, bool alongV, bool perCell,
                  const Operand& out) const;
  // machine_shadeop.cpp
  void shadeopCall(Frame& f, const Step& s);
  void callByPoint(Frame& f, const Step& s, bool varying);
  void callByBatch(Frame& f, const Step& s, bool varying);
  void prepareStrings(Frame& f, const Step& s);
  void takeStrings(Frame& f, const Step& s);
  // machine_texture.cpp
  void textureOp(Frame& f, const Step& s);
  void textureOptions(Frame& f, const Step& s, uint32_t fixed, FrTextureCall& call);
  void cornersToPlace(const Frame& f, const Operand* corner, bool triples, uint32_t lanes);
  void storeResult(const Frame& f, const Operand& out, uint32_t component, const float* values);
  void shadowMaps(Frame& f, const Step& s, const TextureLibrary& library, const Texture& list,
                  FrTextureCall& call);
  void bumpNormals(Frame& f, const Step& s, const float* bySide, const float* byHeight);
  void textureInfo(Frame& f, const Step& s, const TextureLibrary& library);
  void neutralTexture(Frame& f, const Step& s);
  // machine_text.cpp
  void formatText(Frame& f, const Step& s, uint32_t first, uint32_t lane, std::string& out);
  bool writeValue(Frame& f, uint32_t arg, const Operand& out, const ShaderValue& v);
  bool copyRegister(Frame& f, uint32_t arg, const Operand& out, Frame& from, std::string_view name);
  bool pointVariable(Frame& f, uint32_t arg, const Operand& out, std::string_view name);
  bool copyInstance(Frame& f, uint32_t arg, const Operand& out, const ShaderInstance* from,
                    std::string_view name);
  void setFloat(const Frame& f, const Operand& out, float value);
  std::string_view keep(std::string text);
  bool matchesText(std::string_view pattern, std::string_view subject);

  // Operand k of a step, as symbol index.
  static uint32_t symbolOf(const Frame& f, const Step& s, uint32_t k) {
    return f.exe().program().args[s.firstArg + k] & kArgIndex;
  }
  static bool isWritten(const Frame& f, const Step& s, uint32_t k) {
    return (f.exe().program().args[s.firstArg + k] & kArgWritten) != 0;
  }
  static std::string_view text(Frame& f, const Step& s, uint32_t k) {
    return f.strings(symbolOf(f, s, k))[0];
  }

  const ShaderHost& host_;
  Batch batch_;
  Partners partners_;
  Frame main_;
  std::vector<std::unique_ptr<LightState>> lights_;
  uint32_t lightCount_ = 0;
  std::vector<Frame*> stack_;
  std::unique_ptr<PendingRays> rays_;
  AlignedFloats scratch_, differences_, footprints_, rayColumns_, sampleColumns_, texture_;
  bool footprintsKnown_ = false;
  std::unordered_set<std::string> texts_;  // made by this batch; nodes stay where they are
  size_t textBytes_ = 0;
  struct Matched {
    std::string pattern, subject;
    bool result;
  };
  std::vector<Matched> matched_;
  ShaderValue answered_;              // by attribute(), option() and their kin
  std::unique_ptr<RayCall> rayCall_;  // the one that waits for its rays
  AlignedFloats accumulator_;         // of ray operations with several samples, see RayCall
  AlignedFloats aim_;                 // where rays towards a light go: points, normals, factors
  AlignedFloats missColor_;           // of rays that hit nothing, see lookUpEnvironment()
  /// Points of a ray call: those that have not asked yet, those of the present block; of a gather also who
  /// hit.
  struct Groups {
    const int32_t* whole = nullptr;  // all of these have yet to ask, in one block
    const int32_t* asked = nullptr;  // the points of the present block
    std::vector<int32_t> left, now, hits, missed;
    std::vector<uint32_t> points, first, many;  // who asks, the place of its first ray, and how many it asks
  } groups_;
  std::vector<Vec2> pairs_;  // random numbers for points of a light
  struct ShadeopCalls;       // buffers for calls of shared objects
  std::unique_ptr<ShadeopCalls> shadeopCalls_;
  /// Machine code of the programs that ran last, so that nobody has to be asked for it; by address of the
  /// program.
  struct KnownNative {
    std::shared_ptr<const Executable> exe;
    std::vector<RunLight> lights;
    const NativeCode* code = nullptr;
  };
  std::array<KnownNative, 16> knownNatives_;
  std::vector<RunLight> runLights_;
  std::vector<float*> columns_;  // of the surface and its lights
  bool columnsKnown_ = false;
  MachineStatistics statistics_;
};

}  // namespace fr
