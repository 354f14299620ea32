// How deep each pixel of a depth camera sees when nothing that moves is in the way.
#pragma once

#include <algorithm>
#include <cstdint>

#include "interface.h"
#include "rounded.h"

namespace forecast {

// The backdrop after one more image; `is_robot` of a pixel's number.
template <class IsRobot>
FORECAST_ROUNDED inline void revise(const ReviseRequest &r, const IsRobot &is_robot) {
  FORECAST_ROUNDED_BODY
  const float above = static_cast<float>(1 + r.step_share), below = static_cast<float>(1 - r.step_share);
  const int64_t pixels = static_cast<int64_t>(r.width) * r.height;
  for (int64_t i = 0; i < pixels; i++) {
    const float before = r.before[i], depth = r.depth[i];
    const bool bare = !is_robot(i), moving = r.moving[i] != 0, known = bare & (depth > 0);
    const float growing = r.noise * before, slack = (growing < r.most_noise ? growing : r.most_noise) * before;
    const float farther = before * above + r.step, nearer = before * below - r.step;
    const float past_noise = before + slack, near_noise = before - slack;
    const bool past = depth > (farther < past_noise ? past_noise : farther);
    const bool near = depth > (near_noise < nearer ? near_noise : nearer);
    const float step = r.learning_rate * (depth - before), drawn = before + (known & !moving & near ? step : 0.0f);
    const float revised = known & (past | !(moving | near)) ? depth : drawn;
    r.after[i] = bare & !moving & (depth == 0) & (revised == r.unseen) ? r.unmeasured : revised;
  }
}

// Gives pixels that show something of which no depth is known the greatest depth that is known about them.
inline void fill(const ReviseRequest &r) {
  const auto deepest_about = [&](int32_t x, int32_t y) {
    float deepest = 0.0f;
    for (int32_t v = std::max(y - r.reach, 0); v <= std::min(y + r.reach, r.height - 1); v++) {
      for (int32_t u = std::max(x - r.reach, 0); u <= std::min(x + r.reach, r.width - 1); u++) {
        const float depth = r.after[static_cast<int64_t>(v) * r.width + u];
        deepest = std::max(deepest, depth < r.unseen ? depth : 0.0f);
      }
    }
    return deepest;
  };
  const int64_t pixels = static_cast<int64_t>(r.width) * r.height;
  for (int64_t i = 0; i < pixels; i++) r.filled[i] = std::min(r.after[i], r.unseen);
  for (int64_t i = 0; i < pixels; i++) {  // these are few
    if (r.after[i] != r.unmeasured) continue;
    const float deepest = deepest_about(static_cast<int32_t>(i % r.width), static_cast<int32_t>(i / r.width));
    if (deepest > 0) r.filled[i] = deepest;
  }
}

inline void revise(const ReviseRequest &r) {
  if (r.robot) {
    revise(r, [&](int64_t i) { return r.robot[i] != 0; });
  } else {
    revise(r, [](int64_t) { return false; });
  }
  fill(r);
}

}  // namespace forecast
