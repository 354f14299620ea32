// The voxels that a view measures surfaces in.
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "interface.h"
#include "rounded.h"

namespace forecast {

// Flat voxel of points along one fine row of pixels; -1 outside the grid. A point between two voxels must not depend on
// who computes it.
FORECAST_ROUNDED inline void locate(const MarkRequest &r, float down, const float *depths, int32_t *voxels) {
  FORECAST_ROUNDED_BODY
  const int32_t points = r.width * r.finer;
  const float *T = r.T_base_cam;
  for (int32_t i = 0; i < points; i++) {
    const float z = depths[i], x = r.across[i] * z / r.focal[0], y = down * z / r.focal[1];
    const float px = T[0] * x + T[1] * y + T[2] * z + T[3];
    const float py = T[4] * x + T[5] * y + T[6] * z + T[7];
    const float pz = T[8] * x + T[9] * y + T[10] * z + T[11];
    const double vx = std::floor((px - r.origin[0]) / r.voxel_size), vy = std::floor((py - r.origin[1]) / r.voxel_size);
    const double vz = std::floor((pz - r.origin[2]) / r.voxel_size);
    const bool inside = (vx >= 0) & (vx < r.nx) & (vy >= 0) & (vy < r.ny) & (vz >= 0) & (vz < r.nz);
    voxels[i] = inside ? static_cast<int32_t>((vx * r.ny + vy) * r.nz + vz) : -1;
  }
}

inline void mark(const MarkRequest &r) {
  const int32_t points = r.width * r.finer;
  std::vector<float> depths(points);
  std::vector<int32_t> voxels(points);
  for (int32_t row = 0; row < r.height; row++) {
    const float *depth = r.depth + static_cast<int64_t>(row) * r.width;
    const uint8_t *chosen = r.chosen + static_cast<int64_t>(row) * r.width;
    for (int32_t i = 0; i < points; i++) depths[i] = depth[i / r.finer];
    for (int32_t fine = 0; fine < r.finer; fine++) {
      locate(r, r.down[row * r.finer + fine], depths.data(), voxels.data());
      for (int32_t i = 0; i < points; i++) {
        if (chosen[i / r.finer] && voxels[i] >= 0) r.marked[voxels[i]] = 1;
      }
    }
  }
}

}  // namespace forecast
