// What depth shows within the outline of an arm that is not the arm.
#pragma once

#include <algorithm>

#include "capsules.h"
#include "interface.h"

namespace model {

// Measured pixels of one view, collected until there are as many as are judged together.
class OutlinePixels {
 public:
  OutlinePixels(const OutlineRequest &request, const OutlineView &view) : request_(request), view_(view) {}

  void add(int row, int column) {
    const double z = view_.depth[static_cast<int64_t>(row) * view_.width + column], *K = view_.K;
    points_[count_] = (column + 0.5 - K[2]) / K[0] * z;
    points_[kPointsAtOnce + count_] = (row + 0.5 - K[5]) / K[4] * z;
    points_[2 * kPointsAtOnce + count_] = z;
    pixels_[count_++] = static_cast<int64_t>(row) * view_.width + column;
    if (count_ == kPointsAtOnce) judge();
  }

  // Those collected so far that lie well off every capsule: nearer than the place on an axis that is nearest, or not.
  void judge() {
    find_nearest_capsules({kPointsAtOnce, request_.capsules, request_.shortest_square, view_.ends, view_.radii, points_,
                           gaps_, nearest_, shares_});
    for (int i = 0; i < count_; i++) {
      const double z = points_[2 * kPointsAtOnce + i], *end = view_.ends + 6 * nearest_[i];
      const bool nearer = z < end[2] + shares_[i] * (end[5] - end[2]);
      const bool clear = gaps_[i] > request_.clear_m + request_.depth_share * z;
      view_.before[pixels_[i]] = clear && nearer;
      view_.past[pixels_[i]] = clear && !nearer;
    }
    count_ = 0;
  }

 private:
  const OutlineRequest &request_;
  const OutlineView &view_;
  int count_ = 0;
  double points_[3 * kPointsAtOnce] = {}, gaps_[kPointsAtOnce], shares_[kPointsAtOnce];
  int64_t pixels_[kPointsAtOnce], nearest_[kPointsAtOnce];
};

// Rows [first, first + kRowsPerTask) of a view.
inline void tell_outline(const OutlineRequest &request, const OutlineView &v, int first) {
  OutlinePixels measured(request, v);
  for (int row = first; row < std::min(first + kRowsPerTask, v.height); row++) {
    const int64_t begin = static_cast<int64_t>(row) * v.width;
    for (int column = 0; column < v.width; column++) {
      const bool is_within = v.outline[begin + column] != 0;
      v.before[begin + column] = 0;
      v.past[begin + column] = !is_within;
      if (is_within && v.depth[begin + column] > 0) measured.add(row, column);
    }
  }
  measured.judge();
}

}  // namespace model
