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
};

class Pinhole {
 public:
  // `viewmat` [4, 4] (world to camera), `K` [3, 3].
  Pinhole(const double *viewmat, const double *K, int width, int height)
      : m_(viewmat), K_(K), width_(width), height_(height) {}

  double focal() const { return K_[0]; }

  void to_camera(const double *point, double *out) const {
    for (int i = 0; i < 3; i++) {
      out[i] = m_[4 * i] * point[0] + m_[4 * i + 1] * point[1] + m_[4 * i + 2] * point[2] + m_[4 * i + 3];
    }
  }

  Found find(const double *point) const {
    double x[3];
    to_camera(point, x);
    const double z = std::fabs(x[2]) < kSmallestDepth ? kSmallestDepth : x[2];
    const int64_t u = whole(K_[0] * x[0] / z + K_[2]), v = whole(K_[4] * x[1] / z + K_[5]);
    const bool inside = u >= 0 && u < width_ && v >= 0 && v < height_ && x[2] > kNearestSeen;
    return {cut(v, height_) * width_ + cut(u, width_), x[2], inside};
  }

 private:
  static int64_t whole(double v) {
    return static_cast<int64_t>(std::floor(std::min(std::max(v, -kFarthestPixel), kFarthestPixel)));
  }
  static int64_t cut(int64_t at, int size) { return std::min<int64_t>(std::max<int64_t>(at, 0), size - 1); }

  const double *m_, *K_;
  int width_, height_;
};

}  // namespace model
