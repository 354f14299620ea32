// Poses of nodes that move on at constant velocity.
#pragma once

#include <cmath>

#include "interface.h"

namespace model {

constexpr double kSmallAngle2 = 1e-8;  // squared: below, sin(x) / x is its series

// The unit quaternion w, x, y, z of a rotation vector.
inline void quat_from_vector(const double *omega, double *quat) {
  double half[3], angle2 = 0;
  for (int k = 0; k < 3; k++) {
    half[k] = omega[k] / 2;
    angle2 += half[k] * half[k];
  }
  const double angle = std::sqrt(angle2);
  const double sinc = angle2 < kSmallAngle2 ? 1 - angle2 / 6 : std::sin(angle) / angle;
  quat[0] = std::cos(angle);
  for (int k = 0; k < 3; k++) quat[1 + k] = half[k] * sinc;
}

// a * b: the rotation b followed by a.
inline void multiply(const double *a, const double *b, double *out) {
  out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
  out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
  out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
  out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
}

// Where each node is, and how it is turned, at each time from now.
inline void advance(const AdvanceRequest &r) {
  for (int64_t time = 0; time < r.times; time++) {
    for (int64_t node = 0; node < r.nodes; node++) {
      const int64_t at = time * r.nodes + node;
      double turned[3], turn[4];
      for (int k = 0; k < 3; k++) {
        r.advanced[3 * at + k] = r.positions[3 * node + k] + r.velocities[3 * node + k] * r.seconds[time];
        turned[k] = r.turns[3 * node + k] * r.seconds[time];
      }
      quat_from_vector(turned, turn);
      multiply(turn, r.quats + 4 * node, r.rotated + 4 * at);
    }
  }
}

}  // namespace model
