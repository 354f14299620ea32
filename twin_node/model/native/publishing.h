// Gaussians as other rooms read them, and how far the nodes reach that carry them.
#pragma once

#include <algorithm>
#include <cmath>

#include "../../native/quaternions.h"
#include "interface.h"

namespace model {

// The velocity of a point that a node carries, m/s.
inline void velocity_at(const NodesNow &nodes, int64_t node, const float *point, float *out) {
  const double *position = nodes.positions + 3 * node, *turning = nodes.turns + 3 * node;
  double arm[3];
  for (int k = 0; k < 3; k++) arm[k] = point[k] - position[k];
  for (int i = 0; i < 3; i++) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    out[i] = static_cast<float>(nodes.velocities[3 * node + i] + (turning[j] * arm[k] - turning[k] * arm[j]));
  }
}

constexpr int64_t kPublishedPerTask = 1024;

// Those from number `first` on, as many as a task takes.
inline void publish(const PublishRequest &r, int64_t first) {
  for (int64_t i = first; i < std::min(r.count, first + kPublishedPerTask); i++) {
    const int64_t row = r.rows[i], node = r.carriers[row];
    const float *value = r.values + kColumns * row;
    double mean[3], quat[4], own[4];
    std::copy_n(value, 3, mean);
    std::copy_n(value + 3, 4, quat);
    if (node >= 0) {
      quaternions::turn(r.nodes.quats + 4 * node, mean);
      for (int k = 0; k < 3; k++) mean[k] += r.nodes.positions[3 * node + k];
      std::copy_n(quat, 4, own);
      quaternions::multiply(r.nodes.quats + 4 * node, own, quat);
    }
    for (int k = 0; k < 3; k++) {
      r.means[3 * i + k] = static_cast<float>(mean[k]);
      r.scales[3 * i + k] = std::exp(value[7 + k]);
      r.rgb[3 * i + k] = std::min(std::max(value[11 + k], 0.f), 1.f);
      r.velocities[3 * i + k] = 0;
    }
    double square = 0;
    for (int k = 0; k < 4; k++) square += quat[k] * quat[k];
    const double length = std::max(std::sqrt(square), 1e-12);  // the fit leaves them of any
    for (int k = 0; k < 4; k++) r.quats[4 * i + k] = static_cast<float>(quat[k] / length);
    if (node >= 0) velocity_at(r.nodes, node, r.means + 3 * i, r.velocities + 3 * i);
    r.opacities[i] = 1.f / (1.f + std::exp(-value[10]));
    r.tiers[i] = r.tier_of[row];
    r.ids[i] = static_cast<uint32_t>(r.id_of[row]);
    r.published[i] = node < 0 ? -1 : static_cast<int32_t>(r.position_of[node]);
  }
}

// Whether what is seen of number `i` of one cloud and of number `j` of an older one differs.
inline bool looks_otherwise(const ChangeRequest &r, int64_t i, int64_t j) {
  const float *size = r.then.scales + 3 * j;
  const float farthest = r.size * std::max(std::max(size[0], size[1]), size[2]);
  for (int k = 0; k < 3; k++) {
    if (std::abs(r.now.scales[3 * i + k] - size[k]) > r.size * size[k]) return true;
    if (std::abs(r.now.means[3 * i + k] - r.then.means[3 * j + k]) > farthest) return true;
    if (std::abs(r.now.rgb[3 * i + k] - r.then.rgb[3 * j + k]) > r.colour) return true;
  }
  return std::abs(r.now.opacities[i] - r.then.opacities[j]) > r.opacity;
}

// What stands and is new or looks otherwise, and what has stood and is gone. Most ids come in the order of the older cloud.
inline void find_changes(const ChangeRequest &r) {
  const uint32_t *ids = r.then.ids, *end = ids + r.then.count, *next = ids;
  for (int64_t j = 0; j < r.then.count; j++) r.gone[j] = r.then.tiers[j] == r.standing;
  for (int64_t i = 0; i < r.now.count; i++) {
    if (next == end || *next != r.now.ids[i]) next = std::lower_bound(ids, end, r.now.ids[i]);
    const bool is_known = next != end && *next == r.now.ids[i];
    const int64_t j = next - ids;
    r.changed[i] = r.now.tiers[i] == r.standing &&
                   !(is_known && r.then.tiers[j] == r.standing && !looks_otherwise(r, i, j));
    if (is_known) r.gone[j] = 0, next++;
  }
}

// Of every node, in its own frame: the centroid of what it carries, by opacity, and how far from there that lies.
inline void find_extents(const ExtentRequest &r) {
  std::fill_n(r.centroids, 3 * r.nodes, 0.);
  std::fill_n(r.radii, r.nodes, 0.);
  std::fill_n(r.weights, r.nodes, 0.);
  for (int64_t i = 0; i < r.count; i++) {
    const int64_t node = r.carriers[r.rows[i]];
    if (node < 0) continue;
    const float *value = r.values + kColumns * r.rows[i];
    const double weight = 1 / (1 + std::exp(-static_cast<double>(value[10])));
    r.weights[node] += weight;
    for (int k = 0; k < 3; k++) r.centroids[3 * node + k] += weight * value[k];
  }
  for (int64_t node = 0; node < r.nodes; node++) {
    for (int k = 0; k < 3; k++) r.centroids[3 * node + k] /= std::max(r.weights[node], 1e-9);
  }
  for (int64_t i = 0; i < r.count; i++) {
    const int64_t node = r.carriers[r.rows[i]];
    if (node < 0) continue;
    const float *value = r.values + kColumns * r.rows[i];
    double square = 0;
    for (int k = 0; k < 3; k++) {
      const double apart = value[k] - r.centroids[3 * node + k];
      square += apart * apart;
    }
    r.radii[node] = std::max(r.radii[node], std::sqrt(square));
  }
}

}  // namespace model
