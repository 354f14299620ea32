// Where points fall in one camera's image.
#pragma once

#include <algorithm>
#include <cmath>

#include "interface.h"

namespace splat {

constexpr double kNearestSeen = 0.02;    // along the optical axis: what is nearer is not in front of the camera
constexpr double kFarthestPixel = 1e6;   // pixel coordinates beyond are cut, so that they can be whole numbers
constexpr double kSmallestDepth = 1e-9;  // divided by where a point lies in the camera's plane

struct Pinhole {
  double R[9], t[3], fx, fy, cx, cy;
  Pinhole(const double *viewmat, const double *K) : fx(K[0]), fy(K[4]), cx(K[2]), cy(K[5]) {
    for (int i = 0; i < 3; i++) {
      for (int j = 0; j < 3; j++) R[3 * i + j] = viewmat[4 * i + j];
      t[i] = viewmat[4 * i + 3];
    }
  }
  void to_camera(const double *point, double *out) const {
    for (int i = 0; i < 3; i++) {
      out[i] = R[3 * i] * point[0] + R[3 * i + 1] * point[1] + R[3 * i + 2] * point[2] + t[i];
    }
  }
};

// A pixel that a point falls in, cut to the image.
struct Found {
  int64_t column, row;
  double depth;
  bool inside;
  double u, v;  // where it falls
};

inline Found find_pixel(const Pinhole &camera, int width, int height, const double *point) {
  double x[3];
  camera.to_camera(point, x);
  const double z = std::fabs(x[2]) < kSmallestDepth ? kSmallestDepth : x[2];
  const auto whole = [](double v) {
    return static_cast<int64_t>(std::floor(std::min(std::max(v, -kFarthestPixel), kFarthestPixel)));
  };
  const double at_u = camera.fx * x[0] / z + camera.cx, at_v = camera.fy * x[1] / z + camera.cy;
  const int64_t u = whole(at_u), v = whole(at_v);
  const bool inside = u >= 0 && u < width && v >= 0 && v < height && x[2] > kNearestSeen;
  return {std::min<int64_t>(std::max<int64_t>(u, 0), width - 1),
          std::min<int64_t>(std::max<int64_t>(v, 0), height - 1), x[2], inside, at_u, at_v};
}

// Pixels that a sphere about what was found reaches into the image from its pixel; -1: it does not.
inline float reach_of(const Found &found, double radius, double focal) {
  if (!(found.depth > kNearestSeen)) return -1.f;
  const double du = found.u - 0.5 - found.column, dv = found.v - 0.5 - found.row, px = radius * focal / found.depth;
  const double square = px * px - (found.inside ? 0. : du * du + dv * dv);
  return square > 0 ? static_cast<float>(std::sqrt(square)) : -1.f;
}

inline void look(const LookRequest &r) {
  const Pinhole camera(r.viewmat, r.K);
  for (int64_t i = 0; i < r.count; i++) {
    const Found found = find_pixel(camera, r.width, r.height, r.points + 3 * i);
    r.columns[i] = found.column;
    r.rows[i] = found.row;
    r.depths[i] = found.depth;
    r.inside[i] = found.inside;
    if (r.radii != nullptr) r.reached[i] = reach_of(found, r.radii[i], camera.fx);
  }
}

}  // namespace splat
