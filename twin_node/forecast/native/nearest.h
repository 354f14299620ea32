// Which of some points are nearest to others.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <vector>

#include "interface.h"
#include "rounded.h"

namespace forecast {

constexpr int64_t kBatch = 32;  // points looked at in one go

// Points of one group by their coordinates; what fills up the last ones is nowhere.
struct Spaced {
  std::vector<double> x, y, z;

  Spaced(const double *points, int64_t count) {
    const double nowhere = std::numeric_limits<double>::infinity();
    const size_t room = (count + kBatch - 1) / kBatch * kBatch;
    x.assign(room, nowhere), y.assign(room, nowhere), z.assign(room, nowhere);
    for (int64_t i = 0; i < count; i++) x[i] = points[3 * i], y[i] = points[3 * i + 1], z[i] = points[3 * i + 2];
  }
};

typedef double Lane __attribute__((vector_size(4 * sizeof(double))));  // of as many points: twice as many are slower

inline Lane lane_at(const double *from) {
  Lane lane;
  std::memcpy(&lane, from, sizeof(lane));
  return lane;
}

// Squared distances of a point from those from `first` on; the least of them.
FORECAST_ROUNDED inline double squares_from(const Spaced &others, size_t first, const double *point, double *squares) {
  FORECAST_ROUNDED_BODY
  constexpr int64_t kLane = sizeof(Lane) / sizeof(double);
  const double *x = others.x.data() + first, *y = others.y.data() + first, *z = others.z.data() + first;
  const double px = point[0], py = point[1], pz = point[2];
  Lane least = Lane{} + std::numeric_limits<double>::infinity();
  for (int64_t i = 0; i < kBatch; i += kLane) {
    const Lane dx = px - lane_at(x + i), dy = py - lane_at(y + i), dz = pz - lane_at(z + i);
    const Lane own = dx * dx + dy * dy + dz * dz;
    least = own < least ? own : least;
    std::memcpy(squares + i, &own, sizeof(own));
  }
  double one = least[0];
  for (int64_t i = 1; i < kLane; i++) one = std::min(one, least[i]);
  return one;
}

// Writes the rows of the nearest of `others`, nearest first, and how far they are.
inline void find_nearest(const NearestRequest &r, const Spaced &others, const double *point, double *far, int64_t *rows) {
  double squares[kBatch];
  std::fill_n(far, r.wanted, r.within * r.within);
  std::fill_n(rows, r.wanted, r.others);
  double &farthest = far[r.wanted - 1];
  for (size_t first = 0; first < others.x.size(); first += kBatch) {
    if (!(squares_from(others, first, point, squares) < farthest)) continue;
    for (int64_t i = 0; i < kBatch; i++) {
      if (!(squares[i] < farthest)) continue;
      int64_t place = r.wanted - 1;
      for (; place > 0 && far[place - 1] > squares[i]; place--) far[place] = far[place - 1], rows[place] = rows[place - 1];
      far[place] = squares[i], rows[place] = static_cast<int64_t>(first) + i;
    }
  }
  for (int32_t i = 0; i < r.wanted; i++) {
    far[i] = rows[i] < r.others ? std::sqrt(far[i]) : std::numeric_limits<double>::infinity();
  }
}

inline void nearest(const NearestRequest &r) {
  for (int64_t group = 0; group < r.groups; group++) {
    const Spaced others(r.among + 3 * group * r.others, r.others);
    for (int64_t point = 0; point < r.points; point++) {
      const int64_t first = (group * r.points + point) * r.wanted;
      find_nearest(r, others, r.asked + 3 * point, r.distances + first, r.rows + first);
    }
  }
}

}  // namespace forecast
