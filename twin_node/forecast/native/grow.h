// Union of balls on packed bits: exact, whatever the number of balls.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>
#include <utility>
#include <vector>

#include "balls.h"
#include "bits.h"
#include "interface.h"

namespace forecast {

constexpr int kPerVoxel = 4;  // units of reach in a voxel's edge

// Balls of one radius in one layer.
struct Task {
  int64_t layer;
  int level;
  std::vector<int64_t> rows;
  double cost;  // about proportional to the time that it takes
};

// A rectangle of columns of bits, a plane for each word: what is done to columns is done to many of them at once.
struct Columns {
  int x0, y0, width, depth, words;  // x from x0 on, y from y0 on
  std::vector<uint64_t> bits;

  Columns(Range x, Range y, int words)
      : x0(x.from), y0(y.from), width(x.size()), depth(y.size()), words(words), bits(plane() * words) {}
  size_t plane() const { return static_cast<size_t>(width) * depth; }
  uint64_t *at(int word, int x, int y) {
    return bits.data() + word * plane() + static_cast<size_t>(x - x0) * depth + (y - y0);
  }
};

// Largest whole number whose square is at most v; -1 for negative ones.
inline int whole_root(int v) {
  if (v < 0) return -1;
  int root = static_cast<int>(std::sqrt(static_cast<double>(v)));
  while (root * root > v) root--;
  while ((root + 1) * (root + 1) <= v) root++;
  return root;
}

// Every run of set bits one longer at both ends; `kept` is room for two planes.
inline void lengthen(Columns &c, std::vector<uint64_t> &kept) {
  const size_t plane = c.plane();
  kept.assign(2 * plane, 0);
  uint64_t *below = kept.data(), *here = below + plane;
  for (int w = 0; w < c.words; w++) {
    uint64_t *own = c.bits.data() + w * plane;
    const bool is_last = w + 1 == c.words;
    const uint64_t *above = is_last ? own : own + plane, used = is_last ? 0 : ~uint64_t{0};
#pragma omp simd
    for (size_t i = 0; i < plane; i++) {
      const uint64_t bits = own[i];
      here[i] = bits;
      own[i] = bits | bits << 1 | bits >> 1 | below[i] >> 63 | (above[i] & used) << 63;
    }
    std::swap(below, here);
  }
}

// `count` bits of each of the same columns, from bit `skipped` on.
inline void crop(const Columns &from, int skipped, int count, Columns &to) {
  const int whole = skipped / 64, rest = skipped % 64;
  const size_t plane = to.plane();
  for (int w = 0; w < to.words; w++) {
    const bool has_high = w + whole + 1 < from.words;
    const uint64_t used = w + 1 == to.words && count % 64 ? (uint64_t{1} << count % 64) - 1 : ~uint64_t{0};
    const uint64_t *low = from.bits.data() + (w + whole) * plane, *high = has_high ? low + plane : low;
    const uint64_t joined = has_high && rest ? ~uint64_t{0} : 0;
    uint64_t *target = to.bits.data() + w * plane;
#pragma omp simd
    for (size_t i = 0; i < plane; i++) {
      target[i] = (low[i] >> rest | (high[i] & joined) << (rest ? 64 - rest : 0)) & used;
    }
  }
}

// The balls of a task, united with what is reached already in those columns of the grid that they may reach.
//
// Whatever is reached in columns that are full by then is known: where bounds are as wide as the grid, and a task of a
// larger radius came before, there is little left to do.
class Union {
 public:
  Union(const Balls &balls, const Task &task)
      : b_(balls), r_(balls.grid), task_(task), whole_(task.level / kPerVoxel), grown_(reachable()) {}

  // Takes over what a mask [nx, ny, words] holds.
  void load(const uint64_t *mask) {
    each_column([&](int w, int64_t x, int64_t y, uint64_t *own) { *own = mask[(x * r_.ny + y) * grown_.words + w]; });
  }

  // Adds the balls.
  void grow() {
    narrow();
    Columns tall = marked();
    if (tall.plane() == 0) return;
    find_filled(tall);
    Columns inner(range_x(tall), range_y(tall), grown_.words);
    std::vector<uint64_t> kept;
    for (int height = 0; height <= whole_; height++) {
      if (height > 0) lengthen(tall, kept);
      crop(tall, whole_, r_.nz, inner);
      unite(inner, height);
    }
  }

  // Sets all of them in that mask.
  void enter(uint64_t *mask) {
    each_column([&](int w, int64_t x, int64_t y, uint64_t *own) { mask[(x * r_.ny + y) * grown_.words + w] |= *own; });
  }

 private:
  static Range range_x(const Columns &c) { return {c.x0, c.x0 + c.width}; }
  static Range range_y(const Columns &c) { return {c.y0, c.y0 + c.depth}; }

  template <class Visit>
  void each_column(const Visit &visit) {
    for (int x = grown_.x0; x < grown_.x0 + grown_.width; x++) {
      for (int w = 0; w < grown_.words; w++) {
        uint64_t *own = grown_.at(w, x, grown_.y0);
        for (int y = grown_.y0; y < grown_.y0 + grown_.depth; y++) visit(w, x, y, own++);
      }
    }
  }

  // Where the balls' middles may be to reach the grid.
  Cuboid reaching() const { return {{-whole_, r_.nx + whole_}, {-whole_, r_.ny + whole_}, {-whole_, r_.nz + whole_}}; }

  // Columns of the grid about those with middles.
  Columns reachable() const {
    Cuboid about;
    for (const int64_t row : task_.rows) about.take_in(b_.box(task_.layer, row).within(reaching()));
    return Columns(
        about.axes[0].wider(whole_).within({0, r_.nx}), about.axes[1].wider(whole_).within({0, r_.ny}), words_of(r_.nz));
  }

  // The middles of balls that reach columns which are not full; bit 0 is `whole_` voxels below the grid.
  Columns marked() const {
    Range open_x, open_y;
    for (int i = 0; i < grown_.width; i++) {
      if (open_[i].is_empty()) continue;
      open_x.take_in({grown_.x0 + i, grown_.x0 + i + 1}), open_y.take_in(open_[i]);
    }
    if (open_x.is_empty()) return Columns({0, 0}, {0, 0}, 1);
    const Cuboid wanted = Cuboid(open_x.wider(whole_), open_y.wider(whole_), reaching().axes[2]).within(reaching());
    Cuboid about;
    for (const int64_t row : task_.rows) about.take_in(b_.box(task_.layer, row).within(wanted));
    if (about.is_empty()) return Columns({0, 0}, {0, 0}, 1);
    Columns marks(about.axes[0], about.axes[1], words_of(r_.nz + 2 * whole_));
    const size_t plane = marks.plane();
    const int x0 = marks.x0, y0 = marks.y0, z0 = -whole_;
    const int64_t depth = marks.depth;
    uint64_t *bits = marks.bits.data();
    for (const int64_t row : task_.rows) {
      const Cuboid box = b_.box(task_.layer, row);
      if (box.within(wanted).is_empty()) continue;
      b_.each_place(task_.layer, row, box.is_within(wanted) ? nullptr : &wanted, [&](int64_t, int x, int y, int z) {
        const unsigned bit = z - z0;
        bits[bit / 64 * plane + (x - x0) * depth + (y - y0)] |= uint64_t{1} << bit % 64;
      });
    }
    return marks;
  }

  // First and one past the last column of each row that is not empty.
  void find_filled(Columns &marks) {
    filled_.assign(marks.width, {});
    for (int w = 0; w < marks.words; w++) {
      for (int x = 0; x < marks.width; x++) {
        const uint64_t *row = marks.at(w, marks.x0 + x, marks.y0);
        for (int y = 0; y < marks.depth; y++) {
          if (row[y]) filled_[x].take_in({marks.y0 + y, marks.y0 + y + 1});
        }
      }
    }
  }

  bool is_full(int x, int y) {
    for (int w = 0; w < grown_.words; w++) {
      const bool is_part = w + 1 == grown_.words && r_.nz % 64;
      if (*grown_.at(w, x, y) != (is_part ? (uint64_t{1} << r_.nz % 64) - 1 : ~uint64_t{0})) return false;
    }
    return true;
  }

  // Leaves full columns at the ends of rows out from now on.
  void narrow() {
    open_.assign(grown_.width, range_y(grown_));
    for (int x = grown_.x0; x < grown_.x0 + grown_.width; x++) {
      Range &open = open_[x - grown_.x0];
      while (!open.is_empty() && is_full(x, open.from)) open.from++;
      while (!open.is_empty() && is_full(x, open.to - 1)) open.to--;
    }
  }

  // Unites the columns with all that lie so far beside them that the ball is `height` voxels high there.
  void unite(Columns &columns, int height) {
    const int reach2 = task_.level * task_.level;
    for (int dx = -whole_; dx <= whole_; dx++) {
      const int left = reach2 - kPerVoxel * kPerVoxel * dx * dx;
      const int outer = whole_root(left / (kPerVoxel * kPerVoxel) - height * height);
      const int inner = whole_root(left / (kPerVoxel * kPerVoxel) - (height + 1) * (height + 1));
      for (int dy = inner + 1; dy <= outer; dy++) {
        shift_in(columns, dx, dy);
        if (dy) shift_in(columns, dx, -dy);
      }
    }
  }

  void shift_in(Columns &columns, int dx, int dy) {
    const Range rows = range_x(columns).within({grown_.x0 - dx, grown_.x0 + grown_.width - dx});
    for (int x = rows.from; x < rows.to; x++) {
      const Range &open = open_[x + dx - grown_.x0];
      const Range some = filled_[x - columns.x0].within({open.from - dy, open.to - dy});
      if (some.is_empty()) continue;
      for (int w = 0; w < grown_.words; w++) {
        const uint64_t *source = columns.at(w, x, some.from);
        uint64_t *target = grown_.at(w, x + dx, some.from + dy);
        const int count = some.size();
#pragma omp simd
        for (int i = 0; i < count; i++) target[i] |= source[i];
      }
    }
  }

  const Balls &b_;
  const GrowRequest &r_;
  const Task &task_;
  const int whole_;
  Columns grown_;
  std::vector<Range> filled_;  // columns of each row of the middles
  std::vector<Range> open_;    // columns of each row of `grown_`: all beside them are full
};

// One task per radius of a layer, of the rows that reach the grid.
inline std::vector<Task> layer_tasks(const Balls &b, int64_t layer) {
  const GrowRequest &r = b.grid;
  const uint16_t *reaches = b.reaches + layer * b.rows();
  const int levels = b.rows() > 0 ? *std::max_element(reaches, reaches + b.rows()) + 1 : 0;
  std::vector<std::vector<int64_t>> members(levels);
  std::vector<int64_t> points(levels);
  for (int64_t row = 0; row < b.rows(); row++) {
    const int level = reaches[row], whole = level / kPerVoxel;
    const Cuboid near({-whole, r.nx + whole}, {-whole, r.ny + whole}, {-whole, r.nz + whole});
    if (b.box(layer, row).within(near).is_empty()) continue;
    members[level].push_back(row), points[level] += b.points(row);
  }
  std::vector<Task> tasks;
  for (int level = 0; level < levels; level++) {
    if (members[level].empty()) continue;
    const double cost = static_cast<double>(level + kPerVoxel) * (level + kPerVoxel) * points[level];
    tasks.push_back({layer, level, std::move(members[level]), cost});
  }
  return tasks;
}

// Columns of a layer's masks that its balls may reach are cleared.
inline void clear_planes(const Balls &b, int64_t layer, const std::vector<Task> &tasks) {
  const GrowRequest &r = b.grid;
  Range x;
  for (const Task &task : tasks) {
    for (const int64_t row : task.rows) x.take_in(b.box(layer, row).axes[0].wider(task.level / kPerVoxel));
  }
  x = x.within({0, r.nx});
  const int64_t first = x.is_empty() ? 0 : x.from, last = x.is_empty() ? 0 : x.to;
  r.planes[2 * layer] = first, r.planes[2 * layer + 1] = last;
  const int64_t row = static_cast<int64_t>(r.ny) * words_of(r.nz), begin = (layer * int64_t{r.nx} + first) * row;
  std::fill_n(r.reached + begin, (last - first) * row, 0);
  std::fill_n(r.core + begin, (last - first) * row, 0);
}

inline void mark_cores(const Balls &b, const Task &task, uint64_t *mask) {
  const GrowRequest &r = b.grid;
  const Cuboid grid({0, r.nx}, {0, r.ny}, {0, r.nz});
  const int64_t words = words_of(r.nz);
  for (const int64_t row : task.rows) {
    if (!b.has_cores(row)) continue;
    b.each_place(task.layer, row, &grid, [&](int64_t i, int64_t x, int64_t y, int z) {
      if (b.is_core(i)) mask[(x * r.ny + y) * words + z / 64] |= uint64_t{1} << z % 64;
    });
  }
}

inline int64_t count_planes(const GrowRequest &r, int64_t layer) {
  const int64_t row = static_cast<int64_t>(r.ny) * words_of(r.nz);
  const uint64_t *first = r.reached + (layer * r.nx + r.planes[2 * layer]) * row;
  const uint64_t *last = r.reached + (layer * r.nx + r.planes[2 * layer + 1]) * row;
  int64_t count = 0;
  for (; first < last; first++) count += __builtin_popcountll(*first);
  return count;
}

inline void grow(const Balls &b) {
  const GrowRequest &r = b.grid;
  const int64_t size = static_cast<int64_t>(r.nx) * r.ny * words_of(r.nz);
  std::vector<std::vector<Task>> layers(r.layers);
  crew::parallel_for(r.threads, r.layers, [&](int64_t layer) {
    layers[layer] = layer_tasks(b, layer);
    clear_planes(b, layer, layers[layer]);
  });
  std::vector<const Task *> tasks;
  for (const std::vector<Task> &own : layers) {
    for (const Task &task : own) tasks.push_back(&task);
  }
  std::stable_sort(tasks.begin(), tasks.end(), [](const Task *a, const Task *b) { return a->cost > b->cost; });
  std::vector<std::mutex> writing(r.layers);
  crew::parallel_for(r.threads, static_cast<int64_t>(tasks.size()), [&](int64_t i) {
    const Task &task = *tasks[i];
    uint64_t *reached = r.reached + task.layer * size;
    Union balls(b, task);
    {
      const std::lock_guard<std::mutex> lock(writing[task.layer]);
      balls.load(reached);
    }
    balls.grow();
    const std::lock_guard<std::mutex> lock(writing[task.layer]);
    balls.enter(reached);
    mark_cores(b, task, r.core + task.layer * size);
  });
  crew::parallel_for(r.threads, r.layers, [&](int64_t layer) { r.counts[layer] = count_planes(r, layer); });
}

}  // namespace forecast
