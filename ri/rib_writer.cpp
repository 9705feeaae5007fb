#include "ri/rib_writer.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <iterator>

#include "ri/rib_text.h"

namespace fr::ri {
namespace {

constexpr size_t kFlushAt = size_t(1) << 16;
constexpr int kMostStringTokens = 1 << 16;
constexpr size_t kMostStringsSeen = 1 << 17;

bool isFloat(double v) { return double(float(v)) == v || v != v; }
bool isInteger(double v) {
  return std::abs(v) <= 2147483647.0 && v == std::floor(v) && !(v == 0 && std::signbit(v));
}

}  // namespace

void appendQuoted(std::string& to, std::string_view s) {
  to += '"';
  for (size_t i = 0; i < s.size(); ++i) {
    const char c = s[i];
    switch (c) {
      case ':':
        // Before another escape it could be taken for a drive, and that for part of a path.
        if (i + 1 < s.size() && (s[i + 1] == '"' || static_cast<unsigned char>(s[i + 1]) < 32))
          to += "\\072";
        else
          to += c;
        break;
      case '"':
        to += "\\\"";
        break;
      case '\\':
        to += "\\\\";
        break;
      case '\n':
        to += "\\n";
        break;
      case '\r':
        to += "\\r";
        break;
      case '\t':
        to += "\\t";
        break;
      default:
        if (static_cast<unsigned char>(c) < 32) {
          fmt::format_to(std::back_inserter(to), "\\{:03o}", int(c));
        } else {
          to += c;
        }
    }
  }
  to += '"';
}

RibWriter::RibWriter(std::function<void(std::string_view)> write, RibWriterOptions options)
    : write_(std::move(write)), options_(options) {}
RibWriter::~RibWriter() { flush(); }

void RibWriter::flush() {
  if (!text_.empty()) write_(text_);
  text_.clear();
  lineBegin_ = 0;
}

RibWriter& RibWriter::put(std::string_view request) {
  if (options_.binary) {
    auto code = requestCodes_.find(request);
    if (code == requestCodes_.end()) {
      if (requestCodes_.size() == 256) {  // more than there are codes: as text
        text_ += request;
        text_ += ' ';
        return *this;
      }
      code = requestCodes_.emplace(request, static_cast<unsigned char>(requestCodes_.size())).first;
      definitions_ += '\314';
      definitions_ += char(code->second);
      define(request);
    }
    text_ += '\246';
    text_ += char(code->second);
    return *this;
  }
  const bool ends = request.ends_with("End") || request.starts_with("Else");
  if (ends && depth_ > 0) --depth_;
  if (options_.indent > 0) text_.append(size_t(std::min(depth_, 40)) * size_t(options_.indent), ' ');
  if (request.ends_with("Begin") || request.starts_with("Else")) ++depth_;
  text_ += request;
  return *this;
}
void RibWriter::end() {
  if (options_.binary) {
    if (!definitions_.empty()) {
      text_.insert(lineBegin_, definitions_);
      definitions_.clear();
    }
  } else {
    text_ += '\n';
  }
  lineBegin_ = text_.size();
  if (text_.size() >= kFlushAt) flush();
}

// Between two words: a blank, or a new line where the line is full.
void RibWriter::space() {
  if (options_.binary) return;
  if (options_.width == 0) {
    text_ += ' ';
    return;
  }
  const size_t last = text_.rfind('\n');
  const size_t begin = last == std::string::npos || last < lineBegin_ ? lineBegin_ : last + 1;
  if (text_.size() - begin < size_t(options_.width)) {
    text_ += ' ';
  } else {
    text_ += '\n';
    text_.append(size_t(std::min(depth_ + 2, 40)) * size_t(options_.indent), ' ');
  }
}

void RibWriter::binaryLength(unsigned char code, size_t n) {
  const int bytes = n < 0x100 ? 1 : n < 0x10000 ? 2 : n < 0x1000000 ? 3 : 4;
  text_ += char(code + bytes - 1);
  for (int i = bytes - 1; i >= 0; --i) text_ += char(n >> (8 * i) & 0xff);
}
void RibWriter::binaryInteger(int64_t v) {
  const int bytes = v >= -0x80 && v < 0x80           ? 1
                    : v >= -0x8000 && v < 0x8000     ? 2
                    : v >= -0x800000 && v < 0x800000 ? 3
                                                     : 4;
  text_ += char(0x80 + bytes - 1);
  for (int i = bytes - 1; i >= 0; --i) text_ += char(uint64_t(v) >> (8 * i) & 0xff);
}
void RibWriter::binaryFloat(float v) {
  const auto bits = std::bit_cast<uint32_t>(v);
  for (int i = 3; i >= 0; --i) text_ += char(bits >> (8 * i) & 0xff);
}
void RibWriter::binaryNumber(double v) {
  if (isInteger(v)) {
    binaryInteger(int64_t(v));
  } else if (isFloat(v)) {
    text_ += '\244';
    binaryFloat(float(v));
  } else {
    text_ += '\245';
    const auto bits = std::bit_cast<uint64_t>(v);
    for (int i = 7; i >= 0; --i) text_ += char(bits >> (8 * i) & 0xff);
  }
}
// The name of a definition whose head is written already.
void RibWriter::define(std::string_view text) {
  std::swap(text_, definitions_);
  if (text.size() < 16) {
    text_ += char(0x90 + text.size());
  } else {
    binaryLength(0xa0, text.size());
  }
  text_ += text;
  std::swap(text_, definitions_);
}

void RibWriter::string(std::string_view s) {
  if (!options_.binary) return appendQuoted(text_, s);
  if (s.size() >= 4 && s.size() <= 256) {  // what comes twice is defined
    const auto use = [&](int token) {
      text_ += token < 256 ? '\317' : '\320';
      if (token >= 256) text_ += char(token >> 8);
      text_ += char(token & 0xff);
    };
    std::string key(s);
    const auto known = strings_.find(key);
    if (known == strings_.end()) {
      if (strings_.size() < kMostStringsSeen) strings_.emplace(std::move(key), -1);
    } else if (known->second >= 0) {
      return use(known->second);
    } else if (stringTokens_ < kMostStringTokens) {
      const int token = known->second = stringTokens_++;
      definitions_ += token < 256 ? '\315' : '\316';
      if (token >= 256) definitions_ += char(token >> 8);
      definitions_ += char(token & 0xff);
      define(s);
      return use(token);
    }
  }
  if (s.size() < 16) {
    text_ += char(0x90 + s.size());
  } else {
    binaryLength(0xa0, s.size());
  }
  text_ += s;
}

RibWriter& RibWriter::add(double v) {
  if (options_.binary) {
    binaryNumber(v);
    return *this;
  }
  space();
  appendNumber(text_, v);
  return *this;
}
RibWriter& RibWriter::add(int v) {
  if (options_.binary) {
    binaryInteger(v);
    return *this;
  }
  space();
  fmt::format_to(std::back_inserter(text_), "{}", v);
  return *this;
}
RibWriter& RibWriter::add(const std::string& s) {
  space();
  string(s);
  return *this;
}
RibWriter& RibWriter::add(const Handle& h) {
  if (!h.isInteger) return add(h.name);
  int v = 0;
  std::from_chars(h.name.data(), h.name.data() + h.name.size(), v);
  return add(v);
}

template <class T>
RibWriter& RibWriter::addArray(const std::vector<T>& v) {
  space();
  text_ += '[';
  bool first = true;
  for (const T& one : v) {
    if (!first) space();
    first = false;
    if constexpr (std::is_same_v<T, std::string>) {
      string(one);
    } else if (!options_.binary) {
      appendNumber(text_, one);
    } else {
      binaryNumber(double(one));
    }
  }
  text_ += ']';
  return *this;
}

RibWriter& RibWriter::add(const std::vector<float>& v) {
  if (!options_.binary) return addArray(v);
  binaryLength(0xc8, v.size());
  for (const float f : v) binaryFloat(f);
  return *this;
}
RibWriter& RibWriter::add(const std::vector<double>& v) {
  if (!options_.binary || !std::all_of(v.begin(), v.end(), isFloat)) return addArray(v);
  return add(std::vector<float>(v.begin(), v.end()));
}
RibWriter& RibWriter::add(const std::vector<int>& v) { return addArray(v); }
RibWriter& RibWriter::add(const std::vector<std::string>& v) { return addArray(v); }
RibWriter& RibWriter::add(const DMat4& m) {
  std::vector<double> a(16);
  for (int i = 0; i < 16; ++i) a[size_t(i)] = m[i / 4][i % 4];
  return add(a);
}
RibWriter& RibWriter::add(const ParamList& params) {
  for (const Param& p : params) {
    const bool bare = options_.keepBareNames && p.form != TokenForm::kInline;
    add(!bare ? fmt::format("{} {}", p.declaration.str(), p.name) : p.name);
    switch (p.declaration.type) {
      case ValueType::kString:
        add(p.strings);
        break;
      case ValueType::kInteger:
        add(p.ints);
        break;
      default:
        // Numbers of unknown type: an array of floats would exclude integers.
        bare&& p.form == TokenForm::kUndeclared ? addArray(p.floats) : add(p.floats);
        break;
    }
  }
  return *this;
}

void RibWriter::frameBegin(int n) { put("FrameBegin").add(n).end(); }
void RibWriter::frameEnd() { put("FrameEnd").end(); }
void RibWriter::worldBegin() { put("WorldBegin").end(); }
void RibWriter::worldEnd() { put("WorldEnd").end(); }
void RibWriter::attributeBegin() { put("AttributeBegin").end(); }
void RibWriter::attributeEnd() { put("AttributeEnd").end(); }
void RibWriter::transformBegin() { put("TransformBegin").end(); }
void RibWriter::transformEnd() { put("TransformEnd").end(); }
void RibWriter::solidBegin(std::string operation) { put("SolidBegin").add(operation).end(); }
void RibWriter::solidEnd() { put("SolidEnd").end(); }
void RibWriter::objectBegin(Handle h) { put("ObjectBegin").add(h).end(); }
void RibWriter::objectEnd() { put("ObjectEnd").end(); }
void RibWriter::objectInstance(Handle h) { put("ObjectInstance").add(h).end(); }
void RibWriter::motionBegin(std::vector<float> times) { put("MotionBegin").add(times).end(); }
void RibWriter::motionEnd() { put("MotionEnd").end(); }
void RibWriter::resourceBegin() { put("ResourceBegin").end(); }
void RibWriter::resourceEnd() { put("ResourceEnd").end(); }

void RibWriter::format(int x, int y, double aspect) { put("Format").add(x).add(y).add(aspect).end(); }
void RibWriter::frameAspectRatio(double a) { put("FrameAspectRatio").add(a).end(); }
void RibWriter::screenWindow(double l, double r, double b, double t) {
  put("ScreenWindow").add(l).add(r).add(b).add(t).end();
}
void RibWriter::cropWindow(double a, double b, double c, double d) {
  put("CropWindow").add(a).add(b).add(c).add(d).end();
}
void RibWriter::projection(std::string name, ParamList params) {
  put("Projection");
  if (!name.empty()) add(name).add(params);
  end();
}
void RibWriter::clipping(double n, double f) { put("Clipping").add(n).add(f).end(); }
void RibWriter::clippingPlane(DVec3 p, DVec3 n) {
  put("ClippingPlane").add(p.x).add(p.y).add(p.z).add(n.x).add(n.y).add(n.z).end();
}
void RibWriter::depthOfField(double a, double b, double c) { put("DepthOfField").add(a).add(b).add(c).end(); }
void RibWriter::depthOfField() { put("DepthOfField").end(); }
void RibWriter::shutter(double a, double b) { put("Shutter").add(a).add(b).end(); }
void RibWriter::camera(std::string name, ParamList p) { put("Camera").add(name).add(p).end(); }
void RibWriter::pixelVariance(double v) { put("PixelVariance").add(v).end(); }
void RibWriter::pixelSamples(double x, double y) { put("PixelSamples").add(x).add(y).end(); }
void RibWriter::pixelFilter(std::string n, double x, double y) {
  put("PixelFilter").add(n).add(x).add(y).end();
}
void RibWriter::exposure(double gain, double gamma) { put("Exposure").add(gain).add(gamma).end(); }
void RibWriter::quantize(std::string type, int one, int min, int max, double dither) {
  put("Quantize").add(type).add(one).add(min).add(max).add(dither).end();
}
void RibWriter::display(std::string name, std::string type, std::string mode, ParamList p) {
  put("Display").add(name).add(type).add(mode).add(p).end();
}
void RibWriter::displayChannel(std::string d, ParamList p) { put("DisplayChannel").add(d).add(p).end(); }
void RibWriter::hider(std::string type, ParamList p) { put("Hider").add(type).add(p).end(); }
void RibWriter::colorSamples(std::vector<float> a, std::vector<float> b) {
  put("ColorSamples").add(a).add(b).end();
}
void RibWriter::relativeDetail(double v) { put("RelativeDetail").add(v).end(); }
void RibWriter::option(std::string category, ParamList p) { put("Option").add(category).add(p).end(); }

void RibWriter::color(std::span<const float> c) {
  put("Color").add(std::vector<float>(c.begin(), c.end())).end();
}
void RibWriter::opacity(std::span<const float> c) {
  put("Opacity").add(std::vector<float>(c.begin(), c.end())).end();
}
void RibWriter::textureCoordinates(const std::array<float, 8>& st) {
  put("TextureCoordinates").add(std::vector<float>(st.begin(), st.end())).end();
}
void RibWriter::shader(ShaderKind kind, std::string name, ParamList p) {
  put(shaderKindName(kind)).add(name).add(p).end();
}
void RibWriter::lightSource(std::string name, Handle h, ParamList p) {
  put("LightSource").add(name).add(h).add(p).end();
}
void RibWriter::areaLightSource(std::string name, Handle h, ParamList p) {
  put("AreaLightSource").add(name).add(h).add(p).end();
}
void RibWriter::illuminate(Handle light, bool on) { put("Illuminate").add(light).add(int(on)).end(); }
void RibWriter::shaderLayer(std::string t, std::string n, std::string l, ParamList p) {
  put("ShaderLayer").add(t).add(n).add(l).add(p).end();
}
void RibWriter::connectShaderLayers(std::string t, std::string a, std::string b, std::string c,
                                    std::string d) {
  put("ConnectShaderLayers").add(t).add(a).add(b).add(c).add(d).end();
}
void RibWriter::shadingRate(double v) { put("ShadingRate").add(v).end(); }
void RibWriter::shadingInterpolation(std::string t) { put("ShadingInterpolation").add(t).end(); }
void RibWriter::matte(bool on) { put("Matte").add(int(on)).end(); }
void RibWriter::bound(const Bound& b) { put("Bound").add(std::vector<double>(b.begin(), b.end())).end(); }
void RibWriter::detail(const Bound& b) { put("Detail").add(std::vector<double>(b.begin(), b.end())).end(); }
void RibWriter::detailRange(double a, double b, double c, double d) {
  put("DetailRange").add(a).add(b).add(c).add(d).end();
}
void RibWriter::geometricApproximation(std::string t, double v) {
  put("GeometricApproximation").add(t).add(v).end();
}
void RibWriter::geometricRepresentation(std::string t) { put("GeometricRepresentation").add(t).end(); }
void RibWriter::orientation(std::string o) { put("Orientation").add(o).end(); }
void RibWriter::reverseOrientation() { put("ReverseOrientation").end(); }
void RibWriter::sides(int n) { put("Sides").add(n).end(); }
void RibWriter::attribute(std::string category, ParamList p) { put("Attribute").add(category).add(p).end(); }
void RibWriter::basis(BasisArgument u, BasisArgument v) {
  put("Basis");
  for (const BasisArgument* b : {&u, &v}) {
    b->name.empty() ? add(b->matrix) : add(b->name);
    add(b->step);
  }
  end();
}
void RibWriter::trimCurve(TrimCurve t) {
  put("TrimCurve")
      .add(t.ncurves)
      .add(t.order)
      .add(t.knot)
      .add(t.min)
      .add(t.max)
      .add(t.n)
      .add(t.u)
      .add(t.v)
      .add(t.w);
  end();
}
void RibWriter::resource(std::string h, std::string t, ParamList p) {
  put("Resource").add(h).add(t).add(p).end();
}

void RibWriter::identity() { put("Identity").end(); }
void RibWriter::transform(const DMat4& m) { put("Transform").add(m).end(); }
void RibWriter::concatTransform(const DMat4& m) { put("ConcatTransform").add(m).end(); }
void RibWriter::perspective(double fov) { put("Perspective").add(fov).end(); }
void RibWriter::translate(DVec3 t) { put("Translate").add(t.x).add(t.y).add(t.z).end(); }
void RibWriter::rotate(double angle, DVec3 a) { put("Rotate").add(angle).add(a.x).add(a.y).add(a.z).end(); }
void RibWriter::scale(DVec3 s) { put("Scale").add(s.x).add(s.y).add(s.z).end(); }
void RibWriter::skew(double angle, DVec3 a, DVec3 b) {
  put("Skew").add(angle).add(a.x).add(a.y).add(a.z).add(b.x).add(b.y).add(b.z).end();
}
void RibWriter::coordinateSystem(std::string n) { put("CoordinateSystem").add(n).end(); }
void RibWriter::scopedCoordinateSystem(std::string n) { put("ScopedCoordinateSystem").add(n).end(); }
void RibWriter::coordSysTransform(std::string n) { put("CoordSysTransform").add(n).end(); }

void RibWriter::primitive(Primitive primitive) {
  put(primitiveName(primitive));
  const auto word = [](bool b, const char* yes, const char* no) { return std::string(b ? yes : no); };
  const auto wrap = [&](bool b) { return word(b, "periodic", "nonperiodic"); };
  if (const auto* p = std::get_if<GeneralPolygon>(&primitive)) {
    add(p->nverts);
  } else if (const auto* q = std::get_if<PointsPolygons>(&primitive)) {
    add(q->nverts).add(q->verts);
  } else if (const auto* g = std::get_if<PointsGeneralPolygons>(&primitive)) {
    add(g->nloops).add(g->nverts).add(g->verts);
  } else if (const auto* a = std::get_if<Patch>(&primitive)) {
    add(word(a->bicubic, "bicubic", "bilinear"));
  } else if (const auto* m = std::get_if<PatchMesh>(&primitive)) {
    add(word(m->bicubic, "bicubic", "bilinear")).add(m->nu).add(wrap(m->uPeriodic));
    add(m->nv).add(wrap(m->vPeriodic));
  } else if (const auto* n = std::get_if<NuPatch>(&primitive)) {
    add(n->nu).add(n->uOrder).add(n->uKnot).add(double(n->uMin)).add(double(n->uMax));
    add(n->nv).add(n->vOrder).add(n->vKnot).add(double(n->vMin)).add(double(n->vMax));
  } else if (const auto* s = std::get_if<SubdivisionMesh>(&primitive)) {
    add(s->scheme).add(s->nverts).add(s->verts).add(s->tags).add(s->nargs).add(s->intArgs).add(s->floatArgs);
    if (s->hierarchical) add(s->stringArgs);
  } else if (const auto* sp = std::get_if<Sphere>(&primitive)) {
    add(sp->radius).add(sp->zmin).add(sp->zmax).add(sp->thetaMax);
  } else if (const auto* co = std::get_if<Cone>(&primitive)) {
    add(co->height).add(co->radius).add(co->thetaMax);
  } else if (const auto* cy = std::get_if<Cylinder>(&primitive)) {
    add(cy->radius).add(cy->zmin).add(cy->zmax).add(cy->thetaMax);
  } else if (const auto* h = std::get_if<Hyperboloid>(&primitive)) {
    add(h->p1[0]).add(h->p1[1]).add(h->p1[2]).add(h->p2[0]).add(h->p2[1]).add(h->p2[2]).add(h->thetaMax);
  } else if (const auto* pa = std::get_if<Paraboloid>(&primitive)) {
    add(pa->rmax).add(pa->zmin).add(pa->zmax).add(pa->thetaMax);
  } else if (const auto* d = std::get_if<Disk>(&primitive)) {
    add(d->height).add(d->radius).add(d->thetaMax);
  } else if (const auto* t = std::get_if<Torus>(&primitive)) {
    add(t->majorRadius).add(t->minorRadius).add(t->phiMin).add(t->phiMax).add(t->thetaMax);
  } else if (const auto* c = std::get_if<Curves>(&primitive)) {
    add(word(c->cubic, "cubic", "linear")).add(c->nverts).add(wrap(c->periodic));
  } else if (const auto* b = std::get_if<Blobby>(&primitive)) {
    add(b->nleaf).add(b->code).add(b->floats).add(b->strings);
  } else if (const auto* ge = std::get_if<Geometry>(&primitive)) {
    add(ge->type);
  }
  add(paramsOf(primitive)).end();
}

void RibWriter::procedural(Procedural p) {
  if (p.kind == ProceduralKind::kProcedural2) {
    return put("Procedural2").add(p.subdivide).add(p.boundFunction).add(p.params).end();
  }
  put("Procedural").add(p.subdivide).add(p.data);
  const Bound b = p.bound.value_or(Bound{-1e30, 1e30, -1e30, 1e30, -1e30, 1e30});
  add(std::vector<double>(b.begin(), b.end())).end();
}

void RibWriter::makeTexture(MakeKind kind, MakeTextureArgs a) {
  static constexpr const char* kNames[] = {
      "MakeTexture",   "MakeBump",    "MakeLatLongEnvironment", "MakeCubeFaceEnvironment", "MakeShadow",
      "MakeOcclusion", "MakeBrickMap"};
  put(kNames[size_t(kind)]);
  if (kind == MakeKind::kOcclusion || kind == MakeKind::kBrickMap) {
    add(a.pictures);
  } else {
    for (const std::string& p : a.pictures) add(p);
  }
  add(a.texture);
  if (kind == MakeKind::kCubeFaceEnvironment) add(a.fov);
  if (kind == MakeKind::kTexture || kind == MakeKind::kBump) add(a.sWrap).add(a.tWrap);
  if (!a.filter.empty()) add(a.filter).add(a.sWidth).add(a.tWidth);
  add(a.params).end();
}
void RibWriter::errorHandler(std::string name) { put("ErrorHandler").add(name).end(); }
void RibWriter::declare(std::string name, std::string d) { put("Declare").add(name).add(d).end(); }
void RibWriter::readArchive(std::string name, ParamList p) { put("ReadArchive").add(name).add(p).end(); }
void RibWriter::archiveBegin(Handle name, ParamList p) { put("ArchiveBegin").add(name).add(p).end(); }
void RibWriter::archiveEnd() { put("ArchiveEnd").end(); }
void RibWriter::archiveRecord(RecordKind kind, std::string text) {
  // Text among binary requests: a line of its own.
  if (options_.binary && lineBegin_ > 0) text_ += '\n';
  if (kind == RecordKind::kStructure) text_ += "##";
  if (kind != RecordKind::kStructure && options_.indent > 0)
    text_.append(size_t(std::min(depth_, 40)) * size_t(options_.indent), ' ');
  if (kind == RecordKind::kComment) text_ += '#';
  // A comment ends with its line.
  if (kind != RecordKind::kVerbatim)
    std::replace_if(
        text.begin(), text.end(), [](char c) { return c == '\n' || c == '\r'; }, ' ');
  text_ += text;
  if (options_.binary) text_ += '\n';
  end();
}
void RibWriter::version(double number) { put("version").add(number).end(); }
void RibWriter::conditional(std::string_view request, std::string condition) {
  put(request);
  if (request == "IfBegin" || request == "ElseIf") add(condition);
  end();
}

}  // namespace fr::ri
