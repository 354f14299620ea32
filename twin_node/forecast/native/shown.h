// What the images of one view show of parts that move.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "interface.h"
#include "rounded.h"

namespace forecast {

// Follows what moves back along its way into the image before.
inline void trace(const TraceRequest &r) {
  for (int32_t y = 0, here = 0; y < r.height; y++) {
    for (int32_t x = 0; x < r.width; x++, here++) {
      r.found[here] = 0;
      if (r.receded) r.receded[here] = std::numeric_limits<float>::quiet_NaN();
      if (!r.moving[here]) continue;
      const double u = std::nearbyint(x - static_cast<double>(r.shifts[2 * here]));
      const double v = std::nearbyint(y - static_cast<double>(r.shifts[2 * here + 1]));
      if (!(u >= 0 && u < r.width && v >= 0 && v < r.height)) continue;
      const int64_t there = static_cast<int64_t>(v) * r.width + static_cast<int64_t>(u);
      const int change = r.grey[here] - r.grey_before[there];
      if (!r.moved_before[there] || std::abs(change) >= r.alike) continue;
      r.found[here] = 1;
      if (r.receded && r.depth[here] > 0 && r.depth_before[there] > 0) {
        r.receded[here] = r.depth[here] - r.depth_before[there];
      }
    }
  }
}

// Lists the voxels of parts that are nearest to the camera, where the mask shows something moving.
inline void show(const ShowRequest &r) {
  const int32_t columns = r.width / 2 + 1;
  const int64_t outside = static_cast<int64_t>(r.width) * r.height;
  const auto cell = [&](int64_t pixel) { return pixel / r.width / 2 * columns + pixel % r.width / 2; };
  std::vector<float> nearest(static_cast<size_t>(columns) * (r.height / 2 + 1), std::numeric_limits<float>::infinity());
  for (int64_t i = 0; i < r.voxels; i++) {
    const int64_t pixel = r.table_pixels[r.places[i]];
    if (pixel >= outside) continue;
    float &least = nearest[cell(pixel)];
    least = std::min(least, r.table_depths[r.places[i]]);
  }
  int64_t count = 0;
  for (int64_t i = 0; i < r.voxels; i++) {
    const int64_t pixel = r.table_pixels[r.places[i]];
    if (pixel >= outside || !r.moving[pixel]) continue;
    if (!(r.table_depths[r.places[i]] < nearest[cell(pixel)] + r.part_size)) continue;
    r.pixels[count] = pixel;
    r.shown_labels[count++] = r.labels[i];
  }
  *r.count = count;
}

// What moves in a pixel counts for more than what stands still beside it.
FORECAST_ROUNDED inline float weight_of(const TellRequest &r, int64_t pixel) {
  FORECAST_ROUNDED_BODY
  const float across = r.moved[2 * pixel] * r.moved[2 * pixel], down = r.moved[2 * pixel + 1] * r.moved[2 * pixel + 1];
  const float way = std::sqrt(across + down) + r.flow_noise;
  return r.found[pixel] ? way * way : 0.0f;
}

// Means over the pixels of each part.
inline void tell(const TellRequest &r) {
  struct Sums {
    int64_t pixels = 0, found = 0, flying = 0, measured = 0;
    double weight = 0, across = 0, down = 0, receded = 0, depth = 0;
  };
  std::vector<Sums> sums(r.parts);
  for (int64_t i = 0; i < r.voxels; i++) {
    const int64_t pixel = r.pixels[i];
    Sums &own = sums[r.labels[i]];
    const float weight = weight_of(r, pixel);
    const float across = weight * r.moved[2 * pixel], down = weight * r.moved[2 * pixel + 1];
    own.pixels++, own.found += r.found[pixel], own.flying += r.flying[pixel];
    own.weight += weight, own.across += across, own.down += down;
    if (r.receded && std::abs(r.receded[pixel]) < r.most_receded) {
      own.measured++, own.receded += r.receded[pixel], own.depth += r.depth[pixel];
    }
  }
  for (int64_t part = 0; part < r.parts; part++) {
    const Sums &own = sums[part];
    const double weight = std::max(own.weight, r.least), pixels = std::max<double>(own.pixels, r.least);
    const double measured = std::max<double>(own.measured, r.least);
    const bool is_measured = r.receded && own.measured >= r.fewest;
    r.shifts[2 * part] = own.across / weight, r.shifts[2 * part + 1] = own.down / weight;
    r.shown[part] = own.pixels > 0;
    r.known[part] = static_cast<double>(own.found) > r.known_share * static_cast<double>(own.pixels);
    r.flies[part] = static_cast<double>(own.flying) / pixels > 0.5;
    r.recessions[part] = is_measured ? own.receded / measured : 0.0;
    r.depths[part] = is_measured ? own.depth / measured : std::numeric_limits<double>::infinity();
  }
}

}  // namespace forecast
