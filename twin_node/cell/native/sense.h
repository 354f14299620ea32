// Colours and depth with a sensor's errors: `sensor.sense`.
#pragma once

#include "interface.h"

#include "../../native/rounded_twice.h"

namespace cell {

inline void sense_colours(const ColourRequest &r) {
  const float sigma = r.sigma;
  const uint8_t *__restrict blurred = r.blurred;
  const float *__restrict noise = r.noise;
  uint8_t *__restrict sensed = r.sensed;
  for (int64_t i = 0; i < r.levels; i++) {
    const float level = static_cast<float>(blurred[i]) + noise[i] * sigma + 0.5f, low = level > 0.f ? level : 0.f;
    sensed[i] = static_cast<uint8_t>(static_cast<int32_t>(low < 255.f ? low : 255.f));
  }
}

inline void sense_depth(const DepthRequest &request) {
  const DepthRequest r = request;
  uint16_t *__restrict sensed = r.sensed_mm;
  for (int64_t i = 0; i < r.pixels; i++) {
    const float depth = r.depth[i], far_enough = depth > r.shortest ? depth : r.shortest;
    const bool is_edge = r.highest[i] - r.lowest[i] > r.step * far_enough;
    const float mm = 1000.f * depth + r.sigma_mm * depth * depth * r.noise[i];
    const bool is_lost =
        (depth == 0.f) | (r.chance[i] < (is_edge ? r.edge_dropout : r.dropout)) | (mm >= r.farthest_mm);
    const float rounded = mm + 0.5f;
    sensed[i] = static_cast<uint16_t>(static_cast<int32_t>(is_lost | !(rounded > 0.f) ? 0.f : rounded));
  }
}

}  // namespace cell

#include "../../native/rounded_as_usual.h"
