// What experts go by, how they are weighed, where they lead, and what that tells of their errors.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "around.h"
#include "interface.h"
#include "lead.h"
#include "paths.h"

namespace forecast {

class Outlook {
 public:
  explicit Outlook(const OutlookRequest &request) : r_(request), around_(request), weights_(kExperts * r_.nodes) {}

  void find() {
    const Paths paths(r_);
    paths.fit();
    paths.find_steps();
    find_features();
    share_out();
    weigh();
    const double *here = r_.positions + 3 * (r_.samples - 1) * r_.nodes;
    lead(
        {r_.nodes, r_.horizons, r_.seen, r_.bounce, here, r_.line, r_.parabola, r_.falling, r_.floors, r_.features,
         r_.learnt, weights_.data(), r_.horizon, r_.travelled, r_.gravity, r_.single, r_.mixed});
    find_cues();
  }

 private:
  // Averages of the steps, behind them.
  void find_features() const {
    const int64_t columns = 3 * r_.steps;
    std::vector<double> own(r_.nodes * columns), near(own.size()), body(own.size());
    for (int64_t i = 0; i < 3 * r_.nodes; i++) {
      std::copy_n(r_.features + i * r_.seen, r_.steps, own.data() + i * r_.steps);
    }
    around_.near(own.data(), columns, near.data());
    around_.body(own.data(), columns, body.data());
    for (int64_t i = 0; i < 3 * r_.nodes; i++) {
      std::copy_n(near.data() + i * r_.steps, r_.steps, r_.features + i * r_.seen + r_.steps);
      std::copy_n(body.data() + i * r_.steps, r_.steps, r_.features + i * r_.seen + 2 * r_.steps);
    }
  }

  // Weights of the experts by their records, and by those around.
  void share_out() const {
    std::vector<double> squared(kExperts * r_.nodes), pooled(squared.size());
    for (int64_t node = 0; node < r_.nodes; node++) {
      for (int expert = 0; expert < kExperts; expert++) {
        squared[node * kExperts + expert] = r_.squared[expert * r_.nodes + node];
      }
    }
    around_.body(squared.data(), kExperts, pooled.data());
    for (int64_t node = 0; node < r_.nodes; node++) {
      std::array<double, kExperts> own;
      for (int expert = 0; expert < kExperts; expert++) {
        const int64_t i = node * kExperts + expert;
        own[expert] = (1 - r_.pooled) * squared[i] + r_.pooled * pooled[i];
      }
      const double best = *std::min_element(own.begin(), own.end());
      const double scale = r_.sharpness * best + r_.indifference * r_.indifference;
      double sum = 0;
      for (double &one : own) one = std::exp(-(one - best) / scale), sum += one;
      for (int expert = 0; expert < kExperts; expert++) r_.shares[expert * r_.nodes + node] = own[expert] / sum;
    }
  }

  // The same by how far each expert is trusted; one alone where a node is led by one.
  void weigh() {
    for (int64_t node = 0; node < r_.nodes; node++) {
      double sum = 0;
      for (int expert = 0; expert < kExperts; expert++) sum += r_.shares[expert * r_.nodes + node] * r_.trust[expert];
      for (int expert = 0; expert < kExperts; expert++) {
        const int64_t i = expert * r_.nodes + node;
        weights_[i] = r_.alone[node] < 0 ? r_.shares[i] * r_.trust[expert] / sum : expert == r_.alone[node];
      }
    }
  }

  // At the last horizon.
  double distance(int expert, const double *from, int64_t node) const {
    const double *place = place_of(expert, node);
    return std::sqrt(
        (place[0] - from[0]) * (place[0] - from[0]) + (place[1] - from[1]) * (place[1] - from[1]) +
        (place[2] - from[2]) * (place[2] - from[2]));
  }
  const double *place_of(int expert, int64_t node) const {
    return r_.single + 3 * ((expert * r_.horizons + r_.horizons - 1) * r_.nodes + node);
  }

  void find_cues() const {
    static constexpr double kHere[3] = {0, 0, 0};
    std::vector<double> squares(3 * r_.nodes), bodies(3 * r_.nodes);
    for (int64_t node = 0; node < r_.nodes; node++) {
      const double *mixed = r_.mixed + 3 * ((r_.horizons - 1) * r_.nodes + node);
      const double way = distance(kConstantVelocity, kHere, node);
      const double acceleration = distance(kConstantAcceleration, place_of(kConstantVelocity, node), node);
      const double lengths[3] = {way, acceleration, r_.errors[node]};
      for (int i = 0; i < 3; i++) squares[3 * node + i] = lengths[i] * lengths[i];
      double *cues = r_.cues + kCues * node;
      cues[0] = 1, cues[1] = log_of(spread(mixed, node)), cues[2] = log_of(way), cues[3] = log_of(acceleration);
    }
    around_.body(squares.data(), 3, bodies.data());
    for (int64_t node = 0; node < r_.nodes; node++) {
      for (int i = 0; i < 3; i++) r_.cues[kCues * node + 4 + i] = log_of(std::sqrt(bodies[3 * node + i]));
    }
  }

  // Median distance of the experts of motion by will from their mixture.
  double spread(const double *mixed, int64_t node) const {
    std::array<double, kFreeFall> far;
    for (int expert = 0; expert < kFreeFall; expert++) {
      const double own = distance(expert, mixed, node);
      int place = expert;
      for (; place > 0 && far[place - 1] > own; place--) far[place] = far[place - 1];
      far[place] = own;
    }
    return far[kFreeFall / 2];
  }

  double log_of(double length) const { return std::log(length + r_.least); }

  static constexpr int kCues = 7;
  const OutlookRequest &r_;
  const Around around_;
  std::vector<double> weights_;  // [experts, nodes]
};

}  // namespace forecast
