// Solid textures: `textures.colors`.
#pragma once

#include <cmath>

#include "vectors.h"

#include "../../native/rounded_twice.h"

namespace cell {

constexpr int32_t kBlock = 256;  // points at a time, so that all about them stays in the nearest cache

// Up to `kBlock` points.
struct Points {
  int32_t count;
  float x[kBlock], y[kBlock], z[kBlock];
};

// Random values of unit cells, again and again in all directions.
class Volume {
 public:
  explicit Volume(const Patterns &patterns) : side_(patterns.lattice), values_(patterns.volume) {}

  // Of the cell that begins at whole coordinates.
  float block(float x, float y, float z) const { return values_[row(wrap(x), wrap(y)) + wrap(z)]; }

  // Linear between the values at a cell's corners.
  float noise(float x, float y, float z) const {
    const float bx = std::floor(x), by = std::floor(y), bz = std::floor(z);
    const float u = x - bx, v = y - by, w = z - bz;
    const int32_t i = wrap(bx), j = wrap(by), k = wrap(bz);
    const int32_t i1 = (i + 1) & (side_ - 1), j1 = (j + 1) & (side_ - 1), k1 = (k + 1) & (side_ - 1);
    const float near = mix(mix(at(i, j, k), at(i, j, k1), w), mix(at(i, j1, k), at(i, j1, k1), w), v);
    const float far = mix(mix(at(i1, j, k), at(i1, j, k1), w), mix(at(i1, j1, k), at(i1, j1, k1), w), v);
    return mix(near, far, u);
  }

 private:
  int32_t wrap(float whole) const { return static_cast<int32_t>(whole) & (side_ - 1); }
  int32_t row(int32_t i, int32_t j) const { return (i * side_ + j) * side_; }
  float at(int32_t i, int32_t j, int32_t k) const { return values_[row(i, j) + k]; }
  static float mix(float first, float second, float share) { return first * (1.f - share) + second * share; }

  int32_t side_;
  const float *values_;
};

inline float odd(float whole) { return whole - 2.f * std::floor(whole * 0.5f); }

// Distance from the nearest whole number.
inline float off_whole(float x) { return std::fabs(x - std::nearbyint(x)); }

// Shares [count] of a texture's second colour.
class Weights {
 public:
  Weights(const Patterns &patterns, int32_t pattern) : p_(patterns), pattern_(pattern), volume_(patterns) {}

  void find(const Points &cells, float *weights) const {
    find_figure(cells, weights);
    const Volume volume = volume_;
    const float share = p_.shares[2 * pattern_], rest = p_.shares[2 * pattern_ + 1], grain = p_.grain;
    each(cells, weights, [=](float x, float y, float z, float figure) {
      return share * figure + rest * volume.noise(x * grain, y * grain, z * grain);
    });
  }

 private:
  template <class Value>
  static void each(const Points &cells, float *values, const Value value) {
    const int32_t count = cells.count;
#pragma omp simd
    for (int32_t i = 0; i < count; i++) values[i] = value(cells.x[i], cells.y[i], cells.z[i], values[i]);
  }

  void find_figure(const Points &cells, float *figure) const {
    const Patterns p = p_;
    const Volume volume = volume_;
    switch (pattern_) {
      case kChecker:
        return each(cells, figure, [](float x, float y, float z, float) {
          return odd(std::floor(x) + std::floor(y) + std::floor(z));
        });
      case kStripes:
        return each(cells, figure, [](float x, float y, float z, float) { return odd(std::floor(x + y + z)); });
      case kTiles:
        return each(cells, figure, [=](float x, float y, float z, float) {
          const float dx = off_whole(x), dy = off_whole(y), shade = p.shades * block(volume, x, y, z);
          return (dx < dy ? dx : dy) < p.joint ? 1.f : shade;
        });
      case kWood:
        return each(cells, figure, [=](float x, float y, float z, float) {
          const float *grain = p.wood_grain;
          const float angle =
              p.wood_rings * (y + p.wood_distortion * volume.noise(x * grain[0], y * grain[1], z * grain[2]));
          return 0.5f + 0.5f * static_cast<float>(std::sin(static_cast<double>(angle)));
        });
      case kSpeckle:
        return each(cells, figure, [=](float x, float y, float z, float) { return volume.noise(x, y, z); });
      case kPatches:
        return each(cells, figure, [=](float x, float y, float z, float) { return block(volume, x, y, z); });
      default:
        return each(cells, figure, [](float, float, float, float) { return 0.f; });
    }
  }

  static float block(const Volume &volume, float x, float y, float z) {
    return volume.block(std::floor(x), std::floor(y), std::floor(z));
  }

  const Patterns &p_;
  int32_t pattern_;
  Volume volume_;
};

}  // namespace cell

#include "../../native/rounded_as_usual.h"
