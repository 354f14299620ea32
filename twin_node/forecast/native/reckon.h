// What became of forecasts of nodes: their errors, and the records that these enter.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "interface.h"

namespace forecast {

struct Vector {
  double x, y, z;

  static Vector at(const double *row) { return {row[0], row[1], row[2]}; }
  Vector operator-(const Vector &other) const { return {x - other.x, y - other.y, z - other.z}; }
  Vector operator*(double scale) const { return {x * scale, y * scale, z * scale}; }
  double dot(const Vector &other) const { return x * other.x + y * other.y + z * other.z; }
  double length() const { return std::sqrt(dot(*this)); }
};

// Distance of `moved` from the straight way between `ahead` and as far behind.
inline double off_the_way(const Vector &ahead, const Vector &moved) {
  const double share = std::clamp(moved.dot(ahead) / std::max(ahead.dot(ahead), 1e-12), -1.0, 1.0);
  return (moved - ahead * share).length();
}

// Where a node was between two samples.
inline Vector place_of(const ReckonRequest &r, const Between &b, int64_t node) {
  const double *before = r.positions + 3 * (b.before * r.nodes + node);
  const double *after = r.positions + 3 * (b.after * r.nodes + node);
  const double rest = 1 - b.share;
  return {
      rest * before[0] + b.share * after[0], rest * before[1] + b.share * after[1],
      rest * before[2] + b.share * after[2]};
}

struct Errors {
  int64_t count;
  double sum;
};

// Finds how far wrong each forecast was; notes who turned back.
inline Errors find_errors(const ReckonRequest &r) {
  const double *mixed = r.mixed + 3 * r.knot * r.before;
  const double mean = r.profile[r.knot], last = r.profile[r.knots - 1];
  Errors all{0, 0};
  for (int64_t node = 0; node < r.nodes; node++) {
    const int64_t row = r.rows[node];
    if (row < 0) continue;
    const Vector moved = place_of(r, r.here, node) - place_of(r, r.there, node);
    const Vector ahead = Vector::at(mixed + 3 * row);
    double wrong = (ahead - moved).length();
    if (r.turns) {
      const double expected = r.radii[row] * mean / last, aside = off_the_way(ahead, moved) / r.narrower;
      const bool is_back = moved.dot(ahead) < 0 && wrong > std::max(r.factor * expected, r.turn);
      if (is_back && aside <= expected) r.turned[node] = r.now;
      if (r.turning[row]) wrong = std::min(wrong, aside);
    }
    r.found[all.count] = row, r.wrong[all.count] = wrong;
    std::copy_n(&moved.x, 3, r.moved + 3 * all.count);
    all.sum += wrong;
    all.count++;
  }
  return all;
}

// Enters the error of the mixture in the record of a node.
inline void enter(const ReckonRequest &r, int64_t node, double wrong) {
  const double before = r.errors[node], first = 1 / (1 + static_cast<double>(r.judged[node]));
  const double rate = std::max(wrong > before ? r.rise : r.fall, first);
  r.errors[node] = before + rate * (wrong - before);
  r.judged[node]++;
}

// How many nodes there are still.
inline int64_t reckon(const ReckonRequest &r) {
  const Errors all = find_errors(r);
  double &mean = r.profile[r.knot];
  if (all.count) mean = r.kept * mean + (1 - r.kept) * (all.sum / static_cast<double>(all.count));
  const double last = r.profile[r.knots - 1];
  for (int64_t node = 0, i = 0; node < r.nodes; node++) {
    const int64_t row = r.rows[node];
    if (row < 0) continue;
    const Vector moved = Vector::at(r.moved + 3 * i);
    for (int64_t expert = 0; expert < r.experts; expert++) {
      const double *place = r.places + 3 * ((expert * r.knots + r.knot) * r.before + row);
      const double error = (Vector::at(place) - moved).length() / r.knot_share;
      double &square = r.squared[expert * r.nodes + node];
      square += r.rate * (error * error - square);
    }
    const double known_s = r.time - std::max(r.began[node], r.turned[node]);
    r.grown[i] = known_s >= r.grown_s;
    if (r.wrong[i] > r.startled * (r.radii[row] * mean / last)) r.began[node] = r.now, r.judged[node] = 0;
    if (r.knot == r.knots - 1 && known_s >= 0) enter(r, node, r.wrong[i]);
    i++;
  }
  return all.count;
}

}  // namespace forecast
