// The scale of errors by their cues, and the quantile of past errors over it.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "interface.h"

namespace forecast {

// The product of two rows.
inline double product(const double *one, const double *other, int32_t size) {
  double sum = 0;
  for (int32_t i = 0; i < size; i++) sum += one[i] * other[i];
  return sum;
}

// Solves for the right side `x` [n], in place, by Cholesky's factors of a positive definite matrix [n, n].
inline void solve_definite(std::vector<double> &matrix, double *x, int32_t n) {
  for (int32_t i = 0; i < n; i++) {
    double *row = matrix.data() + i * n;
    for (int32_t j = 0; j <= i; j++) {
      const double *other = matrix.data() + j * n;
      const double left = row[j] - product(row, other, j);
      row[j] = i == j ? std::sqrt(left) : left / other[j];
    }
    x[i] = (x[i] - product(row, x, i)) / row[i];
  }
  for (int32_t i = n - 1; i >= 0; i--) {
    for (int32_t j = i + 1; j < n; j++) x[i] -= matrix[j * n + i] * x[j];
    x[i] /= matrix[i * (n + 1)];
  }
}

// Enters errors in the normal equations, and solves them.
inline void regress(const RegressRequest &r) {
  const int32_t n = r.cues;
  for (int32_t i = 0; i < n * n; i++) r.gram[i] *= r.kept;
  for (int32_t i = 0; i < n; i++) r.moment[i] *= r.kept;
  for (int64_t one = 0; one < r.errors; one++) {
    const double *cues = r.then + one * n;
    const double weight = r.weight * (r.logs[one] > product(cues, r.slopes, n) ? r.upper : 1 - r.upper);
    for (int32_t i = 0; i < n; i++) {
      const double own = weight * cues[i];
      for (int32_t j = 0; j < n; j++) r.gram[i * n + j] += own * cues[j];
      r.moment[i] += own * r.logs[one];
    }
  }
  std::vector<double> matrix(r.gram, r.gram + n * n);
  for (int32_t i = 0; i < n; i++) {
    matrix[i * (n + 1)] += r.ridge;
    r.slopes[i] = r.moment[i] + r.ridge * r.prior[i];
  }
  solve_definite(matrix, r.slopes, n);
}

// The first of the bins at whose end the errors hold a share of all weights.
inline int64_t find_quantile(const QuantileRequest &r) {
  std::vector<double> held(r.bins);
  for (int64_t one = 0; one < r.errors; one++) {
    const double log = r.logs[one] - product(r.then + one * r.cues, r.slopes, r.cues);
    const double bin = (log - r.lowest) / r.width;
    held[bin > 0 ? std::min(static_cast<int64_t>(bin), r.bins - 1) : 0] += r.weights[one];
  }
  for (int64_t bin = 1; bin < r.bins; bin++) held[bin] += held[bin - 1];
  for (double &one : held) one *= r.fresh;
  const double wanted = r.share * held.back() - r.slack;
  return std::min<int64_t>(std::lower_bound(held.begin(), held.end(), wanted) - held.begin(), r.bins - 1);
}

}  // namespace forecast
