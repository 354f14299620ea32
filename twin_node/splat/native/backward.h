// The backward pass: from gradients of the images to gradients of the Gaussians and cameras.
#pragma once

#include "rasterizer.h"

namespace splat {

constexpr int kRowsPerShare = 128;  // Gaussians whose gradients one task adds up; fixed, as `kGaussiansPerTask`

inline void blend_vjp_pass(const Request &r, const Gradients &g, Workspace &w, const Pass &pass) {
  const Wanted wanted{g.first_row, g.learns};
  over_tiles(r, w, [&](int i, int index) {
    Image &image = *w.images[i];
    if (image.tile_begin[index] == image.tile_begin[index + 1]) return;
    const int64_t pixels = static_cast<int64_t>(r.width) * r.height * i;
    const PixelsIn in{r.renders + pixels * pass.total, r.alphas + pixels, g.v_renders + pixels * pass.total,
                      g.v_alphas == nullptr ? nullptr : g.v_alphas + pixels,
                      r.backdrop == nullptr ? nullptr : r.backdrop + pixels * pass.total};
    const Tile tile(image, index, mask_of(r, i));
    for_width(pass.count, [&](auto width) { blend_tile_vjp<width>(image, tile, pass, r.max_alpha, in, wanted); });
  });
}

// True where a splat has a gradient at all.
inline bool has_gradient(const Image &image, int row) {
  if (row < 0) return false;
  const uint8_t *used = image.slot_used.data();
  return std::any_of(used + image.slot_begin[row], used + image.slot_begin[row + 1], [](uint8_t u) { return u != 0; });
}

// Sums of a vector of Gaussians' slots over the tiles of one image, [value][lane].
class SlotTotals {
 public:
  SlotTotals(int values, int stride)
      : values_(values), stride_(stride), totals_(static_cast<size_t>(values) * kLanes) {}

  // False where the image has nothing for any of the Gaussians.
  bool collect(const Image &image, const Rows &rows) {
    uint32_t found = 0;
    for (int lane = 0; lane < rows.count; lane++) found |= (image.row_of[rows.id[lane]] >= 0 ? 1u : 0u) << lane;
    if (found == 0) return false;
    std::fill(totals_.begin(), totals_.end(), 0.f);
    for (; found; found &= found - 1) {
      const int lane = __builtin_ctz(found), row = image.row_of[rows.id[lane]];
      for (int first = 0; first < values_; first += kLanes) collect_lane(image, row, first, lane);
    }
    return true;
  }
  Vec operator[](int value) const { return load(&totals_[static_cast<size_t>(value) * kLanes]); }

 private:
  // Values [first, first + kLanes) of the splat in `row`; the last slot is followed by room for a vector.
  void collect_lane(const Image &image, int row, int first, int lane) {
    Vec sums{};
    for (int slot = image.slot_begin[row]; slot < image.slot_begin[row + 1]; slot++) {
      if (image.slot_used[slot]) sums += load(&image.slot_gradient[static_cast<size_t>(slot) * stride_ + first]);
    }
    for (int i = first; i < std::min(first + kLanes, values_); i++) {
      totals_[static_cast<size_t>(i) * kLanes + lane] = sums[i - first];
    }
  }

  int values_, stride_;
  std::vector<float> totals_;
};

inline void add_column(float *base, int width, int index, const Rows &rows, Vec v) {
  for (int lane = 0; lane < rows.count; lane++) base[static_cast<int64_t>(rows.id[lane]) * width + index] += v[lane];
}

// Gradient of the colours; with harmonics also what comes back through the viewing direction.
inline void colors_vjp(const Request &r, const Gradients &g, int index, const Image &image, const Rows &rows,
                       const Shape &shape, const SlotTotals &totals, Vec *v_direction) {
  if (r.color_channels == 0) return;
  float *v_colors = g.v_colors + color_offset(r, index);
  const int width = floats_per_color(r);
  if (!has_harmonics(r)) {
    for (int q = 0; q < width; q++) add_column(v_colors, width, q, rows, totals[kGeometrySums + q]);
    return;
  }
  const float *colors = r.colors + color_offset(r, index);
  const int bases = (r.sh_degree + 1) * (r.sh_degree + 1);
  Vec inverse_length, value[kMaxBases], v_value[kMaxBases] = {};
  const Direction d = view_direction(image.camera, shape.mean, inverse_length);
  harmonics(r.sh_degree, d, value);
  for (int q = 0; q < 3; q++) {
    Vec color{};
    for (int lane = 0; lane < rows.count; lane++) {
      const int row = image.row_of[rows.id[lane]];
      if (row >= 0) color[lane] = image.splats[row].channel[q];
    }
    const Vec v = select(gt(color, Vec{}), totals[kGeometrySums + q], Vec{});  // the clamp at 0 stops it
    for (int k = 0; k < bases; k++) {
      if (r.sh_degree > 0) v_value[k] += v * rows.column(colors, width, 3 * k + q);
      add_column(v_colors, width, 3 * k + q, rows, v * value[k]);
    }
  }
  if (r.sh_degree == 0) return;
  const Direction v = harmonics_vjp(r.sh_degree, d, v_value);
  const Vec along = v.x * d.x + v.y * d.y + v.z * d.z;
  v_direction[0] = (v.x - along * d.x) * inverse_length;
  v_direction[1] = (v.y - along * d.y) * inverse_length;
  v_direction[2] = (v.z - along * d.z) * inverse_length;
}

// Gradient of what a Projection gives, from a vector's slots.
inline ProjectionGradient projection_gradient(const Request &r, const Projection &p, Vec opacity,
                                              const SlotTotals &sums, Vec &v_opacity) {
  ProjectionGradient v;
  const Vec a = p.conic_a(), b = p.conic_b(), c = p.conic_c();
  v.mean2d[0] = a * sums[1] + b * sums[2];
  v.mean2d[1] = b * sums[1] + c * sums[2];
  v.conic[0] = 0.5f * sums[3];
  v.conic[1] = sums[4];
  v.conic[2] = 0.5f * sums[5];
  v.depth = r.depth_mode == kNoDepth ? Vec{} : sums[kGeometrySums + channels_of(r) - 1];
  const Vec factor = r.antialiased ? compensation(p, r.min_compensation) : broadcast(1.f);
  const Vec v_effective = -sums[0] / max(opacity * factor, broadcast(1e-12f));
  v.compensation = v_effective * opacity;
  v_opacity = v_effective * factor;
  return v;
}

// Gradients of one vector of Gaussians, summed over cameras.
struct RowGradient {
  ShapeGradient shape;
  Vec opacity;
  RowGradient() { std::memset(this, 0, sizeof(*this)); }

  // Adds those of one camera; lanes that it does not see may hold infinities there and are left out.
  void add(const RowGradient &other, Mask seen, const Vec *v_direction) {
    for (int i = 0; i < 3; i++) shape.mean[i] += select(seen, other.shape.mean[i], Vec{}) + v_direction[i];
    for (int i = 0; i < 4; i++) shape.quat[i] += select(seen, other.shape.quat[i], Vec{});
    for (int i = 0; i < 3; i++) shape.scale[i] += select(seen, other.shape.scale[i], Vec{});
    opacity += select(seen, other.opacity, Vec{});
  }
};

inline Mask seen_by(const Image &image, const Rows &rows) {
  Vec row = broadcast(-1.f);
  for (int lane = 0; lane < rows.count; lane++) row[lane] = static_cast<float>(image.row_of[rows.id[lane]]);
  return ge(row, Vec{});
}

// One camera's part of the gradients of one vector of Gaussians; with the camera's own added to sums[kCameraSums].
inline void camera_vjp(const Request &r, const Gradients &g, int index, const Image &image, const Rows &rows,
                       const Shape &shape, Vec opacity, const SlotTotals &totals, RowGradient &v, float *sums) {
  Projection p;
  transform_point(image.camera, shape, p);
  project_covariance(image.camera, shape, r.eps2d, p);
  RowGradient here;
  Vec v_direction[3] = {};
  const ProjectionGradient v_projection = projection_gradient(r, p, opacity, totals, here.opacity);
  const ProjectionOptions options{r.eps2d, r.antialiased != 0, r.min_compensation};
  project_vjp(image.camera, shape, p, v_projection, options, g.v_viewmats != nullptr, here.shape);
  colors_vjp(r, g, index, image, rows, shape, totals, v_direction);
  const Mask seen = seen_by(image, rows);
  v.add(here, seen, v_direction);
  if (g.v_viewmats == nullptr) return;
  for (int i = 0; i < 9; i++) sums[i] += sum(select(seen, here.shape.R[i], Vec{}));
  for (int i = 0; i < 3; i++) sums[9 + i] += sum(select(seen, here.shape.t[i], Vec{}));
  for (int i = 0; i < 3; i++) sums[12 + i] -= sum(v_direction[i]);
}

// Backward pass of one vector of Gaussians through all cameras of a batch; the cameras' sums are [camera][kCameraSums].
inline void shape_vjp(const Request &r, const Gradients &g, Workspace &w, int batch, const Rows &rows,
                      SlotTotals &totals, float *camera_sums) {
  RowGradient v;
  const Shape shape = load_shape(r, batch, rows);
  const Vec opacity = rows.column(r.opacities + batch * r.opacities_stride, 1, 0);
  for (int camera = 0; camera < r.cameras; camera++) {
    const int index = batch * r.cameras + camera;
    const Image &image = *w.images[index];
    if (!totals.collect(image, rows)) continue;
    camera_vjp(r, g, index, image, rows, shape, opacity, totals, v, camera_sums + camera * kCameraSums);
  }
  for (int i = 0; i < 3; i++) add_column(g.v_means + batch * r.means_stride, 3, i, rows, v.shape.mean[i]);
  for (int i = 0; i < 4; i++) add_column(g.v_quats + batch * r.quats_stride, 4, i, rows, v.shape.quat[i]);
  for (int i = 0; i < 3; i++) add_column(g.v_scales + batch * r.scales_stride, 3, i, rows, v.shape.scale[i]);
  add_column(g.v_opacities + batch * r.opacities_stride, 1, 0, rows, v.opacity);
}

// Lists those of the Gaussians [begin, end) that any camera of the batch has a gradient for; the number of them.
inline int find_touched(const Request &r, const Workspace &w, int batch, int begin, int end, int32_t *ids) {
  int count = 0;
  for (int id = begin; id < end; id++) {
    bool touched = false;
    for (int camera = 0; camera < r.cameras && !touched; camera++) {
      const Image &image = *w.images[batch * r.cameras + camera];
      touched = has_gradient(image, image.row_of[id]);
    }
    if (touched) ids[count++] = id;
  }
  return count;
}

// Adds what comes back through the position p, which solves viewmat (p, 1) = (0, 0, 0, 1), to the gradient of viewmat.
inline void position_vjp(const Camera &camera, const float *v_position, float *v_viewmat) {
  const double p[4] = {camera.position[0], camera.position[1], camera.position[2], 1.};
  double v_row[4] = {};  // times -p it is the gradient of each row
  for (int i = 0; i < 3; i++) {
    for (int j = 0; j < 3; j++) v_row[i] += camera.inverse_R[3 * j + i] * v_position[j];
    v_row[3] += v_position[i] * p[i];
  }
  for (int i = 0; i < 4; i++) {
    for (int j = 0; j < 4; j++) v_viewmat[4 * i + j] -= static_cast<float>(v_row[i] * p[j]);
  }
}

// Adds the tasks' camera sums up, in the tasks' order.
inline void write_camera_gradients(const Request &r, const Gradients &g, const Workspace &w, int tasks) {
  const int images = images_of(r);
  for (int image = 0; image < images; image++) {
    float total[kCameraSums] = {};
    for (int task = 0; task < tasks; task++) {
      const float *sums = &w.camera_sums[(static_cast<size_t>(task) * images + image) * kCameraSums];
      for (int i = 0; i < kCameraSums; i++) total[i] += sums[i];
    }
    float *v_viewmat = g.v_viewmats + 16 * image;
    for (int i = 0; i < 3; i++) {
      for (int j = 0; j < 3; j++) v_viewmat[4 * i + j] = total[3 * i + j];
      v_viewmat[4 * i + 3] = total[9 + i];
    }
    position_vjp(w.images[image]->camera, total + 12, v_viewmat);
  }
}

inline Status backward(Workspace &w, const Request &r, const Gradients &g) {
  const std::lock_guard<std::mutex> lock(w.in_use);
  const int images = images_of(r), tasks = (r.gaussians - g.first_row + kRowsPerShare - 1) / kRowsPerShare;
  const int stride = make_pass(r, 0).slot_stride;
  for (int i = 0; i < images; i++) {
    w.images[i]->slot_gradient.reserve(static_cast<size_t>(w.images[i]->intersections) * stride);
    w.images[i]->slot_used.reserve(w.images[i]->intersections);
  }
  const size_t camera_floats = static_cast<size_t>(tasks) * images * kCameraSums;
  std::fill_n(w.camera_sums.reserve(camera_floats), camera_floats, 0.f);
  const bool reload = channels_of(r) > kChannels;  // the splats still hold the forward pass's last channels
  for (int first = 0; first < channels_of(r); first += kChannels) {
    const Pass pass = make_pass(r, first);
    if (reload) fill_splats(r, w, pass);
    blend_vjp_pass(r, g, w, pass);
  }
  // A task owns its Gaussians in every batch and camera, so that sums need no locks and have one order.
  constexpr int64_t kGrain = 1024;  // intersections
  int64_t intersections = 0;
  for (int i = 0; i < images; i++) intersections += w.images[i]->intersections;
  parallel_for(threads_for(r.threads, intersections, kGrain), tasks, [&](int64_t task) {
    SlotTotals totals(kGeometrySums + channels_of(r), stride);
    const int begin = g.first_row + static_cast<int>(task) * kRowsPerShare;
    const int end = std::min(r.gaussians, begin + kRowsPerShare);
    for (int batch = 0; batch < r.batches; batch++) {
      float *sums = &w.camera_sums[(static_cast<size_t>(task) * images + batch * r.cameras) * kCameraSums];
      int32_t ids[kRowsPerShare];
      const int count = find_touched(r, w, batch, begin, end, ids);
      for (int i = 0; i < count; i += kLanes) shape_vjp(r, g, w, batch, Rows(ids + i, count - i), totals, sums);
    }
  });
  if (g.v_viewmats != nullptr) write_camera_gradients(r, g, w, tasks);
  return kOk;
}

}  // namespace splat
