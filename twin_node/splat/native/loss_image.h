// The pixels of a batch of images that a loss is summed over, and the order in which it is.
#pragma once

#include <algorithm>
#include <memory>
#include <vector>

#include "interface.h"
#include "workspace.h"

namespace splat {

constexpr int kRowsPerTask = 8;

// One image's weighted pixels, and planes over their bounding box for the SSIM, padded by its window's radius.
struct LossImage {
  int x0 = 0, x1 = 0, y0 = 0, y1 = 0;  // bounding box of the weights, end exclusive
  int stride = 0, padded_rows = 0;
  double weight = 0, depth_weight = 0;  // sums over the image
  Buffer<float> x, y;                   // [3, padded rows, stride] render and target
  Buffer<float> weights;                // [rows, stride], 0 beyond the box
  Buffer<float> maps;                   // [9, padded rows, stride] three derivatives of each channel's SSIM

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

}  // namespace splat
