#include "imaging/frame_output.h"

#include <algorithm>
#include <cstring>

#include "imaging/display_mode.h"
#include "imaging/image_file.h"
#include "shm/memory_info.h"

namespace fr {

/// One image: its rows are kept, quantised, until the driver can take them in order.
struct FrameOutput::Display {
  DisplayRequest request;
  DisplayTarget target;
  DisplayMode mode;
  std::vector<int> sources;  // index of the delivered channel, for each channel of the file
  SampleFormat format = SampleFormat::kFloat;
  size_t pixelBytes = 0;
  bool failed = false;

  std::mutex mutex;  // guards all below
  ImageFile file;
  std::vector<std::byte> pixels;
  std::vector<int> missing;  // pixels of each row that have not come
  int nextRow = 0;
  bool writing = false;  // a thread is in file.write(), without the mutex
};

namespace {

/// Depth alone is quantised by the depth quantiser; beside colours it takes their format if both are floats.
const Quantizer& formatQuantizer(const DisplayRequest& r, const std::vector<int>& sources) {
  const bool onlyDepth =
      std::all_of(sources.begin(), sources.end(), [](int s) { return s == kDepthChannel; });
  return onlyDepth ? r.depthQuantizer : r.quantizer;
}

void store(std::byte* to, SampleFormat format, uint32_t q) {
  switch (format) {
    case SampleFormat::kU8:
      *reinterpret_cast<uint8_t*>(to) = uint8_t(std::min(q, 255u));
      break;
    case SampleFormat::kU16: {
      const auto v = uint16_t(std::min(q, 65535u));
      std::memcpy(to, &v, sizeof v);
      break;
    }
    case SampleFormat::kU32:
    case SampleFormat::kFloat:
      std::memcpy(to, &q, sizeof q);
      break;
  }
}

}  // namespace

std::vector<OutputChannel> requiredOutputs(const std::vector<DisplayRequest>& displays) {
  std::vector<OutputChannel> out;
  for (const DisplayRequest& d : displays)
    for (const DisplayMode::Channel& c : parseDisplayMode(d.mode).channels) {
      const bool known =
          c.variable.empty() || std::any_of(out.begin(), out.end(), [&](const OutputChannel& o) {
            return o.variable == c.variable && o.component == c.component && o.rule == d.rule;
          });
      if (!known) out.push_back({c.variable, c.component, d.rule});
    }
  return out;
}

void resolveOutputTypes(std::vector<DisplayRequest>& displays,
                        const std::function<int(std::string_view)>& components) {
  for (DisplayRequest& d : displays) {
    std::string mode;
    for (const std::string& item : splitDisplayMode(d.mode)) {
      if (!mode.empty()) mode += ',';
      const bool bare = item.find(' ') == std::string::npos;
      const int n = bare && isVariableOfMode(item) ? components(item) : 0;
      if (n > 0) mode += n == 1 ? "float " : n == 3 ? "color " : fmt::format("float[{}] ", n);
      mode += item;
    }
    d.mode = std::move(mode);
  }
}

Result<void> checkPictureFits(const FrameGeometry& geometry, const std::vector<DisplayRequest>& displays) {
  // A byte a channel is the least that a display keeps; a tile's records come to about a byte a pixel.
  uint64_t bytesPerPixel = 1;
  for (const DisplayRequest& d : displays) bytesPerPixel += parseDisplayMode(d.mode).channels.size();
  const uint64_t bytes = bytesPerPixel * uint64_t(geometry.crop.area());
  const uint64_t usable = shm::availableMemory().usable();
  if (bytes <= usable / 10 * 9) return {};
  return makeError(
      RiError::kNoMem,
      "a picture of {} x {} pixels takes {} MiB or more, and {} MiB of memory are free: render a "
      "smaller one, or parts of it with CropWindow",
      geometry.crop.width(), geometry.crop.height(), bytes >> 20, usable >> 20);
}

FrameOutput::FrameOutput(FrameGeometry geometry, std::vector<DisplayRequest> displays,
                         std::vector<std::string> searchPath)
    : geometry_(std::move(geometry)), searchPath_(std::move(searchPath)) {
  const std::vector<OutputChannel> outputs = requiredOutputs(displays);
  for (DisplayRequest& r : displays) {
    auto d = std::make_unique<Display>();
    d->mode = parseDisplayMode(r.mode);
    for (const DisplayMode::Channel& c : d->mode.channels) {
      int source = c.component;
      if (!c.variable.empty())
        for (size_t i = 0; i < outputs.size(); ++i)
          if (outputs[i].variable == c.variable && outputs[i].component == c.component &&
              outputs[i].rule == r.rule)
            source = kFixedChannels + int(i);
      d->sources.push_back(source);
    }
    d->request = std::move(r);
    displays_.push_back(std::move(d));
  }
}
FrameOutput::~FrameOutput() = default;

void FrameOutput::fail(Display& display, Error error) {
  display.failed = true;
  report(error);
  const std::lock_guard lock(errorMutex_);
  if (!firstError_) firstError_ = std::move(error);
}

Result<void> FrameOutput::open() {
  const int width = geometry_.crop.width(), height = geometry_.crop.height();
  if (width <= 0 || height <= 0) return makeError(RiError::kRange, "the crop window holds no pixels");
  size_t opened = 0;
  for (auto& display : displays_) {
    Display& d = *display;
    d.target = resolveDisplayType(d.request.type, d.request.name, searchPath_);
    auto driver = openDisplayDriver(d.target.driver, searchPath_);
    if (!driver) {
      fail(d, std::move(driver.error()).context("display \"" + d.request.name + "\""));
      continue;
    }
    const FrDisplayDriver& use = **driver;
    d.format = formatQuantizer(d.request, d.sources).format();
    if (!(use.acceptedFormats & (1u << int(d.format)))) d.format = SampleFormat::kFloat;
    d.pixelBytes = sampleBytes(d.format) * d.sources.size();
    d.pixels.resize(d.pixelBytes * size_t(width) * size_t(height));
    d.missing.assign(size_t(height), width);

    std::vector<const char*> names;
    for (const DisplayMode::Channel& c : d.mode.channels) names.push_back(c.name.c_str());
    std::vector<FrDisplayParameter> parameters;
    std::vector<std::vector<const char*>> strings;
    strings.reserve(geometry_.metadata.size() +
                    d.request.parameters.size());  // pointers into it are handed out
    for (const auto* list : {&geometry_.metadata, &d.request.parameters})
      for (const DisplayParameter& p : *list) {
        if (const auto* f = std::get_if<0>(&p.values))
          parameters.push_back({p.name.c_str(), FR_DISPLAY_TYPE_FLOAT, int(f->size()), f->data()});
        else if (const auto* i = std::get_if<1>(&p.values))
          parameters.push_back({p.name.c_str(), FR_DISPLAY_TYPE_INTEGER, int(i->size()), i->data()});
        else {
          auto& s = strings.emplace_back();
          for (const std::string& text : std::get<2>(p.values)) s.push_back(text.c_str());
          parameters.push_back({p.name.c_str(), FR_DISPLAY_TYPE_STRING, int(s.size()), s.data()});
        }
      }
    FrDisplayImage image{};
    image.path = d.target.path.c_str();
    image.fileFormat = d.target.fileFormat.c_str();
    image.originX = geometry_.crop.x0, image.originY = geometry_.crop.y0;
    image.width = width, image.height = height;
    image.fullWidth = geometry_.fullWidth, image.fullHeight = geometry_.fullHeight;
    image.pixelAspect = geometry_.pixelAspect;
    image.channelCount = int(names.size()), image.channelNames = names.data();
    image.format = int(d.format);
    image.parameterCount = int(parameters.size()), image.parameters = parameters.data();
    if (auto r = d.file.open(use, image); !r) {
      fail(d, std::move(r.error()));
      continue;
    }
    ++opened;
  }
  if (opened == 0 && !displays_.empty())
    return makeError(firstError_->code, "none of the displays could be opened: nothing is rendered");
  return {};
}

void FrameOutput::addTile(const FilmTile& tile) {
  const size_t n = size_t(tile.rect.area());
  const int width = tile.rect.width();
  std::vector<std::vector<float>> image(4);
  std::vector<float> x, y;
  std::vector<std::byte> quantised;
  for (auto& display : displays_) {
    Display& d = *display;
    {
      const std::lock_guard lock(d.mutex);
      if (d.failed || !d.file.isOpen()) continue;
    }
    for (size_t c = 0; c < 4; ++c) image[c] = tile.channels[c];
    if (!d.request.exposure.isIdentity())
      for (size_t c = 0; c < 3; ++c)
        for (float& v : image[c]) v = d.request.exposure.apply(v);
    if (imager_) {
      if (x.empty())
        for (size_t i = 0; i < n; ++i) {
          x.push_back(float(tile.rect.x0 + int(i) % width) + 0.5f);
          y.push_back(float(tile.rect.y0 + int(i) / width) + 0.5f);
        }
      float* const color[3] = {image[0].data(), image[1].data(), image[2].data()};
      std::vector<float> opacity[3] = {image[3], image[3], image[3]};
      float* const planes[3] = {opacity[0].data(), opacity[1].data(), opacity[2].data()};
      const std::lock_guard lock(imagerMutex_);
      imager_(n, x.data(), y.data(), color, planes, image[3].data());
    }
    quantised.resize(n * d.pixelBytes);
    const size_t bytes = sampleBytes(d.format);
    for (size_t c = 0; c < d.sources.size(); ++c) {
      const int source = d.sources[c];
      const std::vector<float>& from = source < 4 ? image[size_t(source)] : tile.channels[size_t(source)];
      const Quantizer& q = source == kDepthChannel ? d.request.depthQuantizer : d.request.quantizer;
      std::byte* to = quantised.data() + c * bytes;
      for (size_t i = 0; i < n; ++i, to += d.pixelBytes) {
        if (d.format == SampleFormat::kFloat) {
          std::memcpy(to, &from[i], sizeof(float));
        } else {
          const int px = tile.rect.x0 + int(i) % width, py = tile.rect.y0 + int(i) / width;
          store(to, d.format,
                q.isFloat() ? uint32_t(std::clamp(from[i], 0.0f, 4294967040.0f))
                            : q.quantize(from[i], px, py, source, 0));
        }
      }
    }

    std::unique_lock lock(d.mutex);
    const size_t rowBytes = d.pixelBytes * size_t(geometry_.crop.width());
    const size_t column = size_t(tile.rect.x0 - geometry_.crop.x0) * d.pixelBytes;
    for (int row = 0; row < tile.rect.height(); ++row) {
      const size_t imageRow = size_t(tile.rect.y0 - geometry_.crop.y0 + row);
      std::memcpy(d.pixels.data() + imageRow * rowBytes + column,
                  quantised.data() + size_t(row * width) * d.pixelBytes, size_t(width) * d.pixelBytes);
      d.missing[imageRow] -= width;
    }
    // One thread at a time writes; the others only leave their rows.
    while (!d.writing && !d.failed) {
      int last = d.nextRow;
      while (last < int(d.missing.size()) && d.missing[size_t(last)] == 0) ++last;
      if (last == d.nextRow) break;
      const int first = d.nextRow;
      d.nextRow = last;
      d.writing = true;
      lock.unlock();
      auto r = d.file.write(0, first, geometry_.crop.width(), last - first,
                            d.pixels.data() + size_t(first) * rowBytes, rowBytes);
      lock.lock();
      d.writing = false;
      if (!r) fail(d, std::move(r.error()));
    }
  }
}

std::string FrameOutput::firstPath() const {
  return displays_.empty() ? std::string() : displays_.front()->target.path;
}

Result<void> FrameOutput::finishPartial() {
  const size_t width = size_t(geometry_.crop.width());
  for (auto& display : displays_) {
    Display& d = *display;
    const int rows = int(d.missing.size()) - d.nextRow;
    if (d.failed || !d.file.isOpen() || rows == 0) continue;
    const size_t rowBytes = d.pixelBytes * width;
    auto r = d.file.write(0, d.nextRow, int(width), rows, d.pixels.data() + size_t(d.nextRow) * rowBytes,
                          rowBytes);
    d.nextRow = int(d.missing.size());
    if (!r) fail(d, std::move(r.error()));
  }
  return finish();
}

Result<void> FrameOutput::finish() {
  for (auto& display : displays_) {
    Display& d = *display;
    if (d.failed || !d.file.isOpen()) continue;
    if (auto r = d.file.finish(); !r) fail(d, std::move(r.error()));
  }
  if (firstError_) {
    const auto failed =
        std::count_if(displays_.begin(), displays_.end(), [](const auto& d) { return d->failed; });
    return makeError(firstError_->code, "{} of {} pictures {} not written", failed, displays_.size(),
                     failed == 1 ? "was" : "were");
  }
  return {};
}

}  // namespace fr
