// Which Gaussians the images refute: `deaths.refuted_moving_reference` and `judge_static_reference` in one go.
#pragma once

#include <algorithm>
#include <cmath>

#include "camera.h"
#include "interface.h"

namespace model {

constexpr int64_t kGaussiansPerTask = 256;

inline int64_t tasks_of(int64_t count) { return (count + kGaussiansPerTask - 1) / kGaussiansPerTask; }

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

  // Whether the view sees through what moves at `mean`, of a `radius` (m).
  bool refutes(const double *mean, double radius, bool carried) const {
    const Found seen = camera_.find(mean);
    const bool shows = seen.inside || looms(mean, radius, seen);
    if (shows && before_ground(seen.at, seen.depth) && is_empty(seen.at, carried)) return true;
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

  // Whether what lies beyond the image reaches into it.
  bool looms(const double *mean, double radius, const Found &seen) const {
    double point[3];
    camera_.to_camera(mean, point);
    if (!(point[2] > kNearestSeen)) return false;
    const double u = v_.K[0] * point[0] / point[2] + v_.K[2] - 0.5 - static_cast<double>(seen.at % v_.width);
    const double v = v_.K[4] * point[1] / point[2] + v_.K[5] - 0.5 - static_cast<double>(seen.at / v_.width);
    const double reach = rules_.reach * radius * v_.K[0] / point[2];
    return reach * reach - u * u - v * v > 1;
  }

  const DeathView &v_;
  const DeathRules &rules_;
  const Pinhole camera_;
};

// The moving Gaussians of one task.
inline void refute(const RefutedRequest &r, int64_t task) {
  const int64_t end = std::min(r.count, (task + 1) * kGaussiansPerTask);
  for (int64_t i = task * kGaussiansPerTask; i < end; i++) {
    bool refuted = false;
    for (int view = 0; view < r.view_count && !refuted; view++) {
      double mean[3];
      std::copy_n(r.means + 3 * (view * r.count + i), 3, mean);
      refuted = Witness(r.views[view], *r.rules).refutes(mean, r.radii[i], r.carried[i] != 0);
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
