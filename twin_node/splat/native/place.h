// Gaussians from the frames of what carries them to where they are drawn, and their attributes made linear.
#pragma once

#include <cmath>

#include "interface.h"
#include "workspace.h"

namespace splat {

constexpr int kPlaceColumns = 14;        // of a row of values: mean, quat, log scale, logit, colour
constexpr int64_t kPlacedPerTask = 512;  // rows

// out = a * b for quaternions w, x, y, z.
inline void multiply(const double *a, const double *b, double *out) {
  out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
  out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
  out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
  out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
}

// v turned by the unit quaternion q, in place.
inline void turn(const double *q, double *v) {
  double t[3], u[3];
  for (int i = 0; i < 3; i++) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    t[i] = 2 * (q[1 + j] * v[k] - q[1 + k] * v[j]);
  }
  for (int i = 0; i < 3; i++) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    u[i] = v[i] + q[0] * t[i] + q[1 + j] * t[k] - q[1 + k] * t[j];
  }
  for (int i = 0; i < 3; i++) v[i] = u[i];
}

// Row `i` at time `time`, from `row` of the store.
inline void carry_row(const PlaceRequest &r, int64_t i, int64_t row, int64_t time) {
  const float *value = r.values + kPlaceColumns * row;
  double mean[3], quat[4], carried[4];
  for (int k = 0; k < 3; k++) mean[k] = value[k];
  for (int k = 0; k < 4; k++) quat[k] = value[3 + k];
  const int64_t node = r.carriers[row];
  if (node >= 0) {
    const double *position = r.positions + 3 * (time * r.nodes + node), *by = r.rotations + 4 * (time * r.nodes + node);
    turn(by, mean);
    for (int k = 0; k < 3; k++) mean[k] += position[k];
    multiply(by, quat, carried);
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
      const float *value = r.values + kPlaceColumns * row;
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
