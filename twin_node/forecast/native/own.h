// The voxels that capsules touch.
#pragma once

#include <algorithm>
#include <cmath>

#include "bits.h"
#include "interface.h"

namespace forecast {

// First and one past the last of `count` voxels that [lower, upper] (voxels) reaches into.
struct Extent {
  int64_t begin, end;

  Extent(double lower, double upper, int64_t count)
      : begin(static_cast<int64_t>(std::clamp(std::floor(lower), 0.0, static_cast<double>(count)))),
        end(static_cast<int64_t>(std::clamp(std::ceil(upper), 0.0, static_cast<double>(count)))) {}
};

inline void take(const TakeRequest &r, const double *ends, double radius) {
  const double *start = ends, *stop = ends + 3;
  const double u[3] = {stop[0] - start[0], stop[1] - start[1], stop[2] - start[2]};
  const double length2 = std::max(u[0] * u[0] + u[1] * u[1] + u[2] * u[2], 1e-12);
  const auto extent = [&](int axis, int64_t count) {
    const double lower = std::min(start[axis], stop[axis]) - radius - r.origin[axis];
    const double upper = std::max(start[axis], stop[axis]) + radius - r.origin[axis];
    return Extent(lower / r.voxel_size, upper / r.voxel_size, count);
  };
  const Extent ex = extent(0, r.nx), ey = extent(1, r.ny), ez = extent(2, r.nz);
  const auto middle = [&](int axis, int64_t i) { return r.origin[axis] + (i + 0.5) * r.voxel_size - start[axis]; };
  for (int64_t x = ex.begin; x < ex.end; x++) {
    for (int64_t y = ey.begin; y < ey.end; y++) {
      const double px = middle(0, x), py = middle(1, y), along = px * u[0] + py * u[1];
      uint64_t *column = r.taken + (x * r.ny + y) * words_of(r.nz);
      for (int64_t z = ez.begin; z < ez.end; z++) {
        const double pz = middle(2, z);
        const double share = std::min(std::max((along + pz * u[2]) / length2, 0.0), 1.0);
        const double dx = px - share * u[0], dy = py - share * u[1], dz = pz - share * u[2];
        column[z / 64] |= uint64_t{dx * dx + dy * dy + dz * dz <= radius * radius} << z % 64;
      }
    }
  }
}

inline void take(const TakeRequest &r) {
  for (int64_t i = 0; i < r.capsules; i++) take(r, r.ends + 6 * i, r.radii[i]);
}

}  // namespace forecast
