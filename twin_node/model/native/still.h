// What one camera sees where nothing moves: `rest.look_reference` in one go.
#pragma once

#include <algorithm>
#include <cmath>

#include "interface.h"

#include "../../native/rounded_twice.h"

namespace model {

constexpr int64_t kStillPerTask = 16384;

inline float largest_of(const float *a, const float *b) {
  const float r = std::fabs(a[0] - b[0]), g = std::fabs(a[1] - b[1]), larger = r > g ? r : g;
  const float other = std::fabs(a[2] - b[2]);
  return larger > other ? larger : other;
}

// Pixels [first, first + kStillPerTask).
inline void look_at_still(const StillRequest &r, int64_t first) {
  for (int64_t at = first; at < std::min(r.pixels, first + kStillPerTask); at++) {
    const float *seen = r.image + 3 * at;
    float *rgb = r.rgb + 3 * at;
    const bool hidden = r.usable[at] == 0 || r.near_moving[at] != 0;
    const bool calm = !hidden && largest_of(seen, rgb) < r.threshold;
    const float share = calm ? r.uptake : 1.f;
    for (int k = 0; k < 3; k++) rgb[k] += share * (seen[k] - rgb[k]);
    if (r.measured != nullptr && calm && r.measured[at] > 0) r.depth[at] = r.measured[at];
    r.calm_for_s[at] = calm ? r.calm_for_s[at] + r.since_s : 0.f;
    r.hidden[at] = hidden;
    r.stirred[at] = !hidden && !calm;
    r.counted[at] = r.calm_for_s[at] > r.calm_s;
    r.difference[at] = largest_of(rgb, r.background + 3 * at);
  }
}

}  // namespace model

#include "../../native/rounded_as_usual.h"
