// Points that views with depth measure on what moves: which part holds each, and whether it was foreseen.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "interface.h"
#include "rounded.h"

namespace forecast {

// A voxel's place in a grid; -1 outside.
struct Raster {
  const int32_t *dims;
  const double *origin;
  double voxel_size;

  FORECAST_ROUNDED int64_t locate(const float *point) const {
    FORECAST_ROUNDED_BODY
    double at[3];
    for (int axis = 0; axis < 3; axis++) at[axis] = std::floor((point[axis] - origin[axis]) / voxel_size);
    const bool inside = (at[0] >= 0) & (at[0] < dims[0]) & (at[1] >= 0) & (at[1] < dims[1]) & (at[2] >= 0) &
                        (at[2] < dims[2]);
    return inside ? static_cast<int64_t>((at[0] * dims[1] + at[1]) * dims[2] + at[2]) : -1;
  }
};

// Where a pixel with depth shows a surface, m. A point between two voxels must not depend on who computes it.
FORECAST_ROUNDED inline void unproject(const SurfaceView &view, int32_t row, int32_t column, float z, float *point) {
  FORECAST_ROUNDED_BODY
  const double *K = view.K, *T = view.T_base_cam;
  const float across = static_cast<float>(column + 0.5 - K[2]), down = static_cast<float>(row + 0.5 - K[5]);
  const float x = across * z / static_cast<float>(K[0]), y = down * z / static_cast<float>(K[4]);
  for (int axis = 0; axis < 3; axis++) {
    const double *R = T + 4 * axis;
    point[axis] = static_cast<float>(R[0]) * x + static_cast<float>(R[1]) * y + static_cast<float>(R[2]) * z +
                  static_cast<float>(R[3]);
  }
}

inline void find_surface(const SurfaceRequest &r) {
  const Raster inner{r.inner_dims, r.inner_origin, r.voxel_size}, outer{r.outer_dims, r.outer_origin, r.voxel_size};
  const int64_t voxels = static_cast<int64_t>(r.inner_dims[0]) * r.inner_dims[1] * r.inner_dims[2];
  std::vector<uint64_t> forecast((voxels + 63) / 64);
  for (int64_t i = 0; i < r.forecasts; i++) forecast[r.forecast[i] / 64] |= uint64_t{1} << r.forecast[i] % 64;
  int64_t found = 0;
  for (int32_t number = 0; number < r.views; number++) {
    const SurfaceView &view = r.seen[number];
    for (int32_t row = 0, pixel = 0; row < view.height; row++) {
      for (int32_t column = 0; column < view.width; column++, pixel++) {
        if (!view.moving[pixel] || !(view.depth[pixel] > 0)) continue;
        float point[3];
        unproject(view, row, column, view.depth[pixel], point);
        const int64_t here = inner.locate(point);
        if (here < 0) continue;
        const int64_t place = outer.locate(point), *end = r.indices + r.voxels;
        const int64_t *voxel = std::lower_bound(r.indices, end, place);
        r.parts[found] = voxel < end && *voxel == place ? r.labels[voxel - r.indices] : -1;
        r.foreseen[found] = forecast[here / 64] >> here % 64 & 1;
        found++;
      }
    }
  }
  *r.count = found;
}

}  // namespace forecast
