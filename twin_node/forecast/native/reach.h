// How far nodes may be from where they are led; rounded as NumPy does.
#pragma once

#include <cstdint>

#include "interface.h"
#include "rounded.h"

namespace forecast {

// The lesser and the greater, as NumPy has them: no number where either is none.
inline double least_of(double one, double other) { return one < other || one != one ? one : other; }
inline double most_of(double one, double other) { return one > other || one != one ? one : other; }

// At the last horizon, but for what may start.
FORECAST_ROUNDED inline double farthest(const ReachRequest &r, int64_t i) {
  FORECAST_ROUNDED_BODY
  const double age = r.now - r.began[i], calibrated = r.multiplier * r.scales[i];
  double radius = calibrated;
  if (!(age >= r.last)) radius = most_of(calibrated, r.reachable + r.spread[i]);
  radius = least_of(radius, r.largest);
  if (r.now - r.turned[i] < r.wary_s) radius = most_of(radius, r.reachable);
  if (r.sigmas != nullptr && ((r.now - r.born[i] < r.horizon_s && age < r.horizon_s) || r.falling[i])) {
    const double astray = least_of(r.newcomer_sigmas * r.sigmas[i], r.person_speed) * r.last;
    radius = !r.flying[i] && r.speeds[i] > r.person_speed ? most_of(r.fallen, r.reachable) : r.reachable;
    radius += r.sigmas[i] < r.blind ? least_of(astray, r.spread[i]) : astray;
  }
  return least_of(radius, r.largest);
}

FORECAST_ROUNDED inline void reach(const ReachRequest &r) {
  FORECAST_ROUNDED_BODY
  for (int64_t i = 0; i < r.nodes; i++) {
    const double radius = farthest(r, i);
    for (int32_t h = 0; h < r.horizons; h++) {
      double &within = r.radii[h * r.nodes + i];
      within = r.shares[h] * radius;
      if (r.sigmas == nullptr) continue;
      if (r.flying[i]) within = most_of(r.shares[h], r.roots[h]) * radius;
      if (r.horizon[h] < r.clear[i]) {
        const double astray = least_of(r.newcomer_sigmas * r.sigmas[i], r.person_speed) * r.horizon[h];
        within = least_of(within, r.place + astray + r.reached[h]);
      }
      if (r.capped && !r.flying[i] && !(r.sigmas[i] >= r.blind)) {
        const double rate = least_of(r.astray_at_rest + r.astray_rise * r.speeds[i], r.astray) +
                            r.astray_fast * most_of(r.speeds[i] - r.fast, 0);
        within = least_of(within, rate * r.power[h] + r.most_sigmas * r.sigmas[i] * r.horizon[h]);
      }
      within = most_of(within, least_of(r.alone[i] ? 0 : r.start[h], r.largest));
    }
  }
}

}  // namespace forecast
