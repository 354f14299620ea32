// Pixels that a rendering is held to.
#pragma once

#include <algorithm>
#include <cstring>
#include <vector>

#include "camera.h"
#include "interface.h"

namespace model {

// `to` [n] or of `from` [n], pixel by pixel.
inline void add_pixels(const uint8_t *__restrict from, int64_t n, uint8_t *__restrict to) {
  for (int64_t i = 0; i < n; i++) to[i] |= from[i];
}

// `grown` [H, W] is `mask` dilated by a square of `radius` pixels.
inline void grow(const uint8_t *mask, int width, int height, int radius, uint8_t *grown) {
  std::vector<uint8_t> wide(static_cast<size_t>(width) * height);
  for (int y = 0; y < height; y++) {
    const uint8_t *row = mask + static_cast<int64_t>(y) * width;
    uint8_t *out = wide.data() + static_cast<int64_t>(y) * width;
    std::copy_n(row, width, out);
    for (int k = 1; k <= std::min(radius, width - 1); k++) {
      add_pixels(row, width - k, out + k);
      add_pixels(row + k, width - k, out);
    }
  }
  std::memcpy(grown, wide.data(), wide.size());
  for (int k = 1; k <= std::min(radius, height - 1); k++) {
    const int64_t shift = static_cast<int64_t>(k) * width, rest = static_cast<int64_t>(height - k) * width;
    add_pixels(wide.data(), rest, grown + shift);
    add_pixels(wide.data() + shift, rest, grown);
  }
}

// Near what is active, and at and around the points of one view.
inline void hold(const HeldRequest &r, const HeldView &v) {
  const int64_t pixels = static_cast<int64_t>(v.width) * v.height;
  const Pinhole camera(v.viewmat, v.K, v.width, v.height);
  std::vector<uint8_t> footprint(pixels, 0), grown(pixels);
  for (int64_t i = 0; i < r.points; i++) {
    const double point[3] = {v.means[3 * i], v.means[3 * i + 1], v.means[3 * i + 2]};
    const Found found = camera.find(point);
    if (found.inside) footprint[found.at] = 1;
  }
  grow(footprint.data(), v.width, v.height, r.around, grown.data());
  grow(v.active, v.width, v.height, r.skirt, v.held);
  for (int64_t i = 0; i < pixels; i++) v.held[i] = (v.held[i] | grown[i]) & v.usable[i];
}

}  // namespace model
