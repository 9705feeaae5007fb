#include "reyes/sample_buffer.h"

#include <algorithm>
#include <cmath>

namespace fr::reyes {

void SampleBuffer::reset(const PixelRect& rect, const SamplePattern& pattern, float farKey,
                         const SampleRound& round) {
  rect_ = rect;
  perPixel_ = round.count > 0 ? round.count : pattern.perPixel();
  firstOfPixel_ = size_t(round.first);
  const int used = rect.width() * perPixel_;
  rowStride_ = (used + kRunPadding - 1) / kRunPadding * kRunPadding + kRunPadding;
  const size_t n = size_t(rowStride_) * size_t(rect.height()) + kRunPadding;
  x.assign(n, 0), y.assign(n, 0), xy.assign(n, 0);
  const int group = rasterWidth();
  groups_.clear();
  if (perPixel_ % group == 0) groups_.assign(size_t(perPixel_ / group), {kSubpixels, kSubpixels, 0, 0});
  depth.assign(n, -kInfinity);  // the padding keeps it: nothing is nearer
  hit.assign(n, kNothing);
  for (int row = 0; row < rect.height(); ++row)
    for (int column = 0; column < rect.width(); ++column) {
      const size_t first = index(column, row);
      const SamplePattern::Offset* offset =
          pattern.offsets().data() + pattern.first(rect.x0 + column, rect.y0 + row) + firstOfPixel_;
      const bool wanted = !round.wanted || round.wanted[row * rect.width() + column];
      for (size_t i = first; i < first + size_t(perPixel_); ++i, ++offset) {
        x[i] = column * kSubpixels + offset->x;
        y[i] = row * kSubpixels + offset->y;
        if (wanted) depth[i] = farKey;
        xy[i] = uint32_t(y[i]) << 16 | (uint32_t(x[i]) & 0xffff);
        if (groups_.empty()) continue;
        SampleGroup& g = groups_[(i - first) / size_t(group)];
        g.x0 = std::min<int32_t>(g.x0, offset->x), g.x1 = std::max<int32_t>(g.x1, offset->x);
        g.y0 = std::min<int32_t>(g.y0, offset->y), g.y1 = std::max<int32_t>(g.y1, offset->y);
      }
      if (column + 1 == rect.width())
        for (size_t i = first + size_t(perPixel_); i < size_t(row + 1) * size_t(rowStride_); ++i)
          x[i] = x[first], y[i] = y[first],
          xy[i] = xy[first];  // near the run, so that kernels' integers do not overflow
    }
  resetBlur(pattern);
  start_.clear();
  blocksX_ = (rect.width() + kBlock - 1) / kBlock;
  blocksY_ = (rect.height() + kBlock - 1) / kBlock;
  blockDepth_.assign(size_t(blocksX_ * blocksY_), farKey);
  blockStale_.assign(size_t(blocksX_ * blocksY_), round.wanted != nullptr);
}

void SampleBuffer::limit(const SamplePattern& pattern, const SightLines& lines, const RasterSpace& space) {
  const double near = double(space.near()), far = double(space.far());
  bool late = false;
  start_.assign(size(), -kInfinity);
  for (int row = 0; row < rect_.height(); ++row)
    for (int column = 0; column < rect_.width(); ++column) {
      const size_t inPattern = pattern.first(rect_.x0 + column, rect_.y0 + row) + firstOfPixel_,
                   first = index(column, row);
      for (size_t k = 0; k < size_t(perPixel_); ++k) {
        const size_t i = first + k;
        const auto blur = pattern.blurs().empty() ? SamplePattern::Blur{} : pattern.blurs()[inPattern + k];
        const SightLines::Depths seen = lines.seen(
            lines.line(rect_.x0 + double(x[i]) / kSubpixels, rect_.y0 + double(y[i]) / kSubpixels, blur),
            near, far);
        if (!(seen.near < seen.far)) {
          depth[i] = -kInfinity;
        } else if (seen.far < far) {
          depth[i] = std::min(depth[i], space.key(float(seen.far)));
        }
        if (seen.near > near) start_[i] = space.key(float(seen.near)), late = true;
      }
    }
  if (!late) start_.clear();
  touched(0, 0, rect_.width() - 1, rect_.height() - 1);
}

float SampleBuffer::chance(size_t sample, const SamplePattern& pattern) const {
  const auto row = int(sample / size_t(rowStride_)), inRow = int(sample % size_t(rowStride_));
  const int column = inRow / perPixel_;
  return pattern.chance(pattern.first(rect_.x0 + column, rect_.y0 + row) + firstOfPixel_ +
                        size_t(inRow % perPixel_));
}

void SampleBuffer::resetBlur(const SamplePattern& pattern) {
  if (pattern.blurs().empty()) {
    time.clear(), lensX.clear(), lensY.clear();
    return;
  }
  for (auto* v : {&time, &lensX, &lensY}) v->assign(size(), 0.0f);
  slots_.assign(size_t(perPixel_), {1, 0, 1, -1, 1, -1});
  candidates_.resize(size() + kRunPadding);
  pairs_.resize(kMostBlurPairs), sorted_.resize(kMostBlurPairs);
  for (int row = 0; row < rect_.height(); ++row)
    for (int column = 0; column < rect_.width(); ++column) {
      const SamplePattern::Blur* blur =
          pattern.blurs().data() + pattern.first(rect_.x0 + column, rect_.y0 + row) + firstOfPixel_;
      size_t i = index(column, row);
      for (size_t slot = 0; slot < size_t(perPixel_); ++slot, ++i, ++blur) {
        time[i] = blur->time, lensX[i] = blur->lensX, lensY[i] = blur->lensY;
        SlotRange& r = slots_[slot];
        r.time0 = std::min(r.time0, blur->time), r.time1 = std::max(r.time1, blur->time);
        r.lensX0 = std::min(r.lensX0, blur->lensX), r.lensX1 = std::max(r.lensX1, blur->lensX);
        r.lensY0 = std::min(r.lensY0, blur->lensY), r.lensY1 = std::max(r.lensY1, blur->lensY);
      }
    }
}

BlurSamples SampleBuffer::blurSamples() {
  return {time.data(),        lensX.data(),  lensY.data(),  slots_.data(),
          candidates_.data(), pairs_.data(), sorted_.data()};
}

void SampleBuffer::touched(int column0, int row0, int column1, int row1) {
  for (int by = row0 / kBlock; by <= row1 / kBlock; ++by)
    for (int bx = column0 / kBlock; bx <= column1 / kBlock; ++bx) blockStale_[size_t(by * blocksX_ + bx)] = 1;
}

float SampleBuffer::blockDepth(int block) {
  if (!blockStale_[size_t(block)]) return blockDepth_[size_t(block)];
  const int c0 = block % blocksX_ * kBlock, r0 = block / blocksX_ * kBlock;
  const int columns = std::min(kBlock, rect_.width() - c0), rows = std::min(kBlock, rect_.height() - r0);
  float farthest = -kInfinity;
  for (int r = 0; r < rows; ++r) {
    const size_t first = index(c0, r0 + r);
    for (size_t i = first; i < first + size_t(columns * perPixel_); ++i)
      farthest = std::max(farthest, depth[i]);
  }
  blockStale_[size_t(block)] = 0;
  return blockDepth_[size_t(block)] = farthest;
}

bool SampleBuffer::hides(const RasterBounds& b) {
  const auto toBlock = [](float v, int origin, int count) {
    return int(std::clamp((v - float(origin)) / float(kBlock), 0.0f, float(count - 1)));
  };
  const int bx0 = toBlock(b.x0, rect_.x0, blocksX_), bx1 = toBlock(b.x1, rect_.x0, blocksX_);
  const int by0 = toBlock(b.y0, rect_.y0, blocksY_), by1 = toBlock(b.y1, rect_.y0, blocksY_);
  for (int by = by0; by <= by1; ++by)
    for (int bx = bx0; bx <= bx1; ++bx)
      if (!(b.key > blockDepth(by * blocksX_ + bx))) return false;
  return true;
}

}  // namespace fr::reyes
