// Where something may be hidden: ways through unknown space, and how long ago they were reached.
#pragma once

#include <algorithm>
#include <numeric>
#include <utility>
#include <vector>

#include "bits.h"
#include "interface.h"

namespace forecast {

// Cells one above the other.
struct Stretch {
  int64_t begin, end;  // first cell and one past the last
  int64_t cells;       // of its piece, where it is the root
};

// The cells that what is attached reached last so long ago, s.
struct Reached {
  float age;
  Bits cells;
};

// Pieces of cells that touch at faces, edges or corners.
class Pieces {
 public:
  Pieces(const Bits &cells, int64_t nz) : starts_(cells.nx * cells.ny + 1) {
    for (int64_t column = 0; column < cells.nx * cells.ny; column++) {
      starts_[column] = static_cast<int64_t>(stretches_.size());
      find(cells, column, nz);
    }
    starts_.back() = static_cast<int64_t>(stretches_.size());
    parents_.resize(stretches_.size());
    std::iota(parents_.begin(), parents_.end(), 0);
    for (int64_t x = 0; x < cells.nx; x++) {
      for (int64_t y = 0; y < cells.ny; y++) {
        const int64_t own = x * cells.ny + y, below = own - cells.ny;
        if (y > 0) unite(own, own - 1);
        if (x > 0) unite(own, below);
        if (x > 0 && y > 0) unite(own, below - 1);
        if (x > 0 && y + 1 < cells.ny) unite(own, below + 1);
      }
    }
  }

  // Takes away the cells of pieces of fewer than `fewest`.
  void drop_small(Bits &cells, int64_t fewest) {
    for (int64_t column = 0; column + 1 < static_cast<int64_t>(starts_.size()); column++) {
      for (int64_t i = starts_[column]; i < starts_[column + 1]; i++) {
        if (stretches_[root(i)].cells >= fewest) continue;
        for (int64_t z = stretches_[i].begin; z < stretches_[i].end; z++) {
          cells.bits[column * cells.words + z / 64] &= ~(uint64_t{1} << z % 64);
        }
      }
    }
  }

 private:
  void find(const Bits &cells, int64_t column, int64_t nz) {
    const uint64_t *words = cells.bits.data() + column * cells.words;
    for (int64_t z = 0; z < nz;) {
      const uint64_t left = words[z / 64] >> z % 64;
      if (left == 0) {
        z = (z / 64 + 1) * 64;
        continue;
      }
      z += __builtin_ctzll(left);
      const int64_t begin = z;
      while (z < nz && words[z / 64] >> z % 64 & 1) z++;
      stretches_.push_back({begin, z, z - begin});
    }
  }

  int64_t root(int64_t i) {
    while (parents_[i] != i) i = parents_[i] = parents_[parents_[i]];
    return i;
  }

  void unite(int64_t column, int64_t other) {
    int64_t i = starts_[column], j = starts_[other];
    while (i < starts_[column + 1] && j < starts_[other + 1]) {
      const Stretch &one = stretches_[i], &two = stretches_[j];
      if (one.begin <= two.end && two.begin <= one.end) {
        const int64_t a = root(i), b = root(j);
        if (a != b) stretches_[std::min(a, b)].cells += stretches_[std::max(a, b)].cells;
        parents_[std::max(a, b)] = std::min(a, b);
      }
      (one.end < two.end ? i : j)++;
    }
  }

  std::vector<int64_t> starts_;  // [columns + 1] of each column's stretches
  std::vector<Stretch> stretches_;
  std::vector<int64_t> parents_;
};

// The cells that were reached lately, by how long ago, the youngest first; those that something moves in, and those at
// the grid's sides but for its bottom, are reached now.
inline std::vector<Reached> reached_lately(const HideRequest &r, const Bits &moving) {
  const int64_t cx = moving.nx, cy = moving.ny, cz = (r.nz + 1) / 2;
  const int64_t words = moving.words;
  Bits now = moving;
  for (int64_t x = 0; x < cx; x++) {
    for (int64_t y = 0; y < cy; y++) {
      uint64_t *column = now.at(x, y);
      if (x == 0 || y == 0 || x == cx - 1 || y == cy - 1) std::fill_n(column, words, ~uint64_t{0});
      column[(cz - 1) / 64] |= uint64_t{1} << (cz - 1) % 64;
    }
  }
  std::vector<Reached> reached;
  reached.push_back({0.0f, std::move(now)});
  size_t last = 0;  // that a cell belonged to: neighbours were mostly reached together
  for (int64_t word = 0; word < cx * cy * words; word++) {
    const float *ages = r.ages + word / words * cz + word % words * 64;
    for (uint64_t left = r.reached[word]; left; left &= left - 1) {
      const int z = __builtin_ctzll(left);
      const float age = ages[z] + r.elapsed_s;
      if (age > r.rest_s) continue;
      if (reached[last].age != age) {
        const auto is_older = [&](const Reached &one) { return one.age >= age; };
        auto own = std::find_if(reached.begin(), reached.end(), is_older);
        if (own == reached.end() || own->age > age) own = reached.insert(own, {age, Bits(cx, cy, cz)});
        last = own - reached.begin();
      }
      reached[last].cells.bits[word] |= uint64_t{1} << z;
    }
  }
  return reached;
}

// Voxels where a hand's width is unknown or moving.
inline Bits passable(const HideRequest &r, const Bits &moving) {
  Bits beside(r.nx, r.ny, r.nz, r.standing);
  join_around<Join::kAny>(beside, -1, 1);  // beside what stands lie the rims of its measurement
  Bits passable(r.nx, r.ny, r.nz, r.unknown);
  for (size_t i = 0; i < passable.bits.size(); i++) {
    const uint64_t bottom = i % passable.words == 0;
    passable.bits[i] = (passable.bits[i] & ~(beside.bits[i] | bottom)) | moving.bits[i];
  }
  join_around<Join::kAll>(passable, 0, r.width - 1);
  join_around<Join::kAny>(passable, 1 - r.width, 0);
  return passable;
}

// Forgets the ages of all cells, [columns, cz] in columns of words.
inline void clear(const HideRequest &r, int64_t cz, int64_t words) {
  const int64_t size = (r.nx + 1) / 2 * ((r.ny + 1) / 2) * words;
  for (int64_t word = 0; word < size; word++) {
    float *ages = r.ages + word / words * cz + word % words * 64;
    for (uint64_t left = r.reached[word]; left; left &= left - 1) ages[__builtin_ctzll(left)] = r.never;
  }
}

// Keeps those of the bits that others have too.
inline void keep(Bits &b, const Bits &others) {
  for (size_t i = 0; i < b.bits.size(); i++) b.bits[i] &= others.bits[i];
}

// Spreads cells to their neighbours, within `ways`, so many times or until there is no more.
inline void spread(Bits &cells, const Bits &ways, int64_t times) {
  for (; times > 0; times--) {
    const std::vector<uint64_t> before = cells.bits;
    widen(cells, 1);
    keep(cells, ways);
    if (cells.bits == before) return;
  }
}

// Writes ages into cells, each its least: the youngest of `reached` come first. Returns all that have one.
inline Bits write_ages(const HideRequest &r, const std::vector<Reached> &reached, int64_t cz) {
  Bits written(reached[0].cells.nx, reached[0].cells.ny, cz);
  for (const Reached &one : reached) {
    for (size_t word = 0; word < written.bits.size(); word++) {
      float *ages = r.ages + word / written.words * cz + word % written.words * 64;
      for (uint64_t left = one.cells.bits[word] & ~written.bits[word]; left; left &= left - 1) {
        ages[__builtin_ctzll(left)] = one.age;
      }
      written.bits[word] |= one.cells.bits[word];
    }
  }
  return written;
}

inline void hide(const HideRequest &r) {
  const Bits moving(r.nx, r.ny, r.nz, r.moving);
  std::vector<Reached> reached = reached_lately(r, halved(moving, r.nz));
  const Bits ways = halved(passable(r, moving), r.nz);
  const int64_t cz = (r.nz + 1) / 2;
  Bits roomy = ways;  // where a hand fits in
  Pieces(ways, cz).drop_small(roomy, r.fewest);
  for (Reached &one : reached) {
    const Bits &own = one.age > 0 ? roomy : ways;
    widen(one.cells, r.hop);
    keep(one.cells, own);
    spread(one.cells, own, r.way);
  }
  clear(r, cz, ways.words);
  Bits open = write_ages(r, reached, cz);
  std::copy(open.bits.begin(), open.bits.end(), r.reached);
  join_around<Join::kAny>(open, -1, 1);
  for (int64_t x = 0; x < r.nx; x++) {
    for (int64_t y = 0; y < r.ny; y++) {
      const int64_t first = (x * r.ny + y) * moving.words;
      const uint64_t *cells = open.at(x / 2, y / 2);
      for (int64_t w = 0; w < moving.words; w++) {
        const uint64_t unknown = r.unknown[first + w];
        const uint64_t reachable = unknown & doubled_bits(cells[w / 2] >> 32 * (w % 2));
        r.reachable[first + w] = reachable;
        r.maybe_full[first + w] = (r.maybe_full[first + w] & unknown) | reachable;
      }
    }
  }
}

}  // namespace forecast
