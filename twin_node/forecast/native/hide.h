// Where something may be hidden: ways through unknown space, and how long ago they were reached.
#pragma once

#include <algorithm>
#include <cstring>
#include <limits>
#include <numeric>
#include <vector>

#include "interface.h"

namespace forecast {

// Bits in columns along z, lowest first.
struct Bits {
  int64_t nx, ny, words;
  std::vector<uint64_t> bits;

  Bits(int64_t nx, int64_t ny, int64_t nz) : nx(nx), ny(ny), words((nz + 63) / 64), bits(nx * ny * words) {}
  uint64_t *at(int64_t x, int64_t y) { return bits.data() + (x * ny + y) * words; }
  const uint64_t *at(int64_t x, int64_t y) const { return bits.data() + (x * ny + y) * words; }
};

// Eight bytes of 0 or 1 as eight bits.
inline uint64_t eight_bits(const uint8_t *bytes) {
  uint64_t together;
  std::memcpy(&together, bytes, 8);
  return together * 0x0102040810204080 >> 56;
}

inline Bits packed(const uint8_t *mask, int64_t nx, int64_t ny, int64_t nz) {
  Bits out(nx, ny, nz);
  for (int64_t column = 0; column < nx * ny; column++, mask += nz) {
    uint8_t any = 0;
    for (int64_t z = 0; z < nz; z++) any |= mask[z];
    if (!any) continue;  // most of them
    uint64_t *words = out.bits.data() + column * out.words;
    int64_t z = 0;
    for (; z + 8 <= nz; z += 8) words[z / 64] |= eight_bits(mask + z) << z % 64;
    for (; z < nz; z++) words[z / 64] |= static_cast<uint64_t>(mask[z]) << z % 64;
  }
  return out;
}

enum class Join { kAll, kAny };

template <Join join>
inline uint64_t joined(uint64_t one, uint64_t other) {
  return join == Join::kAll ? one & other : one | other;
}

// Words joined with those `offset` further on, of lines that begin at every multiple of `line`; none lie beyond a line.
template <Join join>
inline void join_along(
    const std::vector<uint64_t> &before, std::vector<uint64_t> &words, int64_t line, int64_t offset) {
  for (int64_t begin = 0; begin < static_cast<int64_t>(words.size()); begin += line) {
    uint64_t *own = &words[begin];
    const uint64_t *from = &before[begin];
    const int64_t first = std::clamp<int64_t>(-offset, 0, line);
    const int64_t last = std::clamp<int64_t>(line - offset, first, line);
    if (join == Join::kAll) std::fill(own, own + first, 0), std::fill(own + last, own + line, 0);
    for (int64_t i = first; i < last; i++) own[i] = joined<join>(own[i], from[i + offset]);
  }
}

// Bits of columns of words joined with those `step` further up, -63 to 63; `beside` is room for as many words.
template <Join join>
inline void join_up(
    const std::vector<uint64_t> &before, std::vector<uint64_t> &words, std::vector<uint64_t> &beside, int64_t column,
    int64_t step) {
  const int64_t shift = std::abs(step), size = static_cast<int64_t>(words.size());
  const int64_t up = step > 0 ? 1 : 0, down = 1 - up;  // words are moved as a whole, then columns parted again
  std::copy(before.begin() + up, before.end() - down, beside.begin() + down);
  for (int64_t end = up ? column - 1 : 0; end < size; end += column) beside[end] = 0;
  const uint64_t *own = before.data(), *next = beside.data();
  uint64_t *to = words.data();
  if (up) {
    for (int64_t i = 0; i < size; i++) to[i] = joined<join>(to[i], own[i] >> shift | next[i] << (64 - shift));
  } else {
    for (int64_t i = 0; i < size; i++) to[i] = joined<join>(to[i], own[i] << shift | next[i] >> (64 - shift));
  }
}

// Every bit joined with those from `first` to `last` places further up each axis; outside there are none.
template <Join join>
inline void join_around(Bits &b, int64_t first, int64_t last) {
  const int64_t row = b.ny * b.words, all = b.nx * row;
  std::vector<uint64_t> before, beside(b.bits.size());
  for (int axis = 0; axis < 3; axis++) {
    before = b.bits;
    for (int64_t step = first; step <= last; step++) {
      if (step == 0) continue;
      if (axis == 0) join_along<join>(before, b.bits, all, step * row);
      if (axis == 1) join_along<join>(before, b.bits, row, step * b.words);
      if (axis == 2) join_up<join>(before, b.bits, beside, b.words, step);
    }
  }
}

// The even bits of a word next to each other.
inline uint64_t even_bits(uint64_t word) {
  word &= 0x5555555555555555;
  word = (word | word >> 1) & 0x3333333333333333;
  word = (word | word >> 2) & 0x0F0F0F0F0F0F0F0F;
  word = (word | word >> 4) & 0x00FF00FF00FF00FF;
  word = (word | word >> 8) & 0x0000FFFF0000FFFF;
  return (word | word >> 16) & 0x00000000FFFFFFFF;
}

// Cells of two by two by two bits that hold any; bits beside the grid do not count.
inline Bits halved(const Bits &b, int64_t nz) {
  Bits out((b.nx + 1) / 2, (b.ny + 1) / 2, (nz + 1) / 2);
  for (int64_t x = 0; x < b.nx; x++) {
    for (int64_t y = 0; y < b.ny; y++) {
      const uint64_t *from = b.at(x, y);
      uint64_t *to = out.at(x / 2, y / 2);
      for (int64_t w = 0; w < b.words; w++) {
        const int64_t left = nz - 64 * w;
        const uint64_t word = left < 64 ? from[w] & ((uint64_t{1} << left) - 1) : from[w];
        to[w / 2] |= even_bits(word | word >> 1) << 32 * (w % 2);
      }
    }
  }
  return out;
}

// Least values of those up to `cells` steps before and after each, all over a line.
inline void least_along(const std::vector<float> &before, std::vector<float> &least, int64_t step, int64_t cells) {
  const int64_t size = static_cast<int64_t>(before.size());
  std::copy(before.begin(), before.end(), least.begin());
  for (int64_t offset = step; offset <= cells * step && offset < size; offset += step) {
    for (int64_t i = 0; i < size - offset; i++) least[i] = std::min(least[i], before[i + offset]);
    for (int64_t i = offset; i < size; i++) least[i] = std::min(least[i], before[i - offset]);
  }
}

// Least value of the cube of so many cells around each of [nx, ny, nz].
inline void least_around(std::vector<float> &values, int64_t nx, int64_t ny, int64_t nz, int64_t cells) {
  const int64_t tall = nz + cells, plane = ny * nz;
  std::vector<float> one(ny * tall, std::numeric_limits<float>::infinity()), other(one), planes(values.size());
  for (int64_t x = 0; x < nx; x++) {  // a plane at a time, its columns apart, stays in the cache
    const auto column = [&](std::vector<float> &of, int64_t y) { return of.begin() + (x * ny + y) * nz; };
    for (int64_t y = 0; y < ny; y++) {
      const auto end = std::copy_n(column(values, y), nz, one.begin() + y * tall);
      std::fill_n(end, cells, std::numeric_limits<float>::infinity());
    }
    least_along(one, other, 1, cells);
    least_along(other, one, tall, cells);
    for (int64_t y = 0; y < ny; y++) std::copy_n(one.begin() + y * tall, nz, column(planes, y));
  }
  for (int64_t x = 0; x < nx; x++) {
    float *least = &values[x * plane];
    std::copy_n(&planes[x * plane], plane, least);
    for (int64_t near = std::max<int64_t>(x - cells, 0); near <= std::min(x + cells, nx - 1); near++) {
      const float *beside = &planes[near * plane];
      for (int64_t i = 0; i < plane; i++) least[i] = std::min(least[i], beside[i]);
    }
  }
}

// Cells one above the other.
struct Stretch {
  int64_t begin, end;  // first cell and one past the last
  float least;
};

// Pieces of cells that touch at faces, edges or corners, and the least value in each.
class Pieces {
 public:
  Pieces(const Bits &cells, int64_t nz, const std::vector<float> &values) : starts_(cells.nx * cells.ny + 1) {
    for (int64_t column = 0; column < cells.nx * cells.ny; column++) {
      starts_[column] = static_cast<int64_t>(stretches_.size());
      find(cells.bits.data() + column * cells.words, nz, values.data() + column * nz);
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

  // Gives every cell its piece's least value, or `otherwise` where that is above `most` and outside of all pieces; the
  // cells whose values are at most `most`.
  Bits write(std::vector<float> &values, int64_t nx, int64_t ny, int64_t nz, float most, float otherwise) {
    Bits written(nx, ny, nz);
    std::fill(values.begin(), values.end(), otherwise);
    for (int64_t column = 0; column + 1 < static_cast<int64_t>(starts_.size()); column++) {
      for (int64_t i = starts_[column]; i < starts_[column + 1]; i++) {
        const float least = stretches_[root(i)].least;
        if (least > most) continue;
        for (int64_t z = stretches_[i].begin; z < stretches_[i].end; z++) {
          values[column * nz + z] = least;
          written.bits[column * written.words + z / 64] |= uint64_t{1} << z % 64;
        }
      }
    }
    return written;
  }

 private:
  void find(const uint64_t *words, int64_t nz, const float *values) {
    for (int64_t z = 0; z < nz;) {
      const uint64_t left = words[z / 64] >> z % 64;
      if (left == 0) {
        z = (z / 64 + 1) * 64;
        continue;
      }
      z += __builtin_ctzll(left);
      const int64_t begin = z;
      while (z < nz && words[z / 64] >> z % 64 & 1) z++;
      stretches_.push_back({begin, z, *std::min_element(values + begin, values + z)});
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
        const float least = std::min(stretches_[a].least, stretches_[b].least);
        parents_[std::max(a, b)] = std::min(a, b);
        stretches_[std::min(a, b)].least = least;
      }
      (one.end < two.end ? i : j)++;
    }
  }

  std::vector<int64_t> starts_;  // [columns + 1] of each column's stretches
  std::vector<Stretch> stretches_;
  std::vector<int64_t> parents_;
};

inline void hide(const HideRequest &r) {
  const int64_t nx = r.nx, ny = r.ny, nz = r.nz, cx = (nx + 1) / 2, cy = (ny + 1) / 2, cz = (nz + 1) / 2;
  const Bits moving = packed(r.moving, nx, ny, nz);
  Bits beside = packed(r.standing, nx, ny, nz);
  join_around<Join::kAny>(beside, -1, 1);  // beside what stands lie the rims of its measurement
  Bits passable = packed(r.unknown, nx, ny, nz);
  for (size_t i = 0; i < passable.bits.size(); i++) {
    const uint64_t bottom = i % passable.words == 0;
    passable.bits[i] = (passable.bits[i] & ~(beside.bits[i] | bottom)) | moving.bits[i];
  }
  join_around<Join::kAll>(passable, 0, r.width - 1);
  join_around<Join::kAny>(passable, 1 - r.width, 0);

  std::vector<float> ages(r.ages, r.ages + cx * cy * cz);
  for (float &age : ages) age += r.elapsed_s;
  const Bits near = halved(moving, nz);
  for (int64_t x = 0; x < cx; x++) {
    for (int64_t y = 0; y < cy; y++) {
      float *column = &ages[(x * cy + y) * cz];
      column[cz - 1] = 0;
      if (x == 0 || y == 0 || x == cx - 1 || y == cy - 1) std::fill_n(column, cz, 0.0f);
      for (int64_t w = 0; w < near.words; w++) {
        for (uint64_t left = near.at(x, y)[w]; left; left &= left - 1) column[64 * w + __builtin_ctzll(left)] = 0;
      }
    }
  }
  least_around(ages, cx, cy, cz, r.reach);
  Bits reached = Pieces(halved(passable, nz), cz, ages).write(ages, cx, cy, cz, r.rest_s, r.never);
  std::copy(ages.begin(), ages.end(), r.ages);

  join_around<Join::kAny>(reached, -1, 1);
  std::vector<uint8_t> open(2 * cz);
  for (int64_t cell = 0; cell < cx * cy; cell++) {
    const uint64_t *words = reached.bits.data() + cell * reached.words;
    for (int64_t z = 0; z < cz; z++) open[2 * z] = open[2 * z + 1] = words[z / 64] >> z % 64 & 1;
    for (int64_t x = cell / cy * 2; x < std::min(nx, cell / cy * 2 + 2); x++) {
      for (int64_t y = cell % cy * 2; y < std::min(ny, cell % cy * 2 + 2); y++) {
        const int64_t first = (x * ny + y) * nz;
        const uint8_t *unknown = r.unknown + first;
        uint8_t *reachable = r.reachable + first, *maybe_full = r.maybe_full + first;
        for (int64_t z = 0; z < nz; z++) {
          reachable[z] = unknown[z] & open[z];
          maybe_full[z] = (maybe_full[z] & unknown[z]) | reachable[z];
        }
      }
    }
  }
}

}  // namespace forecast
