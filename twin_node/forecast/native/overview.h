// What one view says over windows of its image: enough to decide most blocks as wholes.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include "interface.h"

namespace forecast {

// More than nothing of a measured moving surface shows; beside the bits of Flag.
constexpr uint8_t kSurface = 128;

// What is freed along the rays of some pixels, m, and all flags that any of them has.
struct Extremes {
  float least, most;
  uint8_t flags;
};

inline Extremes joined(const Extremes &a, const Extremes &b) {
  return {std::min(a.least, b.least), std::max(a.most, b.most), static_cast<uint8_t>(a.flags | b.flags)};
}

// Between which depths measured moving surfaces explain the rays of a window: over squares of `kSide` pixels.
class SurfaceRange {
 public:
  explicit SurfaceRange(const Sight &sight)
      : width_((sight.width + kSide - 1) / kSide),
        ranges_(static_cast<size_t>(width_) * ((sight.height + kSide - 1) / kSide), {kFar, -kFar}) {
    if (!sight.begin) return;
    for (int32_t y = 0; y < sight.height; y++) {
      const float *begin = sight.begin + static_cast<int64_t>(y) * sight.width;
      const float *end = sight.end + static_cast<int64_t>(y) * sight.width;
      for (int32_t x = 0; x < sight.width; x++) {
        if (!(begin[x] < end[x])) continue;
        Range &own = ranges_[y / kSide * width_ + x / kSide];
        own = {std::min(own.begin, begin[x]), std::max(own.end, end[x])};
      }
    }
  }

  // Whether one may explain what lies in a window [first column, last column, first row, last row] at such depths, m.
  bool reaches(const int32_t *window, float near, float far) const {
    for (int32_t y = window[2] / kSide; y <= window[3] / kSide; y++) {
      for (int32_t x = window[0] / kSide; x <= window[1] / kSide; x++) {
        const Range &one = ranges_[y * width_ + x];
        if (one.begin <= far && near < one.end) return true;
      }
    }
    return false;
  }

 private:
  static constexpr int32_t kSide = 8;
  static constexpr float kFar = std::numeric_limits<float>::infinity();

  struct Range {
    float begin, end;
  };

  const int32_t width_;
  std::vector<Range> ranges_;
};

// Extremes over squares of 1, 2, 4 ... cells of two by two pixels, one from every cell on; four make up any window.
class Overview {
 public:
  explicit Overview(const Sight &sight)
      : sight_(sight), width_((sight.width + 1) / 2), height_((sight.height + 1) / 2), outside_(of(sight.size - 1)),
        surface_(sight) {
    const size_t cells = static_cast<size_t>(width_) * height_;
    for (Level &level : levels_) level = {std::vector<float>(cells), std::vector<float>(cells), Bytes(cells)};
    take_in();
    for (int power = 1; power < kLevels; power++) {
      Level rows = levels_[power - 1];
      double_up(levels_[power - 1], rows, width_, 1 << (power - 1));
      double_up(rows, levels_[power], width_ * height_, width_ << (power - 1));
    }
  }

  // Four squares that hold the pixels in [first column, last column, first row, last row], and some about them.
  struct Window {
    int power;
    size_t corners[4];
  };

  Window window(const int32_t *ends) const {
    const int32_t left = ends[0] / 2, right = ends[1] / 2, top = ends[2] / 2, bottom = ends[3] / 2;
    const int power = 31 - __builtin_clz(std::max(right - left, bottom - top) + 1), side = 1 << power;
    const int32_t upper = top * width_, lower = std::max(top, bottom - side + 1) * width_;
    const size_t beside = std::max(left, right - side + 1), first = left;
    return {power, {upper + first, upper + beside, lower + first, lower + beside}};
  }

  // Least depth that the rays of a window free; -infinity for a window that is too large.
  float least(const Window &w) const {
    if (w.power >= kLevels) return -kFar;
    const std::vector<float> &of = levels_[w.power].least;
    return std::min(std::min(of[w.corners[0]], of[w.corners[1]]), std::min(of[w.corners[2]], of[w.corners[3]]));
  }

  // All of it; anything for a window that is too large.
  Extremes over(const Window &w) const {
    if (w.power >= kLevels) return {-kFar, kFar, 255};
    const Level &level = levels_[w.power];
    Extremes all{least(w), -kFar, 0};
    for (const size_t cell : w.corners) {
      all.most = std::max(all.most, level.most[cell]);
      all.flags |= level.flags[cell];
    }
    return all;
  }

  const SurfaceRange &surface() const { return surface_; }

  // Of rays that are not in the image.
  const Extremes &outside() const { return outside_; }

 private:
  using Bytes = std::vector<uint8_t>;
  static constexpr int kLevels = 6;  // windows of up to 128 pixels
  static constexpr float kFar = std::numeric_limits<float>::infinity();

  struct Level {
    std::vector<float> least, most;
    Bytes flags;
  };

  Extremes of(int64_t pixel) const {
    const bool surface = sight_.begin && sight_.begin[pixel] < sight_.end[pixel];
    const float depth = sight_.free_until[pixel];
    return {depth, depth, static_cast<uint8_t>(sight_.flags[pixel] | (surface ? kSurface : 0))};
  }

  void take_in() {
    Level &cells = levels_[0];
    for (int32_t y = 0; y < height_; y++) {
      const int64_t upper = static_cast<int64_t>(2 * y) * sight_.width;
      const int64_t lower = static_cast<int64_t>(std::min(2 * y + 1, sight_.height - 1)) * sight_.width;
      for (int32_t x = 0; x < width_; x++) {
        const int32_t left = 2 * x, right = std::min(2 * x + 1, sight_.width - 1);
        const size_t cell = static_cast<size_t>(y) * width_ + x;
        Extremes all = of(upper + left);
        for (const int64_t pixel : {upper + right, lower + left, lower + right}) all = joined(all, of(pixel));
        cells.least[cell] = all.least, cells.most[cell] = all.most, cells.flags[cell] = all.flags;
      }
    }
  }

  // Joins every cell with the one `step` further on in its line of `length`, where there is one.
  static void double_up(const Level &from, Level &to, int32_t length, int32_t step) {
    join(from.least, to.least, length, step, [](float a, float b) { return std::min(a, b); });
    join(from.most, to.most, length, step, [](float a, float b) { return std::max(a, b); });
    join(from.flags, to.flags, length, step, [](uint8_t a, uint8_t b) { return a | b; });
  }

  template <class Value, class Join>
  static void join(
      const std::vector<Value> &from, std::vector<Value> &to, int32_t length, int32_t step, const Join &joined) {
    const int32_t both = std::max(length - step, 0);
    for (size_t first = 0; first < from.size(); first += length) {
      const Value *source = from.data() + first;
      Value *target = to.data() + first;
      for (int32_t i = 0; i < both; i++) target[i] = joined(source[i], source[i + step]);
      std::copy(source + both, source + length, target + both);
    }
  }

  const Sight &sight_;
  const int32_t width_, height_;
  const Extremes outside_;
  const SurfaceRange surface_;
  std::array<Level, kLevels> levels_;
};

}  // namespace forecast
