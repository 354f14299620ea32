// Which Gaussians the images refute: `deaths.refuted_moving_plainly` and `judge_static_plainly` in one go.
#pragma once

#include <algorithm>
#include <cmath>

#include "../../native/quaternions.h"
#include "camera.h"
#include "interface.h"

namespace model {

constexpr int64_t kGaussiansPerTask = 256;

inline int tasks_of(int64_t count) { return static_cast<int>((count + kGaussiansPerTask - 1) / kGaussiansPerTask); }

// What views say about one STATIC Gaussian.
struct Verdict {
  int shown, gone, moving;
  bool proven, on_surface;
};

// One view, and what it shows at its pixels.
class Witness {
 public:
  Witness(const DeathView &view, const DeathRules &rules)
      : v_(view), rules_(rules), camera_(view.viewmat, view.K, view.width, view.height) {}

  // Whether the view sees through what moves at `mean`, with three half axes [3, 3] (m, one after another).
  bool refutes(const double *mean, const double (*axes)[3], double radius, bool carried) const {
    const Found seen = camera_.find(mean);
    if (seen.inside ? rim_is_empty(mean, axes, seen, carried) : looms_over_nothing(mean, radius, seen, carried)) {
      return true;
    }
    return sees_through(seen.at, seen.depth, seen.inside);
  }

  // What the view says about the STATIC Gaussian `i`.
  void judge(int64_t i, Verdict &out) const {
    const int64_t at = v_.rows[i] * v_.width + v_.columns[i];
    const double depth = v_.depths[i], surface = v_.surface[at];
    const bool inside = v_.inside[i];
    if (inside && std::fabs(depth - surface) < rules_.occlusion * surface) out.on_surface = true;
    out.proven |= sees_through(at, depth, inside);  // through all that is drawn before it too
    const double front = v_.shown[4 * at + 3];
    const bool covered = v_.active[at] && front > 0 && depth > (1 + rules_.occlusion) * front;
    if (!inside || depth > v_.far[at] * (1 + rules_.occlusion) || covered || !v_.usable[at]) return;
    bool changed = v_.surprise[at] > rules_.threshold;
    if (v_.nearest != nullptr) {
      if (!(v_.nearest[at] > (1 - rules_.seen_through) * depth)) return;
      changed = false;
    }
    out.shown++;
    out.gone += changed;
    out.moving += v_.moving[at];
  }

 private:
  // A view that shows nothing moving speaks against what a node carries; against others, one that shows the background.
  bool is_empty(int64_t at, bool carried) const { return v_.usable[at] && !(carried ? v_.near_moving : v_.active)[at]; }
  bool before_ground(int64_t at, double depth) const { return !(depth > v_.far[at] * (1 + rules_.occlusion)); }

  bool sees_through(int64_t at, double depth, bool inside) const {
    return v_.nearest != nullptr && inside && v_.active[at] && v_.nearest[at] > (1 + rules_.seen_through) * depth;
  }

  bool rim_is_empty(const double *mean, const double (*axes)[3], const Found &seen, bool carried) const {
    const int64_t row = seen.at / v_.width, column = seen.at % v_.width;
    double half[2][2];
    half_axes(mean, axes, half);
    for (int k = -2; k <= 2; k++) {  // the middle, and both ends of both axes
      const double *axis = half[k < 0 ? -k - 1 : std::max(k - 1, 0)], reach = k == 0 ? 0 : std::copysign(rules_.reach, k);
      const int64_t x = column + shift(reach * axis[0]), y = row + shift(reach * axis[1]);
      if (x < 0 || x >= v_.width || y < 0 || y >= v_.height) continue;
      const int64_t at = y * v_.width + x;
      if (before_ground(at, seen.depth) && is_empty(at, carried)) return true;
    }
    return false;
  }

  static int64_t shift(double pixels) {
    return static_cast<int64_t>(std::nearbyint(std::min(std::max(pixels, -kFarthestPixel), kFarthestPixel)));
  }

  // The long and the short half axis of 1 sigma, (u, v) pixels, of the ellipse that the camera sees.
  void half_axes(const double *mean, const double (*axes)[3], double (*out)[2]) const {
    double point[3];
    camera_.to_camera(mean, point);
    const double z = std::max(point[2], rules_.nearest_m);
    double uu = 0, uv = 0, vv = 0;
    for (int k = 0; k < 3; k++) {
      double axis[3];
      camera_.turn(axes[k], axis);
      const double u = v_.K[0] / z * (axis[0] - point[0] / z * axis[2]);
      const double v = v_.K[4] / z * (axis[1] - point[1] / z * axis[2]);
      uu += u * u;
      uv += u * v;
      vv += v * v;
    }
    const double middle = (uu + vv) / 2, apart = std::hypot((uu - vv) / 2, uv);
    const double cosine = apart > 0 ? (uu - vv) / 2 / apart : 1;  // of twice the angle of the long one
    const double x = std::sqrt(std::max(1 + cosine, 0.) / 2), y = std::copysign(std::sqrt(std::max(1 - cosine, 0.) / 2), uv);
    const double longer = std::sqrt(middle + apart), shorter = std::sqrt(std::max(middle - apart, 0.));
    out[0][0] = longer * x;
    out[0][1] = longer * y;
    out[1][0] = -shorter * y;
    out[1][1] = shorter * x;
  }

  // Beyond the image, and reaching into it where nothing is.
  bool looms_over_nothing(const double *mean, double radius, const Found &seen, bool carried) const {
    double point[3];
    camera_.to_camera(mean, point);
    if (!(point[2] > kNearestSeen)) return false;
    const double u = v_.K[0] * point[0] / point[2] + v_.K[2] - 0.5 - static_cast<double>(seen.at % v_.width);
    const double v = v_.K[4] * point[1] / point[2] + v_.K[5] - 0.5 - static_cast<double>(seen.at / v_.width);
    const double reach = rules_.reach * radius * v_.K[0] / point[2];
    return reach * reach - u * u - v * v > 1 && before_ground(seen.at, seen.depth) && is_empty(seen.at, carried);
  }

  const DeathView &v_;
  const DeathRules &rules_;
  const Pinhole camera_;
};

// The axes of a Gaussian of any quaternion w, x, y, z, 1 sigma long, one after another.
inline void half_axes_of(const float *quat, const float *scales, double (*axes)[3]) {
  double q[4], square = 0;
  std::copy_n(quat, 4, q);
  for (const double part : q) square += part * part;
  for (double &part : q) part /= std::sqrt(square);
  for (int k = 0; k < 3; k++) {
    for (int i = 0; i < 3; i++) axes[k][i] = i == k ? scales[k] : 0.;
    quaternions::turn(q, axes[k]);
  }
}

// The moving Gaussians of one task.
inline void refute(const RefutedRequest &r, int64_t task) {
  const int64_t end = std::min(r.count, (task + 1) * kGaussiansPerTask);
  for (int64_t i = task * kGaussiansPerTask; i < end; i++) {
    double axes[3][3], radius = 0;
    half_axes_of(r.quats + 4 * i, r.scales + 3 * i, axes);
    for (int k = 0; k < 3; k++) radius += r.scales[3 * i + k] / 3.;
    bool refuted = false;
    for (int view = 0; view < r.view_count && !refuted; view++) {
      double mean[3];
      std::copy_n(r.means + 3 * (view * r.count + i), 3, mean);
      refuted = Witness(r.views[view], *r.rules).refutes(mean, axes, radius, r.carried[i] != 0);
    }
    r.refuted[i] = refuted;
  }
}

// The STATIC Gaussians of one task.
inline void judge(const StaticRequest &r, int64_t task) {
  const int64_t end = std::min(r.count, (task + 1) * kGaussiansPerTask);
  for (int64_t i = task * kGaussiansPerTask; i < end; i++) {
    Verdict said{};
    for (int view = 0; view < r.view_count; view++) Witness(r.views[view], *r.rules).judge(i, said);
    r.left[i] = said.proven || (!said.on_surface && said.gone == said.shown && said.gone >= 1);
    r.moving[i] = !said.on_surface && said.moving == said.shown && said.moving >= std::min(2, r.view_count);
  }
}

}  // namespace model
