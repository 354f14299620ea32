// Semi-global matching; see `semi_global.py`, whose sums are these in the same order.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "interface.h"

namespace model {

// The eight paths in pairs, each there and back: lines one after the other, and where on the line before a path was.
struct PathPair {
  bool upright;  // whether lines are columns
  int shift;
};
constexpr int kPathPairs = 4;
constexpr PathPair kPaths[kPathPairs] = {{false, 0}, {true, 0}, {false, 1}, {false, -1}};

// One pair's sums; `sums` [H, W, K] is the caller's.
class PathSums {
 public:
  PathSums(const SmoothRequest &request, const PathPair &pair, float *sums)
      : r_(request),
        pair_(pair),
        sums_(sums),
        lines_(pair.upright ? r_.width : r_.height),
        places_(pair.upright ? r_.height : r_.width),
        stride_(r_.labels + 2),
        before_(places_ * stride_, kNever),
        now_(places_ * stride_, kNever),
        least_before_(places_),
        least_now_(places_) {}

  void run() {
    walk(false);
    walk(true);
  }

 private:
  static constexpr float kNever = std::numeric_limits<float>::infinity();  // beside the first and the last label

  int64_t pixel(int64_t line, int64_t place) const {
    return pair_.upright ? place * r_.width + line : line * r_.width + place;
  }

  void walk(bool back) {
    for (int64_t i = 0; i < lines_; i++) {
      const int64_t line = back ? lines_ - 1 - i : i;
      for (int64_t place = 0; place < places_; place++) {
        const int64_t from = place + (back ? -pair_.shift : pair_.shift);
        const bool goes_on = i > 0 && from >= 0 && from < places_;
        step(pixel(line, place), goes_on ? from : -1, back ? line + 1 : line - 1, place, back);
      }
      before_.swap(now_);
      least_before_.swap(least_now_);
    }
  }

  // The costs of the pixel `at` with the least that the one before adds, which is `from` on its line; -1: as they are.
  void step(int64_t at, int64_t from, int64_t line_before, int64_t place, bool back) {
    const int64_t labels = r_.labels;
    const float *costs = r_.costs + at * labels;
    float *out = now_.data() + place * stride_ + 1, *sums = sums_ + at * labels;
    if (from < 0) {
      std::copy_n(costs, labels, out);
    } else {
      const float *before = before_.data() + from * stride_ + 1;
      const float least = least_before_[from], far = least + jump(at, pixel(line_before, from)), near = r_.step_cost;
      for (int64_t k = 0; k < labels; k++) {
        const float beside = std::min(before[k - 1], before[k + 1]) + near;
        out[k] = costs[k] + std::min(std::min(before[k], far), beside) - least;
      }
    }
    float least = kNever;
    for (int64_t k = 0; k < labels; k++) least = std::min(least, out[k]);
    least_now_[place] = least;
    if (back) {
      for (int64_t k = 0; k < labels; k++) sums[k] += out[k];
    } else {
      std::copy_n(out, labels, sums);
    }
  }

  float jump(int64_t a, int64_t b) const {
    const float *one = r_.image + 3 * a, *other = r_.image + 3 * b;
    float apart = 0;
    for (int c = 0; c < 3; c++) apart = std::max(apart, std::abs(one[c] - other[c]));
    return std::max(r_.jump_cost / (1 + apart / r_.edge), r_.step_cost);
  }

  const SmoothRequest &r_;
  const PathPair pair_;
  float *const sums_;
  const int64_t lines_, places_, stride_;
  std::vector<float> before_, now_, least_before_, least_now_;
};

inline int64_t entries(const SmoothRequest &r) { return r.height * r.width * r.labels; }

inline void add_pairs(const SmoothRequest &r) {
  const int64_t count = entries(r);
  const float *first = r.pairs, *second = first + count, *third = second + count, *fourth = third + count;
  for (int64_t i = 0; i < count; i++) r.smoothed[i] = first[i] + second[i] + third[i] + fourth[i];
}

}  // namespace model
