// What stands still and can stand before something that moves.
#pragma once

#include <algorithm>
#include <vector>

#include "camera.h"
#include "interface.h"

namespace model {

// The deepest point in each cell of an image or in those around it; 0 where there is none.
inline std::vector<double> deepest_around(const OccluderRequest &r, const OccluderView &v) {
  const int64_t columns = v.width / r.cell_px + 1, rows = v.height / r.cell_px + 1;
  std::vector<double> own(columns * rows, 0.), around(columns * rows, 0.);
  const Pinhole camera(v.viewmat, v.K, v.width, v.height);
  for (int64_t i = 0; i < r.points; i++) {
    const double point[3] = {v.means[3 * i], v.means[3 * i + 1], v.means[3 * i + 2]};
    const Found found = camera.find(point);
    if (!found.inside) continue;
    double &deepest = own[found.at / v.width / r.cell_px * columns + found.at % v.width / r.cell_px];
    deepest = std::max(deepest, found.depth);
  }
  for (int64_t row = 0; row < rows; row++) {
    for (int64_t column = 0; column < columns; column++) {
      double &deepest = around[row * columns + column];
      for (int64_t y = std::max<int64_t>(row - 1, 0); y <= std::min(row + 1, rows - 1); y++) {
        for (int64_t x = std::max<int64_t>(column - 1, 0); x <= std::min(column + 1, columns - 1); x++) {
          deepest = std::max(deepest, own[y * columns + x]);
        }
      }
    }
  }
  return around;
}

inline void find_occluders(const OccluderRequest &r) {
  std::fill_n(r.before, r.standing, uint8_t{0});
  for (int32_t view = 0; view < r.view_count; view++) {
    const OccluderView &v = r.views[view];
    const std::vector<double> around = deepest_around(r, v);
    for (int64_t i = 0; i < r.standing; i++) {
      r.before[i] |= static_cast<uint8_t>((v.reach_px[i] >= 0) & (v.depths[i] < around[v.cells[i]]));
    }
  }
}

}  // namespace model
