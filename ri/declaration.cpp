#include "ri/declaration.h"

#include <array>
#include <cctype>
#include <cstring>
#include <deque>
#include <unordered_map>

namespace fr::ri {
namespace {

constexpr std::array<const char*, 6> kClassNames = {"constant", "uniform",     "varying",
                                                    "vertex",   "facevarying", "facevertex"};
constexpr std::array<const char*, 9> kTypeNames = {"float",  "integer", "string", "color", "point",
                                                   "vector", "normal",  "hpoint", "matrix"};
// A declaration may ask for no longer arrays than this; the values themselves come from the file anyway.
constexpr int kMaxArrayLength = 1 << 24;

bool isSpace(char c) { return c == ' ' || c == '\t' || c == '\n' || c == '\r'; }

std::string_view trim(std::string_view s) {
  while (!s.empty() && isSpace(s.front())) s.remove_prefix(1);
  while (!s.empty() && isSpace(s.back())) s.remove_suffix(1);
  return s;
}

bool equalIgnoringCase(std::string_view a, std::string_view b) {
  if (a.size() != b.size()) return false;
  for (size_t i = 0; i < a.size(); ++i) {
    if (std::tolower(static_cast<unsigned char>(a[i])) != std::tolower(static_cast<unsigned char>(b[i]))) {
      return false;
    }
  }
  return true;
}

std::optional<StorageClass> classFromName(std::string_view s) {
  for (size_t i = 0; i < kClassNames.size(); ++i) {
    if (equalIgnoringCase(s, kClassNames[i])) return StorageClass(i);
  }
  return std::nullopt;
}

std::optional<ValueType> typeFromName(std::string_view s) {
  for (size_t i = 0; i < kTypeNames.size(); ++i) {
    if (equalIgnoringCase(s, kTypeNames[i])) return ValueType(i);
  }
  if (equalIgnoringCase(s, "int")) return ValueType::kInteger;
  if (equalIgnoringCase(s, "mpoint")) return ValueType::kMatrix;
  return std::nullopt;
}

// Takes one word off the front: up to blank or '['.
std::string_view takeWord(std::string_view& s) {
  s = trim(s);
  size_t n = 0;
  while (n < s.size() && !isSpace(s[n]) && s[n] != '[') ++n;
  const std::string_view word = s.substr(0, n);
  s.remove_prefix(n);
  return word;
}

Error badDeclaration(std::string_view text) {
  return makeError(RiError::kSyntax, "\"{}\" is not a declaration (class type[n])", text);
}

// "[n]" at the front of `rest`, if there is one.
bool takeArrayLength(std::string_view& rest, Declaration& d) {
  rest = trim(rest);
  if (rest.empty() || rest.front() != '[') return true;
  const size_t close = rest.find(']');
  if (close == std::string_view::npos) return false;
  const std::string_view digits = trim(rest.substr(1, close - 1));
  int n = 0;
  for (char c : digits) {
    if (c < '0' || c > '9' || n > kMaxArrayLength) return false;
    n = n * 10 + (c - '0');
  }
  if (digits.empty() || n < 1 || n > kMaxArrayLength) return false;
  d.arrayLength = n;
  d.isArray = true;
  rest = trim(rest.substr(close + 1));
  return true;
}

// Reads the declaration at the front of `rest`; what follows it stays in `rest`.
Result<Declaration> takeDeclaration(std::string_view& rest, std::string_view whole) {
  Declaration d;
  std::string_view word = takeWord(rest);
  if (const auto c = classFromName(word)) {
    d.storage = *c;
    word = takeWord(rest);
  }
  const auto t = typeFromName(word);
  if (!t) return badDeclaration(whole);
  d.type = *t;
  if (!takeArrayLength(rest, d)) return badDeclaration(whole);
  return d;
}

using S = StorageClass;
using T = ValueType;
struct BuiltIn {
  const char* name;
  Declaration d;
};

constexpr Declaration plain(S s, T t) { return {s, t, 1, false}; }
constexpr Declaration array(S s, T t, int n) { return {s, t, n, true}; }

// RISpec 3.2 Table 5.1 and the standard shaders' parameters.
const BuiltIn kGeneral[] = {
    {"P", plain(S::kVertex, T::kPoint)},
    {"Pz", plain(S::kVertex, T::kFloat)},
    {"Pw", plain(S::kVertex, T::kHpoint)},
    {"N", plain(S::kVarying, T::kNormal)},
    {"Np", plain(S::kUniform, T::kNormal)},
    {"Cs", plain(S::kVarying, T::kColor)},
    {"Os", plain(S::kVarying, T::kColor)},
    {"s", plain(S::kVarying, T::kFloat)},
    {"t", plain(S::kVarying, T::kFloat)},
    {"st", array(S::kVarying, T::kFloat, 2)},
    {"width", plain(S::kVarying, T::kFloat)},
    {"constantwidth", plain(S::kConstant, T::kFloat)},
    {"origin", array(S::kUniform, T::kInteger, 2)},
    {"fov", plain(S::kUniform, T::kFloat)},
    {"flatness", plain(S::kUniform, T::kFloat)},
    {"Ka", plain(S::kUniform, T::kFloat)},
    {"Kd", plain(S::kUniform, T::kFloat)},
    {"Ks", plain(S::kUniform, T::kFloat)},
    {"Kr", plain(S::kUniform, T::kFloat)},
    {"Km", plain(S::kUniform, T::kFloat)},
    {"roughness", plain(S::kUniform, T::kFloat)},
    {"specularcolor", plain(S::kUniform, T::kColor)},
    {"texturename", plain(S::kUniform, T::kString)},
    {"intensity", plain(S::kUniform, T::kFloat)},
    {"lightcolor", plain(S::kUniform, T::kColor)},
    {"from", plain(S::kUniform, T::kPoint)},
    {"to", plain(S::kUniform, T::kPoint)},
    {"coneangle", plain(S::kUniform, T::kFloat)},
    {"conedeltaangle", plain(S::kUniform, T::kFloat)},
    {"beamdistribution", plain(S::kUniform, T::kFloat)},
    {"mindistance", plain(S::kUniform, T::kFloat)},
    {"maxdistance", plain(S::kUniform, T::kFloat)},
    {"background", plain(S::kUniform, T::kColor)},
    {"bgcolor", plain(S::kUniform, T::kColor)},
    {"distance", plain(S::kUniform, T::kFloat)},
    {"amplitude", plain(S::kUniform, T::kFloat)},
};

// Names that mean something only inside one option, attribute or request.
struct ContextBuiltIn {
  const char* context;
  const char* name;
  Declaration d;
};
constexpr Declaration kF = plain(S::kUniform, T::kFloat);
constexpr Declaration kI = plain(S::kUniform, T::kInteger);
constexpr Declaration kStr = plain(S::kUniform, T::kString);
constexpr Declaration kCol = plain(S::kUniform, T::kColor);

const ContextBuiltIn kInContext[] = {
    // Requests
    {"Display", "merge", kI},
    {"Display", "quantize", array(S::kUniform, T::kInteger, 4)},
    {"Display", "dither", kF},
    {"Display", "exposure", array(S::kUniform, T::kFloat, 2)},
    {"Display", "filter", kStr},
    {"Display", "filterwidth", array(S::kUniform, T::kFloat, 2)},
    {"Display", "compression", kStr},
    {"Resource", "operation", kStr},
    {"Resource", "subset", kStr},
    {"Hider", "jitter", kI},
    {"Hider", "depthfilter", kStr},
    {"Hider", "subpixel", kI},
    {"Hider", "sigma", kI},
    {"Hider", "sigmablur", kF},
    {"Hider", "emit", kI},
    {"Hider", "samplemotion", kI},
    {"Hider", "extrememotiondof", kI},
    {"Hider", "mattefile", kStr},
    {"Hider", "maxvpdepth", kI},
    // Options
    {"limits", "bucketsize", array(S::kUniform, T::kInteger, 2)},
    {"limits", "gridsize", kI},
    {"limits", "eyesplits", kI},
    {"limits", "texturememory", kI},
    {"limits", "geommemory", kI},
    {"limits", "derivmemory", kI},
    {"limits", "extremedisplacement", kI},
    {"limits", "zthreshold", kCol},
    {"limits", "othreshold", kCol},
    {"limits", "threads", kI},
    {"searchpath", "shader", kStr},
    {"searchpath", "texture", kStr},
    {"searchpath", "archive", kStr},
    {"searchpath", "procedural", kStr},
    {"searchpath", "display", kStr},
    {"searchpath", "include", kStr},
    {"searchpath", "resource", kStr},
    {"shadow", "bias", kF},
    {"shadow", "bias0", kF},
    {"shadow", "bias1", kF},
    {"shutter", "offset", kF},
    {"shutter", "clampmotion", kI},
    {"statistics", "endofframe", kI},
    {"statistics", "filename", kStr},
    {"statistics", "xmlfilename", kStr},
    {"runtime", "verbosity", kStr},
    {"rib", "format", kStr},
    {"rib", "compression", kStr},
    {"ribparse", "varsubst", kStr},
    {"render", "max_raylevel", kI},
    {"render", "minshadowbias", kF},
    {"render", "minsamples", kI},
    {"render", "maxsamples", kI},
    {"render", "prmanspecular", kI},
    {"render", "useprmandspy", kI},
    {"render", "use_hierarchy", kI},
    {"render", "bucketorder", kStr},
    {"radiosity", "steps", kI},
    {"radiosity", "minpatchsamples", kI},
    {"indirect", "savefile", kStr},
    {"indirect", "seedfile", kStr},
    {"indirect", "maxbounce", kI},
    {"indirect", "minsamples", kI},
    {"photon", "emit", kI},
    {"photon", "maxdiffusedepth", kI},
    {"photon", "maxspeculardepth", kI},
    // Attributes
    {"identifier", "name", kStr},
    {"identifier", "shadinggroup", kStr},
    {"displacementbound", "sphere", kF},
    {"displacementbound", "coordinatesystem", kStr},
    {"dice", "binary", kI},
    {"dice", "rasterorient", kI},
    {"dice", "hair", kI},
    {"trimcurve", "sense", kStr},
    {"cull", "hidden", kI},
    {"cull", "backfacing", kI},
    {"grouping", "membership", kStr},
    {"derivatives", "centered", kI},
    {"sides", "doubleshaded", kI},
    {"sides", "backfacetolerance", kF},
    {"shade", "strategy", kStr},
    {"shade", "transmissionhitmode", kStr},
    {"shade", "diffusehitmode", kStr},
    {"shade", "specularhitmode", kStr},
    {"shade", "camerahitmode", kStr},
    {"trace", "bias", kF},
    {"trace", "levels", kStr},
    {"trace", "maxdepth", kI},
    {"trace", "maxdiffusedepth", kI},
    {"trace", "maxspeculardepth", kI},
    {"trace", "specularthreshold", kF},
    {"trace", "displacements", kI},
    {"trace", "samplemotion", kI},
    {"visibility", "camera", kI},
    {"visibility", "trace", kI},
    {"visibility", "diffuse", kI},
    {"visibility", "specular", kI},
    {"visibility", "reflection", kI},
    {"visibility", "shadow", kI},
    {"visibility", "photon", kI},
    {"visibility", "transmission", kStr},
    {"irradiance", "maxerror", kF},
    {"irradiance", "maxpixeldist", kF},
    {"irradiance", "handle", kStr},
    {"irradiance", "filemode", kStr},
    {"irradiance", "nsamples", kI},
    {"photon", "causticmap", kStr},
    {"photon", "globalmap", kStr},
    {"photon", "shadingmodel", kStr},
    {"photon", "estimator", kI},
    {"render", "visibility", kI},
    {"render", "casts_shadows", kStr},
    {"render", "truedisplacement", kI},
    {"render", "patch_multiplier", kF},
    {"render", "patch_maxlevel", kI},
    {"render", "patch_minlevel", kI},
    {"render", "use_shadingrate", kI},
    {"light", "shadows", kStr},
    {"light", "nsamples", kI},
    {"light", "nphotons", kI},
    {"light", "cache", kStr},
    {"radiosity", "averagecolor", kCol},
    {"radiosity", "emissioncolor", kCol},
    {"radiosity", "specularcolor", kCol},
    {"radiosity", "patchsize", kF},
    {"radiosity", "elemsize", kF},
    {"radiosity", "minsize", kF},
    {"radiosity", "zonal", kStr},
    {"radiosity", "has_caustics", kI},
    {"indirect", "maxerror", kF},
    {"indirect", "maxpixeldist", kF},
    {"indirect", "nsamples", kI},
    {"caustic", "maxpixeldist", kF},
    {"caustic", "ngather", kI},
    {"caustic", "specularcolor", kCol},
    {"caustic", "refractioncolor", kCol},
    {"caustic", "refractionindex", kF},
    {"procedural", "immediatesubdivide", kI},
    {"procedural", "patience", kF},
    {"procedural", "detail", kF},
};

}  // namespace

const char* storageClassName(StorageClass c) { return kClassNames[size_t(c)]; }
const char* valueTypeName(ValueType t) { return kTypeNames[size_t(t)]; }

int componentCount(ValueType t) {
  switch (t) {
    case ValueType::kFloat:
    case ValueType::kInteger:
    case ValueType::kString:
      return 1;
    case ValueType::kColor:
    case ValueType::kPoint:
    case ValueType::kVector:
    case ValueType::kNormal:
      return 3;
    case ValueType::kHpoint:
      return 4;
    case ValueType::kMatrix:
      return 16;
  }
  return 1;
}

std::string Declaration::str() const {
  std::string s = fmt::format("{} {}", storageClassName(storage), valueTypeName(type));
  if (isArray) s += fmt::format("[{}]", arrayLength);
  return s;
}

Result<Declaration> parseDeclaration(std::string_view text) {
  std::string_view rest = text;
  Result<Declaration> d = takeDeclaration(rest, text);
  if (d && !rest.empty()) return badDeclaration(text);
  return d;
}

Result<ParsedToken> parseToken(std::string_view token) {
  ParsedToken r;
  std::string_view rest = trim(token);
  r.name = rest;
  if (rest.find_first_of(" \t[\n\r") == std::string_view::npos) return r;
  Result<Declaration> d = takeDeclaration(rest, token);
  if (!d) return d.error();
  r.name = takeWord(rest);
  if (!d->isArray && !takeArrayLength(rest, *d)) return badDeclaration(token);  // "float x[3]", as C has it
  if (r.name.empty() || !trim(rest).empty()) return badDeclaration(token);
  r.declaration = *d;
  return r;
}

Result<void> Dictionary::declare(std::string_view name, std::string_view declaration) {
  Result<Declaration> d = parseDeclaration(declaration);
  if (!d) return d.error();
  user_.insert_or_assign(std::string(name), *d);
  return {};
}

std::optional<Declaration> Dictionary::find(std::string_view name, std::string_view context) const {
  if (const auto it = user_.find(name); it != user_.end()) return it->second;
  // Asked for every bare parameter of a file: "context:name" without building a string.
  using Map = std::unordered_map<std::string_view, Declaration>;
  static const Map& builtIn = *[] {
    static std::deque<std::string> keys;
    auto* m = new Map;
    for (const BuiltIn& b : kGeneral) m->emplace(b.name, b.d);
    for (const ContextBuiltIn& b : kInContext)
      m->emplace(keys.emplace_back(fmt::format("{}:{}", b.context, b.name)), b.d);
    return m;
  }();
  char key[96];
  if (!context.empty() && context.size() + 1 + name.size() <= sizeof key) {
    std::memcpy(key, context.data(), context.size());
    key[context.size()] = ':';
    std::memcpy(key + context.size() + 1, name.data(), name.size());
    if (const auto it = builtIn.find({key, context.size() + 1 + name.size()}); it != builtIn.end())
      return it->second;
  }
  if (const auto it = builtIn.find(name); it != builtIn.end()) return it->second;
  return std::nullopt;
}

}  // namespace fr::ri
