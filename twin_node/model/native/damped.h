// A damped step of Gaussians that stand towards what views miss: `least_squares.Step.take_reference` in one go, to the bit.
#pragma once

#include <algorithm>
#include <cmath>

#include "interface.h"

#include "../../native/rounded_twice.h"

namespace model {

inline float within(float value, float most) { return std::max(std::min(value, most), -most); }

// Where the step takes row `row` of the store, which is number `i` of those that were drawn; whether that is finite.
inline bool step_of(const DampedRequest &r, int64_t i, int64_t row, float *next) {
  const float *value = r.values + kColumns * row, *scale = r.scales + 3 * i;
  const float *colours = r.colours + 4 * i, weight = colours[3];
  const float share = r.shape_share * (1.f / weight), size = (scale[0] + scale[1] + scale[2]) / 3.f;
  for (int k = 0; k < 3; k++) {
    next[k] = value[k] + size * within(share * r.means[3 * i + k] * size, r.longest);
    const float log_scale = value[7 + k] + within(share * r.sizes[3 * i + k] * scale[k], r.longest);
    next[7 + k] = std::max(std::min(log_scale, r.ceilings[row]), r.smallest_log_scale);
    const float colour = value[11 + k] + r.colour_share * colours[k] / weight;
    next[11 + k] = std::max(std::min(colour, 1.f), 0.f);
  }
  for (int k = 0; k < 4; k++) next[3 + k] = value[3 + k] + within(share * r.quats[4 * i + k], r.longest);
  next[10] = value[10] + within(share * r.logits[i] * r.opacities[i], 2 * r.longest);
  return std::all_of(next, next + kColumns, [](float v) { return std::isfinite(v); });
}

inline void take_damped(const DampedRequest &r) {
  *r.refused = 0;
  for (int64_t i = 0; i < r.count; i++) {
    if (!r.learners[i] || !(r.colours[4 * i + 3] > r.fewest)) continue;
    const int64_t row = r.rows[i];
    if (!r.alive[row] || r.tiers[row] != r.standing || r.ids[row] != r.drawn_ids[i]) continue;
    float next[kColumns];
    if (step_of(r, i, row, next)) {
      std::copy_n(next, kColumns, r.values + kColumns * row);
    } else {
      (*r.refused)++;
    }
  }
}

}  // namespace model

#include "../../native/rounded_as_usual.h"
