// How bright an image shows what stood still before, and what it adds to the memory of that.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "interface.h"

#include "../../native/rounded_twice.h"

namespace model {

constexpr float kQuantum = 1.f / 255.f;  // an image's own steps

// Runs work(sample, pixel) over every few pixels, each way, that stand still.
template <class Work>
inline void over_samples(const SampledImage &image, const Work &work) {
  int64_t sample = 0;
  for (int y = 0; y < image.height; y += image.stride) {
    for (int x = 0; x < image.width; x += image.stride, sample++) {
      const int64_t pixel = static_cast<int64_t>(y) * image.width + x;
      if (image.still[pixel] != 0) work(sample, pixel);
    }
  }
}

inline float exposed(const RatioRequest &r, int channel, float colour) {
  return std::min(std::max(colour * r.gains[channel] + r.offsets[channel], 0.f), 1.f);
}

// The middle ratio, per colour, of what is seen to what an exposure makes of the memory, where both tell one.
inline void find_ratios(const RatioRequest &r) {
  std::vector<float> ratios[3];
  r.found[0] = 0;
  over_samples(r.image, [&](int64_t sample, int64_t pixel) {
    r.found[0]++;
    float ratio[3];
    for (int k = 0; k < 3; k++) {
      const float seen = kQuantum * r.image.rgb[3 * pixel + k], shown = exposed(r, k, r.rest[3 * sample + k]);
      if (!(seen < r.brightest && shown > r.darkest)) return;
      ratio[k] = seen / shown;
    }
    for (int k = 0; k < 3; k++) ratios[k].push_back(ratio[k]);
  });
  r.found[1] = static_cast<int64_t>(ratios[0].size());
  for (int k = 0; k < 3; k++) {
    if (ratios[k].empty()) continue;
    const auto middle = ratios[k].begin() + static_cast<int64_t>(ratios[k].size() / 2);
    std::nth_element(ratios[k].begin(), middle, ratios[k].end());
    r.middle[k] = *middle;
  }
}

// Takes in an image that has been levelled: all that stands still, and a share of what has hardly changed.
inline void remember(const RestRequest &r) {
  const uint8_t *still = r.image.still, *end = still + static_cast<int64_t>(r.image.width) * r.image.height;
  while (still != end) {  // a run of pixels that stand still after the other
    const uint8_t *begin = std::find(still, end, 1);
    still = std::find(begin, end, 0);
    const int64_t first = begin - r.image.still;
    std::copy_n(r.image.rgb + 3 * first, 3 * (still - begin), r.newest + 3 * first);
  }
  over_samples(r.image, [&](int64_t sample, int64_t pixel) {
    float change[3], *rest = r.rest + 3 * sample;
    for (int k = 0; k < 3; k++) change[k] = kQuantum * r.image.rgb[3 * pixel + k] - rest[k];
    if (!(std::max({std::fabs(change[0]), std::fabs(change[1]), std::fabs(change[2])}) < r.slack)) return;
    for (int k = 0; k < 3; k++) rest[k] += r.uptake * change[k];
  });
}

}  // namespace model

#include "../../native/rounded_as_usual.h"
