// What of few things is nearest to each of few others, and which are near each other: no tree pays for itself.
#pragma once

#include <algorithm>
#include <limits>

#include "interface.h"

namespace model {

constexpr int kThingsAtOnce = 256;  // whose distances stay in the nearest cache
constexpr int kLanes = 8;           // that are compared at once

// The least of `count` values, a multiple of the lanes.
inline double least_of(const double *values, int count) {
  double least[kLanes];
  std::copy_n(values, kLanes, least);
  for (int first = kLanes; first < count; first += kLanes) {
    for (int k = 0; k < kLanes; k++) least[k] = values[first + k] < least[k] ? values[first + k] : least[k];
  }
  return *std::min_element(least, least + kLanes);
}

// The row of `own` nearest to each place and nearer than 1; -1 without one. Of equally near ones the first.
inline void nearest(const NearestRequest &r) {
  for (int64_t i = 0; i < r.places; i++) {
    const double *place = r.at + i * r.width;
    double least = 1;
    r.found[i] = -1;
    for (int64_t first = 0; first < r.owns; first += kThingsAtOnce) {
      const int count = static_cast<int>(std::min<int64_t>(kThingsAtOnce, r.owns - first));
      double apart[kThingsAtOnce];
      std::fill_n(apart, count, 0.);
      std::fill(apart + count, apart + kThingsAtOnce, std::numeric_limits<double>::infinity());
      for (int64_t k = 0; k < r.width; k++) {
        const double *own = r.own + k * r.owns + first;
        for (int j = 0; j < count; j++) apart[j] += (place[k] - own[j]) * (place[k] - own[j]);
      }
      const double nearest = least_of(apart, kThingsAtOnce);
      if (!(nearest < least)) continue;
      least = nearest;
      r.found[i] = first + (std::find(apart, apart + count, nearest) - apart);
    }
  }
}

// Deals places out to groups.
inline void group(const GroupRequest &r) {
  std::fill_n(r.groups, r.places, -1);
  int64_t groups = 0;
  for (int64_t i = 0; i < r.places; i++) {
    if (r.groups[i] >= 0) continue;
    for (int64_t j = i; j < r.places; j++) {
      double apart = 0;
      for (int64_t k = 0; k < r.width; k++) {
        const double along = r.at[j * r.width + k] - r.at[i * r.width + k];
        apart += along * along;
      }
      if (r.groups[j] < 0 && apart < 1) r.groups[j] = groups;
    }
    groups++;
  }
}

}  // namespace model
