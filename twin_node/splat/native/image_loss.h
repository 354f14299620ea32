// L1 + (1 - SSIM) + depth L1 of a batch of images, value and gradient in one go.
#pragma once

#include <cmath>

#include "finite.h"
#include "ssim.h"

namespace splat {

// Index of the first argument with a value that is not finite, or -1: render, target, weights, target_depth.
inline int non_finite_argument(const LossRequest &r) {
  const int64_t pixels = static_cast<int64_t>(r.images) * r.height * r.width;
  const Floats arguments[] = {
      {r.render, pixels * r.channels}, {r.target, pixels * 3}, {r.weights, pixels}, {r.target_depth, pixels}};
  return first_non_finite(arguments);
}

// Factors of the three terms: what one pixel of weight 1 contributes per unit of each.
struct Factors {
  float l1, ssim, depth;
};

inline Factors factors_of(const LossRequest &r, const LossWorkspace &w) {
  double weight = 0, depth_weight = 0;
  for (int i = 0; i < r.images; i++) {
    weight += w.images[i]->weight;
    depth_weight += w.images[i]->depth_weight;
  }
  const bool depth = r.channels == 4 && r.target_depth != nullptr && depth_weight > 0;
  return {weight > 0 ? static_cast<float>(r.l1 / (3 * weight)) : 0.f,
          weight > 0 ? static_cast<float>(r.ssim / (3 * weight)) : 0.f,
          depth ? static_cast<float>(r.depth_weight / depth_weight) : 0.f};
}

inline float sign(float x) { return x > 0.f ? 1.f : (x < 0.f ? -1.f : 0.f); }

// L1 term of row `y` of the box, value and gradient.
inline float l1_row(const LossRequest &r, const Factors &f, int index, const LossImage &image, int y) {
  const int64_t first = (static_cast<int64_t>(index) * r.height + image.y0 + y) * r.width + image.x0;
  float total = 0.f;
  for (int64_t at = first; at < first + image.columns(); at++) {
    const float weight = weight_at(r, at);
    if (!(weight > 0.f)) continue;
    for (int q = 0; q < 3; q++) {
      const float difference = r.render[r.channels * at + q] - r.target[3 * at + q];
      total += weight * std::fabs(difference);
      r.gradient[r.channels * at + q] = f.l1 * weight * sign(difference);
    }
  }
  return total;
}

// Depth term of row `y` of the box, value and gradient.
inline float depth_row(const LossRequest &r, const Factors &f, int index, const LossImage &image, int y) {
  const int64_t first = (static_cast<int64_t>(index) * r.height + image.y0 + y) * r.width + image.x0;
  float total = 0.f;
  for (int x = 0; x < image.columns(); x++) {
    const float weight = weight_at(r, first + x), target = r.target_depth[first + x];
    if (!(weight > 0.f && target > 0.f)) continue;
    const float difference = r.render[(first + x) * 4 + 3] - target;
    total += weight * std::fabs(difference);
    r.gradient[(first + x) * 4 + 3] = f.depth * weight * sign(difference);
  }
  return total;
}

// Takes in the targets and weights: renders are held to them until others are taken in.
inline void hold_to_target(const LossRequest &r, LossWorkspace &w) {
  while (static_cast<int>(w.images.size()) < r.images) w.images.push_back(std::make_unique<LossImage>());
  parallel_for(r.threads, r.images, [&](int64_t i) { measure_weights(r, static_cast<int>(i), *w.images[i]); });
  if (r.ssim != 0.f) fill_all_planes(r, w);
}

// The loss of a render beside the targets that were taken in. Its gradient is written where pixels count, nowhere else.
inline double loss_terms(const LossRequest &r, LossWorkspace &w) {
  static const Window window;
  const Factors f = factors_of(r, w);
  const double unlike = f.ssim == 0.f ? 0. : unlike_terms(r, w, window);
  const auto rows = [&](int i) { return rows_of(w, i); };
  const double rest = sum_over_bands(r, w, rows, [&](int i, int begin, int end) {
    const LossImage &image = *w.images[i];
    Filtered filtered(kMaps, f.ssim == 0.f ? 0 : image.stride);
    double total = 0;
    for (int y = begin; y < end; y++) {
      total += f.l1 * l1_row(r, f, i, image, y);
      for (int q = 0; q < 3 && f.ssim != 0.f; q++) ssim_gradient_row(r, f.ssim, window, i, image, q, y, filtered);
      if (f.depth != 0.f) total += f.depth * depth_row(r, f, i, image, y);
    }
    return total;
  });
  return f.ssim * unlike + rest;
}

inline Status image_loss(const LossRequest &r) {
  const LossWorkspaceInUse w;
  hold_to_target(r, *w);
  *r.loss = loss_terms(r, *w);
  return kOk;
}

}  // namespace splat
