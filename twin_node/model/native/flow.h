// Optical flow of patches near what moves: inverse search from coarse to fine, see `patch_flow.py`.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <vector>

#include "interface.h"

namespace model {

constexpr int kSide = 8, kPixels = kSide * kSide;  // of a patch: `patch_flow.SIDE`

typedef float Row __attribute__((vector_size(kSide * sizeof(float))));  // of a patch

inline Row row_at(const float *from) {
  Row row;
  std::memcpy(&row, from, sizeof(row));
  return row;
}

inline void add_to(float *to, Row more) {
  const Row sum = row_at(to) + more;
  std::memcpy(to, &sum, sizeof(sum));
}

inline float sum_of(Row row) {
  float total = 0;
  for (int k = 0; k < kSide; k++) total += row[k];
  return total;
}

// One number per pixel of a patch.
struct Patch {
  Row rows[kSide];

  float sum() const {
    Row sums = rows[0];
    for (int r = 1; r < kSide; r++) sums += rows[r];
    return sum_of(sums);
  }

  float times(const Patch &other) const {
    Row sums = rows[0] * other.rows[0];
    for (int r = 1; r < kSide; r++) sums += rows[r] * other.rows[r];
    return sum_of(sums);
  }

  // Leaves its mean aside; the sum of the squares that are left.
  float centre() {
    const float middle = sum() / kPixels;
    for (Row &row : rows) row -= middle;
    return times(*this);
  }
};

struct Shift {
  float x, y;  // pixels
};

// One level of both images' pyramids.
class FlowLevel {
 public:
  FlowLevel(const FlowRules &rules, int width, int height)
      : width(width), height(height), shown(width * height), image(width * height), wanted(width * height),
        rules_(rules) {}

  // Half the size: means of 2 x 2 pixels.
  FlowLevel halved() const {
    FlowLevel half(rules_, width / 2, height / 2);
    for (int y = 0; y < half.height; y++) {
      for (int x = 0; x < half.width; x++) {
        const int64_t from = static_cast<int64_t>(2 * y) * width + 2 * x, to = static_cast<int64_t>(y) * half.width + x;
        half.shown[to] = mean(shown, from);
        half.image[to] = mean(image, from);
      }
    }
    for (int y = 0; y < height; y++) {
      for (int x = 0; x < width; x++) {
        if (wanted[static_cast<int64_t>(y) * width + x] == 0) continue;
        half.wanted[static_cast<int64_t>(std::min(y / 2, half.height - 1)) * half.width + std::min(x / 2, half.width - 1)] = 1;
      }
    }
    return half;
  }

  // The flow of the image whose level this is after so many halvings.
  void tell(const FlowView &view, int halvings) const {
    const float times = static_cast<float>(1 << halvings);
    for (int y = 0; y < view.height; y++) {
      const float *row = flow.data() + 2 * static_cast<int64_t>(std::min(y >> halvings, height - 1)) * width;
      float *out = view.flow + 2 * static_cast<int64_t>(y) * view.width;
      for (int x = 0; x < view.width; x++) {
        const float *at = row + 2 * std::min(x >> halvings, width - 1);
        out[2 * x] = times * at[0], out[2 * x + 1] = times * at[1];
      }
    }
  }

  // Finds the flow, from half that of the level `coarser` on or from none.
  void search(const FlowLevel *coarser) {
    prepare();
    differentiate();
    const int64_t count = columns_ * rows_;
    std::vector<Shift> now(count);
    for (int64_t i = 0; i < count; i++) {
      if (active_[i] != 0 && coarser != nullptr) now[i] = coarser->doubled(left(i) + kSide / 2, top(i) + kSide / 2);
    }
    for (int pass = 0; pass < rules_.passes; pass++) {
      std::vector<Shift> before = now;
      for (int64_t i = 0; i < count; i++) {
        if (active_[i] != 0) now[i] = descended(i, best_around(i, before));
      }
    }
    spread(now);
  }

  const int width, height;
  std::vector<float> shown, image;  // [H, W] grey levels
  std::vector<uint8_t> wanted;      // [H, W]
  std::vector<float> flow;          // [H, W, 2] pixels; 0 where no patch lies

 private:
  float mean(const std::vector<float> &of, int64_t at) const {
    return 0.25f * (of[at] + of[at + 1] + of[at + width] + of[at + width + 1]);
  }

  Shift doubled(int x, int y) const {
    const int64_t at = static_cast<int64_t>(std::min(y / 2, height - 1)) * width + std::min(x / 2, width - 1);
    return {2 * flow[2 * at], 2 * flow[2 * at + 1]};
  }

  int left(int64_t patch) const { return std::min<int>(patch % columns_ * rules_.stride, width - kSide); }
  int top(int64_t patch) const { return std::min<int>(patch / columns_ * rules_.stride, height - kSide); }

  // Which patches there are, and the image with its rim repeated around it, as far as patches may be moved out of it.
  void prepare() {
    columns_ = (width - kSide + rules_.stride - 1) / rules_.stride + 1;
    rows_ = (height - kSide + rules_.stride - 1) / rules_.stride + 1;
    active_.assign(columns_ * rows_, 0);
    for (int64_t i = 0; i < columns_ * rows_; i++) {
      for (int r = 0; r < kSide && active_[i] == 0; r++) {
        const uint8_t *row = wanted.data() + static_cast<int64_t>(top(i) + r) * width + left(i);
        active_[i] = std::any_of(row, row + kSide, [](uint8_t one) { return one != 0; });
      }
    }
    padded_ = width + 2 * rules_.border;
    around_.resize(static_cast<int64_t>(padded_) * (height + 2 * rules_.border));
    for (int y = 0; y < height + 2 * rules_.border; y++) {
      const float *row = image.data() + static_cast<int64_t>(clamped(y - rules_.border, height)) * width;
      float *out = around_.data() + static_cast<int64_t>(y) * padded_;
      std::fill_n(out, rules_.border, row[0]);
      std::copy_n(row, width, out + rules_.border);
      std::fill_n(out + rules_.border + width, rules_.border, row[width - 1]);
    }
  }

  static int clamped(int at, int size) { return std::min(std::max(at, 0), size - 1); }

  // What a patch, moved by `shift`, shows in the image less what it shows in the rendering.
  Patch differences(int64_t patch, Shift shift) const {
    const float x = placed(left(patch) + shift.x, width), y = placed(top(patch) + shift.y, height);
    const float x0 = std::floor(x), y0 = std::floor(y), fx = x - x0, fy = y - y0;
    const float a = (1 - fx) * (1 - fy), b = fx * (1 - fy), c = (1 - fx) * fy, d = fx * fy;
    const float *at = around_.data() + (static_cast<int64_t>(y0) + rules_.border) * padded_ +
                      static_cast<int64_t>(x0) + rules_.border;
    const float *own = shown.data() + static_cast<int64_t>(top(patch)) * width + left(patch);
    Patch out;
    Row here = row_at(at), beside = row_at(at + 1);
    for (int r = 0; r < kSide; r++) {
      at += padded_;
      const Row below = row_at(at), across = row_at(at + 1);
      out.rows[r] = a * here + b * beside + c * below + d * across - row_at(own + static_cast<int64_t>(r) * width);
      here = below, beside = across;
    }
    return out;
  }

  Patch patch_of(const std::vector<float> &values, int64_t patch) const {
    const float *at = values.data() + static_cast<int64_t>(top(patch)) * width + left(patch);
    Patch out;
    for (int r = 0; r < kSide; r++) out.rows[r] = row_at(at + static_cast<int64_t>(r) * width);
    return out;
  }

  // Gradients of the rendering, by Sobel's kernels; beyond its rim it goes on as at the rim.
  void differentiate() {
    across_.resize(shown.size());
    down_.resize(shown.size());
    std::vector<float> sums(width + 2), steps(width + 2);
    for (int y = 0; y < height; y++) {
      const float *at = shown.data() + static_cast<int64_t>(y) * width;
      const float *above = shown.data() + static_cast<int64_t>(std::max(y - 1, 0)) * width;
      const float *below = shown.data() + static_cast<int64_t>(std::min(y + 1, height - 1)) * width;
      for (int x = 0; x < width; x++) {
        sums[x + 1] = above[x] + 2 * at[x] + below[x];
        steps[x + 1] = below[x] - above[x];
      }
      for (std::vector<float> *row : {&sums, &steps}) row->front() = (*row)[1], row->back() = (*row)[width];
      float *across = across_.data() + static_cast<int64_t>(y) * width, *down = down_.data() + static_cast<int64_t>(y) * width;
      for (int x = 0; x < width; x++) {
        across[x] = 0.125f * (sums[x + 2] - sums[x]);
        down[x] = 0.125f * (steps[x] + 2 * steps[x + 1] + steps[x + 2]);
      }
    }
  }

  // Where a patch may lie: as far outside as the rim is repeated.
  float placed(float at, int size) const {
    const float farthest = static_cast<float>(size - kSide + rules_.border - 2);
    return std::min(std::max(at, static_cast<float>(1 - rules_.border)), farthest);
  }

  // The squared differences of a patch that is moved by `shift`, brightness left aside.
  float misfit(int64_t patch, Shift shift) const { return differences(patch, shift).centre(); }

  // The shift of a patch or of its neighbours on the grid that fits it best.
  Shift best_around(int64_t patch, const std::vector<Shift> &shifts) const {
    const int64_t column = patch % columns_, row = patch / columns_;
    Shift best = shifts[patch];
    float least = misfit(patch, best);
    const int64_t around[4][2] = {{column - 1, row}, {column + 1, row}, {column, row - 1}, {column, row + 1}};
    for (const auto &one : around) {
      if (one[0] < 0 || one[0] >= columns_ || one[1] < 0 || one[1] >= rows_) continue;
      const int64_t other = one[1] * columns_ + one[0];
      if (active_[other] == 0 || (shifts[other].x == best.x && shifts[other].y == best.y)) continue;
      const float here = misfit(patch, shifts[other]);
      if (here < least) least = here, best = shifts[other];
    }
    return best;
  }

  // Gauss-Newton from `shift` on, with the gradients of the rendering, which stay where they are.
  Shift descended(int64_t patch, Shift shift) const {
    Patch gx = patch_of(across_, patch), gy = patch_of(down_, patch);
    const float xx = gx.centre() + rules_.stiffness, yy = gy.centre() + rules_.stiffness;
    const float xy = gx.times(gy), share = 1 / (xx * yy - xy * xy);
    const Shift begun = shift;
    Shift best = shift;
    float least = std::numeric_limits<float>::infinity();
    for (int step = 0; step < rules_.steps; step++) {
      Patch apart = differences(patch, shift);
      const float here = apart.centre();
      if (here >= least) break;
      least = here, best = shift;
      const float px = gx.times(apart), py = gy.times(apart);
      shift.x -= share * (yy * px - xy * py);
      shift.y -= share * (xx * py - xy * px);
    }
    const float dx = best.x - begun.x, dy = best.y - begun.y;
    return dx * dx + dy * dy > kPixels ? begun : best;
  }

  // The flow of every pixel in a patch: of all patches that hold it, of those the most that fit it best.
  void spread(const std::vector<Shift> &shifts) {
    const int64_t pixels = static_cast<int64_t>(width) * height;
    std::vector<float> sums(3 * pixels);
    float *weights = sums.data(), *x = weights + pixels, *y = x + pixels;
    for (int64_t i = 0; i < columns_ * rows_; i++) {
      if (active_[i] == 0) continue;
      const Patch apart = differences(i, shifts[i]);
      int64_t at = static_cast<int64_t>(top(i)) * width + left(i);
      for (int r = 0; r < kSide; r++, at += width) {
        Row off = apart.rows[r];
        for (int k = 0; k < kSide; k++) off[k] = std::max(1.f, std::fabs(off[k]));
        const Row weight = 1 / off;
        add_to(weights + at, weight);
        add_to(x + at, weight * shifts[i].x);
        add_to(y + at, weight * shifts[i].y);
      }
    }
    flow.assign(2 * pixels, 0);
    for (int64_t at = 0; at < pixels; at++) {
      if (weights[at] == 0) continue;
      flow[2 * at] = x[at] / weights[at];
      flow[2 * at + 1] = y[at] / weights[at];
    }
  }

  const FlowRules &rules_;
  int64_t columns_ = 0, rows_ = 0;  // of patches
  std::vector<uint8_t> active_;     // [patches] those that hold a wanted pixel
  int64_t padded_ = 0;              // width of `around_`
  std::vector<float> around_;
  std::vector<float> across_, down_;  // [H, W] gradients of the rendering, levels per pixel
};

inline void find_flow(const FlowRules &rules, const FlowView &view) {
  const int64_t pixels = static_cast<int64_t>(view.width) * view.height;
  const bool is_wanted = std::any_of(view.wanted, view.wanted + pixels, [](uint8_t one) { return one != 0; });
  if (!is_wanted || std::min(view.width, view.height) < kSide) {
    std::fill_n(view.flow, 2 * pixels, 0.f);
    return;
  }
  int unsearched = 0;  // of the finest levels
  while (view.width >> (unsearched + 1) >= rules.width) unsearched++;
  std::vector<FlowLevel> levels;
  const int most = rules.levels + unsearched;
  levels.reserve(most);
  levels.emplace_back(rules, view.width, view.height);
  FlowLevel &whole = levels.front();
  const float *__restrict seen = view.shown;
  const uint8_t *__restrict came = view.image;
  float *__restrict shown = whole.shown.data(), *__restrict image = whole.image.data();
  const auto level = [](float part) { return part > 0 ? 255 * (part < 1 ? part : 1.f) : 0.f; };  // no number: 0
  for (int64_t i = 0; i < pixels; i++) {
    shown[i] = 0.299f * level(seen[4 * i]) + 0.587f * level(seen[4 * i + 1]) + 0.114f * level(seen[4 * i + 2]);
  }
  for (int64_t i = 0; i < pixels; i++) {
    image[i] = 0.299f * came[3 * i] + 0.587f * came[3 * i + 1] + 0.114f * came[3 * i + 2];
  }
  std::copy_n(view.wanted, pixels, whole.wanted.begin());
  for (int i = 1; i < most && std::min(levels.back().width, levels.back().height) >= 2 * kSide; i++) {
    levels.push_back(levels.back().halved());
  }
  const int count = static_cast<int>(levels.size()), finest = std::min(unsearched, count - 1);
  for (int i = count; i-- > finest;) levels[i].search(i + 1 < count ? &levels[i + 1] : nullptr);
  levels[finest].tell(view, finest);
}

}  // namespace model
