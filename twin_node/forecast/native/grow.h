// Union of balls on packed bits: exact, whatever the number of balls.
#pragma once

#include <algorithm>
#include <cmath>
#include <mutex>
#include <vector>

#include "bits.h"
#include "interface.h"

namespace forecast {

constexpr int kPerVoxel = 4;  // units of reach in a voxel's edge

// Balls of one radius in one layer.
struct Task {
  int layer, level;
  std::vector<int64_t> points;
  double cost;  // about proportional to the time that it takes
};

// A rectangle of columns of bits.
struct Columns {
  int x0, y0, width, depth, words;  // x from x0 on, y from y0 on
  std::vector<uint64_t> bits;

  Columns(int x0, int y0, int width, int depth, int words)
      : x0(x0), y0(y0), width(width), depth(depth), words(words), bits(static_cast<size_t>(width) * depth * words) {}
  uint64_t *at(int x, int y) { return bits.data() + (static_cast<size_t>(x - x0) * depth + (y - y0)) * words; }
};

// Largest whole number whose square is at most v; -1 for negative ones.
inline int whole_root(int v) {
  if (v < 0) return -1;
  int root = static_cast<int>(std::sqrt(static_cast<double>(v)));
  while (root * root > v) root--;
  while ((root + 1) * (root + 1) <= v) root++;
  return root;
}

// Every run of set bits one longer at both ends.
inline void lengthen(Columns &c) {
  for (size_t first = 0; first < c.bits.size(); first += c.words) {
    uint64_t *column = c.bits.data() + first;
    uint64_t below = 0;
    for (int w = 0; w < c.words; w++) {
      const uint64_t own = column[w], above = w + 1 < c.words ? column[w + 1] : 0;
      column[w] = own | own << 1 | own >> 1 | below >> 63 | above << 63;
      below = own;
    }
  }
}

// `count` bits of each of the same columns, from bit `skipped` on.
inline void crop(const Columns &from, int skipped, int count, Columns &to) {
  const int whole = skipped / 64, rest = skipped % 64;
  const uint64_t used = count % 64 ? (uint64_t{1} << count % 64) - 1 : ~uint64_t{0};  // of the last word
  for (size_t column = 0; column < static_cast<size_t>(from.width) * from.depth; column++) {
    const uint64_t *source = from.bits.data() + column * from.words;
    uint64_t *target = to.bits.data() + column * to.words;
    for (int w = 0; w < to.words; w++) {
      const uint64_t low = w + whole < from.words ? source[w + whole] : 0;
      const uint64_t high = w + whole + 1 < from.words ? source[w + whole + 1] : 0;
      target[w] = rest ? low >> rest | high << (64 - rest) : low;
    }
    target[to.words - 1] &= used;
  }
}

struct Place {
  int x, y, z;
};

inline Place place_of(const GrowRequest &r, int layer, int64_t point) {
  const int32_t *shift = r.shifts + 3 * (static_cast<int64_t>(layer) * r.parts + r.labels[point]);
  return {r.places[point] + shift[0], r.places[r.points + point] + shift[1], r.places[2 * r.points + point] + shift[2]};
}

// The balls of a task, united into those columns of the grid that they may reach.
class Union {
 public:
  Union(const GrowRequest &request, const Task &task)
      : r_(request), task_(task), whole_(task.level / kPerVoxel), tall_(marked()), grown_(reachable()) {
    Columns inner(tall_.x0, tall_.y0, tall_.width, tall_.depth, grown_.words);
    find_filled(tall_);
    for (int height = 0; height <= whole_; height++) {
      if (height > 0) lengthen(tall_);
      crop(tall_, whole_, r_.nz, inner);
      unite(inner, height);
    }
  }

  // Sets them in a mask [nx, ny, words].
  void enter(uint64_t *mask) const {
    const int64_t row = static_cast<int64_t>(grown_.depth) * grown_.words;
    for (int64_t x = 0; x < grown_.width; x++) {
      const uint64_t *own = grown_.bits.data() + x * row;
      uint64_t *to = mask + ((grown_.x0 + x) * r_.ny + grown_.y0) * grown_.words;
      for (int64_t w = 0; w < row; w++) to[w] |= own[w];
    }
  }

 private:
  // Columns of the grid about those with middles: all points of a task reach the grid.
  Columns reachable() const {
    const int x0 = std::max(tall_.x0 - whole_, 0), x1 = std::min(tall_.x0 + tall_.width + whole_, r_.nx);
    const int y0 = std::max(tall_.y0 - whole_, 0), y1 = std::min(tall_.y0 + tall_.depth + whole_, r_.ny);
    return Columns(x0, y0, x1 - x0, y1 - y0, words_of(r_.nz));
  }

  // The balls' middles; bit 0 is `whole_` voxels below the grid.
  Columns marked() const {
    int low[2] = {r_.nx + whole_, r_.ny + whole_}, high[2] = {-whole_, -whole_};
    for (const int64_t point : task_.points) {
      const Place p = place_of(r_, task_.layer, point);
      low[0] = std::min(low[0], p.x), high[0] = std::max(high[0], p.x);
      low[1] = std::min(low[1], p.y), high[1] = std::max(high[1], p.y);
    }
    Columns marks(low[0], low[1], high[0] - low[0] + 1, high[1] - low[1] + 1, words_of(r_.nz + 2 * whole_));
    for (const int64_t point : task_.points) {
      const Place p = place_of(r_, task_.layer, point);
      const int bit = p.z + whole_;
      marks.at(p.x, p.y)[bit / 64] |= uint64_t{1} << bit % 64;
    }
    return marks;
  }

  // First and one past the last column of each row that is not empty.
  void find_filled(const Columns &marks) {
    first_.assign(marks.width, marks.depth);
    last_.assign(marks.width, 0);
    for (int x = 0; x < marks.width; x++) {
      const uint64_t *row = marks.bits.data() + static_cast<size_t>(x) * marks.depth * marks.words;
      for (int y = 0; y < marks.depth; y++) {
        uint64_t any = 0;
        for (int w = 0; w < marks.words; w++) any |= row[static_cast<size_t>(y) * marks.words + w];
        if (any) first_[x] = std::min(first_[x], y), last_[x] = y + 1;
      }
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
    const int from = std::max(columns.x0, -dx), to = std::min(columns.x0 + columns.width, r_.nx - dx);
    for (int x = from; x < to; x++) {
      const int row = x - columns.x0;
      const int start = std::max(columns.y0 + first_[row], -dy), stop = std::min(columns.y0 + last_[row], r_.ny - dy);
      if (start >= stop) continue;
      const uint64_t *source = columns.at(x, start);
      uint64_t *target = grown_.at(x + dx, start + dy);
      const int count = (stop - start) * grown_.words;
#pragma omp simd
      for (int i = 0; i < count; i++) target[i] |= source[i];
    }
  }

  const GrowRequest &r_;
  const Task &task_;
  const int whole_;
  Columns tall_, grown_;
  std::vector<int> first_, last_;
};

// One task per radius of a layer, of the points that reach the grid.
inline std::vector<Task> layer_tasks(const GrowRequest &r, int layer) {
  const uint16_t *reaches = r.reaches + static_cast<int64_t>(layer) * r.parts;
  const int levels = r.parts > 0 ? *std::max_element(reaches, reaches + r.parts) + 1 : 0;
  std::vector<int64_t> most(levels);
  for (int64_t point = 0; point < r.points; point++) most[reaches[r.labels[point]]]++;
  std::vector<std::vector<int64_t>> members(levels);
  for (int level = 0; level < levels; level++) members[level].reserve(most[level]);
  for (int64_t point = 0; point < r.points; point++) {
    const int level = reaches[r.labels[point]], whole = level / kPerVoxel;
    const Place p = place_of(r, layer, point);
    if (p.x < -whole || p.x >= r.nx + whole || p.y < -whole || p.y >= r.ny + whole || p.z < -whole ||
        p.z >= r.nz + whole) {
      continue;
    }
    members[level].push_back(point);
  }
  std::vector<Task> tasks;
  for (int level = 0; level < levels; level++) {
    if (members[level].empty()) continue;
    const double cost = static_cast<double>(level + kPerVoxel) * (level + kPerVoxel) * members[level].size();
    tasks.push_back({layer, level, std::move(members[level]), cost});
  }
  return tasks;
}

// Columns of a layer's masks that its balls may reach are cleared.
inline void clear_planes(const GrowRequest &r, int layer, const std::vector<Task> &tasks) {
  int64_t first = r.nx, last = 0;
  for (const Task &task : tasks) {
    const int64_t whole = task.level / kPerVoxel;
    for (const int64_t point : task.points) {
      const int64_t x = place_of(r, layer, point).x;
      first = std::min(first, x - whole), last = std::max(last, x + whole + 1);
    }
  }
  first = std::max<int64_t>(first, 0), last = std::max(std::min<int64_t>(last, r.nx), first);
  r.planes[2 * layer] = first, r.planes[2 * layer + 1] = last;
  const int64_t row = static_cast<int64_t>(r.ny) * words_of(r.nz), begin = (layer * int64_t{r.nx} + first) * row;
  std::fill_n(r.reached + begin, (last - first) * row, 0);
  std::fill_n(r.core + begin, (last - first) * row, 0);
}

inline void mark_cores(const GrowRequest &r, const Task &task, uint64_t *mask) {
  for (const int64_t point : task.points) {
    if (!r.cores[point]) continue;
    const Place p = place_of(r, task.layer, point);
    if (p.x < 0 || p.x >= r.nx || p.y < 0 || p.y >= r.ny || p.z < 0 || p.z >= r.nz) continue;
    mask[(static_cast<int64_t>(p.x) * r.ny + p.y) * words_of(r.nz) + p.z / 64] |= uint64_t{1} << p.z % 64;
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

inline void grow(const GrowRequest &r) {
  const int64_t size = static_cast<int64_t>(r.nx) * r.ny * words_of(r.nz);
  std::vector<std::vector<Task>> layers(r.layers);
  crew::parallel_for(r.threads, r.layers, [&](int64_t layer) {
    layers[layer] = layer_tasks(r, static_cast<int>(layer));
    clear_planes(r, static_cast<int>(layer), layers[layer]);
  });
  std::vector<const Task *> tasks;
  for (const std::vector<Task> &own : layers) {
    for (const Task &task : own) tasks.push_back(&task);
  }
  std::stable_sort(tasks.begin(), tasks.end(), [](const Task *a, const Task *b) { return a->cost > b->cost; });
  std::vector<std::mutex> writing(r.layers);
  crew::parallel_for(r.threads, static_cast<int64_t>(tasks.size()), [&](int64_t i) {
    const Task &task = *tasks[i];
    const Union balls(r, task);
    const std::lock_guard<std::mutex> lock(writing[task.layer]);
    balls.enter(r.reached + task.layer * size);
    mark_cores(r, task, r.core + task.layer * size);
  });
  crew::parallel_for(r.threads, r.layers, [&](int64_t layer) { r.counts[layer] = count_planes(r, layer); });
}

}  // namespace forecast
