// Several steps of Adam on some of the Gaussians of a scene: carry, draw, compare, differentiate, step, all in one.
#pragma once

#include "backward.h"
#include "image_loss.h"

namespace splat {

constexpr int kMean = 0, kQuat = 3, kLogScale = 7, kLogit = 10, kRgb = 11;  // first columns of a row of values
constexpr float kAdamFloor = 1e-12f;
constexpr int kRowsPerChunk = 128;

// What carries learned row i at time t: mean = turn * mean + shift, quat = product * quat.
struct Carriage {
  const float *turn, *shift, *product;  // [3, 3], [3], [4, 4]
  Carriage(const DescentRequest &d, int time, int row) {
    const int64_t at = time * d.carriages + d.carriers[row];
    turn = d.turns + 9 * at;
    shift = d.shifts + 3 * at;
    product = d.products + 16 * at;
  }
};

// Puts learned row `i` into the scene that is drawn, at every time.
inline void place_row(const DescentRequest &d, int i) {
  const Request &r = d.scene;
  const float *value = d.values + kColumns * d.rows[i];
  const int64_t row = d.standing + i;
  for (int k = 0; k < 3; k++) {
    d.scales[3 * row + k] = std::exp(value[kLogScale + k]);
    d.colors[3 * row + k] = value[kRgb + k];
  }
  d.opacities[row] = 1.f / (1.f + std::exp(-value[kLogit]));
  for (int time = 0; time < r.batches; time++) {
    const Carriage c(d, time, i);
    float *mean = d.means + time * r.means_stride + 3 * row, *quat = d.quats + time * r.quats_stride + 4 * row;
    for (int k = 0; k < 3; k++) {
      mean[k] = c.turn[3 * k] * value[kMean] + c.turn[3 * k + 1] * value[kMean + 1] +
                c.turn[3 * k + 2] * value[kMean + 2] + c.shift[k];
    }
    for (int k = 0; k < 4; k++) {
      const float *p = c.product + 4 * k, *q = value + kQuat;
      quat[k] = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3];
    }
  }
}

// Gradient of the loss by the columns of learned row `i`.
inline void gradient_of_row(const DescentRequest &d, int i, float *out) {
  const Request &r = d.scene;
  const int64_t row = d.standing + i;
  std::fill_n(out, kColumns, 0.f);
  for (int time = 0; time < r.batches; time++) {
    const Carriage c(d, time, i);
    const float *v_mean = d.gradients.v_means + time * r.means_stride + 3 * row;
    const float *v_quat = d.gradients.v_quats + time * r.quats_stride + 4 * row;
    for (int k = 0; k < 3; k++) {
      for (int j = 0; j < 3; j++) out[kMean + k] += c.turn[3 * j + k] * v_mean[j];
    }
    for (int k = 0; k < 4; k++) {
      for (int j = 0; j < 4; j++) out[kQuat + k] += c.product[4 * j + k] * v_quat[j];
    }
  }
  for (int k = 0; k < 3; k++) {
    out[kLogScale + k] = d.gradients.v_scales[3 * row + k] * d.scales[3 * row + k];
    out[kRgb + k] = d.gradients.v_colors[3 * row + k];
  }
  const float opacity = d.opacities[row];
  out[kLogit] = d.gradients.v_opacities[row] * opacity * (1.f - opacity);
}

// What makes up for moments that began at zero `taken` steps ago: 1 / (1 - decay^taken), of its logarithm to base 2.
inline float correction(double log2_decay, double taken) {
  return static_cast<float>(1. / (1. - std::exp2(taken * log2_decay)));
}

// Logarithms to base 2 of what moments keep of themselves.
struct LogDecays {
  double first, second;
  explicit LogDecays(const DescentRequest &d)
      : first(std::log2(static_cast<double>(d.first_decay))), second(std::log2(static_cast<double>(d.second_decay))) {}
};

// One step of Adam (Kingma and Ba, 2015) on learned row `i`, none where nothing pulls at it; false where it would not
// stay finite: it then keeps its values and forgets its moments.
inline bool step_row(const DescentRequest &d, const LogDecays &decays, int i) {
  float gradient[kColumns], next[kColumns];
  gradient_of_row(d, i, gradient);
  if (std::all_of(gradient, gradient + kColumns, [](float v) { return v == 0.f; })) return true;
  const int64_t at = kColumns * d.rows[i];
  const float *rates = d.rates + static_cast<int64_t>(kColumns) * i;
  const float ceiling = d.ceilings[d.rows[i]];
  float *value = d.values + at, *first = d.moment1 + at, *second = d.moment2 + at;
  const double taken = static_cast<double>(++d.steps_taken[d.rows[i]]);
  const float correct1 = correction(decays.first, taken), correct2 = correction(decays.second, taken);
  float sum = 0.f;
  for (int k = 0; k < kColumns; k++) {
    first[k] += (1.f - d.first_decay) * (gradient[k] - first[k]);
    second[k] = d.second_decay * second[k] + (1.f - d.second_decay) * gradient[k] * gradient[k];
    next[k] = value[k] - rates[k] * (first[k] * correct1) / (std::sqrt(second[k] * correct2) + kAdamFloor);
  }
  for (int k = kLogScale; k < kLogScale + 3; k++) {
    if (std::isfinite(next[k])) next[k] = std::max(std::min(next[k], ceiling), d.smallest_log_scale);
  }
  for (int k = kRgb; k < kRgb + 3; k++) {
    if (std::isfinite(next[k])) next[k] = std::min(std::max(next[k], 0.f), 1.f);
  }
  for (int k = 0; k < kColumns; k++) sum += next[k] - next[k];
  if (sum == 0.f) {
    std::copy_n(next, kColumns, value);
    return true;
  }
  std::fill_n(first, kColumns, 0.f);
  std::fill_n(second, kColumns, 0.f);
  d.steps_taken[d.rows[i]] = 0;
  return false;
}

// Runs work(row) -> int over the learned rows and adds the results up.
template <class Work>
inline int64_t over_rows(const DescentRequest &d, const Work &work) {
  const int64_t chunks = (d.learned + kRowsPerChunk - 1) / kRowsPerChunk;
  std::vector<int64_t> sums(chunks, 0);
  parallel_for(d.scene.threads, chunks, [&](int64_t chunk) {
    const int begin = static_cast<int>(chunk) * kRowsPerChunk, end = std::min(d.learned, begin + kRowsPerChunk);
    for (int i = begin; i < end; i++) sums[chunk] += work(i);
  });
  int64_t total = 0;
  for (const int64_t sum : sums) total += sum;
  return total;
}

inline void clear_gradients(const DescentRequest &d) {
  const Request &r = d.scene;
  const Gradients &g = d.gradients;
  for (int time = 0; time < r.batches; time++) {
    std::fill_n(g.v_means + time * r.means_stride + 3 * static_cast<int64_t>(d.standing), 3 * d.learned, 0.f);
    std::fill_n(g.v_quats + time * r.quats_stride + 4 * static_cast<int64_t>(d.standing), 4 * d.learned, 0.f);
  }
  std::fill_n(g.v_scales + 3 * static_cast<int64_t>(d.standing), 3 * d.learned, 0.f);
  std::fill_n(g.v_opacities + d.standing, d.learned, 0.f);
  std::fill_n(g.v_colors + 3 * static_cast<int64_t>(d.standing), 3 * d.learned, 0.f);
}

// Takes the steps; `refused` counts those of single rows that were not taken. A few steps move a Gaussian by less than
// a pixel: those after the first draw with its order and tiles.
inline Status descend(Workspace &w, const DescentRequest &d) {
  *d.refused = 0;
  const LogDecays decays(d);
  const LossWorkspaceInUse loss;
  hold_to_target(d.loss, *loss);
  const int64_t floats = 4 * static_cast<int64_t>(d.scene.width) * d.scene.height;
  parallel_for(d.scene.threads, d.scene.batches,
               [&](int64_t image) { std::fill_n(d.loss.gradient + image * floats, floats, 0.f); });
  for (int step = 0; step < d.steps; step++) {
    over_rows(d, [&](int i) {
      place_row(d, i);
      return 0;
    });
    Status status = kOk;
    if (step == 0) {
      status = forward(w, d.scene);
    } else {
      redraw(w, d.scene, d.standing);
    }
    if (status != kOk) return status;
    clear_gradients(d);
    d.losses[step] = loss_terms(d.loss, *loss);
    status = backward(w, d.scene, d.gradients);
    if (status != kOk) return status;
    *d.refused += over_rows(d, [&](int i) { return step_row(d, decays, i) ? 0 : 1; });
  }
  return kOk;
}

}  // namespace splat
