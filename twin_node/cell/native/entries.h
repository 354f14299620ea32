// Where rays from the camera enter solids: `shapes.ray_entries`.
#pragma once

#include <cmath>
#include <limits>

#include "vectors.h"

#include "../../native/rounded_twice.h"

namespace cell {

constexpr float kNever = std::numeric_limits<float>::infinity();

// The lesser t with a t^2 + 2 b t + c = 0; NaN without one.
inline float nearer_root(float a, float b, float c) { return (-b - std::sqrt(b * b - a * c)) / a; }

class SphereEntry {
 public:
  SphereEntry(Vector origin, float radius) : origin_(origin), c_(along(origin, origin) - radius * radius) {}

  float operator()(Vector ray) const {
    const float t = nearer_root(along(ray, ray), along(origin_, ray), c_);
    return t > 0.f ? t : kNever;
  }

 private:
  Vector origin_;
  float c_;
};

class CapsuleEntry {
 public:
  CapsuleEntry(Vector origin, float radius, float half_length)
      : origin_(origin),
        half_length_(half_length),
        from_axis_(origin.x * origin.x + origin.y * origin.y),
        square_(radius * radius),
        low_({origin.x, origin.y, origin.z + half_length}, radius),
        high_({origin.x, origin.y, origin.z - half_length}, radius) {}

  bool is_about_camera() const {
    const float past_end = std::fmax(std::fabs(origin_.z) - half_length_, 0.f);
    return from_axis_ + past_end * past_end < square_;
  }

  float operator()(Vector ray) const {
    const float a = ray.x * ray.x + ray.y * ray.y, b = origin_.x * ray.x + origin_.y * ray.y;
    const float side = nearer_root(a, b, from_axis_ - square_);
    const bool meets = (std::fabs(origin_.z + side * ray.z) <= half_length_) & (side > 0.f);
    const float low = low_(ray), high = high_(ray), t = meets ? side : kNever, end = low < high ? low : high;
    return end < t ? end : t;
  }

 private:
  Vector origin_;
  float half_length_, from_axis_, square_;
  SphereEntry low_, high_;
};

class BoxEntry {
 public:
  BoxEntry(Vector origin, const float *half)
      : low_{-half[0] - origin.x, -half[1] - origin.y, -half[2] - origin.z},
        high_{half[0] - origin.x, half[1] - origin.y, half[2] - origin.z} {}

  float operator()(Vector ray) const {
    const Slab x(low_.x, high_.x, ray.x), y(low_.y, high_.y, ray.y), z(low_.z, high_.z, ray.z);
    const float late = x.entry > y.entry ? x.entry : y.entry, entry = late > z.entry ? late : z.entry;
    const float soon = x.leave < y.leave ? x.leave : y.leave, leave = soon < z.leave ? soon : z.leave;
    const bool meets = x.is_told & y.is_told & z.is_told & (entry <= leave) & (entry > 0.f);
    return meets ? entry : kNever;
  }

 private:
  // Between two parallel faces; not told for a ray that lies in one of them.
  struct Slab {
    Slab(float low, float high, float step) {
      const float inverse = 1.f / step, first = low * inverse, second = high * inverse;
      is_told = (first == first) & (second == second);
      entry = first < second ? first : second;
      leave = first < second ? second : first;
    }

    bool is_told;
    float entry, leave;
  };

  Vector low_, high_;
};

}  // namespace cell

#include "../../native/rounded_as_usual.h"
