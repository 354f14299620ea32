// L1 + (1 - SSIM) + depth L1 of a batch of images, value and gradient in one go.
//
// SSIM: Wang et al. 2004, 11x11 Gaussian window of sigma 1.5 px, zero padding, data range 1. Pixels of weight 0 count
// as equal to their target, so that windows that reach over the edge of a mask compare what the mask selects and no
// more.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory>

#include "finite.h"
#include "interface.h"
#include "simd.h"
#include "workspace.h"

namespace splat {

constexpr int kRadius = 5, kTaps = 2 * kRadius + 1;  // of the window, pixels
constexpr int kRowsPerTask = 8;
constexpr int kMaps = 3;  // derivatives of the SSIM by E[x], E[x^2] and E[xy]

struct Window {
  float tap[kTaps];
  Window() {
    double total = 0, value[kTaps];
    for (int i = 0; i < kTaps; i++) total += value[i] = std::exp(-(i - kRadius) * (i - kRadius) / (2 * 1.5 * 1.5));
    for (int i = 0; i < kTaps; i++) tap[i] = static_cast<float>(value[i] / total);
  }
};

// One image's weighted pixels and planes over their bounding box, padded by the window's radius.
struct LossImage {
  int x0 = 0, x1 = 0, y0 = 0, y1 = 0;  // bounding box of the weights, end exclusive
  int stride = 0, padded_rows = 0;
  double weight = 0, depth_weight = 0;  // sums over the image
  Buffer<float> x, y;                   // [3, padded rows, stride] render and target
  Buffer<float> weights;                // [rows, stride], 0 beyond the box
  Buffer<float> maps;                   // [3 * kMaps, padded rows, stride]

  int rows() const { return y1 - y0; }
  int columns() const { return x1 - x0; }
  int64_t plane() const { return static_cast<int64_t>(padded_rows) * stride; }
};

struct LossWorkspace {
  std::vector<std::unique_ptr<LossImage>> images;
  Buffer<double> sums;  // [tasks]
};

inline Pool<LossWorkspace> &loss_workspaces() {
  static Pool<LossWorkspace> pool;
  return pool;
}

// Index of the first argument with a value that is not finite, or -1: render, target, weights, target_depth.
inline int non_finite_argument(const LossRequest &r) {
  const int64_t pixels = static_cast<int64_t>(r.images) * r.height * r.width;
  const Floats arguments[] = {
      {r.render, pixels * r.channels}, {r.target, pixels * 3}, {r.weights, pixels}, {r.target_depth, pixels}};
  return first_non_finite(arguments);
}

// 1 for pixels that count fully, 0 for those that do not count.
inline float weight_at(const LossRequest &r, int64_t pixel) {
  return r.weights == nullptr ? 1.f : std::max(r.weights[pixel], 0.f);
}

inline void measure_all(const LossRequest &r, int index, LossImage &image) {
  image.x0 = image.y0 = 0;
  image.x1 = r.width;
  image.y1 = r.height;
  image.weight = static_cast<double>(r.width) * r.height;
  image.depth_weight = 0;
  if (r.target_depth == nullptr) return;
  const float *depth = r.target_depth + static_cast<int64_t>(index) * r.width * r.height;
  for (int64_t i = 0; i < static_cast<int64_t>(r.width) * r.height; i++) image.depth_weight += depth[i] > 0.f;
}

// Sums the weights and finds their bounding box.
inline void measure_weights(const LossRequest &r, int index, LossImage &image) {
  if (r.weights == nullptr) return measure_all(r, index, image);
  image.x0 = r.width;
  image.y0 = r.height;
  image.x1 = image.y1 = 0;
  image.weight = image.depth_weight = 0;
  for (int y = 0; y < r.height; y++) {
    const int64_t row = (static_cast<int64_t>(index) * r.height + y) * r.width;
    float in_row = 0.f, depth_in_row = 0.f;
    for (int x = 0; x < r.width; x++) {
      const float w = weight_at(r, row + x);
      in_row += w;
      if (r.target_depth != nullptr && r.target_depth[row + x] > 0.f) depth_in_row += w;
    }
    if (!(in_row > 0.f)) continue;
    image.weight += in_row;
    image.depth_weight += depth_in_row;
    image.y0 = std::min(image.y0, y);
    image.y1 = y + 1;
    int first = 0, last = r.width;
    while (!(weight_at(r, row + first) > 0.f)) first++;
    while (!(weight_at(r, row + last - 1) > 0.f)) last--;
    image.x0 = std::min(image.x0, first);
    image.x1 = std::max(image.x1, last);
  }
}

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

// Adds the gradient of 1 - SSIM to row `y` of the box, channel q.
inline void ssim_gradient_row(const LossRequest &r, const Factors &f, const Window &window, int index,
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
    const Vec gradient = select(counts, f.ssim * through, Vec{});
    for (int lane = 0; lane < std::min(kLanes, image.columns() - x); lane++)
      to[(x + lane) * r.channels] -= gradient[lane];
  }
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

// Runs task(image, first row, end row) -> double over bands of `rows(image)` rows and adds the results up in order.
template <class Rows, class Task>
inline double sum_over_bands(const LossRequest &r, LossWorkspace &w, const Rows &rows, const Task &task) {
  constexpr int64_t kGrain = 4096;  // pixels
  int most = 0;
  int64_t pixels = 0;
  for (int i = 0; i < r.images; i++) {
    most = std::max(most, rows(i));
    pixels += static_cast<int64_t>(rows(i)) * w.images[i]->columns();
  }
  const int bands = (most + kRowsPerTask - 1) / kRowsPerTask;
  double *sums = w.sums.reserve(static_cast<size_t>(bands) * r.images + 1);
  parallel_for(threads_for(r.threads, pixels, kGrain), static_cast<int64_t>(bands) * r.images, [&](int64_t at) {
    const int image = static_cast<int>(at / bands), begin = static_cast<int>(at % bands) * kRowsPerTask;
    const int end = std::min(rows(image), begin + kRowsPerTask);
    sums[at] = begin < end ? task(image, begin, end) : 0.;
  });
  double total = 0;
  for (int64_t at = 0; at < static_cast<int64_t>(bands) * r.images; at++) total += sums[at];
  return total;
}

inline int rows_of(const LossWorkspace &w, int index) { return std::max(0, w.images[index]->rows()); }

// Takes in the targets and weights: renders are held to them until others are taken in.
inline void hold_to_target(const LossRequest &r, LossWorkspace &w) {
  while (static_cast<int>(w.images.size()) < r.images) w.images.push_back(std::make_unique<LossImage>());
  parallel_for(r.threads, r.images, [&](int64_t i) { measure_weights(r, static_cast<int>(i), *w.images[i]); });
  if (r.ssim == 0.f) return;
  for (int i = 0; i < r.images; i++) reserve_planes(*w.images[i]);
  sum_over_bands(
      r, w, [&](int i) { return rows_of(w, i) == 0 ? 0 : w.images[i]->padded_rows; },
      [&](int i, int begin, int end) {
        fill_planes(r, i, *w.images[i], begin, end);
        return 0.;
      });
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
      for (int q = 0; q < 3 && f.ssim != 0.f; q++) ssim_gradient_row(r, f, window, i, image, q, y, filtered);
      if (f.depth != 0.f) total += f.depth * depth_row(r, f, i, image, y);
    }
    return total;
  });
  return f.ssim * unlike + rest;
}

// A workspace for as long as it is in scope.
class LossWorkspaceInUse {
 public:
  LossWorkspaceInUse() : workspace_(loss_workspaces().acquire()) {}
  ~LossWorkspaceInUse() { loss_workspaces().release(workspace_); }
  LossWorkspaceInUse(const LossWorkspaceInUse &) = delete;
  LossWorkspaceInUse &operator=(const LossWorkspaceInUse &) = delete;
  LossWorkspace &operator*() const { return *workspace_; }

 private:
  LossWorkspace *workspace_;
};

inline Status image_loss(const LossRequest &r) {
  const LossWorkspaceInUse w;
  hold_to_target(r, *w);
  *r.loss = loss_terms(r, *w);
  return kOk;
}

}  // namespace splat
