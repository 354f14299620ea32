// What an image shows beside what the background alone would show.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "interface.h"

namespace model {

constexpr int64_t kAtOnce = 512;  // pixels whose differences stay in the nearest cache

// `count` pixels from `first` on: their colours, and the largest difference of a channel of each.
inline void take_colours(const ObservedView &v, int64_t first, int64_t count, float *__restrict difference) {
  const uint8_t *__restrict image = v.image + 3 * first;
  const float *__restrict background = v.background + 3 * first;
  float *__restrict rgb = v.rgb + 3 * first;
  float apart[3 * kAtOnce];
  for (int64_t j = 0; j < 3 * count; j++) {
    rgb[j] = static_cast<float>(image[j]) / 255.f;
    apart[j] = std::fabs(rgb[j] - background[j]);
  }
  for (int64_t i = 0; i < count; i++) {
    const float larger = apart[3 * i] > apart[3 * i + 1] ? apart[3 * i] : apart[3 * i + 1];
    difference[i] = larger > apart[3 * i + 2] ? larger : apart[3 * i + 2];
  }
}

// Pixels [first, end) beside the background.
inline void compare_pixels(const ObserveRules &rules, const ObservedView &v, int64_t first, int64_t end) {
  for (; first < end; first += kAtOnce) {
    const int64_t count = std::min(kAtOnce, end - first);
    float difference[kAtOnce], known[kAtOnce], before_s[kAtOnce];
    take_colours(v, first, count, difference);
    const uint8_t *__restrict usable = v.usable + first, *__restrict near_moving = v.near_moving + first;
    for (int64_t i = 0; i < count; i++) known[i] = rules.is_first && usable[i] != 0 ? difference[i] : 0;
    if (v.known != nullptr) std::copy_n(v.known + first, count, known);
    std::fill_n(before_s, count, 0.f);
    if (v.before_s != nullptr) std::copy_n(v.before_s + first, count, before_s);
    float *__restrict misfit = v.misfit + first, *__restrict surprise = v.surprise + first;
    float *__restrict wrong_s = v.wrong_s + first;
    uint8_t *__restrict stale = v.stale + first, *__restrict active = v.active + first;
    for (int64_t i = 0; i < count; i++) {
      misfit[i] = std::min(known[i], difference[i] + rules.growth);
      surprise[i] = usable[i] != 0 ? std::max(difference[i] - misfit[i], 0.f) : 0.f;
    }
#pragma omp simd
    for (int64_t i = 0; i < count; i++) {
      const bool wrong = surprise[i] > rules.threshold, moves = near_moving[i] != 0;
      wrong_s[i] = (wrong & !moves) ? before_s[i] + rules.elapsed_s : 0.f;
      stale[i] = wrong_s[i] > rules.stale_s;
      active[i] = (moves | wrong) & (usable[i] != 0);
    }
  }
}

// The smallest depth measured in the 3 x 3 pixels around those of rows [first, end); 0 where there is none.
inline void find_nearest_depth(const ObservedView &v, int first, int end) {
  constexpr float kNone = std::numeric_limits<float>::infinity();
  const int64_t width = v.width;
  std::vector<float> lowest(width + 2, kNone);
  for (int row = first; row < end; row++) {
    float *__restrict low = lowest.data() + 1, *__restrict nearest = v.nearest + row * width;
    std::fill_n(low, width, kNone);
    for (int y = std::max(row - 1, 0); y <= std::min(row + 1, v.height - 1); y++) {
      const float *__restrict depth = v.depth + y * width;
      for (int64_t x = 0; x < width; x++) low[x] = depth[x] > 0 && depth[x] < low[x] ? depth[x] : low[x];
    }
    for (int64_t x = 0; x < width; x++) {
      const float beside = low[x - 1] < low[x + 1] ? low[x - 1] : low[x + 1];
      const float least = beside < low[x] ? beside : low[x];
      nearest[x] = least < kNone ? least : 0.f;
    }
  }
}

// Rows [first, first + kRowsPerTask).
inline void observe(const ObserveRules &rules, const ObservedView &v, int first) {
  const int end = std::min(first + kRowsPerTask, v.height);
  compare_pixels(rules, v, static_cast<int64_t>(first) * v.width, static_cast<int64_t>(end) * v.width);
  if (v.depth != nullptr) find_nearest_depth(v, first, end);
}

}  // namespace model
