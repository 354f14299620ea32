// How likely each colour is ground, and not of a moving thing: `Colours` of `camera_mask`.
#pragma once

#include <algorithm>
#include <utility>
#include <vector>

namespace model {

constexpr int kBins = 4096;           // 16 levels per channel
constexpr double kLeastMoving = 200;  // pixels of moving things before which nothing is told

// The bin of a colour, by its levels per channel.
template <class Level>
int bin_of(const Level &level) {
  int bin = 0;
  for (int k = 0; k < 3; k++) bin = 16 * bin + static_cast<int>(std::min(std::max(level(k), 0.f), 255.f) / 16.f);
  return bin;
}

// How often each colour is what counts, spread over the bins around it.
inline std::vector<double> density(const double *counts) {
  double sum = 0;
  for (int i = 0; i < kBins; i++) sum += counts[i];
  std::vector<double> from(kBins), to(kBins);
  for (int i = 0; i < kBins; i++) from[i] = counts[i] / std::max(sum, 1.);
  for (const int step : {256, 16, 1}) {
    for (int i = 0; i < kBins; i++) {
      const int place = i / step % 16;
      to[i] = (from[place > 0 ? i - step : i] + from[i] + from[place < 15 ? i + step : i]) / 3;
    }
    std::swap(from, to);
  }
  return from;
}

// How likely each colour is ground; `unknown` until moving things have been seen.
inline std::vector<float> ground_shares(const double *ground_counts, const double *moving_counts, float unknown) {
  std::vector<float> share(kBins, unknown);
  double sum = 0;
  for (int i = 0; i < kBins; i++) sum += moving_counts[i];
  if (sum < kLeastMoving) return share;
  const std::vector<double> ground = density(ground_counts), moving = density(moving_counts);
  for (int i = 0; i < kBins; i++) share[i] = static_cast<float>(ground[i] / std::max(ground[i] + moving[i], 1e-9));
  return share;
}

}  // namespace model
