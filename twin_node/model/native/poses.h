// Poses of nodes: where they are after a while, how they have moved, and what they do to what they carry.
#pragma once

#include <cmath>

#include "../../native/quaternions.h"
#include "interface.h"

namespace model {

constexpr double kSmallAngle2 = 1e-8;  // squared: below, sin(x) / x is its series
constexpr double kSmallSine = 1e-8;    // of half an angle: below, the angle is twice that

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
      quaternions::multiply(turn, r.quats + 4 * node, r.rotated + 4 * at);
    }
  }
}

// How far each node has moved, and by which rotation vector it has turned the shorter way.
inline void find_moved(const MovedRequest &r) {
  for (int64_t node = 0; node < r.nodes; node++) {
    const double *then = r.quats_then + 4 * node;
    const double back[4] = {then[0], -then[1], -then[2], -then[3]};
    double turn[4], *moved = r.moved + 6 * node;
    quaternions::multiply(r.quats + 4 * node, back, turn);
    const double sign = turn[0] < 0 ? -1 : 1;
    const double norm = std::sqrt(turn[1] * turn[1] + turn[2] * turn[2] + turn[3] * turn[3]);
    const double share = norm < kSmallSine ? 2 : 2 * std::atan2(norm, sign * turn[0]) / norm;
    for (int k = 0; k < 3; k++) {
      moved[k] = r.positions[3 * node + k] - r.positions_then[3 * node + k];
      moved[3 + k] = sign * turn[1 + k] * share;
    }
  }
}

// The rotation matrix of a unit quaternion, and the matrix of the product with it from the left.
inline void matrices_of(const double *q, float *turn, float *product) {
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  const double turns[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
                           2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                           2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)};
  const double products[16] = {w, -x, -y, -z, x, w, -z, y, y, z, w, -x, z, -y, x, w};
  for (int k = 0; k < 9; k++) turn[k] = static_cast<float>(turns[k]);
  for (int k = 0; k < 16; k++) product[k] = static_cast<float>(products[k]);
}

// What each node does to what it carries, at each time; a last one leaves all as it is.
inline void carry(const CarryRequest &r) {
  constexpr double kNowhere[3] = {0, 0, 0}, kUpright[4] = {1, 0, 0, 0};
  for (int64_t time = 0; time < r.times; time++) {
    for (int64_t node = 0; node <= r.nodes; node++) {
      const int64_t from = time * r.nodes + node, to = time * (r.nodes + 1) + node;
      const bool rests = node == r.nodes;
      const double *position = rests ? kNowhere : r.positions + 3 * from;
      matrices_of(rests ? kUpright : r.quats + 4 * from, r.turns + 9 * to, r.products + 16 * to);
      for (int k = 0; k < 3; k++) r.shifts[3 * to + k] = static_cast<float>(position[k]);
    }
  }
}

}  // namespace model
