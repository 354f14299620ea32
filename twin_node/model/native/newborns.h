// Births become Gaussians of the store: `adoption.as_newborns` and `Gaussians.spawn` in one go.
#pragma once

#include <algorithm>

#include "../../native/quaternions.h"
#include "interface.h"

#include "../../native/rounded_twice.h"

namespace model {

enum NewbornKind { kCarried, kHomeless, kPassing, kLasting, kNewbornKinds };

inline NewbornKind kind_of(const NewbornRequest &r, int64_t i) {
  if (r.carriers[i] >= 0) return kCarried;
  if (!r.on_background[i]) return kHomeless;
  return r.lasting[i] ? kLasting : kPassing;
}

// Birth `i` in the frame of its node, if it has one, and what it looks like.
inline void describe(const NewbornRequest &r, int64_t i, float *value) {
  double mean[3] = {r.means[3 * i], r.means[3 * i + 1], r.means[3 * i + 2]}, quat[4] = {1, 0, 0, 0};
  if (r.carriers[i] >= 0) {
    const int64_t at = r.views[i] * r.nodes + r.carriers[i];
    for (int k = 0; k < 3; k++) mean[k] -= r.positions[3 * at + k];
    for (int k = 0; k < 4; k++) quat[k] = k == 0 ? r.quats[4 * at] : -r.quats[4 * at + k];
    quaternions::turn(quat, mean);
  }
  for (int k = 0; k < 3; k++) value[k] = static_cast<float>(mean[k]);
  for (int k = 0; k < 4; k++) value[3 + k] = static_cast<float>(quat[k]);
  std::fill_n(value + 7, 3, r.log_radii[i]);
  value[10] = r.logit;
  std::copy_n(r.rgb + 3 * i, 3, value + 11);
}

inline void store_newborns(const NewbornRequest &r) {
  int64_t stored = 0;
  for (int kind = 0; kind < kNewbornKinds; kind++) {
    for (int64_t i = 0; i < r.count && stored < r.room; i++) {
      if (kind_of(r, i) != kind) continue;
      const int64_t row = r.rows[stored];
      describe(r, i, r.values + kColumns * row);
      std::fill_n(r.moment1 + kColumns * row, kColumns, 0.f);
      std::fill_n(r.moment2 + kColumns * row, kColumns, 0.f);
      r.steps[row] = 0;
      r.tiers[row] = kind == kCarried ? r.node_tiers[r.carriers[i]] : kind == kLasting ? r.standing : r.transient;
      r.ids[row] = r.first_id + stored;
      r.carried_by[row] = r.carriers[i];
      r.founded_by[row] = r.founders[i];
      r.rested[row] = -1;
      r.births[row] = r.stamp;
      r.largest[row] = r.log_radii[i] + r.growth;
      r.doubts[row] = 0;
      r.homeless[row] = kind == kHomeless;
      stored++;
    }
  }
}

}  // namespace model

#include "../../native/rounded_as_usual.h"
