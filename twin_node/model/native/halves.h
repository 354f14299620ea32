// The best way to see a node as two bodies: `parts.halves_reference` in one go.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <vector>

#include "velocities.h"

namespace model {

constexpr int kAxes = 3;
constexpr int kSweeps = 12;  // of Jacobi's method, each of which squares what is off the diagonal

// What was said of one of two parts, as of one body.
struct Part {
  double H[kTwist * kTwist] = {}, g[kTwist] = {}, squares = 0, count = 0;
};

// The axes of a symmetric matrix as rows of `axes`, the longest first; of each the largest component is positive.
inline void find_axes(double (&A)[kAxes][kAxes], double (&axes)[kAxes][kAxes]) {
  double V[kAxes][kAxes] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  for (int sweep = 0; sweep < kSweeps; sweep++) {
    for (int p = 0; p < kAxes; p++) {
      for (int q = p + 1; q < kAxes; q++) {
        if (A[p][q] == 0) continue;
        const double half = (A[q][q] - A[p][p]) / (2 * A[p][q]);
        const double t = std::copysign(1 / (std::abs(half) + std::sqrt(half * half + 1)), half);
        const double c = 1 / std::sqrt(t * t + 1), s = t * c;
        for (int k = 0; k < kAxes; k++) {
          const double kp = A[k][p], kq = A[k][q];
          A[k][p] = c * kp - s * kq, A[k][q] = s * kp + c * kq;
        }
        for (int k = 0; k < kAxes; k++) {
          const double pk = A[p][k], qk = A[q][k], vp = V[k][p], vq = V[k][q];
          A[p][k] = c * pk - s * qk, A[q][k] = s * pk + c * qk;
          V[k][p] = c * vp - s * vq, V[k][q] = s * vp + c * vq;
        }
      }
    }
  }
  int order[kAxes] = {0, 1, 2};
  std::stable_sort(order, order + kAxes, [&](int a, int b) { return A[a][a] > A[b][b]; });
  for (int i = 0; i < kAxes; i++) {
    int largest = 0;
    for (int k = 1; k < kAxes; k++) {
      if (std::abs(V[k][order[i]]) > std::abs(V[largest][order[i]])) largest = k;
    }
    for (int k = 0; k < kAxes; k++) axes[i][k] = std::copysign(1., V[largest][order[i]]) * V[k][order[i]];
  }
}

// Finds the two bodies that explain best what was said of a node's cells; all that it remembers is of one call.
class Halves {
 public:
  explicit Halves(const HalvesRequest &request) : r_(request), n_(static_cast<int>(request.count)) {}

  void find() {
    *r_.found = 0;
    const double weight = std::accumulate(r_.counts, r_.counts + n_, 0.);
    if (n_ < 2 || weight < 2 * r_.least) return;
    move_to_middle(weight);
    deal();
    for (int round = 0; round < r_.rounds; round++) {
      for (auto &second : tries_) deal_again(second);
    }
    if (r_.suspected) tries_.emplace_back(r_.suspected, r_.suspected + n_);
    choose();
  }

 private:
  // From here on all equations are about the middle of what was seen, and all centres beside it.
  void move_to_middle(double weight) {
    double middle[3] = {};
    for (int i = 0; i < n_; i++) {
      for (int k = 0; k < 3; k++) middle[k] += r_.counts[i] * r_.centres[3 * i + k] / weight;
    }
    H_.resize(kTwist * kTwist * n_), g_.resize(kTwist * n_), arms_.resize(3 * n_);
    for (int i = 0; i < n_; i++) {
      move_to(r_.H + kTwist * kTwist * i, r_.g + kTwist * i, middle, &H_[kTwist * kTwist * i], &g_[kTwist * i]);
      for (int k = 0; k < 3; k++) arms_[3 * i + k] = r_.centres[3 * i + k] - middle[k];
    }
  }

  // First guesses: either side of the middle along each axis of the body, and along its cells' motions.
  void deal() {
    double A[kAxes][kAxes] = {}, axes[kAxes][kAxes];
    for (int i = 0; i < n_; i++) add_product(&arms_[3 * i], r_.counts[i], A);
    find_axes(A, axes);
    for (const auto &axis : axes) deal_along(arms_, axis);
    const std::vector<double> pulls = find_pulls();
    double P[kAxes][kAxes] = {};
    for (int i = 0; i < n_; i++) add_product(&pulls[3 * i], 1, P);
    find_axes(P, axes);
    deal_along(pulls, axes[0]);
  }

  static void add_product(const double *v, double weight, double (&A)[kAxes][kAxes]) {
    for (int p = 0; p < kAxes; p++) {
      for (int q = 0; q < kAxes; q++) A[p][q] += weight * v[p] * v[q];
    }
  }

  // Where each cell pulls when all move as one.
  std::vector<double> find_pulls() const {
    Part whole;
    for (int i = 0; i < n_; i++) add(i, whole);
    double velocity[kTwist];
    solve_body(whole.H, whole.g, r_.loose, velocity);
    std::vector<double> pulls(3 * n_);
    for (int i = 0; i < n_; i++) {
      const double *H = &H_[kTwist * kTwist * i];
      const double known = std::sqrt(std::max(H[0] + H[kTwist + 1] + H[2 * kTwist + 2], 1e-12));
      for (int k = 0; k < 3; k++) {
        double rest = g_[kTwist * i + k];
        for (int j = 0; j < kTwist; j++) rest -= H[kTwist * k + j] * velocity[j];
        pulls[3 * i + k] = rest / known;
      }
    }
    return pulls;
  }

  void deal_along(const std::vector<double> &places, const double (&axis)[kAxes]) {
    std::vector<double> along(n_);
    for (int i = 0; i < n_; i++) {
      along[i] = places[3 * i] * axis[0] + places[3 * i + 1] * axis[1] + places[3 * i + 2] * axis[2];
    }
    const double middle = median(along);
    auto &second = tries_.emplace_back(n_);
    for (int i = 0; i < n_; i++) second[i] = along[i] > middle;
  }

  // Weighted by how much was said of each cell.
  double median(const std::vector<double> &values) const {
    std::vector<int> order(n_);
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return values[a] < values[b]; });
    double whole = 0, reached = 0;
    for (const int i : order) whole += r_.counts[i];
    for (const int i : order) {
      reached += r_.counts[i];
      if (reached >= whole / 2) return values[i];
    }
    return values[order.back()];
  }

  void add(int i, Part &part) const {
    for (int k = 0; k < kTwist * kTwist; k++) part.H[k] += H_[kTwist * kTwist * i + k];
    for (int k = 0; k < kTwist; k++) part.g[k] += g_[kTwist * i + k];
    part.squares += r_.squares[i], part.count += r_.counts[i];
  }

  // What was said of the first part and of the second.
  void add_up_parts(const std::vector<uint8_t> &second, Part (&parts)[2]) const {
    for (int i = 0; i < n_; i++) add(i, parts[second[i] != 0]);
  }

  // Each cell to the part whose velocity leaves the smaller error (Lloyd's algorithm).
  void deal_again(std::vector<uint8_t> &second) const {
    Part parts[2];
    add_up_parts(second, parts);
    double velocities[2][kTwist];
    for (int part = 0; part < 2; part++) solve_body(parts[part].H, parts[part].g, r_.loose, velocities[part]);
    for (int i = 0; i < n_; i++) second[i] = error_of(i, velocities[1]) < error_of(i, velocities[0]);
  }

  // Squared error of a cell that moves so, less that of one that does not.
  double error_of(int i, const double *velocity) const {
    const double *H = &H_[kTwist * kTwist * i], *g = &g_[kTwist * i];
    double error = 0;
    for (int p = 0; p < kTwist; p++) {
      double along = -2 * g[p];
      for (int q = 0; q < kTwist; q++) along += H[kTwist * p + q] * velocity[q];
      error += velocity[p] * along;
    }
    return error;
  }

  void choose() {
    double most = -std::numeric_limits<double>::infinity(), last = most;
    int best = -1;
    bool first_is_smaller = false;
    for (size_t t = 0; t < tries_.size(); t++) {
      Part parts[2];
      add_up_parts(tries_[t], parts);
      last = -std::numeric_limits<double>::infinity();
      if (!(parts[0].count > r_.least && parts[1].count > r_.least && lie_apart(tries_[t]))) continue;
      last = evidence_of(parts[0]) + evidence_of(parts[1]);
      if (last > most) most = last, best = static_cast<int>(t), first_is_smaller = parts[0].count < parts[1].count;
    }
    if (best < 0 || (r_.suspected && !(most - last > r_.better))) return;
    *r_.found = 1;
    for (int i = 0; i < n_; i++) r_.second[i] = (tries_[best][i] != 0) != first_is_smaller;
  }

  double evidence_of(Part part) const {
    for (double &entry : part.H) entry /= r_.misfit;
    for (double &entry : part.g) entry /= r_.misfit;
    const Judgement judged = judge_body(part.H, part.g, part.squares / r_.misfit, r_.expected);
    return std::max(judged.evidence, judged.at_rest - r_.rarely);
  }

  // Whether either part is in one place: a cell's neighbours are mostly of its own.
  bool lie_apart(const std::vector<uint8_t> &second) {
    const int beside = std::min(static_cast<int>(r_.beside), n_ / 4);
    if (beside == 0) return true;
    if (neighbours_.empty()) find_neighbours(beside);
    int64_t others = 0, seconds = 0;
    for (int i = 0; i < n_; i++) {
      seconds += second[i] != 0;
      for (int k = 0; k < beside; k++) others += (second[neighbours_[beside * i + k]] != 0) != (second[i] != 0);
    }
    const double share = static_cast<double>(seconds) / n_;
    return static_cast<double>(others) / (static_cast<double>(n_) * beside) <= r_.mixed * 2 * share * (1 - share);
  }

  // The nearest of each cell, which are too few for a tree to pay for itself.
  void find_neighbours(int beside) {
    neighbours_.resize(static_cast<size_t>(beside) * n_);
    std::vector<double> apart(n_), nearest(beside), x(n_), y(n_), z(n_);
    for (int i = 0; i < n_; i++) x[i] = arms_[3 * i], y[i] = arms_[3 * i + 1], z[i] = arms_[3 * i + 2];
    for (int i = 0; i < n_; i++) {
      for (int j = 0; j < n_; j++) {
        apart[j] = (x[j] - x[i]) * (x[j] - x[i]) + (y[j] - y[i]) * (y[j] - y[i]) + (z[j] - z[i]) * (z[j] - z[i]);
      }
      apart[i] = std::numeric_limits<double>::infinity();
      std::fill(nearest.begin(), nearest.end(), apart[i]);
      int *own = &neighbours_[static_cast<size_t>(beside) * i];
      for (int j = 0; j < n_; j++) {
        if (!(apart[j] < nearest[beside - 1])) continue;
        int k = beside - 1;
        for (; k > 0 && apart[j] < nearest[k - 1]; k--) nearest[k] = nearest[k - 1], own[k] = own[k - 1];
        nearest[k] = apart[j], own[k] = j;
      }
    }
  }

  const HalvesRequest &r_;
  const int n_;
  std::vector<double> H_, g_, arms_;
  std::vector<std::vector<uint8_t>> tries_;
  std::vector<int> neighbours_;
};

}  // namespace model
