// Where every expert leads nodes, and where their mixture does.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "interface.h"

namespace forecast {

// In the order of their weights: those of motion by will without memory, the one that learns, and free fall.
enum Expert : int32_t { kPersistence, kConstantVelocity, kDamped, kConstantAcceleration, kAutoregression, kFreeFall };
constexpr int32_t kExperts = 6;
constexpr double kHigh = 1e3;  // so far above its floor (m) nothing gets within a horizon

// Of coordinates of all nodes: [nodes, 3] laid out flat.
inline void lead_by_expert(const LeadRequest &r, int32_t horizon, double *const *to) {
  const int64_t size = 3 * r.nodes;
  const double time = r.horizon[horizon], travelled = r.travelled[horizon];
  const double *learnt = r.learnt + static_cast<int64_t>(horizon) * r.features;
  for (int64_t i = 0; i < size; i++) {
    to[kPersistence][i] = 0;
    to[kConstantVelocity][i] = time * r.line[i];
    to[kDamped][i] = travelled * r.line[i];
    to[kConstantAcceleration][i] = time * r.parabola[i] + time * time * r.parabola[size + i];
    to[kFreeFall][i] = time * r.falling[i] + time * time / 2 * r.gravity[i % 3];
  }
  for (int64_t i = 0; i < size; i++) {
    const double *seen = r.seen + i * r.features;
    double sum = 0;
    for (int32_t feature = 0; feature < r.features; feature++) sum += learnt[feature] * seen[feature];
    to[kAutoregression][i] = sum;
  }
  for (int64_t node = 0; node < r.nodes; node++) {  // what comes down bounces, once
    const double above = std::min(std::max(r.here[3 * node + 2] - r.floors[node], 0.0), kHigh);
    const double upward = r.falling[3 * node + 2], gravity = r.gravity[2];
    const double impact = std::sqrt(upward * upward - 2 * gravity * above);  // its speed then, m/s
    const double since = time + (upward + impact) / gravity;
    if (since <= 0) continue;
    to[kFreeFall][3 * node + 2] = std::max(r.bounce * impact * since + since * since / 2 * gravity, 0.0) - above;
  }
}

inline void lead(const LeadRequest &r) {
  const int64_t size = 3 * r.nodes;
  for (int32_t horizon = 0; horizon < r.horizons; horizon++) {
    double *to[kExperts];
    for (int32_t expert = 0; expert < kExperts; expert++) {
      to[expert] = r.single + (static_cast<int64_t>(expert) * r.horizons + horizon) * size;
    }
    lead_by_expert(r, horizon, to);
    double *mixed = r.mixed + horizon * size;
    std::fill_n(mixed, size, 0.0);
    for (int32_t expert = 0; expert < kExperts; expert++) {
      const double *weights = r.weights + expert * r.nodes;
      for (int64_t node = 0; node < r.nodes; node++) {
        for (int axis = 0; axis < 3; axis++) mixed[3 * node + axis] += weights[node] * to[expert][3 * node + axis];
      }
    }
  }
}

}  // namespace forecast
