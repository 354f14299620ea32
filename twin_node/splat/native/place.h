// Gaussians from the frames of what carries them to where they are drawn, and their attributes made linear.
#pragma once

#include <cmath>

#include "../../native/quaternions.h"
#include "interface.h"
#include "workspace.h"

namespace splat {

constexpr int64_t kPlacedPerTask = 512;  // rows

// Row `i` at time `time`, from `row` of the store.
inline void carry_row(const PlaceRequest &r, int64_t i, int64_t row, int64_t time) {
  const float *value = r.values + kColumns * row;
  double mean[3], quat[4], carried[4];
  for (int k = 0; k < 3; k++) mean[k] = value[k];
  for (int k = 0; k < 4; k++) quat[k] = value[3 + k];
  const int64_t node = r.carriers[row];
  if (node >= 0) {
    const double *position = r.positions + 3 * (time * r.nodes + node), *by = r.rotations + 4 * (time * r.nodes + node);
    quaternions::turn(by, mean);
    for (int k = 0; k < 3; k++) mean[k] += position[k];
    quaternions::multiply(by, quat, carried);
    for (int k = 0; k < 4; k++) quat[k] = carried[k];
  }
  const int64_t at = time * r.count + i;
  for (int k = 0; k < 3; k++) r.means[3 * at + k] = static_cast<float>(mean[k]);
  for (int k = 0; k < 4; k++) r.quats[4 * at + k] = static_cast<float>(quat[k]);
}

inline void place(const PlaceRequest &r) {
  const int64_t tasks = (r.count + kPlacedPerTask - 1) / kPlacedPerTask;
  parallel_for(threads_for(r.threads, r.count, 4 * kPlacedPerTask), tasks, [&](int64_t task) {
    const int64_t begin = task * kPlacedPerTask, end = std::min(r.count, begin + kPlacedPerTask);
    for (int64_t i = begin; i < end; i++) {
      const int64_t row = r.rows == nullptr ? i : r.rows[i];
      const float *value = r.values + kColumns * row;
      for (int64_t time = 0; time < r.times; time++) carry_row(r, i, row, time);
      for (int k = 0; k < 3; k++) {
        r.scales[3 * i + k] = std::exp(value[7 + k]);
        r.rgb[3 * i + k] = value[11 + k];
      }
      r.opacities[i] = 1.f / (1.f + std::exp(-value[10]));
    }
  });
}

}  // namespace splat
