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

// Derivatives of the pixels by the middles of parts.
inline void derive(const ShowRequest &r) {
  const double *T = r.viewmat;
  for (int64_t part = 0; part < r.parts; part++) {
    const double *c = r.centers + 3 * part;
    double here[3];
    for (int k = 0; k < 3; k++) here[k] = T[4 * k] * c[0] + T[4 * k + 1] * c[1] + T[4 * k + 2] * c[2] + T[4 * k + 3];
    const double z = std::max(here[2], r.least_depth);
    for (int k = 0; k < 2; k++) {
      double *to = r.jacobian + 6 * part + 3 * k;
      for (int i = 0; i < 3; i++) to[i] = r.focal[k] / z * (T[4 * k + i] - here[k] / z * T[8 + i]);
    }
  }
}

// Lists the voxels of parts that are nearest to the camera, where the mask shows something moving.
inline void show(const ShowRequest &r) {
  derive(r);
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

// A blob that has flown.
struct Flight {
  int32_t label, label_before;
  float across, down;  // pixels
  float receded;       // m by which its depth has grown, or NaN
};

// Middle of the depths of a blob, m; NaN where none was measured.
inline float median_depth(const SeenImage &image, int32_t label, int64_t pixels) {
  std::vector<float> depths;
  for (int64_t i = 0; i < pixels; i++) {
    if (image.labels[i] == label && image.depth[i] > 0) depths.push_back(image.depth[i]);
  }
  if (depths.empty()) return std::numeric_limits<float>::quiet_NaN();
  const auto middle = depths.begin() + depths.size() / 2;
  std::nth_element(depths.begin(), middle, depths.end());
  return depths.size() % 2 ? *middle : (*std::max_element(depths.begin(), middle) + *middle) / 2;
}

// Small things that went further between two images than flow looks.
class Flights {
 public:
  explicit Flights(const TellRequest &r) {
    const int64_t mine = r.now.count, others = r.before.count;
    std::vector<double> shares(mine * others);
    for (int64_t i = 0; i < mine * others; i++) shares[i] = share(r, i / others, i % others);
    for (int64_t i = 0; others > 0 && i < mine; i++) {
      const auto row = shares.begin() + i * others;
      const int64_t j = std::min_element(row, row + others) - row;
      if (!(row[j] > r.found_from && row[j] < r.found_until)) continue;
      int64_t nearest = 0;
      for (int64_t k = 1; k < mine; k++) nearest = shares[k * others + j] < shares[nearest * others + j] ? k : nearest;
      if (nearest == i) flights_.push_back(flight(r, r.now.blobs + 4 * i, r.before.blobs + 4 * j));
    }
  }

  // Of a blob; null where it has not flown.
  const Flight *of(int32_t label) const {
    for (const Flight &one : flights_) {
      if (one.label == label) return &one;
    }
    return nullptr;
  }

 private:
  // Way between two blobs in widths of the newer; infinite where they are not alike.
  FORECAST_ROUNDED static double share(const TellRequest &r, int64_t i, int64_t j) {
    FORECAST_ROUNDED_BODY
    const double *now = r.now.blobs + 4 * i, *before = r.before.blobs + 4 * j;
    const bool alike = std::max(now[1], before[1]) < r.same_area * std::min(now[1], before[1]);
    const double across = now[2] - before[2], down = now[3] - before[3];
    const double across2 = across * across, down2 = down * down;
    return alike ? std::sqrt(across2 + down2) / std::sqrt(now[1]) : std::numeric_limits<double>::infinity();
  }

  static Flight flight(const TellRequest &r, const double *now, const double *before) {
    const int64_t pixels = static_cast<int64_t>(r.width) * r.height;
    const int32_t label = static_cast<int32_t>(now[0]), label_before = static_cast<int32_t>(before[0]);
    const float across = static_cast<float>(now[2] - before[2]), down = static_cast<float>(now[3] - before[3]);
    float receded = std::numeric_limits<float>::quiet_NaN();
    if (r.now.depth) {
      receded = median_depth(r.now, label, pixels) - median_depth(r.before, label_before, pixels);
    }
    return {label, label_before, across, down, receded};
  }

  std::vector<Flight> flights_;
};

// What a pixel shows of its motion.
struct PixelMotion {
  bool is_found, flies;
  float across, down;  // pixels
  float receded;       // m, or NaN
};

// Follows pixels of what moves back into the image before.
class Trace {
 public:
  explicit Trace(const TellRequest &request) : r_(request), flights_(request) {}

  PixelMotion of(int64_t pixel) const {
    constexpr float kUnknown = std::numeric_limits<float>::quiet_NaN();
    if (const Flight *flight = flights_.of(r_.now.labels[pixel])) {
      return {true, true, flight->across, flight->down, flight->receded};
    }
    const int32_t x = static_cast<int32_t>(pixel % r_.width), y = static_cast<int32_t>(pixel / r_.width);
    const int32_t column = x - r_.left, row = y - r_.top;
    PixelMotion motion{false, false, 0.0f, 0.0f, kUnknown};
    if (column >= 0 && column < r_.columns && row >= 0 && row < r_.rows) {
      const float *flow = r_.flow + 2 * (static_cast<int64_t>(row) * r_.columns + column);
      motion.across = -flow[0], motion.down = -flow[1];
    }
    if (!r_.now.near[pixel]) return motion;
    const double u = std::nearbyint(x - static_cast<double>(motion.across));
    const double v = std::nearbyint(y - static_cast<double>(motion.down));
    if (!(u >= 0 && u < r_.width && v >= 0 && v < r_.height)) return motion;
    const int64_t there = static_cast<int64_t>(v) * r_.width + static_cast<int64_t>(u);
    const int change = r_.now.grey[pixel] - r_.before.grey[there];
    if (!r_.before.near[there] || std::abs(change) >= r_.alike) return motion;
    motion.is_found = true;
    if (r_.now.depth && r_.now.depth[pixel] > 0 && r_.before.depth[there] > 0) {
      motion.receded = r_.now.depth[pixel] - r_.before.depth[there];
    }
    return motion;
  }

 private:
  const TellRequest &r_;
  const Flights flights_;
};

// What moves in a pixel counts for more than what stands still beside it.
FORECAST_ROUNDED inline float weight_of(const TellRequest &r, const PixelMotion &motion) {
  FORECAST_ROUNDED_BODY
  const float across = motion.across * motion.across, down = motion.down * motion.down;
  const float way = std::sqrt(across + down) + r.flow_noise;
  return motion.is_found ? way * way : 0.0f;
}

// Of the shift of a part, pixels^2: what is near moves far between two images, and flow does not find it again.
FORECAST_ROUNDED inline double variance_of(const TellRequest &r, const double *jacobian, bool flies) {
  FORECAST_ROUNDED_BODY
  double squares = 0;
  for (int i = 0; i < 6; i++) squares += jacobian[i] * jacobian[i];
  const double reach = std::sqrt(squares) / std::sqrt(2.0) * r.fast;
  const double sigma = flies ? r.flight_sigma : r.flow_sigma * (1 + std::pow(reach / r.lost, 3.0));
  return sigma * sigma;
}

// Means over the pixels of each part.
inline void tell(const TellRequest &r) {
  struct Sums {
    int64_t pixels = 0, found = 0, flying = 0, measured = 0;
    double weight = 0, across = 0, down = 0, receded = 0, depth = 0;
  };
  constexpr double kUnknown = std::numeric_limits<double>::infinity();
  const Trace trace(r);
  std::vector<Sums> sums(r.parts);
  for (int64_t i = 0; i < r.voxels; i++) {
    const PixelMotion motion = trace.of(r.pixels[i]);
    Sums &own = sums[r.labels[i]];
    const float weight = weight_of(r, motion), across = weight * motion.across, down = weight * motion.down;
    own.pixels++, own.found += motion.is_found, own.flying += motion.flies;
    own.weight += weight, own.across += across, own.down += down;
    if (r.now.depth && std::abs(motion.receded) < r.most_receded) {
      own.measured++, own.receded += motion.receded, own.depth += r.now.depth[r.pixels[i]];
    }
  }
  for (int64_t part = 0; part < r.parts; part++) {
    const Sums &own = sums[part];
    const double weight = std::max(own.weight, r.least), pixels = std::max<double>(own.pixels, r.least);
    const double measured = std::max<double>(own.measured, r.least);
    const bool is_known = static_cast<double>(own.found) > r.known_share * static_cast<double>(own.pixels);
    const bool flies = static_cast<double>(own.flying) / pixels > 0.5, is_measured = own.measured >= r.fewest;
    r.shifts[2 * part] = own.across / weight, r.shifts[2 * part + 1] = own.down / weight;
    r.shown[part] = own.pixels > 0;
    r.variances[part] = is_known ? variance_of(r, r.jacobian + 6 * part, flies) : kUnknown;
    r.receded[part] = is_measured ? own.receded / measured : 0.0;
    r.depths[part] = is_measured ? own.depth / measured : kUnknown;
  }
}

}  // namespace forecast
