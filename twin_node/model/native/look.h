// Where points fall in one camera's image.
#pragma once

#include <cmath>

#include "camera.h"
#include "interface.h"

namespace model {

// Pixels that a sphere about what was found reaches into the image from its pixel; -1: it does not.
inline float reach_of(const Found &found, double radius, double focal) {
  if (!(found.depth > kNearestSeen)) return -1.f;
  const double du = found.u - 0.5 - found.column, dv = found.v - 0.5 - found.row, px = radius * focal / found.depth;
  const double square = px * px - (found.inside ? 0. : du * du + dv * dv);
  return square > 0 ? static_cast<float>(std::sqrt(square)) : -1.f;
}

inline void find_pixels(const PixelsRequest &r) {
  const Pinhole camera(r.viewmat, r.K, r.width, r.height);
  for (int64_t i = 0; i < r.count; i++) {
    const Found found = camera.find(r.points + 3 * i);
    r.columns[i] = found.column;
    r.rows[i] = found.row;
    r.depths[i] = found.depth;
    r.inside[i] = found.inside;
    if (r.radii != nullptr) r.reached[i] = reach_of(found, r.radii[i], camera.fx);
  }
}

}  // namespace model
