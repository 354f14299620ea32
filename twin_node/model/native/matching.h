// The points along one view's rays in another view; see `matching.py`.
#pragma once

#include <cmath>

#include "camera.h"
#include "interface.h"

namespace model {

inline void compare(const CompareRequest &r, int64_t pixel) {
  const Pinhole camera(r.viewmat, r.K, r.width, r.height);
  const double *reach = r.reach + 3 * pixel;
  const float *own = r.rgb + 3 * pixel;
  for (int64_t k = 0; k < r.labels; k++) {
    double point[3];
    for (int i = 0; i < 3; i++) point[i] = r.centre[i] + reach[i] * r.shares[k];
    const Found found = camera.find(point);
    const float *theirs = r.other + 3 * found.at;
    float apart = 0;
    for (int i = 0; i < 3; i++) apart += std::fabs(theirs[i] - own[i]);
    r.apart[pixel * r.labels + k] = apart / 3;
    r.at[pixel * r.labels + k] = found.inside && r.valid[found.at] ? static_cast<int32_t>(found.at) : -1;
  }
}

}  // namespace model
