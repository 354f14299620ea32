// The colours of pixels that show a solid: its pattern under the lamps.
#pragma once

#include <algorithm>
#include <cmath>

#include "patterns.h"

#include "../../native/rounded_twice.h"

namespace cell {

// Draws pixels that show one solid.
class Shader {
 public:
  Shader(const CastRequest &request, const Solid &solid)
      : r_(request), solid_(solid), weights_(request.patterns, solid.pattern) {}

  // Up to `kBlock` pixels, whose rays enter the solid at depths.
  void draw(const int64_t *pixels, const float *depths, int32_t count) {
    if (count == 0) return;
    place(pixels, depths, count);
    if (solid_.form == kBox) {
      face([&](Vector p) { return box_normal(p); });
    } else {
      const float half_length = solid_.lengths[1];
      face([&](Vector p) { return round_normal(p, half_length); });
    }
    light_up();
    std::fill_n(weight_, count, 0.f);
    weights_.find(points_, weight_);
    for (int32_t k = 0; k < 3; k++) colour(pixels, k);
  }

 private:
  void place(const int64_t *pixels, const float *depths, int32_t count) {
    const int64_t plane = static_cast<int64_t>(r_.width) * r_.height;
    points_.count = count;
    for (int32_t i = 0; i < count; i++) {
      const float *ray = r_.rays + pixels[i];
      const Vector local = solid_.rotation.turn_back({ray[0], ray[plane], ray[2 * plane]});
      points_.x[i] = solid_.origin.x + depths[i] * local.x;
      points_.y[i] = solid_.origin.y + depths[i] * local.y;
      points_.z[i] = solid_.origin.z + depths[i] * local.z;
    }
  }

  // Finds the normals at the points, and moves these to where their textures are read, in elements of the pattern.
  template <class Normal>
  void face(const Normal &normal) {
    const float depth = r_.texture_depth, scale = solid_.look[6];
    for (int32_t i = 0; i < points_.count; i++) {
      const Vector local = normal({points_.x[i], points_.y[i], points_.z[i]});
      points_.x[i] = (points_.x[i] - depth * local.x) / scale;
      points_.y[i] = (points_.y[i] - depth * local.y) / scale;
      points_.z[i] = (points_.z[i] - depth * local.z) / scale;
      const Vector facing = solid_.rotation.turn(local);
      normals_.x[i] = facing.x, normals_.y[i] = facing.y, normals_.z[i] = facing.z;
    }
  }

  Vector box_normal(Vector p) const {
    const float *half = solid_.lengths;
    const Vector ratio{p.x / half[0], p.y / half[1], p.z / half[2]};
    const Vector far{std::fabs(ratio.x), std::fabs(ratio.y), std::fabs(ratio.z)};
    const bool is_x = (far.x >= far.y) & (far.x >= far.z), is_y = !is_x & (far.y >= far.z);
    return {is_x ? sign(ratio.x) : 0.f, is_y ? sign(ratio.y) : 0.f, is_x | is_y ? 0.f : sign(ratio.z)};
  }

  Vector round_normal(Vector p, float half_length) const {
    const float up = p.z < -half_length ? -half_length : p.z, along_axis = up > half_length ? half_length : up;
    const float radius = solid_.lengths[0];
    return {p.x / radius, p.y / radius, (p.z - along_axis) / radius};
  }

  static float sign(float x) { return x > 0.f ? 1.f : (x < 0.f ? -1.f : 0.f); }

  void light_up() {
    const Lighting &lighting = r_.lighting;
    std::fill_n(light_, points_.count, lighting.ambient);
    for (int32_t lamp = 0; lamp < lighting.lamps; lamp++) {
      const float *to = lighting.lamp + 4 * lamp, strength = to[0];
      const Vector direction{to[1], to[2], to[3]};
      for (int32_t i = 0; i < points_.count; i++) {
        const float faced = along(direction, {normals_.x[i], normals_.y[i], normals_.z[i]});
        light_[i] += strength * (faced > 0.f ? faced : 0.f);
      }
    }
  }

  void colour(const int64_t *pixels, int32_t k) {
    const float first = solid_.look[k], change = solid_.look[3 + k] - first;
    int32_t levels[kBlock];
    for (int32_t i = 0; i < points_.count; i++) {
      const float level = (first + weight_[i] * change) * light_[i] + 0.5f;
      levels[i] = static_cast<int32_t>(level < 255.f ? level : 255.f);
    }
    for (int32_t i = 0; i < points_.count; i++) r_.rgb[3 * pixels[i] + k] = static_cast<uint8_t>(levels[i]);
  }

  const CastRequest &r_;
  const Solid &solid_;
  Weights weights_;
  Points points_, normals_;
  float light_[kBlock], weight_[kBlock];
};

}  // namespace cell

#include "../../native/rounded_as_usual.h"
