// How deep each pixel of a depth camera sees when nothing that moves is in the way.
#pragma once

#include <cstdint>
#include <vector>

#include "image.h"
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
    const bool past = depth > before * above + r.step, near = depth > before * below - r.step;
    const float step = r.learning_rate * (depth - before), drawn = before + (known & !moving & near ? step : 0.0f);
    const float revised = known & (past | !(moving | near)) ? depth : drawn;
    r.after[i] = bare & !moving & (depth == 0) & (revised == r.unseen) ? r.unmeasured : revised;
  }
}

// Gives pixels that show something of which no depth is known the greatest depth that is known about them.
inline void fill(const ReviseRequest &r) {
  const size_t size = static_cast<size_t>(r.width) * r.height;
  std::vector<float> deepest(size);
  for (size_t i = 0; i < size; i++) deepest[i] = r.after[i] < r.unseen ? r.after[i] : 0.0f;
  spread_over<Greatest>(deepest, r.width, r.height, Patch::square(r.reach), 0.0f);
  for (size_t i = 0; i < size; i++) {
    const float filled = r.after[i] == r.unmeasured && deepest[i] > 0 ? deepest[i] : r.after[i];
    r.filled[i] = filled < r.unseen ? filled : r.unseen;
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
