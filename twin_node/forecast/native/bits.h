// Masks of voxels, one bit each: voxel (x, y, z) is bit z % 64 of word z / 64 of column (x, y).
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <vector>

#include "../../native/boundary.h"
#include "../../native/crew.h"
#include "interface.h"

namespace forecast {

inline int words_of(int bits) { return (bits + 63) / 64; }

// Bits in columns along z, lowest first.
struct Bits {
  int64_t nx, ny, words;
  std::vector<uint64_t> bits;

  Bits(int64_t nx, int64_t ny, int64_t nz) : nx(nx), ny(ny), words(words_of(nz)), bits(nx * ny * words) {}
  Bits(int64_t nx, int64_t ny, int64_t nz, const uint64_t *from)
      : nx(nx), ny(ny), words(words_of(nz)), bits(from, from + nx * ny * words) {}
  uint64_t *at(int64_t x, int64_t y) { return bits.data() + (x * ny + y) * words; }
  const uint64_t *at(int64_t x, int64_t y) const { return bits.data() + (x * ny + y) * words; }
};

enum class Join { kAll, kAny };

template <Join join>
inline uint64_t joined(uint64_t one, uint64_t other) {
  return join == Join::kAll ? one & other : one | other;
}

// `size` words joined with those `offset` further on, of lines that begin at every multiple of `line`; none lie beyond a
// line.
template <Join join>
inline void join_along(const uint64_t *before, uint64_t *words, int64_t size, int64_t line, int64_t offset) {
  const int64_t first = std::clamp<int64_t>(-offset, 0, line);
  const int64_t last = std::clamp<int64_t>(line - offset, first, line);
  for (int64_t begin = 0; begin < size; begin += line) {
    uint64_t *own = words + begin;
    const uint64_t *from = before + begin;
    if (join == Join::kAll) std::fill(own, own + first, 0), std::fill(own + last, own + line, 0);
    for (int64_t i = first; i < last; i++) own[i] = joined<join>(own[i], from[i + offset]);
  }
}

// Bits of columns of words, `size` in all, joined with those `step` further up, -63 to 63; `beside` is room for as many.
template <Join join>
inline void join_up(
    const uint64_t *before, uint64_t *words, uint64_t *beside, int64_t size, int64_t column, int64_t step) {
  const int64_t shift = std::abs(step);
  const int64_t up = step > 0 ? 1 : 0, down = 1 - up;  // words are moved as a whole, then columns parted again
  std::copy(before + up, before + size - down, beside + down);
  for (int64_t end = up ? column - 1 : 0; end < size; end += column) beside[end] = 0;
  if (up) {
    for (int64_t i = 0; i < size; i++) words[i] = joined<join>(words[i], before[i] >> shift | beside[i] << (64 - shift));
  } else {
    for (int64_t i = 0; i < size; i++) words[i] = joined<join>(words[i], before[i] << shift | beside[i] >> (64 - shift));
  }
}

// Every bit joined with those so many places further along each axis, from -63 to 63; outside there are none.
template <Join join>
inline void join_at(Bits &b, const std::vector<int64_t> &steps) {
  const int64_t row = b.ny * b.words;
  std::vector<uint64_t> before(row), beside(row);
  for (int64_t x = 0; x < b.nx; x++) {  // a plane at a time stays in the cache
    uint64_t *plane = b.at(x, 0);
    std::copy_n(plane, row, before.begin());
    for (const int64_t step : steps) join_along<join>(before.data(), plane, row, row, step * b.words);
    std::copy_n(plane, row, before.begin());
    for (const int64_t step : steps) join_up<join>(before.data(), plane, beside.data(), row, b.words, step);
  }
  before = b.bits;
  const int64_t size = b.nx * row;
  for (const int64_t step : steps) join_along<join>(before.data(), b.bits.data(), size, size, step * row);
}

// Every bit joined with those from `first` to `last` places further up each axis.
template <Join join>
inline void join_around(Bits &b, int64_t first, int64_t last) {
  std::vector<int64_t> steps;
  for (int64_t step = first; step <= last; step++) {
    if (step != 0) steps.push_back(step);
  }
  join_at<join>(b, steps);
}

// Sets the cubes of so many bits around each.
inline void widen(Bits &b, int64_t width) {
  constexpr int64_t kMostStep = 63;
  for (int64_t done = 0, step; done < width; done += step) {
    step = std::min({width - done, 2 * done + 1, kMostStep});  // such cubes leave nothing between them
    join_at<Join::kAny>(b, {-step, step});
  }
}

// Eight bytes of 0 or 1 as eight bits.
inline uint64_t eight_bits(const uint8_t *bytes) {
  uint64_t together = 0;
  std::memcpy(&together, bytes, 8);
  return together * 0x0102040810204080 >> 56;
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

// The lower half of a word's bits, each twice.
inline uint64_t doubled_bits(uint64_t word) {
  word &= 0x00000000FFFFFFFF;
  word = (word | word << 16) & 0x0000FFFF0000FFFF;
  word = (word | word << 8) & 0x00FF00FF00FF00FF;
  word = (word | word << 4) & 0x0F0F0F0F0F0F0F0F;
  word = (word | word << 2) & 0x3333333333333333;
  word = (word | word << 1) & 0x5555555555555555;
  return word | word << 1;
}

// Cells of two by two by two bits that hold any.
inline Bits halved(const Bits &b, int64_t nz) {
  Bits out((b.nx + 1) / 2, (b.ny + 1) / 2, (nz + 1) / 2);
  for (int64_t x = 0; x < b.nx; x++) {
    for (int64_t y = 0; y < b.ny; y++) {
      const uint64_t *from = b.at(x, y);
      uint64_t *to = out.at(x / 2, y / 2);
      for (int64_t w = 0; w < b.words; w++) {
        const int64_t left = nz - 64 * w;
        const uint64_t word = left < 64 ? from[w] & ((uint64_t{1} << left) - 1) : from[w];  // others are beside the grid
        to[w / 2] |= even_bits(word | word >> 1) << 32 * (w % 2);
      }
    }
  }
  return out;
}

inline int32_t pack(const PackRequest &r) {
  const int64_t size = static_cast<int64_t>(r.nx) * r.ny * r.nz, words = words_of(r.nz);
  for (int64_t i = 0; i < r.voxels; i++) {
    if (r.indices[i] < 0 || r.indices[i] >= size) return kOutside;
    const int64_t column = r.indices[i] / r.nz, z = r.indices[i] % r.nz;
    r.words[column * words + z / 64] |= uint64_t{1} << z % 64;
  }
  return boundary::kOk;
}

inline int64_t tally(const TallyRequest &r) {
  int64_t count = 0;
  for (int64_t i = 0; i < r.words; i++) count += __builtin_popcountll(r.mask[i]);
  return count;
}

inline void list(const ListRequest &r) {
  const int words = words_of(r.nz);
  const int64_t columns = static_cast<int64_t>(r.nx) * r.ny;
  std::vector<int64_t> firsts(r.masks, 0);
  for (int32_t mask = 1; mask < r.masks; mask++) firsts[mask] = firsts[mask - 1] + r.counts[mask - 1];
  crew::parallel_for(r.threads, r.masks, [&](int64_t mask) {
    const uint64_t *own = r.words + mask * columns * words, *marks = r.marks + mask * columns * words;
    const int64_t begin = r.planes ? r.planes[2 * mask] * r.ny : 0;
    const int64_t end = r.planes ? r.planes[2 * mask + 1] * r.ny : columns;
    int64_t next = firsts[mask];
    for (int64_t column = begin; column < end; column++) {
      for (int w = 0; w < words; w++) {
        uint64_t bits = own[column * words + w];
        if (bits == 0) continue;
        const uint64_t marked = marks[column * words + w];
        for (; bits; bits &= bits - 1) {
          const int bit = __builtin_ctzll(bits);
          r.indices[next] = static_cast<uint32_t>(column * r.nz + 64 * w + bit);
          r.told[next++] = marked >> bit & 1 ? r.marked : r.unmarked;
        }
      }
    }
  });
}

inline void runs(const RunsRequest &r) {
  const int words = words_of(r.nz);
  int64_t count = 0, end = -1;
  for (int64_t column = 0; column < static_cast<int64_t>(r.nx) * r.ny; column++) {
    for (int w = 0; w < words; w++) {
      uint64_t left = r.words[column * words + w];
      while (left) {
        const int bit = __builtin_ctzll(left);
        const uint64_t zeros = ~(left >> bit);  // never none: what is shifted in from above are zeros, unless bit is 0
        const int length = zeros ? __builtin_ctzll(zeros) : 64;
        const int64_t start = column * r.nz + 64 * w + bit;
        if (start != end) r.runs[2 * count] = static_cast<uint32_t>(start), r.runs[2 * count++ + 1] = 0;
        r.runs[2 * count - 1] += length;
        end = start + length;
        left = bit + length < 64 ? left & ~uint64_t{0} << (bit + length) : 0;
      }
    }
  }
  *r.count = count;
}

}  // namespace forecast
