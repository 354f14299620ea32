// Points in groups, and rows of balls about them: where a group is in every layer, and how far its balls reach there.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "interface.h"

namespace forecast {

// Whole numbers from the first on, up to the one before the last.
struct Range {
  int from = std::numeric_limits<int>::max(), to = std::numeric_limits<int>::min();

  Range() = default;
  Range(int from, int to) : from(from), to(to) {}
  bool is_empty() const { return from >= to; }
  int size() const { return is_empty() ? 0 : to - from; }
  Range wider(int by) const { return {from - by, to + by}; }
  Range within(Range other) const { return {std::max(from, other.from), std::min(to, other.to)}; }
  bool holds(int at) const { return at >= from && at < to; }
  bool is_within(Range other) const { return from >= other.from && to <= other.to; }
  void take_in(Range other) { from = std::min(from, other.from), to = std::max(to, other.to); }
};

// Voxels of a range along each axis.
struct Cuboid {
  std::array<Range, 3> axes;

  Cuboid() = default;
  Cuboid(Range x, Range y, Range z) : axes{x, y, z} {}
  bool is_empty() const { return axes[0].is_empty() || axes[1].is_empty() || axes[2].is_empty(); }
  Cuboid within(const Cuboid &other) const {
    return {axes[0].within(other.axes[0]), axes[1].within(other.axes[1]), axes[2].within(other.axes[2])};
  }
  bool is_within(const Cuboid &other) const {
    return axes[0].is_within(other.axes[0]) && axes[1].is_within(other.axes[1]) && axes[2].is_within(other.axes[2]);
  }
  bool holds(int x, int y, int z) const { return axes[0].holds(x) && axes[1].holds(y) && axes[2].holds(z); }
  void take_in(const Cuboid &other) {
    if (other.is_empty()) return;
    for (int k = 0; k < 3; k++) axes[k].take_in(other.axes[k]);
  }
};

class Balls {
 public:
  const GrowRequest &grid;       // its size, threads and results
  const int32_t *shifts;         // [layers, rows, 3] voxels
  const uint16_t *reaches;       // [layers, rows] quarter voxels
  std::vector<int64_t> groups;   // [rows] of whose points each is
  int64_t cored = 0;             // rows before this one make the voxels of their core points cores

  explicit Balls(const GrowRequest &grid) : grid(grid), shifts(grid.shifts), reaches(grid.reaches) {}

  // Takes `count` points in: `place(i, axis)` in voxels, `group(i)` of `all`, and whether it is a core, `core(i)`.
  template <class PlaceOf, class GroupOf, class CoreOf>
  void list(int64_t count, int64_t all, const PlaceOf &place, const GroupOf &group, const CoreOf &core) {
    first_.assign(all + 1, 0);
    for (int64_t i = 0; i < count; i++) first_[group(i) + 1]++;
    for (int64_t g = 0; g < all; g++) first_[g + 1] += first_[g];
    std::vector<int64_t> next(first_.begin(), first_.end() - 1);
    for (std::vector<int32_t> &axis : places_) axis.resize(count);
    cores_.resize(count), bounds_.assign(all, Cuboid{});
    for (int64_t i = 0; i < count; i++) {
      const int64_t g = group(i), to = next[g]++;
      for (int axis = 0; axis < 3; axis++) {
        const int32_t at = places_[axis][to] = place(i, axis);
        bounds_[g].axes[axis].take_in({at, at + 1});
      }
      cores_[to] = core(i);
    }
  }

  int64_t rows() const { return static_cast<int64_t>(groups.size()); }
  int64_t points(int64_t row) const { return first_[groups[row] + 1] - first_[groups[row]]; }
  bool has_cores(int64_t row) const { return row < cored; }

  // Voxels that hold all points of a row; empty where there is none.
  Cuboid box(int64_t layer, int64_t row) const {
    Cuboid moved = bounds_[groups[row]];
    if (moved.is_empty()) return moved;
    const int32_t *shift = shift_of(layer, row);
    for (int axis = 0; axis < 3; axis++) moved.axes[axis].from += shift[axis], moved.axes[axis].to += shift[axis];
    return moved;
  }

  // visit(i, x, y, z) of every point of a row, those in `wanted` alone where that is given.
  template <class Visit>
  void each_place(int64_t layer, int64_t row, const Cuboid *wanted, const Visit &visit) const {
    const int32_t *shift = shift_of(layer, row);
    const int64_t end = first_[groups[row] + 1];
    for (int64_t i = first_[groups[row]]; i < end; i++) {
      const int x = places_[0][i] + shift[0], y = places_[1][i] + shift[1], z = places_[2][i] + shift[2];
      if (!wanted || wanted->holds(x, y, z)) visit(i, x, y, z);
    }
  }

  bool is_core(int64_t i) const { return cores_[i]; }

 private:
  const int32_t *shift_of(int64_t layer, int64_t row) const { return shifts + 3 * (layer * rows() + row); }

  std::array<std::vector<int32_t>, 3> places_;  // group by group
  std::vector<uint8_t> cores_;
  std::vector<int64_t> first_;  // point of each group, and one past the last
  std::vector<Cuboid> bounds_;      // of each group
};

// Every part a group and a row of its own.
inline Balls balls_of(const GrowRequest &r) {
  Balls balls(r);
  balls.list(
      r.points, r.parts, [&](int64_t i, int axis) { return r.places[axis * r.points + i]; },
      [&](int64_t i) { return r.labels[i]; }, [&](int64_t i) { return r.cores[i]; });
  balls.groups.resize(r.parts), balls.cored = r.parts;
  for (int64_t part = 0; part < r.parts; part++) balls.groups[part] = part;
  return balls;
}

}  // namespace forecast
