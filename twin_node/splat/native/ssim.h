// SSIM of a batch of images beside their targets, value and gradient.
//
// Wang et al. 2004, 11x11 Gaussian window of sigma 1.5 px, zero padding, data range 1. Pixels of weight 0 count as equal
// to their target, so that windows that reach over the edge of a mask compare what the mask selects and no more.
#pragma once

#include <cmath>

#include "loss_image.h"
#include "simd.h"

namespace splat {

constexpr int kRadius = 5, kTaps = 2 * kRadius + 1;  // of the window, pixels
constexpr int kMaps = 3;                             // derivatives of the SSIM by E[x], E[x^2] and E[xy]

struct Window {
  float tap[kTaps];
  Window() {
    double total = 0, value[kTaps];
    for (int i = 0; i < kTaps; i++) total += value[i] = std::exp(-(i - kRadius) * (i - kRadius) / (2 * 1.5 * 1.5));
    for (int i = 0; i < kTaps; i++) tap[i] = static_cast<float>(value[i] / total);
  }
};

inline void reserve_planes(LossImage &image) {
  if (image.rows() <= 0) return;
  image.padded_rows = image.rows() + 2 * kRadius;
  image.stride = image.columns() + 2 * kRadius + 2 * kLanes;
  image.x.reserve(3 * image.plane());
  image.y.reserve(3 * image.plane());
  image.weights.reserve(static_cast<size_t>(image.rows()) * image.stride);
  image.maps.reserve(3 * kMaps * image.plane());
}

// Copies padded rows [begin, end) of the box into planes, as if the render were the target, and clears the map rows.
inline void fill_planes(const LossRequest &r, int index, LossImage &image, int begin, int end) {
  for (int padded = begin; padded < end; padded++) {
    const int y = image.y0 - kRadius + padded;
    const int64_t row = static_cast<int64_t>(padded) * image.stride;
    for (int map = 0; map < 3 * kMaps; map++) std::fill_n(&image.maps[map * image.plane() + row], image.stride, 0.f);
    for (int q = 0; q < 3; q++) {
      std::fill_n(&image.x[q * image.plane() + row], image.stride, 0.f);
      std::fill_n(&image.y[q * image.plane() + row], image.stride, 0.f);
    }
    const bool in_box = y >= image.y0 && y < image.y1;
    if (in_box) std::fill_n(&image.weights[static_cast<int64_t>(y - image.y0) * image.stride], image.stride, 0.f);
    if (y < 0 || y >= r.height) continue;
    const int from = std::max(image.x0 - kRadius, 0), to = std::min(image.x1 + kRadius, r.width);
    for (int x = from; x < to; x++) {
      const int64_t pixel = (static_cast<int64_t>(index) * r.height + y) * r.width + x;
      const int64_t at = row + (x - image.x0 + kRadius);
      for (int q = 0; q < 3; q++) {
        image.x[q * image.plane() + at] = image.y[q * image.plane() + at] = r.target[3 * pixel + q];
      }
      if (in_box && x >= image.x0 && x < image.x1) {
        image.weights[static_cast<int64_t>(y - image.y0) * image.stride + (x - image.x0)] = weight_at(r, pixel);
      }
    }
  }
}

// Takes in the targets and weights as if the renders were the targets.
inline void fill_all_planes(const LossRequest &r, LossWorkspace &w) {
  for (int i = 0; i < r.images; i++) reserve_planes(*w.images[i]);
  sum_over_bands(
      r, w, [&](int i) { return rows_of(w, i) == 0 ? 0 : w.images[i]->padded_rows; },
      [&](int i, int begin, int end) {
        fill_planes(r, i, *w.images[i], begin, end);
        return 0.;
      });
}

// Copies the render's pixels that count of rows [begin, end) of the box into the planes.
inline void fill_render(const LossRequest &r, int index, LossImage &image, int begin, int end) {
  for (int y = begin; y < end; y++) {
    const float *weights = &image.weights[static_cast<int64_t>(y) * image.stride];
    const int64_t first = (static_cast<int64_t>(index) * r.height + image.y0 + y) * r.width + image.x0;
    const int64_t at = static_cast<int64_t>(y + kRadius) * image.stride + kRadius;
    for (int x = 0; x < image.columns(); x++) {
      if (!(weights[x] > 0.f)) continue;
      for (int q = 0; q < 3; q++) image.x[q * image.plane() + at + x] = r.render[r.channels * (first + x) + q];
    }
  }
}

// Scratch of one task: rows filtered down the columns.
struct Filtered {
  std::vector<float> data;
  int stride;
  Filtered(int rows, int stride_) : data(static_cast<size_t>(rows) * stride_), stride(stride_) {}
  float *row(int i) { return data.data() + static_cast<size_t>(i) * stride; }
  Vec across(const Window &window, int i, int x) {
    Vec out{};
    for (int k = 0; k < kTaps; k++) out += window.tap[k] * load(row(i) + x + k);
    return out;
  }
};

// Whether columns filtered down at [x, x + kLanes) of a padded row are read by a pixel of the row that counts: each
// vector of pixels reads its own and those behind it as far as the window reaches.
inline bool needed(const float *weights, int x, int columns) {
  constexpr int kBehind = (2 * kRadius + kLanes - 1) / kLanes;
  for (int at = std::max(0, x - kBehind * kLanes); at <= x && at < columns; at += kLanes) {
    if (any(gt(load(weights + at), Vec{}))) return true;
  }
  return false;
}

// SSIM of row `y` of the box, channel q, weighted and summed; leaves the weighted derivatives in the maps.
inline Vec ssim_row(const Window &window, LossImage &image, int q, int y, Filtered &filtered) {
  const int stride = image.stride;
  const float *x_rows = &image.x[q * image.plane() + static_cast<int64_t>(y) * stride];
  const float *y_rows = &image.y[q * image.plane() + static_cast<int64_t>(y) * stride];
  const float *weights = &image.weights[static_cast<int64_t>(y) * stride];
  for (int x = 0; x < image.columns() + 2 * kRadius; x += kLanes) {
    if (!needed(weights, x, image.columns())) continue;
    Vec mean_x{}, mean_y{}, squares{}, product{};
    for (int k = 0; k < kTaps; k++) {
      const Vec a = load(x_rows + k * stride + x), b = load(y_rows + k * stride + x);
      const Vec scaled_a = window.tap[k] * a, scaled_b = window.tap[k] * b;
      mean_x += scaled_a;
      mean_y += scaled_b;
      squares += scaled_a * a + scaled_b * b;
      product += scaled_a * b;
    }
    store(filtered.row(0) + x, mean_x);
    store(filtered.row(1) + x, mean_y);
    store(filtered.row(2) + x, squares);
    store(filtered.row(3) + x, product);
  }
  float *map = &image.maps[q * kMaps * image.plane() + static_cast<int64_t>(y + kRadius) * stride + kRadius];
  Vec total{};
  for (int x = 0; x < image.columns(); x += kLanes) {
    constexpr float c1 = 0.01f * 0.01f, c2 = 0.03f * 0.03f;
    const Vec weight = load(weights + x);
    const Mask counts = gt(weight, Vec{});
    if (!any(counts)) continue;
    const Vec mx = filtered.across(window, 0, x), my = filtered.across(window, 1, x);
    const Vec squares = filtered.across(window, 2, x), product = filtered.across(window, 3, x);
    const Vec luminance = 2.f * mx * my + c1, contrast = 2.f * (product - mx * my) + c2;
    const Vec means = mx * mx + my * my, d = means + c1, e = squares - means + c2;
    const Vec inverse = 1.f / (d * e), value = luminance * contrast * inverse;
    const Vec by_square = -value * d * inverse, by_product = 2.f * luminance * inverse;
    const Vec by_mean =
        2.f * my * contrast * inverse - value * 2.f * mx * e * inverse - 2.f * mx * by_square - my * by_product;
    total += select(counts, weight * value, Vec{});
    store(map + x, select(counts, weight * by_mean, Vec{}));
    store(map + image.plane() + x, select(counts, weight * by_square, Vec{}));
    store(map + 2 * image.plane() + x, select(counts, weight * by_product, Vec{}));
  }
  return total;
}

// The weighted sum of 1 - SSIM over the pixels that count, times three; leaves its derivatives in the maps.
inline double unlike_terms(const LossRequest &r, LossWorkspace &w, const Window &window) {
  const auto rows = [&](int i) { return rows_of(w, i); };
  sum_over_bands(r, w, rows, [&](int i, int begin, int end) {
    fill_render(r, i, *w.images[i], begin, end);
    return 0.;
  });
  double unlike = sum_over_bands(r, w, rows, [&](int i, int begin, int end) {
    LossImage &image = *w.images[i];
    Filtered filtered(4, image.stride);
    Vec like{};
    for (int y = begin; y < end; y++) {
      for (int q = 0; q < 3; q++) like += ssim_row(window, image, q, y, filtered);
    }
    return -static_cast<double>(sum(like));
  });
  for (int i = 0; i < r.images; i++) unlike += 3 * w.images[i]->weight;
  return unlike;
}

// Adds `factor` times the gradient of 1 - SSIM to row `y` of the box, channel q.
inline void ssim_gradient_row(const LossRequest &r, float factor, const Window &window, int index,
                              const LossImage &image, int q, int y, Filtered &filtered) {
  const int stride = image.stride;
  const float *weights = &image.weights[static_cast<int64_t>(y) * stride];
  for (int x = 0; x < image.columns() + 2 * kRadius; x += kLanes) {
    if (!needed(weights, x, image.columns())) continue;
    for (int map = 0; map < kMaps; map++) {
      const float *rows = &image.maps[(q * kMaps + map) * image.plane() + static_cast<int64_t>(y) * stride + x];
      Vec sum{};
      for (int k = 0; k < kTaps; k++) sum += window.tap[k] * load(rows + k * stride);
      store(filtered.row(map) + x, sum);
    }
  }
  const int64_t in_plane = q * image.plane() + static_cast<int64_t>(y + kRadius) * stride + kRadius;
  const int64_t first = (static_cast<int64_t>(index) * r.height + image.y0 + y) * r.width + image.x0;
  float *to = r.gradient + first * r.channels + q;
  for (int x = 0; x < image.columns(); x += kLanes) {
    const Mask counts = gt(load(weights + x), Vec{});
    if (!any(counts)) continue;
    const Vec a = load(&image.x[in_plane + x]), b = load(&image.y[in_plane + x]);
    const Vec through =
        filtered.across(window, 0, x) + 2.f * a * filtered.across(window, 1, x) + b * filtered.across(window, 2, x);
    const Vec gradient = select(counts, factor * through, Vec{});
    for (int lane = 0; lane < std::min(kLanes, image.columns() - x); lane++)
      to[(x + lane) * r.channels] -= gradient[lane];
  }
}

}  // namespace splat
