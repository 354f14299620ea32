// Vectors in a solid's frame or in that of the base.
#pragma once

#include "interface.h"

#include "../../native/rounded_twice.h"

namespace cell {

struct Vector {
  float x, y, z;
};

inline float along(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// From a solid's frame into that of the base.
class Rotation {
 public:
  explicit Rotation(const float *R)
      : row_{{R[0], R[1], R[2]}, {R[3], R[4], R[5]}, {R[6], R[7], R[8]}},
        column_{{R[0], R[3], R[6]}, {R[1], R[4], R[7]}, {R[2], R[5], R[8]}} {}

  Vector turn(Vector v) const { return {along(row_[0], v), along(row_[1], v), along(row_[2], v)}; }
  Vector turn_back(Vector v) const { return {along(column_[0], v), along(column_[1], v), along(column_[2], v)}; }

 private:
  Vector row_[3], column_[3];
};

// One solid of a request.
struct Solid {
  Solid(const CastRequest &r, int32_t index)
      : index(index),
        form(r.kinds[3 * index]),
        pattern(r.kinds[3 * index + 1]),
        owner(static_cast<int16_t>(r.kinds[3 * index + 2])),
        left(r.rects[4 * index]),
        right(r.rects[4 * index + 1]),
        top(r.rects[4 * index + 2]),
        bottom(r.rects[4 * index + 3]),
        lengths(r.lengths + 3 * index),
        rotation{r.rotations + 9 * index},
        origin{r.origins[3 * index], r.origins[3 * index + 1], r.origins[3 * index + 2]},
        look(r.looks + 7 * index) {}

  int32_t index, form, pattern;
  int16_t owner;
  int32_t left, right, top, bottom;
  const float *lengths;
  Rotation rotation;
  Vector origin;
  const float *look;
};

}  // namespace cell

#include "../../native/rounded_as_usual.h"
