// What became of forecasts of nodes: their errors, and the records that these enter.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "between.h"
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

// What one time's forecasts became.
class Reckoning {
 public:
  Reckoning(const ReckonRequest &request, int32_t number)
      : r_(request),
        d_(request.due[number]),
        found_(request.found + number * request.nodes),
        moved_(request.moved + 3 * number * request.nodes),
        wrong_(request.wrong + number * request.nodes),
        grown_(request.grown + number * request.nodes),
        now_(request.times[request.samples - 1]),
        kept_(left_of(request.memory_s)),
        rate_(1 - left_of(request.record_s)),
        rise_(1 - left_of(request.rise_s)),
        fall_(1 - left_of(request.fall_s)),
        learnt_(left_of(request.learnt_s)) {}

  // Enters it in all records; how many of the nodes there are still.
  int64_t enter() {
    find_errors();
    double &mean = r_.profile[d_.knot];
    if (count_) mean = kept_ * mean + (1 - kept_) * (sum_ / static_cast<double>(count_));
    const double last = r_.profile[r_.knots - 1];
    for (int64_t node = 0, i = 0; node < r_.nodes; node++) {
      const int64_t row = d_.rows[node];
      if (row < 0) continue;
      weigh(node, row, Vector::at(moved_ + 3 * i));
      const double known_s = d_.time - std::max(r_.began[node], r_.turned[node]);
      grown_[i] = known_s >= d_.grown_s;
      if (wrong_[i] > r_.startled * (d_.radii[row] * mean / last)) r_.began[node] = now_, r_.judged[node] = 0;
      if (d_.knot == r_.knots - 1 && known_s >= 0) enter_error(node, wrong_[i]);
      i++;
    }
    learn();
    return count_;
  }

 private:
  // Share that is kept of what was, in what follows with a time constant (s).
  double left_of(double constant) const { return std::exp(-d_.elapsed_s / constant); }

  // Where a node was between two samples.
  Vector place_of(const Between &b, int64_t node) const {
    const double *before = r_.positions + 3 * (b.before * r_.nodes + node);
    const double *after = r_.positions + 3 * (b.after * r_.nodes + node);
    const double rest = 1 - b.share;
    return {
        rest * before[0] + b.share * after[0], rest * before[1] + b.share * after[1],
        rest * before[2] + b.share * after[2]};
  }

  // Finds how far wrong each forecast was; notes who turned back.
  void find_errors() {
    const double *mixed = d_.mixed + 3 * d_.knot * d_.before;
    const double mean = r_.profile[d_.knot], last = r_.profile[r_.knots - 1];
    const Between here = Between::of(r_.times, r_.samples, d_.valid_at);
    const Between there = Between::of(r_.times, r_.samples, d_.time);
    for (int64_t node = 0; node < r_.nodes; node++) {
      const int64_t row = d_.rows[node];
      if (row < 0) continue;
      const Vector moved = place_of(here, node) - place_of(there, node);
      const Vector ahead = Vector::at(mixed + 3 * row);
      double wrong = (ahead - moved).length();
      if (r_.turns) {
        const double expected = d_.radii[row] * mean / last, aside = off_the_way(ahead, moved) / r_.narrower;
        const bool is_back = moved.dot(ahead) < 0 && wrong > std::max(d_.factor * expected, r_.turn);
        if (is_back && aside <= expected) r_.turned[node] = now_;
        if (d_.turning[row]) wrong = std::min(wrong, aside);
      }
      found_[count_] = row, wrong_[count_] = wrong;
      std::copy_n(&moved.x, 3, moved_ + 3 * count_);
      sum_ += wrong;
      count_++;
    }
  }

  // Enters the errors of the experts, as if at the horizon, in the record of a node, unless none of them foresaw it.
  void weigh(int64_t node, int64_t row, const Vector &moved) const {
    const auto error_of = [&](int64_t expert) {
      const double *place = d_.places + 3 * ((expert * r_.knots + d_.knot) * d_.before + row);
      return (Vector::at(place) - moved).length() / d_.knot_share;
    };
    double least = error_of(0);
    for (int64_t expert = 1; expert < r_.experts; expert++) least = std::min(least, error_of(expert));
    if (least > d_.radii[row]) return;
    for (int64_t expert = 0; expert < r_.experts; expert++) {
      const double error = error_of(expert);
      double &square = r_.squared[expert * r_.nodes + node];
      square += rate_ * (error * error - square);
    }
  }

  // Enters that of their mixture.
  void enter_error(int64_t node, double wrong) const {
    const double before = r_.errors[node], first = 1 / (1 + static_cast<double>(r_.judged[node]));
    const double rate = std::max(wrong > before ? rise_ : fall_, first);
    r_.errors[node] = before + rate * (wrong - before);
    r_.judged[node]++;
  }

  // Enters some nodes, evenly taken, in the normal equations of the autoregression.
  void learn() const {
    if (count_ == 0) return;
    const int64_t size = r_.features, step = (count_ + r_.learnt_from - 1) / r_.learnt_from;
    double *gram = r_.gram + d_.knot * size * size, *moment = r_.moment + d_.knot * size;
    const double weight = d_.elapsed_s / r_.step_s / static_cast<double>((count_ + step - 1) / step);
    for (int64_t i = 0; i < size * size; i++) gram[i] *= learnt_;
    for (int64_t i = 0; i < size; i++) {
      gram[i * (size + 1)] += (1 - learnt_) * r_.least_gram;
      moment[i] *= learnt_;
    }
    for (int64_t node = 0; node < count_; node += step) {
      for (int axis = 0; axis < 3; axis++) {
        const double *seen = d_.features + (3 * found_[node] + axis) * size;
        const double came_true = moved_[3 * node + axis];
        for (int64_t i = 0; i < size; i++) {
          const double own = weight * seen[i];
          moment[i] += own * came_true;
          for (int64_t j = 0; j < size; j++) gram[i * size + j] += own * seen[j];
        }
      }
    }
  }

  const ReckonRequest &r_;
  const DueForecast &d_;
  int64_t *found_;
  double *moved_, *wrong_;
  uint8_t *grown_;
  const double now_;
  const double kept_, rate_, rise_, fall_, learnt_;  // shares kept of the profile and of what was learnt; rates
  int64_t count_ = 0;
  double sum_ = 0;
};

inline void reckon(const ReckonRequest &r) {
  for (int32_t number = 0; number < r.dues; number++) r.left[number] = Reckoning(r, number).enter();
}

}  // namespace forecast
