// Who moves with whom: averages over the nodes about each node.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <vector>

#include "interface.h"

namespace forecast {

class Around {
 public:
  explicit Around(const OutlookRequest &request) : r_(request), here_(r_.positions + 3 * (r_.samples - 1) * r_.nodes) {
    weigh_near();
    find_cells();
    weigh_cells();
  }

  // Averages [nodes, columns] of values [nodes, columns] over a limb's width, written to rows that are `stride` apart.
  void near(const double *values, int64_t columns, double *averages) const {
    std::fill_n(averages, r_.nodes * columns, 0.0);
    for (int64_t node = 0; node < r_.nodes; node++) {
      double *to = averages + node * columns;
      for (int64_t k = 0; k < r_.near; k++) {
        const double weight = near_[node * r_.near + k], *from = values + r_.nearest[node * r_.near + k] * columns;
        for (int64_t i = 0; i < columns; i++) to[i] += weight * from[i];
      }
    }
  }

  // The same over a person's reach.
  void body(const double *values, int64_t columns, double *averages) const {
    std::vector<double> means(cells() * columns, 0.0);
    for (int64_t cell = 0; cell < cells(); cell++) {
      double *mean = means.data() + cell * columns;
      for (int64_t i = starts_[cell]; i < starts_[cell + 1]; i++) {
        for (int64_t c = 0; c < columns; c++) mean[c] += values[order_[i] * columns + c];
      }
      for (int64_t c = 0; c < columns; c++) mean[c] /= static_cast<double>(size_of(cell));
    }
    std::fill_n(averages, r_.nodes * columns, 0.0);
    for (int64_t node = 0; node < r_.nodes; node++) {
      double *to = averages + node * columns;
      for (int64_t cell = 0; cell < cells(); cell++) {
        const double weight = body_[node * cells() + cell], *from = means.data() + cell * columns;
        for (int64_t c = 0; c < columns; c++) to[c] += weight * from[c];
      }
    }
  }

 private:
  using Place = std::array<double, 3>;

  int64_t cells() const { return static_cast<int64_t>(starts_.size()) - 1; }
  int64_t size_of(int64_t cell) const { return starts_[cell + 1] - starts_[cell]; }

  // Makes weights of a node that sum up to 1.
  static void normalise(double *weights, int64_t count) {
    const double sum = std::max(std::accumulate(weights, weights + count, 0.0), 1e-300);
    for (int64_t i = 0; i < count; i++) weights[i] /= sum;
  }

  void weigh_near() {
    near_.resize(r_.nodes * r_.near);
    for (size_t i = 0; i < near_.size(); i++) {
      near_[i] = std::exp(r_.distances[i] * r_.distances[i] * (-0.5 / (r_.near_scale * r_.near_scale)));
    }
    for (int64_t node = 0; node < r_.nodes; node++) normalise(near_.data() + node * r_.near, r_.near);
  }

  // Nodes in the order of the cells that they lie in.
  void find_cells() {
    std::vector<Place> places(r_.nodes);
    for (int64_t node = 0; node < r_.nodes; node++) {
      for (int axis = 0; axis < 3; axis++) places[node][axis] = std::floor(here_[3 * node + axis] / r_.cell);
    }
    order_.resize(r_.nodes);
    std::iota(order_.begin(), order_.end(), 0);
    std::stable_sort(order_.begin(), order_.end(), [&](int64_t a, int64_t b) { return places[a] < places[b]; });
    for (int64_t i = 0; i < r_.nodes; i++) {
      if (i == 0 || places[order_[i]] != places[order_[i - 1]]) starts_.push_back(i);
    }
    starts_.push_back(r_.nodes);
  }

  void weigh_cells() {
    std::vector<Place> means(cells(), Place{});
    for (int64_t cell = 0; cell < cells(); cell++) {
      for (int64_t i = starts_[cell]; i < starts_[cell + 1]; i++) {
        for (int axis = 0; axis < 3; axis++) means[cell][axis] += here_[3 * order_[i] + axis];
      }
      for (int axis = 0; axis < 3; axis++) means[cell][axis] /= static_cast<double>(size_of(cell));
    }
    body_.resize(r_.nodes * cells());
    for (int64_t node = 0; node < r_.nodes; node++) {
      double *weights = body_.data() + node * cells();
      for (int64_t cell = 0; cell < cells(); cell++) {
        double squared = 0;
        for (int axis = 0; axis < 3; axis++) {
          const double apart = here_[3 * node + axis] - means[cell][axis];
          squared += apart * apart;
        }
        const double weight = std::exp(squared * (-0.5 / (r_.body_scale * r_.body_scale)));
        weights[cell] = static_cast<double>(size_of(cell)) * weight;
      }
      normalise(weights, cells());
    }
  }

  const OutlookRequest &r_;
  const double *here_;
  std::vector<double> near_, body_;  // [nodes, near], [nodes, cells]
  std::vector<int64_t> order_, starts_;
};

}  // namespace forecast
