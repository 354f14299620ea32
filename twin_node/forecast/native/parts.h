// Parts of what moves, and what hangs together.
#pragma once

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <vector>

#include "interface.h"

namespace forecast {

inline void split(const SplitRequest &r) {
  const int64_t ly = (r.ny + r.side - 1) / r.side, lz = (r.nz + r.side - 1) / r.side;
  const int64_t lx = (r.nx + r.side - 1) / r.side;
  std::vector<int64_t> numbers(lx * ly * lz, -1);  // -1 without voxels
  for (int64_t i = 0; i < r.voxels; i++) {
    const int64_t column = r.indices[i] / r.nz, z = r.indices[i] % r.nz, x = column / r.ny, y = column % r.ny;
    r.places[i] = static_cast<int32_t>(x);
    r.places[r.voxels + i] = static_cast<int32_t>(y);
    r.places[2 * r.voxels + i] = static_cast<int32_t>(z);
    r.labels[i] = (x / r.side * ly + y / r.side) * lz + z / r.side;
    numbers[r.labels[i]] = 0;
  }
  int64_t count = 0;
  for (int64_t &number : numbers) {
    if (number == 0) number = count++;
  }
  std::fill(r.sums, r.sums + 4 * count, 0.0);
  for (int64_t i = 0; i < r.voxels; i++) {
    r.labels[i] = numbers[r.labels[i]];
    double *sums = r.sums + 4 * r.labels[i];
    for (int axis = 0; axis < 3; axis++) sums[axis] += r.places[axis * r.voxels + i];
    sums[3]++;
  }
  *r.count = count;
}

}  // namespace forecast
