// From RIB files to finished skeletons, one per world: what every program that renders a scene calls.
#pragma once

#include <array>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "base/error.h"
#include "scene_cache/format.h"

namespace fr::ri {
enum class MakeKind : uint8_t;
struct MakeTextureArgs;
}  // namespace fr::ri

namespace fr::cache {

/// One RIB file; "-" is standard input.
struct RibInput {
  std::string path;
  /// Which renderer sees the geometry and lights of this file: kForReyes | kForTracer for common files.
  uint8_t sides = kForReyes | kForTracer;
};

/// A Display from the command line.
struct DisplayOverride {
  std::string name, type = "file", mode = "rgba";
};

/// What the command line says instead of the RIB.
struct FrameOverrides {
  std::optional<std::array<int, 2>> resolution;
  std::optional<std::array<double, 4>> crop;  ///< xmin xmax ymin ymax in [0,1]
  std::optional<std::array<double, 2>> pixelSamples;
  std::optional<float> shadingRate;
  /// Where the RIB has no Attribute "render" "patch_multiplier".
  std::optional<float> patchMultiplier;
  /// Not empty: replace all Display requests but those for depth files, which later frames may need as shadow
  /// maps.
  std::vector<DisplayOverride> displays;
  /// Searched for shaders after all others. A .fsc remembers the folders of its RIB files in this way.
  std::vector<std::string> shaderFolders;
  /// Searched for textures after all others. loadScene() adds the folders of the RIB files.
  std::vector<std::string> textureFolders;
};

/// What holds where the RIB says nothing.
struct FrameDefaults {
  std::optional<std::array<int, 2>> resolution;
  std::optional<std::array<double, 2>> pixelSamples;
  /// Where there is no Display at all. Not set: no picture then.
  std::optional<DisplayOverride> display;
};
/// The picture of a scene without a Display (RISpec 3.2, "Display": "ri.pic", "file", "rgba").
inline const DisplayOverride kDefaultDisplay{"ri.tif"};

struct LoadOptions {
  FrameOverrides overrides;
  FrameDefaults defaults;
  /// Frame numbers (FrameBegin) to build, inclusive; others are read over. A world outside any frame has
  /// number 1, 2, ... in order of appearance.
  std::optional<std::pair<int, int>> frames;
  /// Executes MakeTexture, MakeShadow and their kin when they are met: worlds before them have been handed
  /// over, those after them not yet. `folders`: where their pictures are searched. Not set: nothing is made,
  /// with one warning.
  std::function<void(ri::MakeKind, const ri::MakeTextureArgs&, const std::vector<std::string>& folders,
                     const SourceLocation& where)>
      makeTexture;
  /// Whether the shader of this name, searched in `folders` first, can ask for rays. Procedurals that no
  /// camera ray can meet are opened only if some shader of the world can. Not set: all are opened, for guests
  /// that ask about everything.
  std::function<bool(const std::string& shader, const std::vector<std::string>& folders)> asksRays;
  /// Whether the surface shader of this name moves points: it then displaces under a "displacementbound". Not
  /// set: all may, so that none of their instances share grids.
  std::function<bool(const std::string& shader, const std::vector<std::string>& folders)> movesPoints;
  /// Whether the shader of this name has a string parameter of that name: strings of primitives take its
  /// place. Not set: none has.
  std::function<bool(const std::string& shader, const std::vector<std::string>& folders,
                     const std::string& parameter)>
      takesString;
  /// Folder for skeletons in files whose pages need not stay in memory; empty: they are memory.
  std::string scratch;
  /// Compute the skeletons' checksums (for files; not needed between processes).
  bool checksum = false;
};

/// Counts of what a world was made of, for statistics and for tools.
struct FrameCounts {
  uint64_t primitives = 0;  ///< RI requests that became objects
  uint64_t dropped = 0;     ///< requests that could not (reported)
  uint64_t lights = 0;
  uint64_t instances = 0;            ///< ObjectInstance requests
  uint64_t sharedInstances = 0;      ///< that show the grids of prototypes
  uint64_t procedurals = 0;          ///< that were expanded
  uint64_t proceduralsUnopened = 0;  ///< that nobody can see
  uint64_t outOfBound = 0;           ///< primitives that nobody can see, by their Bound
  uint64_t otherDetail = 0;          ///< primitives and procedurals that are for another detail
  double seconds = 0;                ///< from WorldBegin to the finished skeleton
};

/// One world, ready to render.
class Frame {
 public:
  Frame() = default;
  Frame(int number, int skeletonFd, uint64_t bytes, FrameCounts counts)
      : number_(number), fd_(skeletonFd), bytes_(bytes), counts_(counts) {}
  Frame(Frame&& o) noexcept { *this = std::move(o); }
  Frame& operator=(Frame&& o) noexcept {
    std::swap(number_, o.number_), std::swap(fd_, o.fd_), std::swap(bytes_, o.bytes_),
        std::swap(counts_, o.counts_);
    return *this;
  }
  ~Frame();

  int number() const { return number_; }
  /// Sealed memory file with the skeleton; owned by the frame. SceneCache::create() takes its own duplicate.
  int skeletonFd() const { return fd_; }
  uint64_t skeletonBytes() const { return bytes_; }
  const FrameCounts& counts() const { return counts_; }

 private:
  int number_ = 0;
  int fd_ = -1;
  uint64_t bytes_ = 0;
  FrameCounts counts_;
};

/// Called at each WorldEnd, on the loading thread; reading goes on when it returns. Returning false stops the
/// loading.
using FrameCallback = std::function<bool(Frame&&)>;

/// Reads the files and hands over every world. The image's files (those that REYES sees) are read one after
/// the other as if they were one stream. Files for the ray tracer alone make a second stream together with
/// the common ones, with a graphics state of its own: its n-th world adds to the image's n-th world, and what
/// it says about the image (Format, Display, camera) means nothing; ray depth, generic options and search
/// paths count. Problems inside the files are reported with their place and the rest goes on. The Result is
/// an error when a file cannot be opened, when the system fails, or when the error handler "abort" was
/// triggered; the other files have been read then. Search paths: Option "searchpath" first, then the
/// environment variables SHADERS, TEXTURES, ARCHIVES, PROCEDURALS and DISPLAYS; archives also stand beside
/// the RIB that names them. Not thread-safe: one loading at a time.
Result<void> loadScene(std::span<const RibInput> inputs, const LoadOptions& options,
                       const FrameCallback& onFrame);
/// What to say when it handed over no frame: "no world of frames 5 to 6 was found in the scene".
std::string noWorldFound(const LoadOptions& options);

}  // namespace fr::cache
