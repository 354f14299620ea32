// What parts hang together, and the things that they make up.
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <numeric>
#include <vector>

#include "interface.h"
#include "rounded.h"

namespace forecast {

// Some points in the order of their first coordinates: what is near one lies about it there.
class Row {
 public:
  Row(const double *centers, std::vector<int64_t> points, double reach)
      : centers_(centers), points_(std::move(points)), reach2_(reach * reach) {
    std::sort(points_.begin(), points_.end(), [&](int64_t a, int64_t b) { return x(a) < x(b); });
  }

  // Calls `work` with every two points that are no further apart than the reach.
  template <class Work>
  void for_pairs(const Work &work) const {
    for (size_t i = 0; i < points_.size(); i++) {
      for (size_t j = i + 1; j < points_.size() && !is_beyond(points_[i], points_[j]); j++) {
        if (squares(points_[i], points_[j]) <= reach2_) work(points_[i], points_[j]);
      }
    }
  }

  // The nearest to a point that need not be one of these, nearer than the reach; -1 where there is none.
  int64_t nearest(int64_t point) const {
    const auto later = [&](int64_t own, int64_t other) { return x(own) < x(other); };
    const auto from = std::lower_bound(points_.begin(), points_.end(), point, later);
    double least = reach2_;
    int64_t found = -1;
    const auto look = [&](int64_t other) {
      const double squared = squares(point, other);
      if (squared < least || (squared == least && found >= 0 && other < found)) least = squared, found = other;
    };
    for (auto at = from; at != points_.end() && !is_beyond(point, *at); ++at) look(*at);
    for (auto at = from; at != points_.begin() && !is_beyond(point, *(at - 1)); --at) look(*(at - 1));
    return found;
  }

 private:
  double x(int64_t point) const { return centers_[3 * point]; }

  FORECAST_ROUNDED bool is_beyond(int64_t one, int64_t other) const {
    FORECAST_ROUNDED_BODY
    const double way = x(one) - x(other);
    return way * way > reach2_;
  }

  FORECAST_ROUNDED double squares(int64_t one, int64_t other) const {
    FORECAST_ROUNDED_BODY
    const double *a = centers_ + 3 * one, *b = centers_ + 3 * other;
    const double dx = a[0] - b[0], dy = a[1] - b[1], dz = a[2] - b[2];
    return dx * dx + dy * dy + dz * dz;
  }

  const double *centers_;
  std::vector<int64_t> points_;
  const double reach2_;
};

// Writes the piece that each point is of, in the order of their first points, and returns how many there are; -1 for
// points that are not among those in `row`.
inline int64_t number_pieces(const Row &row, const std::vector<uint8_t> &is_among, int64_t *pieces) {
  const int64_t points = static_cast<int64_t>(is_among.size());
  std::vector<int64_t> parents(points);
  std::iota(parents.begin(), parents.end(), 0);
  const auto root = [&](int64_t point) {
    while (parents[point] != point) point = parents[point] = parents[parents[point]];
    return point;
  };
  row.for_pairs([&](int64_t a, int64_t b) {
    const int64_t one = root(a), other = root(b);
    parents[std::max(one, other)] = std::min(one, other);
  });
  int64_t count = 0;  // a root is the first point of its piece
  for (int64_t point = 0; point < points; point++) {
    const int64_t first = root(point);
    pieces[point] = !is_among[point] ? -1 : first == point ? count++ : pieces[first];
  }
  return count;
}

inline void link(const LinkRequest &r) {
  std::vector<int64_t> all(r.points);
  std::iota(all.begin(), all.end(), 0);
  number_pieces(Row(r.centers, std::move(all), r.reach), std::vector<uint8_t>(r.points, 1), r.pieces);
}

inline void gather(const GatherRequest &r) {
  constexpr int kColumns = 13;
  std::vector<uint8_t> is_solid(r.parts, 0);
  for (int64_t i = 0; i < r.voxels; i++) is_solid[r.labels[i]] |= r.likely[i] != 0;
  std::vector<int64_t> solid;
  for (int64_t part = 0; part < r.parts; part++) {
    if (is_solid[part]) solid.push_back(part);
  }
  const Row row(r.centers, std::move(solid), r.reach);
  *r.count = number_pieces(row, is_solid, r.things);
  for (int64_t part = 0; part < r.parts; part++) {
    const int64_t nearest = is_solid[part] ? part : row.nearest(part);
    r.things[part] = nearest < 0 ? -1 : r.things[nearest];
  }
  for (int64_t thing = 0; thing < *r.count; thing++) {
    int64_t *own = r.extents + kColumns * thing;
    std::fill_n(own, kColumns, 0);
    std::fill_n(own + 1, 3, std::numeric_limits<int64_t>::max());
  }
  for (int64_t i = 0; i < r.voxels; i++) {
    if (!r.likely[i]) continue;
    int64_t *own = r.extents + kColumns * r.things[r.labels[i]];
    own[0]++;
    for (int axis = 0; axis < 3; axis++) {
      const int64_t at = r.places[axis * r.voxels + i];
      own[1 + axis] = std::min(own[1 + axis], at), own[4 + axis] = std::max(own[4 + axis], at);
      own[7 + axis] += at, own[10 + axis] += at * at;
    }
  }
}

}  // namespace forecast
