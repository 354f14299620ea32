// Which of the cubes of its node's frame holds each Gaussian, and how far it has crept there.
#pragma once

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "interface.h"

namespace model {

// Which of the keys that were asked for before each is: a table with open addresses.
class KeyTable {
 public:
  explicit KeyTable(int64_t most) {
    size_t size = 16;
    while (size < 2 * static_cast<size_t>(most)) size *= 2;
    slots_.assign(size, -1);
  }

  // The number of `key` in the order in which keys were seen first; `keys` holds them.
  int64_t find(int64_t key, std::vector<int64_t> &keys) {
    const size_t mask = slots_.size() - 1;
    size_t at = (static_cast<uint64_t>(key) * 0x9e3779b97f4a7c15u >> 32) & mask;
    while (slots_[at] >= 0 && keys[slots_[at]] != key) at = (at + 1) & mask;
    if (slots_[at] < 0) {
      slots_[at] = static_cast<int64_t>(keys.size());
      keys.push_back(key);
    }
    return slots_[at];
  }

 private:
  std::vector<int64_t> slots_;
};

inline int64_t key_of(const CellRequest &r, int64_t row) {
  const int64_t half = int64_t{1} << (r.axis_bits - 1);
  int64_t key = r.founders[row];
  for (int k = 0; k < 3; k++) {
    const float place = std::floor(r.values[kColumns * row + k] / static_cast<float>(r.side));
    const int64_t voxel = static_cast<int64_t>(std::min(std::max(place, -1e9f), 1e9f));
    key = key * (int64_t{1} << r.axis_bits) + (std::min(std::max(voxel, -half), half - 1) + half);
  }
  return key;
}

// Cells in the order of their keys, with what their Gaussians are on average.
inline void find_cells(const CellRequest &r) {
  std::vector<int64_t> keys, first;
  KeyTable table(r.count);
  for (int64_t i = 0; i < r.count; i++) {
    r.of[i] = table.find(key_of(r, r.rows[i]), keys);
    if (first.size() < keys.size()) first.push_back(i);
  }
  const int64_t cells = r.found[0] = static_cast<int64_t>(keys.size());
  std::vector<int64_t> order(cells), place(cells), counts(cells, 0);
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](int64_t a, int64_t b) { return keys[a] < keys[b]; });
  for (int64_t c = 0; c < cells; c++) {
    place[order[c]] = c;
    r.keys[c] = keys[order[c]];
    r.nodes[c] = r.carriers[r.rows[first[order[c]]]];
  }
  std::fill_n(r.centres, 3 * cells, 0.);
  std::fill_n(r.rgb, 3 * cells, 0.);
  for (int64_t i = 0; i < r.count; i++) {
    const int64_t c = r.of[i] = place[r.of[i]];
    counts[c]++;
    for (int k = 0; k < 3; k++) {
      r.centres[3 * c + k] += r.means[3 * i + k];
      r.rgb[3 * c + k] += r.values[kColumns * r.rows[i] + 11 + k];
    }
  }
  for (int64_t i = 0; i < 3 * cells; i++) {
    r.centres[i] /= static_cast<double>(counts[i / 3]);
    r.rgb[i] /= static_cast<double>(counts[i / 3]);
  }
}

// How far the Gaussians of each cell have crept on average; those that are new or have another node not at all.
inline void find_creep(const CreepRequest &r) {
  std::vector<int64_t> counts(r.cells, 0);
  std::vector<float> steps(3 * r.count, 0.f);
  for (int64_t i = 0; i < r.count; i++) {
    const int64_t row = r.rows[i];
    counts[r.of[i]]++;
    if (r.known_ids[row] != r.ids[row] || r.known_homes[row] != r.homes[r.of[i]]) continue;
    for (int k = 0; k < 3; k++) steps[3 * i + k] = r.values[kColumns * row + k] - r.known_means[3 * row + k];
  }
  std::fill_n(r.known_ids, r.capacity, -1);
  for (int64_t i = 0; i < r.count; i++) {
    const int64_t row = r.rows[i];
    r.known_ids[row] = r.ids[row];
    r.known_homes[row] = r.homes[r.of[i]];
    std::copy_n(r.values + kColumns * row, 3, r.known_means + 3 * row);
  }
  std::fill_n(r.crept, 3 * r.cells, 0.);
  for (int64_t i = 0; i < 3 * r.count; i++) r.crept[3 * r.of[i / 3] + i % 3] += steps[i];
  for (int64_t i = 0; i < 3 * r.cells; i++) r.crept[i] *= 1. / static_cast<double>(std::max<int64_t>(counts[i / 3], 1));
}

}  // namespace model
