// Where a time lies among the stamps of samples.
#pragma once

#include <algorithm>
#include <cstdint>

namespace forecast {

// A time between two samples: a share of the way from one to the other.
struct Between {
  int64_t before, after;
  double share;

  static Between of(const double *times, int64_t samples, double time) {
    const int64_t last = samples - 1;
    if (last < 1) return {last, last, 0};
    const int64_t after = std::clamp<int64_t>(std::lower_bound(times, times + samples, time) - times, 1, last);
    const double share = (time - times[after - 1]) / (times[after] - times[after - 1]);
    return {after - 1, after, std::clamp(share, 0.0, 1.0)};
  }
};

}  // namespace forecast
