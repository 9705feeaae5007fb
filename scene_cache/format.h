// Byte layout of the scene cache: the records of the skeleton and of the grid arena.
//
// docs/format/scenecache.md specifies this file in prose; change both together, and kFormatVersion.
// Everything here is trivially copyable, fixed width, explicitly padded, little endian. References are
// byte offsets from the start of the section they name, or indices; never pointers.
//
// Three segments:
//   skeleton   immutable once finished: strings, attribute states, shaders, lights, transforms, objects,
//              primitive sources, root patches.
//   nodes      one PatchNode per patch. Nodes [0, rootPatchCount) are the root patches; the others are halves
//              of split patches, appended when a split is first needed. Mutable by our two processes.
//   arena      diced grids (GridRecord + vertices), appended when first needed. Mutable by our two processes.
#pragma once

#include <atomic>
#include <cstdint>
#include <type_traits>

#include "base/math.h"

namespace fr::cache {

inline constexpr uint64_t kSkeletonMagic = 0x314c454b53435346ull;  // "FSCSKEL1"
inline constexpr uint32_t kFormatVersion = 10;
inline constexpr uint32_t kNone = 0xffffffffu;

/// Largest grid side in cells: 16x16 micropolygons and their 17x17 vertices are one shading batch.
inline constexpr int kMaxGridLog2 = 4;
inline constexpr int kMaxGridSide = 1 << kMaxGridLog2;
/// Strides 1, 2, 4, 8, 16.
inline constexpr int kLevels = kMaxGridLog2 + 1;
/// Most vertices and triangles of a meshlet.
inline constexpr int kMaxMeshletVertices = 256;
inline constexpr int kMaxMeshletTriangles = 320;
/// Positions start at multiples of this many bytes from the start of the arena, so that a vertex buffer of
/// byte stride 12 * k addresses the grid by an integral vertex index for each of its strides k = 1, 2 ..
/// 2^(levels - 1), and that the record in front of them is aligned to 16 bytes.
constexpr uint64_t positionAlign(uint32_t levels) { return uint64_t(12) << (levels < 3 ? 2 : levels - 1); }
/// The largest of them.
inline constexpr uint64_t kPositionAlign = 192;

using StringId = uint32_t;     // index into the string table; 0 is ""
using TransformId = uint32_t;  // index into transforms
using AttributeId = uint32_t;
using ShaderId = uint32_t;
using ObjectId = uint32_t;
using NodeId = uint32_t;
using SolidId = uint32_t;

/// `count` elements that start at byte `offset` of the skeleton.
struct Range {
  uint64_t offset = 0;
  uint64_t count = 0;
};
/// Elements [first, first + count) of one of the skeleton's tables.
struct Slice {
  uint32_t first = 0;
  uint32_t count = 0;
};

struct StringRecord {
  uint64_t offset;  // of the first byte in the skeleton; not zero terminated
  uint32_t size;
  uint32_t pad;
};

/// kFaceVertex has as many values as kFaceVarying, and is smooth on subdivision meshes whatever their tags
/// say.
enum class ParamClass : uint8_t { kConstant, kUniform, kVarying, kVertex, kFaceVarying, kFaceVertex };
enum class ParamType : uint8_t {
  kFloat,
  kInteger,
  kString,
  kColor,
  kPoint,
  kVector,
  kNormal,
  kHPoint,
  kMatrix
};

/// One typed value or array: shader parameter, primitive variable, option, attribute.
struct ParamRecord {
  StringId name;
  ParamClass storage;
  ParamType type;
  uint16_t pad;
  uint32_t arrayLength;  // 1 for a scalar declaration
  uint32_t pad2;
  Range
      values;  // floats (also for points, colours, matrices), int32s or StringIds; count counts those numbers
};

/// Object, shader or camera space to world, with motion keys. One key: not moving.
struct TransformRecord {
  Range times;     // float, keyCount of them, ascending
  Range matrices;  // DMat4, bytes as in RIB
};

enum class ShaderKind : uint32_t { kSurface, kDisplacement, kLight, kVolume, kImager, kDeformation };

/// A shader instance.
struct ShaderRecord {
  StringId name;
  ShaderKind kind;
  TransformId transform;     // shader space -> world
  Slice params;              // into params
  uint32_t lightFlags;       // kLightShadows | ...
  uint32_t lightSamples;     // Attribute "light" "nsamples"
  uint32_t areaLightObject;  // first object of an area light, else kNone
  StringId handle;           // light handle as text, "" otherwise
  uint32_t attributes;       // for lights: the attribute state at declaration (kNone: none)
  StringId locationFile;     // of the request that made it first, for messages
  uint32_t locationLine;
};
inline constexpr uint32_t kLightShadows = 1;  // Attribute "light" "shadows" "on"

struct NamedSpaceRecord {
  StringId name;
  TransformId transform;  // that space -> world
};

enum class CastsShadows : uint8_t { kNever, kOpaque, kOs, kShade };

inline constexpr uint32_t kVisibleCamera = 1, kVisibleReflection = 2, kVisibleShadow = 4;
inline constexpr uint32_t kForReyes = 1, kForTracer = 2;

enum AttributeFlags : uint32_t {
  kMatte = 1,
  kSmoothShading = 2,       // ShadingInterpolation "smooth"
  kReverseOrientation = 4,  // outcome of Orientation/ReverseOrientation against the handedness of the CTM:
                            // set when N = dPdu x dPdv has to be flipped, both taken in current = camera
                            // space. (In cache space the product is flipped once more when world to camera
                            // mirrors.) Polygons: dPdu x dPdv stands for (v1 - v0) x (v2 - v0).
  kRayDisplacements = 8,    // rays see the displaced surface (default); clear: undisplaced
  kDoubleShaded = 16,
  kReverseInCacheSpace =
      32,  // the same outcome for dPdu x dPdv computed in cache space (differs from kReverseOrientation
           // when the camera transform is mirrored): what dicing and tracing use
  kNoSpecularRays = 64,          // Attribute "visibility" "specular" [0] where "diffuse" is not 0
  kNoDiffuseRays = 128,          // and the other way round
  kCameraHitsPrimitive = 256,    // Attribute "shade" "camerahitmode" "primitive": colour and opacity of the
  kSpecularHitsPrimitive = 512,  // attributes, no shader; "specularhitmode",
  kDiffuseHitsPrimitive = 1024,  // "diffusehitmode"
  kSubtracted = 2048,  // of a solid that is taken away from another: its surface is seen from the side that
                       // was inside. kReverseOrientation and kReverseInCacheSpace are turned over for that
                       // already; displacement shaders see the solid's own orientation.
};

/// One attribute state, stored once for all primitives made under it.
struct AttributeRecord {
  Color color;
  Color opacity;
  float shadingRate;
  float patchMultiplier;    // Attribute "render" "patch_multiplier"; < 0: not set
  float displacementBound;  // world units, already scaled from its coordinate system
  uint32_t flags;           // AttributeFlags
  uint32_t sides;           // 1 or 2
  uint32_t visibility;      // kVisible* bits
  CastsShadows castsShadows;
  uint8_t pad[3];
  ShaderId surface, displacement, atmosphere, interior, exterior;  // kNone: none
  Slice lights;                                                    // into lightLists (ShaderIds), those on
  StringId name;                                                   // Attribute "identifier" "name"
  Slice attributes;  // into params: every Attribute as "category:name"
  float textureCoordinates[8];
  float bias;            // Attribute "trace" "bias"; < 0: not set
  uint32_t groups;       // StringId of grouping:membership
  uint32_t areaLight;    // 1 + ShaderId of the light that this geometry belongs to (AreaLightSource), 0: none
  uint32_t deformation;  // 1 + ShaderId, 0: none
  float flatness;  // GeometricApproximation "flatness": pixels between curves and their chords; 0: not set
  // GeometricApproximation "motionfactor", "focusfactor": how much coarser blur may make grids; 0: not at all
  float motionFactor, focusFactor;
  float thinning[2];  // of a representation in transition (DetailRange): only samples and rays whose chance
                      // is in [thinning[0], 1 - thinning[1]) see it. 0 0: all
};

enum class PrimitiveType : uint8_t {
  kSphere,
  kCone,
  kCylinder,
  kHyperboloid,
  kParaboloid,
  kDisk,
  kTorus,
  kBilinearPatches,  // Patch/PatchMesh "bilinear", and polygons large enough to be diced: one root patch a
                     // face
  kBicubicPatches,
  kSubdivision,
  kMeshlets,  // dense polygon mesh: one root patch (node) a meshlet
  kNurbs,     // NuPatch: one root patch a span (non-empty knot interval in u and in v)
  kPoints,    // one root patch a cluster of points; diced to meshlets of disks
  kCurves,    // one root patch a cluster of curves; diced to meshlets of ribbons
};

enum class SolidOperation : uint32_t { kPrimitive, kUnion, kIntersection, kDifference };

/// A SolidBegin block. Blocks are trees, with "primitive" blocks as leaves; a block stands behind its parent.
struct SolidRecord {
  SolidOperation operation;
  SolidId parent;    // kNone: a tree of its own
  uint32_t isFirst;  // 1: the first in its parent, from which a difference takes the others
  uint32_t pad;
};

/// One primitive of the scene. A *prototype* is made once for many instances: its transform leads to object
/// space (whose origin stands at the cache's), it is seen by nobody (sides 0), and its grids are diced at a
/// fixed rate. The others are what the prototype is, with a transform and attributes of their own: their
/// patches show the grids of the prototype's, transformed.
struct ObjectRecord {
  PrimitiveType type;
  uint8_t sides;      // kForReyes | kForTracer
  uint16_t keyCount;  // of its grids (GridRecord::keyCount), 1 = still
  AttributeId attributes;
  TransformId transform;  // object -> world
  uint32_t surfaceGroup;  // objects that may be pieces of one surface share it (same attribute state,
                          // transform and solid)
  Slice primvars;         // into params, without P, Pw, Pz
  NodeId firstPatch;      // root patches [firstPatch, firstPatch + patchCount)
  uint32_t patchCount;
  Box3f bound;            // cache space, displacement included
  Range source;           // type-specific bytes of the primitive (scene_cache/primitive_source.h)
  uint32_t locationFile;  // StringId: where the primitive stands in the RIB
  uint32_t locationLine;
  uint32_t solidPlus1;         // 1 + SolidId of the leaf that it bounds, 0: an ordinary surface
  ObjectId prototype = kNone;  // kNone: this object has grids of its own
  uint32_t instance = kNone;   // objects that one ObjectInstance made of prototypes share it
  float fixedRate =
      0;  // micropolygons per unit of length of a prototype's grids; 0: by distance from the eye
};
/// Leaf of a tree of solids that an object bounds a part of, or kNone.
inline SolidId solidOf(const ObjectRecord& o) { return o.solidPlus1 - 1; }

/// A border of a root patch: which patch evaluates it, so that neighbours get the same bits.
/// Eight per root patch of a mesh: edges v=0, u=1, v=1, u=0, then corners (0,0) (1,0) (1,1) (0,1).
struct EdgeRecord {
  uint32_t owner;     // root patch that evaluates this edge or corner
  uint8_t ownerEdge;  // which edge (0..3) or corner (0..3) of the owner it is
  uint8_t reversed;   // parameter runs the other way on the owner
  uint16_t pad;
};

/// Immutable facts of a root patch.
struct RootPatchRecord {
  ObjectId object;
  uint32_t face;       // index of the face, patch or meshlet within the primitive
  uint32_t firstEdge;  // into edges, 8 records; kNone: this patch evaluates its own borders
  uint32_t pad;
  Box3f bound;  // cache space, displacement included
};

// Node states (low 2 bits of PatchNode::state). The rest: kBuilding: owner slot (8 bits) and generation;
// kGrid: byte offset of the GridRecord in the arena, shifted left by 2; kSplit: NodeId of the first of two
// children << 2, and bit 63 says that the split is in v. Transitions: empty -> building (compare-and-swap by
// the claimer), building -> grid | split (release store by the owner), building of a dead owner -> building
// (compare-and-swap by the next). Nobody waits for anything while holding a claim.
enum class NodeState : uint64_t { kEmpty = 0, kBuilding = 1, kGrid = 2, kSplit = 3 };

/// A patch: a dyadic rectangle of a root patch's (u,v).
struct alignas(64) PatchNode {
  std::atomic<uint64_t> state;
  uint32_t root;    // index of the root patch
  uint32_t iu, iv;  // u0 = iu / 2^du, u1 = (iu + 1) / 2^du; same in v
  uint8_t du, dv;
  uint8_t
      edgeRootDepth[4];  // depth of the dyadic interval that each border (v0, u1, v1, u0) was created with
  uint16_t pad;
  Box3f bound;  // cache space, displacement included (by its declared bound; GridRecord::bound is measured)
  uint32_t prototype;  // 1 + the node of a prototype whose grids this node shows, transformed; 0: none
  uint32_t pad2;
};
static_assert(sizeof(PatchNode) == 64);

enum class GridKind : uint8_t { kGrid = 0, kMeshlet = 1 };

/// A diced patch. Vertices are cache-space floats, unless `placement` says how they get there.
/// kGrid: (nu + 1) x (nv + 1) vertices, rows `rowStride` vertices apart (padded so that strides 2..16 stay
/// inside). kMeshlet: nu vertices, nv triangles, 3 uint8 indices each.
struct alignas(16) GridRecord {
  NodeId node;
  GridKind kind;
  uint8_t keyCount;  // position keys, equally spaced over the shutter
  uint8_t levels;    // usable strides: 1, 2, .. 2^(levels-1)
  uint8_t flags;     // kGridHasNormals | ...
  uint16_t nu, nv;
  uint32_t rowStride;        // in vertices; kGridSprites: vertices a sprite
  uint64_t positions;        // arena offset of key 0; multiple of positionAlign(levels)
  uint64_t keyBytes;         // distance between keys
  uint64_t normals;          // arena offset of a packed normal (packed_normal.h) per vertex, dense; 0: none
  uint64_t indices;          // meshlet triangles, 0: none
  float deviation[kLevels];  // largest measured distance of stride 2^i to the stride-1 surface (index 0: to
                             // the true one)
  float cellSize;            // longest cell diagonal at stride 1
  Box3f bound;  // of these vertices, all keys; honest even when a displacement went beyond its bound
  uint8_t
      edgeShift[4];  // kGrid: along borders v0, u1, v1, u0 only every 2^edgeShift-th vertex of the border's
                     // line is kept, the others collapse onto the next lower one (neighbours then agree)
  uint32_t pad;
  uint64_t placement;  // arena offset of float[12], three rows of four: the vertices are another grid's, in
                       // its object space, and this takes them to cache space. 0: none
};
static_assert(sizeof(GridRecord) == 112);
inline constexpr uint8_t kGridHasNormals = 1;
inline constexpr uint8_t kGridTrimmed = 2;  // parts are cut away: ask SceneCache::trimOf()
inline constexpr uint8_t kGridAbsent = 4;   // all of it is cut away
/// A meshlet of separate polygons of equally many (rowStride) vertices, each a fan of triangles, each shaded
/// at one point: shading points are polygons, not vertices.
inline constexpr uint8_t kGridSprites = 8;

// ---- frame-wide records
// --------------------------------------------------------------------------------------

enum class ProjectionType : uint32_t { kOrthographic, kPerspective };
inline constexpr uint32_t kMaxClippingPlanes = 16;

struct CameraRecord {
  TransformId worldToCamera;
  ProjectionType projection;
  float fov;              // degrees, full angle of the shorter image side
  float screenWindow[4];  // left right bottom top
  int32_t resolution[2];
  float pixelAspect;
  float frameAspect;
  float cropWindow[4];
  int32_t cropPixels[4];  // xmin xmax ymin ymax, inclusive, by RISpec's rule
  float clipping[2];
  float shutter[2];
  float dof[3];  // fstop focallength focaldistance; fstop >= kRiInfinity: pinhole
  uint32_t clippingPlaneCount;
  float clippingPlanes[kMaxClippingPlanes][4];  // camera space: nobody sees where nx x + ny y + nz z > d
};

struct DisplayRecord {
  StringId name, type, mode;
  Slice params;
  float quantize[4];  // one min max dither
  float exposure[2];
};

struct OptionsRecord {
  float pixelSamples[2];
  StringId filter;
  float filterWidth[2];
  float exposure[2];
  float quantizeRgba[4];  // one min max dither
  float quantizeZ[4];
  float pixelVariance;
  StringId hider;
  Slice hiderParams;
  ShaderId imager;
  Slice displays;
  Slice options;  // into params: every Option as "category:name"
  int32_t maxRayLevel;
  int32_t frameNumber;
  uint32_t pad;
};

/// First bytes of a skeleton. `checksum` (XXH3-64 of all that follows the header) and `magic` are written
/// last.
struct SkeletonHeader {
  uint64_t magic;
  uint32_t version;
  uint32_t byteOrder;  // 0x01020304
  uint64_t layout;     // layoutFingerprint() of the writer's build
  uint64_t totalBytes;
  uint64_t checksum;
  DVec3 cacheOrigin;  // cache space = world space - cacheOrigin
  Range strings;      // StringRecord
  Range params;       // ParamRecord
  Range transforms;   // TransformRecord
  Range shaders;      // ShaderRecord
  Range lightLists;   // ShaderId
  Range namedSpaces;  // NamedSpaceRecord
  Range attributes;   // AttributeRecord
  Range objects;      // ObjectRecord
  Range rootPatches;  // RootPatchRecord
  Range edges;        // EdgeRecord
  Range displays;     // DisplayRecord
  Range camera;       // CameraRecord, 1
  Range options;      // OptionsRecord, 1
  Range searchPaths;  // StringId: shader texture archive procedural display
  Range solids;       // SolidRecord
};

template <class T>
inline constexpr bool isRecord = std::is_trivially_copyable_v<T>&& std::is_standard_layout_v<T>;
static_assert(isRecord<SkeletonHeader> && isRecord<ObjectRecord> && isRecord<AttributeRecord> &&
              isRecord<GridRecord> && isRecord<CameraRecord> && isRecord<OptionsRecord>);

}  // namespace fr::cache
