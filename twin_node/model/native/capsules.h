// What of an arm's capsules is nearest to points.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include "interface.h"

namespace model {

constexpr int kPointsAtOnce = 256;  // whose nearest so far stays in the nearest cache

// Takes in capsule `index` for points [first, first + count).
inline void approach(const CapsuleRequest &r, int64_t index, int64_t first, int count) {
  const double *begin = r.ends + 6 * index, *end = begin + 3, radius = r.radii[index];
  const double along[3] = {end[0] - begin[0], end[1] - begin[1], end[2] - begin[2]};
  const double square = along[0] * along[0] + along[1] * along[1] + along[2] * along[2];
  const double per_length = 1 / std::max(square, r.shortest_square);
  const double *x = r.at + first, *y = x + r.points, *z = y + r.points;
  double *gaps = r.gaps + first, *shares = r.shares + first;
  int64_t *nearest = r.nearest + first;
  double share[kPointsAtOnce], gap[kPointsAtOnce];
#pragma omp simd
  for (int j = 0; j < count; j++) {
    const double off[3] = {x[j] - begin[0], y[j] - begin[1], z[j] - begin[2]};
    const double raw = (along[0] * off[0] + along[1] * off[1] + along[2] * off[2]) * per_length;
    const double positive = raw > 0. ? raw : 0.;
    share[j] = positive < 1. ? positive : 1.;
    const double dx = off[0] - share[j] * along[0], dy = off[1] - share[j] * along[1], dz = off[2] - share[j] * along[2];
    gap[j] = std::sqrt(dx * dx + dy * dy + dz * dz) - radius;
  }
#pragma omp simd
  for (int j = 0; j < count; j++) {
    const bool closer = gap[j] < gaps[j];
    nearest[j] = closer ? index : nearest[j];
    shares[j] = closer ? share[j] : shares[j];
    gaps[j] = closer ? gap[j] : gaps[j];
  }
}

inline void find_nearest_capsules(const CapsuleRequest &r) {
  std::fill_n(r.gaps, r.points, std::numeric_limits<double>::infinity());
  std::fill_n(r.nearest, r.points, 0);
  std::fill_n(r.shares, r.points, 0.);
  for (int64_t first = 0; first < r.points; first += kPointsAtOnce) {
    const int count = static_cast<int>(std::min<int64_t>(kPointsAtOnce, r.points - first));
    for (int64_t index = 0; index < r.capsules; index++) approach(r, index, first, count);
  }
}

}  // namespace model
