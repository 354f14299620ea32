// What one view of a scene misses of what it should show: half the squared error's steepest descent.
#pragma once

#include "backward.h"

namespace splat {

inline float within(float value, float limit) { return std::min(std::max(value, -limit), limit); }

// Which way the channels and alpha of each drawn pixel of [begin, end) should go; the last colour pulls by one, so that
// its gradient is the sum of the blend weights.
inline void pull_pixels(const MissRequest &m, int64_t begin, int64_t end) {
  const Request &r = m.scene;
  const int channels = channels_of(r), colors = r.color_channels;
  for (int64_t at = begin; at < end; at++) {
    float *pull = m.pull + channels * at;
    m.pull_alpha[at] = 0.f;
    std::fill_n(pull, channels, 0.f);
    if (r.pixel_mask[at] == 0) continue;
    const float *seen = r.renders + channels * at;
    for (int k = 0; k + 1 < colors; k++) pull[k] = within(m.target[(colors - 1) * at + k] - seen[k], m.outlier);
    pull[colors - 1] = 1.f;
    if (m.depth == nullptr || !(m.depth[at] > 0.f)) continue;
    const volatile float behind = (1.f - r.alphas[at]) * m.surface[at];  // rounded by itself, as the plain one does
    const float shown = std::max(seen[colors] + behind, m.nearest);
    const float missed = within(m.depth_gain * (m.depth[at] / shown - 1.f), m.outlier);
    pull[colors] = missed * m.depth_gain / shown;
    m.pull_alpha[at] = -pull[colors] * m.surface[at];
  }
}

// Adds what the view misses to the gradients.
inline Status add_missed(Workspace &w, const MissRequest &m) {
  const Status drawn = forward(w, m.scene);
  if (drawn != kOk) return drawn;
  const int64_t band = static_cast<int64_t>(kTile) * m.scene.width, pixels = m.scene.width * int64_t{m.scene.height};
  parallel_for(m.scene.threads, (pixels + band - 1) / band,
               [&](int64_t i) { pull_pixels(m, i * band, std::min(pixels, (i + 1) * band)); });
  return backward(w, m.scene, m.gradients);
}

}  // namespace splat
