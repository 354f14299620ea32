// The paths of nodes: the lines, parabolas and falls that fit their ends, and their last steps.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "between.h"
#include "interface.h"

namespace forecast {

class Paths {
 public:
  explicit Paths(const OutlookRequest &request) : r_(request), size_(3 * request.nodes) {
    for (int64_t i = 0; i < r_.samples; i++) ages_.push_back(r_.times[i] - r_.times[r_.samples - 1]);
  }

  void fit() const {
    fit_line();
    fit_parabola();
    fit_fall();
  }

  // Writes the last steps [nodes, 3, steps], newest first, `features` apart.
  void find_steps() const {
    const double now = r_.times[r_.samples - 1];
    std::vector<double> newer(size_), older(size_);
    place_at(now, newer.data());
    for (int32_t step = 0; step < r_.steps; step++) {
      place_at(now - r_.step_s * (step + 1), older.data());
      for (int64_t i = 0; i < size_; i++) r_.features[i * r_.seen + step] = newer[i] - older[i];
      newer.swap(older);
    }
  }

 private:
  // Samples of the last `span` seconds, and one more where they fill less of it than they must.
  int64_t used(int degree, double span) const {
    int64_t within = 0;
    for (const double age : ages_) within += age >= -span - 1e-6;
    const int64_t used = std::min<int64_t>(std::max<int64_t>(within, degree + 1), r_.samples);
    return used < r_.samples && -ages_[r_.samples - used] < r_.filled * span ? used + 1 : used;
  }

  // Adds a share of each sample's way to now.
  void add(int64_t sample, double share, double *to) const {
    const double *there = r_.positions + sample * size_, *here = r_.positions + (r_.samples - 1) * size_;
    for (int64_t i = 0; i < size_; i++) to[i] += share * (there[i] - here[i]);
  }

  double power_sum(int64_t used, int power) const {
    double sum = 0;
    for (int64_t i = r_.samples - used; i < r_.samples; i++) sum += std::pow(ages_[i], power);
    return sum;
  }

  // Least squares of one coefficient, and of two.
  void fit_linear(int64_t used, double *slopes) const {
    if (used < 2) return;
    const double squares = power_sum(used, 2);
    for (int64_t i = r_.samples - used; i < r_.samples; i++) add(i, ages_[i] / squares, slopes);
  }

  void fit_line() const {
    std::fill_n(r_.line, size_, 0.0);
    fit_linear(used(1, r_.line_s), r_.line);
  }

  void fit_parabola() const {
    const int64_t used_ = used(2, r_.parabola_s);
    std::fill_n(r_.parabola, 2 * size_, 0.0);
    if (used_ < 3) return fit_linear(used_, r_.parabola);
    const double second = power_sum(used_, 2), third = power_sum(used_, 3), fourth = power_sum(used_, 4);
    const double determinant = second * fourth - third * third;
    for (int64_t i = r_.samples - used_; i < r_.samples; i++) {
      const double age = ages_[i];
      add(i, (fourth * age - third * age * age) / determinant, r_.parabola);
      add(i, (second * age * age - third * age) / determinant, r_.parabola + size_);
    }
  }

  // The line through half g t^2 falls behind: its velocity is that of the middle of its span.
  void fit_fall() const {
    const int64_t used_ = used(1, r_.line_s);
    const double squares = power_sum(used_, 2), behind = squares > 0 ? power_sum(used_, 3) / 2 / squares : 0;
    for (int64_t i = 0; i < size_; i++) r_.falling[i] = r_.line[i] - behind * r_.gravity[i % 3];
  }

  void place_at(double time, double *to) const {
    const Between b = Between::of(r_.times, r_.samples, time);
    const double *before = r_.positions + b.before * size_, *after = r_.positions + b.after * size_;
    for (int64_t i = 0; i < size_; i++) to[i] = (1 - b.share) * before[i] + b.share * after[i];
  }

  const OutlookRequest &r_;
  const int64_t size_;
  std::vector<double> ages_;
};

}  // namespace forecast
