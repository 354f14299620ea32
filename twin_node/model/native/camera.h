// Pinhole cameras.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace model {

constexpr double kNearestSeen = 0.02;    // along the optical axis: what is nearer is not in front of the camera
constexpr double kFarthestPixel = 1e6;   // pixel coordinates beyond are cut, so that they can be whole numbers
constexpr double kSmallestDepth = 1e-9;  // divided by where a point lies in the camera's plane

struct Found {
  int64_t at;  // the pixel, cut to the image
  double depth;
  bool inside;
  int64_t column, row;  // of the pixel
  double u, v;          // where it falls
};

struct Pinhole {
  double R[9], t[3], fx, fy, cx, cy;
  int width, height;

  // `viewmat` [4, 4] (world to camera), `K` [3, 3].
  Pinhole(const double *viewmat, const double *K, int width, int height)
      : fx(K[0]), fy(K[4]), cx(K[2]), cy(K[5]), width(width), height(height) {
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

  Found find(const double *point) const {
    double x[3];
    to_camera(point, x);
    const double z = std::fabs(x[2]) < kSmallestDepth ? kSmallestDepth : x[2];
    const double at_u = fx * x[0] / z + cx, at_v = fy * x[1] / z + cy;
    const int64_t u = whole(at_u), v = whole(at_v), column = cut(u, width), row = cut(v, height);
    const bool inside = u >= 0 && u < width && v >= 0 && v < height && x[2] > kNearestSeen;
    return {row * width + column, x[2], inside, column, row, at_u, at_v};
  }

  static int64_t whole(double v) {
    return static_cast<int64_t>(std::floor(std::min(std::max(v, -kFarthestPixel), kFarthestPixel)));
  }
  static int64_t cut(int64_t at, int size) { return std::min<int64_t>(std::max<int64_t>(at, 0), size - 1); }
};

}  // namespace model
