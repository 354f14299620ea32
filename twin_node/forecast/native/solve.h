// What all views together say of the velocities of parts.
#pragma once

#include <algorithm>
#include <cmath>

#include "interface.h"

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

inline void take_in(const SolveView &view, int64_t part, const double *v, int turn, Normal &normal) {
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
  const double trust = doubted(view.trusts[part], misfit, turn);
  for (int k = 0; k < 2; k++) normal.add(trust, design[k], shift[k]);
  const double speed = view.receded[part] / view.elapsed_s;
  const double away = v[0] * view.axis[0] + v[1] * view.axis[1] + v[2] * view.axis[2] - speed;
  normal.add(doubted(view.depth_trusts[part], away * away, turn), view.axis, speed);
}

inline void solve(const SolveRequest &r) {
  for (int64_t part = 0; part < r.parts; part++) {
    const double *prior = r.prior + 3 * part, *whole = r.whole + 3 * part, sigma = r.prior_sigmas[part];
    double *v = r.velocities + 3 * part, trace = 0;
    std::copy(prior, prior + 3, v);
    for (int turn = 0; turn < r.turns; turn++) {
      const double own = 1 / (sigma * sigma + squares(v, prior));
      const double seen = doubted(r.whole_trusts[part], squares(v, whole), turn), both = own + seen;
      Normal normal{both, 0, 0, both, 0, both, {}};
      for (int i = 0; i < 3; i++) normal.right[i] = own * prior[i] + seen * whole[i];
      for (int view = 0; view < r.views; view++) take_in(r.seen[view], part, v, turn, normal);
      trace = normal.solve(v);
    }
    r.sigmas[part] = std::min(std::sqrt(trace / 3), r.most);
  }
}

}  // namespace forecast
