// What all views together say of the velocities of parts.
#pragma once

#include <algorithm>
#include <cmath>

#include "interface.h"
#include "rounded.h"

namespace forecast {

// A symmetric system of three equations.
struct Normal {
  double xx, xy, xz, yy, yz, zz;
  double right[3];

  // Adds the equation `row` * v = value.
  void add(double weight, const double *row, double value) {
    const double a = weight * row[0], b = weight * row[1], c = weight * row[2];
    xx += a * row[0], xy += a * row[1], xz += a * row[2], yy += b * row[1], yz += b * row[2], zz += c * row[2];
    right[0] += a * value, right[1] += b * value, right[2] += c * value;
  }

  // Writes the solution; the trace of the inverse.
  double solve(double *v) const {
    const double axx = yy * zz - yz * yz, axy = xz * yz - xy * zz, axz = xy * yz - xz * yy;
    const double ayy = xx * zz - xz * xz, ayz = xy * xz - xx * yz, azz = xx * yy - xy * xy;
    const double scale = 1 / (xx * axx + xy * axy + xz * axz);
    v[0] = scale * (axx * right[0] + axy * right[1] + axz * right[2]);
    v[1] = scale * (axy * right[0] + ayy * right[1] + ayz * right[2]);
    v[2] = scale * (axz * right[0] + ayz * right[1] + azz * right[2]);
    return scale * (axx + ayy + azz);
  }
};

// Cauchy's weight of what is trusted so much, and so far off; in the first turn nothing is doubted.
inline double doubted(double trust, double squares, int turn) { return turn ? trust / (1 + trust * squares) : trust; }

inline double squares(const double *a, const double *b) {
  double sum = 0;
  for (int i = 0; i < 3; i++) sum += (a[i] - b[i]) * (a[i] - b[i]);
  return sum;
}

// Of the change of a part's depth: the inverse of the variance of its velocity along the axis, s^2 / m^2.
FORECAST_ROUNDED inline double depth_trust(const SolveRequest &r, const SolveView &view, int64_t part) {
  FORECAST_ROUNDED_BODY
  const double share = r.depth_share * view.depths[part], sigma = r.depth_sigma + share;
  return view.elapsed_s * view.elapsed_s / (sigma * sigma);
}

inline void take_in(
    const SolveRequest &r, const SolveView &view, int64_t part, const double *v, int turn, Normal &normal) {
  double design[2][3], misfit = 0;
  const double *shift = view.shifts + 2 * part;
  for (int k = 0; k < 2; k++) {
    double sum = -shift[k];
    for (int i = 0; i < 3; i++) {
      design[k][i] = view.jacobian[6 * part + 3 * k + i] * view.elapsed_s;
      sum += design[k][i] * v[i];
    }
    misfit += sum * sum;
  }
  const double trust = doubted(1 / view.variances[part], misfit, turn);
  for (int k = 0; k < 2; k++) normal.add(trust, design[k], shift[k]);
  const double speed = view.receded[part] / view.elapsed_s;
  const double away = v[0] * view.axis[0] + v[1] * view.axis[1] + v[2] * view.axis[2] - speed;
  normal.add(doubted(depth_trust(r, view, part), away * away, turn), view.axis, speed);
}

inline void solve(const SolveRequest &r, int64_t part) {
  const double *prior = r.prior + 3 * part, *whole = r.whole + 3 * part, sigma = r.prior_sigmas[part];
  const double whole_sigma = r.whole_sigmas[part], whole_trust = 1 / (whole_sigma * whole_sigma);
  double *v = r.velocities + 3 * part, trace = 0;
  std::copy(prior, prior + 3, v);
  for (int turn = 0; turn < r.turns; turn++) {
    const double own = 1 / (sigma * sigma + squares(v, prior));
    const double seen = doubted(whole_trust, squares(v, whole), turn), both = own + seen;
    Normal normal{both, 0, 0, both, 0, both, {}};
    for (int i = 0; i < 3; i++) normal.right[i] = own * prior[i] + seen * whole[i];
    for (int view = 0; view < r.views; view++) take_in(r, r.seen[view], part, v, turn, normal);
    trace = normal.solve(v);
  }
  r.sigmas[part] = std::min(std::sqrt(trace / 3), r.most);
  if (!r.falling[part]) return;
  std::copy(whole, whole + 3, v);
  r.sigmas[part] = std::min(whole_sigma, r.most);
}

// Whether a part went further than flow finds it, and another way than a view says.
inline bool is_lost(const SolveRequest &r, const SolveView &view, int64_t part) {
  const double *v = r.velocities + 3 * part, *shift = view.shifts + 2 * part;
  double gone2 = 0, off2 = 0;
  for (int k = 0; k < 2; k++) {
    const double *row = view.jacobian + 6 * part + 3 * k;
    const double gone = (row[0] * v[0] + row[1] * v[1] + row[2] * v[2]) * view.elapsed_s, off = gone - shift[k];
    gone2 += gone * gone, off2 += off * off;
  }
  const double far = std::sqrt(gone2);
  return far > r.far && (std::isinf(view.variances[part]) || std::sqrt(off2) > r.astray * far) && view.shown[part];
}

inline void solve(const SolveRequest &r) {
  for (int64_t part = 0; part < r.parts; part++) solve(r, part);
  for (int view = 0; view < r.views; view++) {
    bool any = false;
    for (int64_t part = 0; part < r.parts && !any; part++) any = is_lost(r, r.seen[view], part);
    r.lost[view] = any;
  }
}

}  // namespace forecast
