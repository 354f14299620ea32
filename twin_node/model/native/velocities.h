// What the flow says about the velocities of bodies: normal equations in 6 parameters, judged and solved.
#pragma once

#include <algorithm>
#include <cmath>

#include "interface.h"

namespace model {

constexpr int kTwist = 6;

inline void add_up(const SumRequest &r) {
  for (int64_t n = 0; n < r.count; n++) {
    double *sum = r.sums + r.width * r.owners[n];
    for (int64_t k = 0; k < r.width; k++) sum[k] += r.values[r.width * n + k];
  }
}

// The equations of one body with the velocity of the point `at` as unknown, not that of the origin: v = v' - at x w.
inline void move_to(const double *H, const double *g, const double *at, double *moved_H, double *moved_g) {
  const double x = -at[0], y = -at[1], z = -at[2];
  double by[kTwist][kTwist] = {}, half[kTwist][kTwist];
  for (int k = 0; k < kTwist; k++) by[k][k] = 1;
  by[0][4] = z, by[0][5] = -y, by[1][5] = x;
  by[1][3] = -z, by[2][3] = y, by[2][4] = -x;
  for (int i = 0; i < kTwist; i++) {
    moved_g[i] = 0;
    for (int j = 0; j < kTwist; j++) {
      moved_g[i] += by[j][i] * g[j];
      half[i][j] = 0;
      for (int k = 0; k < kTwist; k++) half[i][j] += by[k][i] * H[kTwist * k + j];
    }
  }
  for (int i = 0; i < kTwist; i++) {
    for (int j = 0; j < kTwist; j++) {
      double sum = 0;
      for (int k = 0; k < kTwist; k++) sum += half[i][k] * by[k][j];
      moved_H[kTwist * i + j] = sum;
    }
  }
}

// The lower triangle L of a positive definite matrix, A = L L'.
template <int N>
void decompose(const double (&A)[N][N], double (&L)[N][N]) {
  for (int i = 0; i < N; i++) {
    for (int j = 0; j <= i; j++) {
      double sum = A[i][j];
      for (int k = 0; k < j; k++) sum -= L[i][k] * L[j][k];
      L[i][j] = i == j ? std::sqrt(sum) : sum / L[j][j];
    }
  }
}

// The inverse of a lower triangle.
template <int N>
void invert(const double (&L)[N][N], double (&R)[N][N]) {
  for (int j = 0; j < N; j++) {
    for (int i = 0; i < N; i++) {
      double sum = i == j ? 1 : 0;
      for (int k = j; k < i; k++) sum -= L[i][k] * R[k][j];
      R[i][j] = i < j ? 0 : sum / L[i][i];
    }
  }
}

// How well one body explains what was said of it; see `velocity_equations.Judged`.
struct Judgement {
  double evidence, at_rest, fit, cost, told;
};

// Judges a body by its equations in the velocity of its middle, which is expected to be of `scale` (1 sigma).
inline Judgement judge_body(const double *H, const double *g, double squares, const double *scale) {
  double known[kTwist][kTwist], L[kTwist][kTwist], R[kTwist][kTwist];
  for (int i = 0; i < kTwist; i++) {
    for (int j = 0; j < kTwist; j++) known[i][j] = (i == j) + scale[i] * H[kTwist * i + j] * scale[j];
  }
  decompose(known, L);
  invert(L, R);
  double explained = 0, untold = 0, cost = 0;
  for (int i = 0; i < kTwist; i++) {
    double along = 0;
    for (int j = 0; j <= i; j++) {
      along += R[i][j] * scale[j] * g[j];
      untold += R[i][j] * R[i][j];
    }
    explained += along * along;
    cost += std::log(R[i][i]);
  }
  const double at_rest = -squares / 2, fit = at_rest + explained / 2;
  return {fit + cost, at_rest, fit, squares - explained, kTwist - untold};
}

// The most likely velocity of a body by its equations, where one of `scale` (1 sigma) is expected.
inline void solve_body(const double *H, const double *g, const double *scale, double *velocity) {
  double known[kTwist][kTwist], L[kTwist][kTwist];
  for (int i = 0; i < kTwist; i++) {
    for (int j = 0; j < kTwist; j++) known[i][j] = H[kTwist * i + j];
    known[i][i] += 1 / (scale[i] * scale[i]);
  }
  decompose(known, L);
  for (int i = 0; i < kTwist; i++) {
    double sum = g[i];
    for (int k = 0; k < i; k++) sum -= L[i][k] * velocity[k];
    velocity[i] = sum / L[i][i];
  }
  for (int i = kTwist - 1; i >= 0; i--) {
    double sum = velocity[i];
    for (int k = i + 1; k < kTwist; k++) sum -= L[k][i] * velocity[k];
    velocity[i] = sum / L[i][i];
  }
}

inline void judge_velocities(const JudgeRequest &r) {
  for (int64_t n = 0; n < r.count; n++) {
    double H[kTwist * kTwist], g[kTwist];
    move_to(r.H + kTwist * kTwist * n, r.g + kTwist * n, r.points + 3 * n, H, g);
    const Judgement judged = judge_body(H, g, r.squares[n], r.scale);
    r.evidence[n] = judged.evidence, r.at_rest[n] = judged.at_rest, r.fit[n] = judged.fit;
    r.costs[n] = judged.cost, r.told[n] = judged.told;
  }
}

inline void solve_velocities(const VelocityRequest &r) {
  for (int64_t n = 0; n < r.count; n++) {
    double H[kTwist * kTwist], g[kTwist];
    move_to(r.H + kTwist * kTwist * n, r.g + kTwist * n, r.points + 3 * n, H, g);
    solve_body(H, g, r.scale, r.velocities + kTwist * n);
  }
}

inline void move_velocities(const MoveRequest &r) {
  for (int64_t n = 0; n < r.count; n++) {
    const int64_t matrix = kTwist * kTwist * n;
    move_to(r.H + matrix, r.g + kTwist * n, r.points + 3 * n, r.moved_H + matrix, r.moved_g + kTwist * n);
  }
}

}  // namespace model
