// What one view says along the ray of every pixel: how far it is free, and where something moves.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "../../native/crew.h"
#include "image.h"
#include "interface.h"
#include "rounded.h"

namespace forecast {

constexpr float kNever = 0.0f, kAlways = 1e6f;

class Look {
 public:
  Look(const LookRequest &request, const LookView &view)
      : r_(request), v_(view), size_(static_cast<size_t>(v_.width) * v_.height), moving_(v_.moving, v_.moving + size_),
        seen_(size_, 1), blind_(size_), patch_(Patch::disk(v_.error_pixels)) {
    if (v_.valid) std::copy_n(v_.valid, size_, seen_.begin());
    for (size_t i = 0; i < size_; i++) blind_[i] = !seen_[i] | (v_.robot && v_.robot[i]);
  }

  void write() const {
    std::vector<uint8_t> widened = moving_;
    spread_over<Greatest>(widened, v_.width, v_.height, patch_, uint8_t{0});
    if (v_.depth) {
      const std::vector<uint8_t> found = standing_out(), blank = unmeasured(found);
      write_flags(widened, blank);
      write_free_until(blank);
      write_surface(found);
    } else {
      write_flags(widened, {});
      for (size_t i = 0; i < size_; i++) v_.free_until[i] = widened[i] | blind_[i] ? kNever : kAlways;
    }
    v_.free_until[size_] = kNever;
  }

 private:
  using Depths = std::vector<float>;

  void write_flags(const std::vector<uint8_t> &widened, std::vector<uint8_t> blank) const {
    const uint8_t *wide = widened.data(), *moving = moving_.data(), *seen = seen_.data(), *blind = blind_.data();
    uint8_t *flags = v_.flags;
#pragma omp simd
    for (size_t i = 0; i < size_; i++) {
      const uint8_t is_blunt = wide[i] & (blind[i] ^ 1), is_beside = seen[i] & (moving[i] ^ 1) & (blind[i] ^ 1);
      flags[i] = is_blunt * kMoving | seen[i] * kSeen | is_beside * kBeside;
    }
    if (const float *depth = v_.depth) {
      spread_over<Greatest>(blank, v_.width, v_.height, patch_, uint8_t{0});
      const uint8_t *beside = blank.data();
#pragma omp simd
      for (size_t i = 0; i < size_; i++) flags[i] &= (depth[i] == 0.0f) | beside[i] ? kAll : kAll & ~kMoving;
    }
    for (size_t i = 0; v_.robot && i < size_; i++) flags[i] |= (v_.robot[i] & seen[i]) * kRobot;
    flags[size_] = 0;
  }

  // Before a measured surface, be it the arm's: what its errors leave.
  FORECAST_ROUNDED Depths fronts() const {
    FORECAST_ROUNDED_BODY
    const float share = static_cast<float>(1 - r_.depth_share), margin = static_cast<float>(r_.depth_margin);
    Depths fronts(size_);
    float *to = fronts.data();
    for (size_t i = 0; i < size_; i++) to[i] = v_.depth[i] * share - margin;
    return fronts;
  }

  // What moves and is measured neither there nor around: dark, or too thin. What is measured beside it is what stands
  // behind, and must free nothing there. What is nowhere two pixels wide, and specks, are ground that is bare again and
  // that an image happens not to measure: edges of what stands lack depth here and there.
  std::vector<uint8_t> unmeasured(const std::vector<uint8_t> &found) const {
    std::vector<uint8_t> near = found, blank(size_);
    spread_over<Greatest>(near, v_.width, v_.height, Patch::square(r_.measured_within), uint8_t{0});
    for (size_t i = 0; i < size_; i++) blank[i] = moving_[i] & (blind_[i] ^ 1) & (v_.depth[i] == 0.0f) & (near[i] ^ 1);
    blank = in_squares(blank);
    clear_specks(blank, v_.width, v_.height, r_.least_blank);
    return blank;
  }

  // What of a mask lies in squares of two by two of its pixels.
  std::vector<uint8_t> in_squares(const std::vector<uint8_t> &mask) const {
    std::vector<uint8_t> kept(size_);
    for (int32_t y = 0; y + 1 < v_.height; y++) {
      const uint8_t *row = mask.data() + static_cast<size_t>(y) * v_.width, *next = row + v_.width;
      uint8_t *to = kept.data() + static_cast<size_t>(y) * v_.width, *below = to + v_.width;
      for (int32_t x = 0; x + 1 < v_.width; x++) {
        const uint8_t square = row[x] & row[x + 1] & next[x] & next[x + 1];
        to[x] |= square, to[x + 1] |= square, below[x] |= square, below[x + 1] |= square;
      }
    }
    return kept;
  }

  void write_free_until(const std::vector<uint8_t> &blank) const {
    Depths free = fronts();
    float *own = free.data();
    const float *depth = v_.depth;
    const uint8_t *seen = seen_.data(), *shows_nothing = blank.data();
#pragma omp simd
    for (size_t i = 0; i < size_; i++) own[i] = depth[i] > 0 ? own[i] : kAlways;
    Depths nearest = free;  // single pixels lack depth everywhere
    spread_over<Least>(nearest, v_.width, v_.height, Patch::square(1), kAlways);
    const float *near = nearest.data();
#pragma omp simd
    for (size_t i = 0; i < size_; i++) {
      const float around = near[i] < kAlways ? near[i] : kNever;
      own[i] = !seen[i] | shows_nothing[i] ? kNever : depth[i] > 0 ? own[i] : around;
    }
    spread_over<Least>(free, v_.width, v_.height, patch_, kFarthest);
    std::copy(free.begin(), free.end(), v_.free_until);
  }

  // Half of how wide the mask is about each pixel: the largest of the radii whose disk may lie in it and hold the pixel.
  std::vector<float> radii_within(const std::vector<uint8_t> &mask) const {
    std::vector<float> radii(size_, 0.0f);
    const Window w = Window::about(mask, v_.width, v_.height);
    const auto at = [&](int32_t x, int32_t y) { return static_cast<size_t>(w.top + y) * v_.width + w.left + x; };
    Distances inside(w.width(), w.height()), beside(w.width(), w.height());
    inside.measure([&](int32_t x, int32_t y) { return mask[at(x, y)] != 0; });
    for (size_t i = 0; i < size_; i++) radii[i] = mask[i] ? static_cast<float>(r_.radius[0]) : 0.0f;
    for (int32_t k = 0; k + 1 < r_.radii; k++) {
      const int32_t smaller = units(r_.radius[k]), larger = units(r_.radius[k + 1]);
      bool any = false;
      for (int32_t y = 0; y < w.height(); y++) {
        const int32_t *row = inside.row(y);
        for (int32_t x = 0; x < w.width(); x++) any |= row[x] >= smaller;
      }
      if (!any) break;
      beside.measure([&](int32_t x, int32_t y) { return inside.row(y)[x] < smaller; });
      for (int32_t y = 0; y < w.height(); y++) {
        const int32_t *row = beside.row(y);
        float *to = radii.data() + at(0, y);
        for (int32_t x = 0; x < w.width(); x++) {
          to[x] = (row[x] <= larger) & (to[x] > 0) ? static_cast<float>(r_.radius[k + 1]) : to[x];
        }
      }
    }
    return radii;
  }

  static int32_t units(double pixels) { return static_cast<int32_t>(pixels * Distances::kUnit); }

  // Behind a measured surface: as thick as the thing may be, and not beyond what stands behind it.
  FORECAST_ROUNDED std::vector<double> backs(const std::vector<float> &radii) const {
    FORECAST_ROUNDED_BODY
    const float margin = static_cast<float>(r_.depth_margin);
    std::vector<double> backs(size_);
    double *to = backs.data();
    const float *radius = radii.data();
    for (size_t i = 0; i < size_; i++) {
      const float twice = 2.0f * radius[i], across = twice * v_.depth[i], standing = v_.backdrop[i] + margin;
      const double width = static_cast<double>(across) / v_.focal, wide = r_.thickness_share * width + r_.depth_margin;
      const double thickness = r_.thickness < wide ? r_.thickness : wide, back = v_.depth[i] + thickness;
      to[i] = back < standing ? back : standing;
    }
    return backs;
  }

  FORECAST_ROUNDED std::vector<uint8_t> standing_out() const {
    FORECAST_ROUNDED_BODY
    const float share = static_cast<float>(1 - r_.depth_share), margin = static_cast<float>(r_.depth_margin);
    std::vector<uint8_t> found(size_);
    const uint8_t *moving = moving_.data(), *blind = blind_.data();
    const float *depth = v_.depth, *backdrop = v_.backdrop;
    uint8_t *to = found.data();
#pragma omp simd
    for (size_t i = 0; i < size_; i++) {
      const float least = backdrop[i] * share - margin;
      to[i] = moving[i] & (blind[i] ^ 1) & (depth[i] > 0) & (depth[i] < least);
    }
    clear_specks(found, v_.width, v_.height, r_.speck);
    return found;
  }

  // The moving surface, widened by the calibration's error.
  void write_surface(const std::vector<uint8_t> &found) const {
    std::vector<uint8_t> hidden(size_);
    for (size_t i = 0; i < size_; i++) hidden[i] = moving_[i] | blind_[i];
    const std::vector<double> back = backs(radii_within(hidden));
    const Depths front = fronts();
    Depths begin(size_), end(size_);
    float *first = begin.data(), *last = end.data();
#pragma omp simd
    for (size_t i = 0; i < size_; i++) {
      first[i] = found[i] ? front[i] : kAlways;
      last[i] = found[i] ? static_cast<float>(back[i]) : kNever;
    }
    spread_over<Least>(begin, v_.width, v_.height, patch_, kFarthest);
    spread_over<Greatest>(end, v_.width, v_.height, patch_, -kFarthest);
    write_ends(found.data(), front.data(), back.data(), begin.data(), end.data());
    v_.begin[size_] = kAlways, v_.end[size_] = kNever;
  }

  // Where a near and a far thing meet in the image, what lies between them is part of neither.
  FORECAST_ROUNDED void write_ends(
      const uint8_t *found, const float *front, const double *back, const float *begin, const float *end) const {
    FORECAST_ROUNDED_BODY
    const float slant = static_cast<float>(r_.slant), thickness = static_cast<float>(r_.thickness);
    const uint8_t *blind = blind_.data();
    float *to_begin = v_.begin, *to_end = v_.end;
#pragma omp simd
    for (size_t i = 0; i < size_; i++) {
      const float nearest = front[i] - slant, farthest = begin[i] + thickness + slant;
      const double behind = back[i] + r_.slant;
      const float own = static_cast<float>(end[i] < behind ? end[i] : behind);
      const float other = end[i] < farthest ? end[i] : farthest;
      to_begin[i] = (found[i] != 0) & (begin[i] < nearest) ? nearest : begin[i];
      to_end[i] = blind[i] ? kNever : found[i] ? own : other;
    }
  }

  static constexpr float kFarthest = 3e38f;
  static constexpr uint8_t kAll = kMoving | kRobot | kSeen | kBeside;

  const LookRequest &r_;
  const LookView &v_;
  const size_t size_;
  const std::vector<uint8_t> moving_;
  std::vector<uint8_t> seen_, blind_;
  const Patch patch_;
};

inline void look(const LookRequest &r) {
  crew::parallel_for(r.threads, r.views, [&](int64_t view) { Look(r, r.looks[view]).write(); });
}

}  // namespace forecast
