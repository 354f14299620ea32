// The forward pass over all images of a call.
#pragma once

#include <algorithm>
#include <memory>

#include "blend.h"
#include "finder.h"
#include "finite.h"
#include "harmonics.h"

namespace splat {

struct Workspace {
  std::mutex in_use;                           // one call at a time
  std::vector<std::unique_ptr<Image>> images;  // of the last forward pass
  Buffer<float> camera_sums;                   // [tasks, images, kCameraSums]
};
constexpr int kCameraSums = 15;  // R, t, position

inline int images_of(const Request &r) { return r.batches * r.cameras; }
inline int channels_of(const Request &r) { return r.color_channels + (r.depth_mode != kNoDepth ? 1 : 0); }
inline bool has_harmonics(const Request &r) { return r.sh_bases > 0 && r.color_channels > 0; }
inline int floats_per_color(const Request &r) { return has_harmonics(r) ? 3 * r.sh_bases : r.color_channels; }
inline int64_t color_offset(const Request &r, int image) {
  const int64_t of_camera = r.colors_per_camera ? int64_t{image % r.cameras} * r.gaussians * floats_per_color(r) : 0;
  return image / r.cameras * r.colors_stride + of_camera;
}

// Index of the first argument with a value that is not finite, or -1. Order as in kNonFinite.
inline int non_finite_argument(const Request &r) {
  const int64_t n = r.gaussians, images = images_of(r);
  const auto floats = [&](int64_t stride, int64_t of_batch) { return stride == 0 ? of_batch : stride * r.batches; };
  const int64_t colors = n * floats_per_color(r) * (r.colors_per_camera ? r.cameras : 1);
  const Floats arguments[] = {
      {r.means, floats(r.means_stride, 3 * n)},
      {r.quats, floats(r.quats_stride, 4 * n)},
      {r.scales, floats(r.scales_stride, 3 * n)},
      {r.opacities, floats(r.opacities_stride, n)},
      {r.colors, floats(r.colors_stride, colors)},
      {r.viewmats, 16 * images},
      {r.Ks, 9 * images},
      {r.backgrounds, images * channels_of(r)},
      {r.backdrop, images * channels_of(r) * r.width * r.height},
  };
  return first_non_finite(arguments);
}

// Projects one task's Gaussians of one batch into all its cameras.
inline void project_task(const Request &r, Workspace &w, int batch, int task) {
  const int begin = task * kGaussiansPerTask, end = std::min(r.gaussians, begin + kGaussiansPerTask);
  std::vector<Finder> finders;
  finders.reserve(r.cameras);
  for (int camera = 0; camera < r.cameras; camera++) {
    const int index = batch * r.cameras + camera;
    finders.emplace_back(r, *w.images[index], index, task);
  }
  const float *means = r.means + batch * r.means_stride, *scales = r.scales + batch * r.scales_stride;
  for (int first = begin; first < end; first += kLanes) {
    const Rows rows(first, end);
    const Vec mean[3] = {rows.column(means, 3, 0), rows.column(means, 3, 1), rows.column(means, 3, 2)};
    Vec largest{};
    for (int i = 0; i < 3; i++) largest = max(largest, abs(rows.column(scales, 3, i)));
    for (Finder &finder : finders) finder.scan(rows, mean, largest);
  }
  for (int camera = 0; camera < r.cameras; camera++) {
    w.images[batch * r.cameras + camera]->found_count[task] = finders[camera].finish() - begin;
  }
}

inline Direction view_direction(const Camera &camera, const Vec *mean, Vec &inverse_length) {
  const Direction d{mean[0] - camera.position[0], mean[1] - camera.position[1], mean[2] - camera.position[2]};
  inverse_length = 1.0f / sqrt(max(d.x * d.x + d.y * d.y + d.z * d.z, broadcast(1e-24f)));
  return {d.x * inverse_length, d.y * inverse_length, d.z * inverse_length};
}

// Colours of splats [begin, end) from their harmonics, max(sum + 0.5, 0).
inline void evaluate_harmonics(const Request &r, Image &image, int index, int begin, int end) {
  const float *colors = r.colors + color_offset(r, index);
  const float *means = r.means + index / r.cameras * r.means_stride;
  const int bases = (r.sh_degree + 1) * (r.sh_degree + 1), width = floats_per_color(r);
  for (int first = begin; first < end; first += kLanes) {
    const Rows rows(&image.id[first], end - first);
    const Vec mean[3] = {rows.column(means, 3, 0), rows.column(means, 3, 1), rows.column(means, 3, 2)};
    Vec inverse_length, value[kMaxBases];
    harmonics(r.sh_degree, view_direction(image.camera, mean, inverse_length), value);
    for (int q = 0; q < 3; q++) {
      Vec color = broadcast(0.5f);
      for (int k = 0; k < bases; k++) color += value[k] * rows.column(colors, width, 3 * k + q);
      color = max(color, Vec{});
      for (int lane = 0; lane < rows.count; lane++) image.splats[first + lane].channel[q] = color[lane];
    }
  }
}

// Puts the channels of a pass into splats [begin, end); those that the pass does not use are zero.
inline void load_channels(const Request &r, Image &image, int index, const Pass &pass, int begin, int end) {
  if (has_harmonics(r)) evaluate_harmonics(r, image, index, begin, end);
  const float *colors = r.color_channels > 0 ? r.colors + color_offset(r, index) : nullptr;
  const int from_colors = pass.count - (pass.has_depth ? 1 : 0);
  for (int row = begin; row < end; row++) {
    float *channel = image.splats[row].channel;
    if (!has_harmonics(r) && from_colors > 0) {
      std::copy_n(colors + static_cast<int64_t>(image.id[row]) * r.color_channels + pass.first, from_colors, channel);
    }
    if (pass.has_depth) channel[from_colors] = image.depth[row];
    std::fill(channel + pass.count, channel + kChannels, 0.f);
  }
}

inline Pass make_pass(const Request &r, int first) {
  const int total = channels_of(r), count = std::min(kChannels, total - first);
  const bool has_depth = r.depth_mode != kNoDepth && first + count == total;
  return {first, count, total, has_depth, r.depth_mode == kExpectedDepth, kGeometrySums + total};
}

// Calls `work` with the number of channels to compile for: the smallest of 1, 3, 4 and 8 that holds `count`.
template <class Work>
inline void for_width(int count, const Work &work) {
  if (count <= 1) {
    work(std::integral_constant<int, 1>());
  } else if (count <= 3) {
    work(std::integral_constant<int, 3>());
  } else if (count <= 4) {
    work(std::integral_constant<int, 4>());
  } else {
    work(std::integral_constant<int, kChannels>());
  }
}

// Runs task(image, tile) over all tiles of all images.
template <class Task>
inline void over_tiles(const Request &r, const Workspace &w, const Task &task) {
  constexpr int64_t kGrain = 1024;  // intersections, or pixels by the hundred
  int64_t work = 0;
  for (int i = 0; i < images_of(r); i++)
    work += w.images[i]->intersections + w.images[i]->width * w.images[i]->height / 100;
  const int tiles = w.images[0]->tiles();
  parallel_for(threads_for(r.threads, work, kGrain), int64_t{tiles} * images_of(r),
               [&](int64_t at) { task(static_cast<int>(at / tiles), static_cast<int>(at % tiles)); });
}

inline const uint8_t *mask_of(const Request &r, int image) {
  return r.pixel_mask == nullptr ? nullptr : r.pixel_mask + static_cast<int64_t>(image) * r.width * r.height;
}

// Gives all splats the channels of a pass.
inline void fill_splats(const Request &r, Workspace &w, const Pass &pass) {
  parallel_for(r.threads, images_of(r),
               [&](int64_t i) { load_channels(r, *w.images[i], static_cast<int>(i), pass, 0, w.images[i]->visible); });
}

inline void blend_pass(const Request &r, Workspace &w, const Pass &pass, bool only_live) {
  over_tiles(r, w, [&](int i, int index) {
    const int64_t pixels = static_cast<int64_t>(r.width) * r.height * i;
    const PixelsOut out{r.renders + pixels * pass.total, r.alphas + pixels,
                        r.backgrounds == nullptr ? nullptr : r.backgrounds + i * pass.total,
                        r.backdrop == nullptr ? nullptr : r.backdrop + pixels * pass.total,
                        r.backdrop == nullptr ? nullptr : r.seen + pixels * pass.total, only_live};
    const Tile tile(*w.images[i], index, mask_of(r, i));
    for_width(pass.count, [&](auto width) { blend_tile<width>(*w.images[i], tile, pass, r.max_alpha, out); });
  });
}

// Runs work(image, begin, end) over the splats of all images, some of one image at a time.
template <class Work>
inline void over_splats(int threads, const Request &r, const Workspace &w, const Work &work) {
  constexpr int kSplatsPerTask = 256;
  int most = 0;
  for (int i = 0; i < images_of(r); i++) most = std::max(most, w.images[i]->visible);
  const int64_t chunks = (most + kSplatsPerTask - 1) / kSplatsPerTask;
  parallel_for(threads, chunks * images_of(r), [&](int64_t at) {
    const int i = static_cast<int>(at / chunks), begin = static_cast<int>(at % chunks) * kSplatsPerTask;
    const int end = std::min(w.images[i]->visible, begin + kSplatsPerTask);
    if (begin < end) work(i, begin, end);
  });
}

// Runs step(image) -> Status for all images side by side; the worst of what they return.
template <class Step>
inline Status in_each_image(int threads, const Request &r, const Workspace &w, const Step &step) {
  std::vector<Status> status(images_of(r), kOk);
  parallel_for(threads, images_of(r), [&](int64_t i) { status[i] = step(*w.images[i]); });
  return *std::max_element(status.begin(), status.end());
}

// From what projection found to tiles with their splats.
inline Status sort_and_bin(const Request &r, Workspace &w, int tasks) {
  constexpr int64_t kGrain = 2048;  // splats
  int64_t found = 0;
  for (int i = 0; i < images_of(r); i++) {
    for (int task = 0; task < tasks; task++) found += w.images[i]->found_count[task];
  }
  const int threads = threads_for(r.threads, found, kGrain);
  const Status ordered = in_each_image(threads, r, w, [&](Image &image) {
    order_by_depth(image, r.gaussians);
    return kOk;
  });
  if (ordered != kOk) return ordered;
  over_splats(threads, r, w, [&](int i, int begin, int end) {
    gather_splats(*w.images[i], begin, end);
    load_channels(r, *w.images[i], i, make_pass(r, 0), begin, end);
  });
  return in_each_image(threads, r, w,
                       [](Image &image) { return bin_into_tiles(image) ? kOk : kTooManyIntersections; });
}

inline Status forward(Workspace &w, const Request &r) {
  const std::lock_guard<std::mutex> lock(w.in_use);
  while (static_cast<int>(w.images.size()) < images_of(r)) w.images.push_back(std::make_unique<Image>());
  for (int i = 0; i < images_of(r); i++) prepare_image(*w.images[i], r, i);
  const int tasks = w.images[0]->tasks(r.gaussians);
  constexpr int64_t kGrain = 4096;  // Gaussians times images
  const int threads = threads_for(r.threads, static_cast<int64_t>(r.gaussians) * images_of(r), kGrain);
  parallel_for(threads, static_cast<int64_t>(r.batches) * tasks,
               [&](int64_t at) { project_task(r, w, static_cast<int>(at / tasks), static_cast<int>(at % tasks)); });
  const Status status = sort_and_bin(r, w, tasks);
  if (status != kOk) return status;
  for (int first = 0; first < channels_of(r); first += kChannels) {
    const Pass pass = make_pass(r, first);
    if (first > 0) fill_splats(r, w, pass);
    blend_pass(r, w, pass, false);
  }
  return kOk;
}

// Looks anew at the splats [begin, end) of an image that stand for Gaussians from `first_row` on.
inline void refresh_splats(const Request &r, Image &image, int index, int begin, int end, int first_row) {
  int32_t rows[kLanes], ids[kLanes];
  const auto refresh = [&](int count) {
    const Outlines outlines(r, image.camera, index / r.cameras, Rows(ids, count));
    for (int lane = 0; lane < count; lane++) {
      Splat &splat = image.splats[rows[lane]];
      const float depth = outlines.drawn >> lane & 1 ? outlines.depth(lane) : -1.f;
      if (depth >= r.near_plane && depth <= r.far_plane) {
        splat.shape = outlines.footprint(lane);
        image.depth[rows[lane]] = depth;
      } else {
        splat.shape.log2_opacity = kLog2AlphaThreshold - 1.f;
      }
    }
  };
  int count = 0;
  for (int row = begin; row < end; row++) {
    if (image.id[row] < first_row) continue;
    rows[count] = row;
    ids[count++] = image.id[row];
    if (count < kLanes) continue;
    refresh(count);
    count = 0;
  }
  if (count > 0) refresh(count);
  load_channels(r, image, index, make_pass(r, 0), begin, end);
}

// Draws the scene of the workspace's last forward pass again after its Gaussians from `first_row` on have changed a
// little: they keep their order and their tiles. For no more channels than one pass has.
inline void redraw(Workspace &w, const Request &r, int first_row) {
  const std::lock_guard<std::mutex> lock(w.in_use);
  over_splats(r.threads, r, w,
              [&](int i, int begin, int end) { refresh_splats(r, *w.images[i], i, begin, end, first_row); });
  blend_pass(r, w, make_pass(r, 0), true);
}

}  // namespace splat
