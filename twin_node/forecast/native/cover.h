// Boxes about voxels on an octree: those of the smallest cells, and the few that are worth their price.
#pragma once

#include <algorithm>
#include <vector>

#include "bits.h"
#include "interface.h"

namespace forecast {

constexpr int kCell = 4;  // voxels along a cell of level 0

struct Lattice {
  int64_t x, y, z;  // cells along each axis

  int64_t size() const { return x * y * z; }
  int64_t flat(const int64_t *cell) const { return (cell[0] * y + cell[1]) * z + cell[2]; }
  Lattice halved() const { return {(x + 1) / 2, (y + 1) / 2, (z + 1) / 2}; }
};

inline Lattice lattice_of(int64_t nx, int64_t ny, int64_t nz) {
  return {(nx + kCell - 1) / kCell, (ny + kCell - 1) / kCell, (nz + kCell - 1) / kCell};
}

// Number of a cell: its level, and its flat index on the lattice of level 0.
inline int64_t number_of(const Lattice &lattice, int64_t level, const int64_t *cell) {
  return level << 21 | (lattice.flat(cell) & 0x1FFFFF);
}

struct Box {
  int32_t lower[3], upper[3];  // first and last voxel; empty where they are the wrong way round

  void hold(const int32_t *low, const int32_t *high) {
    for (int a = 0; a < 3; a++) lower[a] = std::min(lower[a], low[a]), upper[a] = std::max(upper[a], high[a]);
  }
  double space() const {
    double product = 1;
    for (int a = 0; a < 3; a++) product *= upper[a] - lower[a] + 1;
    return product;
  }
};

constexpr Box kNothing = {{INT32_MAX, INT32_MAX, INT32_MAX}, {INT32_MIN, INT32_MIN, INT32_MIN}};

// A box of a cover, and the cell that it is of.
struct Covering {
  int64_t level, cell[3];
  Box box;
};

// The smallest boxes about voxels: cell by cell of level 0.
class Leaves {
 public:
  explicit Leaves(const CoverTask &task) : t_(task), lattice_(lattice_of(t_.nx, t_.ny, t_.nz)) {
    if (t_.words) {
      hold_mask();
      return;
    }
    std::vector<Box> boxes(lattice_.size(), kNothing);
    hold_voxels(boxes.data(), t_.voxels, t_.several);
    hold_voxels(boxes.data(), t_.others, t_.more);
    int64_t row = 0;
    for (int64_t x = 0; x < lattice_.x; x++) {
      for (int64_t y = 0; y < lattice_.y; y++) {
        for (int64_t z = 0; z < lattice_.z; z++, row++) {
          if (boxes[row].lower[0] <= boxes[row].upper[0]) found_.push_back({0, {x, y, z}, boxes[row]});
        }
      }
    }
  }

  const std::vector<Covering> &found() const { return found_; }

 private:
  void hold_voxels(Box *boxes, const uint32_t *indices, int64_t voxels) const {
    const int64_t ny = t_.ny, nz = t_.nz;
    int64_t bottom = 0, top = 0;  // first voxel of the column that the last one lay in, and one past its last
    int32_t x = 0, y = 0;
    Box *cells = nullptr;
    for (int64_t i = 0; i < voxels;) {
      const int64_t index = indices[i];
      if (index < bottom || index >= top) {
        const int64_t column = index / nz;
        x = static_cast<int32_t>(column / ny), y = static_cast<int32_t>(column % ny);
        bottom = column * nz, top = bottom + nz;
        cells = &boxes[((x / kCell) * lattice_.y + y / kCell) * lattice_.z];
      }
      const int32_t z = static_cast<int32_t>(index - bottom);
      const int64_t end = std::min(top, bottom + (z / kCell + 1) * kCell);  // of the cell
      int64_t next = index + 1;  // voxels mostly stand one upon the other
      for (i++; i < voxels && indices[i] == next && next < end; i++) next++;
      const int32_t low[3] = {x, y, z}, high[3] = {x, y, static_cast<int32_t>(next - 1 - bottom)};
      cells[z / kCell].hold(low, high);
    }
  }

  // Whole cells that the mask fills some of, and a share at least of what lies in the grid.
  void hold_mask() {
    const std::vector<int32_t> counts = count_voxels();
    const int32_t dims[3] = {t_.nx, t_.ny, t_.nz};
    int64_t row = 0;
    for (int64_t x = 0; x < lattice_.x; x++) {
      for (int64_t y = 0; y < lattice_.y; y++) {
        for (int64_t z = 0; z < lattice_.z; z++, row++) {
          if (counts[row] == 0) continue;
          Covering one{0, {x, y, z}, kNothing};
          for (int a = 0; a < 3; a++) {
            one.box.lower[a] = static_cast<int32_t>(kCell * one.cell[a]);
            one.box.upper[a] = std::min(one.box.lower[a] + kCell, dims[a]) - 1;
          }
          if (counts[row] >= t_.share * one.box.space()) found_.push_back(one);
        }
      }
    }
  }

  std::vector<int32_t> count_voxels() const {
    static_assert(kCell == 4, "bits are counted by fours");
    std::vector<int32_t> all(lattice_.size());
    const int words = words_of(t_.nz);
    const uint64_t *column = t_.words;
    for (int64_t x = 0; x < t_.nx; x++) {
      for (int64_t y = 0; y < t_.ny; y++, column += words) {
        int32_t *counts = all.data() + ((x / kCell) * lattice_.y + y / kCell) * lattice_.z;
        for (int w = 0; w < words; w++) {
          uint64_t fours = column[w] - (column[w] >> 1 & 0x5555555555555555);
          fours = (fours & 0x3333333333333333) + (fours >> 2 & 0x3333333333333333);
          for (int64_t z = 16 * w; fours; z++, fours >>= 4) counts[z] += fours & 15;
        }
      }
    }
    return all;
  }

  const CoverTask &t_;
  const Lattice lattice_;
  std::vector<Covering> found_;
};

// All cells of one level, in the order of their flat indices.
struct Level {
  Lattice lattice;
  std::vector<int64_t> cells;  // [c, 3]
  std::vector<Box> boxes;
  std::vector<double> spaces;      // [c] voxels, those of boxes that were there before count less
  std::vector<int64_t> children;   // rows of the level below, cell by cell
  std::vector<int64_t> starts;     // [c + 1] where each cell's children begin
  std::vector<double> costs;       // [c, prices] of the best set of boxes, from level 1 on
  std::vector<int32_t> numbers;    // [c, prices] boxes in that set
  std::vector<uint8_t> is_divided;  // [c, prices]

  int64_t count() const { return static_cast<int64_t>(boxes.size()); }
};

inline Level parents_of(const Level &below) {
  Level level;
  level.lattice = below.lattice.halved();
  const int64_t count = below.count();
  std::vector<int64_t> parents(count), sizes(level.lattice.size(), 0);
  for (int64_t row = 0; row < count; row++) {
    const int64_t *cell = &below.cells[3 * row];
    const int64_t parent[3] = {cell[0] / 2, cell[1] / 2, cell[2] / 2};
    sizes[parents[row] = level.lattice.flat(parent)]++;
  }
  std::vector<int64_t> rows(level.lattice.size(), 0), next;
  for (int64_t flat = 0, begin = 0; flat < level.lattice.size(); flat++) {
    if (sizes[flat] == 0) continue;
    rows[flat] = static_cast<int64_t>(next.size());
    next.push_back(begin);
    level.starts.push_back(begin);
    begin += sizes[flat];
  }
  level.starts.push_back(count);
  level.cells.resize(3 * next.size());
  level.boxes.assign(next.size(), kNothing);
  level.children.resize(count);
  for (int64_t row = 0; row < count; row++) {
    const int64_t parent = rows[parents[row]];
    level.children[next[parent]++] = row;
    for (int a = 0; a < 3; a++) level.cells[3 * parent + a] = below.cells[3 * row + a] / 2;
    level.boxes[parent].hold(below.boxes[row].lower, below.boxes[row].upper);
  }
  return level;
}

// The octree of a task's smallest boxes, and for every price the cheapest division of each cell.
class Octree {
 public:
  // `before`: numbers of the cells of an earlier cover, rising.
  Octree(const CoverRequest &request, const CoverTask &task, const std::vector<Covering> &smallest,
         const std::vector<int64_t> &before)
      : r_(request), before_(before), most_(task.most), prices_(request.prices) {
    Level leaves;
    leaves.lattice = lattice_of(task.nx, task.ny, task.nz);
    for (const Covering &one : smallest) {
      leaves.cells.insert(leaves.cells.end(), one.cell, one.cell + 3);
      leaves.boxes.push_back(one.box);
    }
    levels_.push_back(std::move(leaves));
    while (levels_.back().count() > 1 && static_cast<int>(levels_.size()) <= r_.highest_level) {
      levels_.push_back(parents_of(levels_.back()));
    }
    for (size_t level = 0; level < levels_.size(); level++) measure(levels_[level], level);
    for (size_t level = 1; level < levels_.size(); level++) divide(level);
  }

  // The boxes at the lowest price that leaves few enough of them; one box about all where none does.
  std::vector<Covering> fitted() const {
    const int price = affordable();
    if (price < 0) {
      Covering all{r_.highest_level, {0, 0, 0}, kNothing};
      for (const Box &box : levels_.back().boxes) all.box.hold(box.lower, box.upper);
      return {all};
    }
    std::vector<Covering> found;
    std::vector<uint8_t> reached(levels_.back().count(), 1);
    for (int64_t number = static_cast<int64_t>(levels_.size()) - 1; number >= 0; number--) {
      const Level &level = levels_[number];
      std::vector<uint8_t> below(level.children.size(), 0);
      for (int64_t row = 0; row < level.count(); row++) {
        if (!reached[row]) continue;
        if (number == 0 || !level.is_divided[row * prices_ + price]) {
          const int64_t *cell = &level.cells[3 * row];
          found.push_back({number, {cell[0], cell[1], cell[2]}, level.boxes[row]});
          continue;
        }
        for (int64_t i = level.starts[row]; i < level.starts[row + 1]; i++) below[level.children[i]] = 1;
      }
      reached = std::move(below);
    }
    return found;
  }

 private:
  void measure(Level &level, int64_t number) const {
    const Lattice lattice = levels_[0].lattice;
    for (int64_t row = 0; row < level.count(); row++) {
      const int64_t place = number_of(lattice, number, &level.cells[3 * row]);
      const bool was_there = std::binary_search(before_.begin(), before_.end(), place);
      level.spaces.push_back(level.boxes[row].space() * (was_there ? r_.loyalty : 1.0));
    }
  }

  // A cell is divided where its children together cost less than its own box, which costs its space and one price.
  void divide(size_t number) {
    Level &level = levels_[number];
    const Level &below = levels_[number - 1];
    const size_t size = static_cast<size_t>(level.count()) * prices_;
    level.costs.resize(size), level.numbers.resize(size), level.is_divided.resize(size);
    std::vector<double> first(prices_), others(prices_);
    std::vector<int32_t> numbers(prices_);
    for (int64_t row = 0; row < level.count(); row++) {
      std::fill(others.begin(), others.end(), 0.0), std::fill(numbers.begin(), numbers.end(), 0);
      for (int64_t i = level.starts[row]; i < level.starts[row + 1]; i++) {
        std::vector<double> &sum = i == level.starts[row] ? first : others;
        if (i == level.starts[row]) std::fill(first.begin(), first.end(), 0.0);
        add_cost(below, number - 1, level.children[i], sum.data(), numbers.data());
      }
      for (int p = 0; p < prices_; p++) {
        const double whole = level.spaces[row] + r_.price[p], apart = first[p] + others[p];
        const bool cheaper = apart < whole;
        level.costs[row * prices_ + p] = cheaper ? apart : whole;
        level.numbers[row * prices_ + p] = cheaper ? numbers[p] : 1;
        level.is_divided[row * prices_ + p] = cheaper;
      }
    }
  }

  void add_cost(const Level &level, int64_t number, int64_t row, double *costs, int32_t *numbers) const {
    if (number == 0) {
      for (int p = 0; p < prices_; p++) costs[p] += level.spaces[row] + r_.price[p], numbers[p]++;
      return;
    }
    const double *own = &level.costs[row * prices_];
    const int32_t *count = &level.numbers[row * prices_];
    for (int p = 0; p < prices_; p++) costs[p] += own[p], numbers[p] += count[p];
  }

  int affordable() const {
    const Level &roots = levels_.back();
    for (int p = 0; p < prices_; p++) {
      int64_t total = 0;
      for (int64_t row = 0; row < roots.count(); row++) total += roots.numbers[row * prices_ + p];
      if (total <= most_) return p;
    }
    return -1;
  }

  const CoverRequest &r_;
  const std::vector<int64_t> &before_;
  const int most_, prices_;
  std::vector<Level> levels_;
};

// Writes the boxes of every task, one after the other.
inline void cover(const CoverRequest &r) {
  int64_t row = 0;
  for (int64_t number = 0; number < r.tasks; number++) {
    const CoverTask &task = r.task[number];
    const Leaves leaves(task);
    std::vector<Covering> few = leaves.found();
    if (static_cast<int64_t>(few.size()) > task.most) {
      std::vector<int64_t> before;
      for (int64_t i = 0; i < r.befores; i++) {
        if (r.before[i] >> 24 == task.prefix) before.push_back(r.before[i] & 0xFFFFFF);
      }
      std::sort(before.begin(), before.end());
      few = Octree(r, task, leaves.found(), before).fitted();
    }
    const Lattice lattice = lattice_of(task.nx, task.ny, task.nz);
    for (const Covering &one : few) {
      r.ids[row] = task.prefix << 24 | static_cast<uint32_t>(number_of(lattice, one.level, one.cell));
      for (int a = 0; a < 3; a++) r.lower[3 * row + a] = one.box.lower[a], r.upper[3 * row + a] = one.box.upper[a];
      row++;
    }
    r.counts[number] = static_cast<int64_t>(few.size());
  }
}

}  // namespace forecast
