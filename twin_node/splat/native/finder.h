// Finds the Gaussians that an image shows.
#pragma once

#include <algorithm>

#include "image.h"

namespace splat {

// Some Gaussians of a batch, one per lane; lanes beyond the count repeat the last one.
struct Rows {
  int count;
  IntVec id;
  // The neighbours [first, end), as many as there are lanes.
  Rows(int first, int end) : count(std::min(kLanes, end - first)) {
    id = first + lane_numbers();
    id = id < end ? id : broadcast(int32_t{end - 1});
  }
  Rows(const int32_t *ids, int count_) : count(std::min(kLanes, count_)) {
    for (int lane = 0; lane < kLanes; lane++) id[lane] = ids[std::min(lane, count - 1)];
  }
  uint32_t valid() const { return (1u << count) - 1; }
  Vec column(const float *base, int width, int index) const { return gather(base + index, id * width); }
};

inline Shape load_shape(const Request &r, int batch, const Rows &rows) {
  Shape s;
  const float *means = r.means + batch * r.means_stride, *quats = r.quats + batch * r.quats_stride;
  const float *scales = r.scales + batch * r.scales_stride;
  for (int i = 0; i < 3; i++) s.mean[i] = rows.column(means, 3, i);
  for (int i = 0; i < 4; i++) s.quat[i] = rows.column(quats, 4, i);
  for (int i = 0; i < 3; i++) s.scale[i] = rows.column(scales, 3, i);
  set_rotation(s);
  return s;
}

// Half sizes in pixels of what gsplat culls by and reports, before they are rounded up, and of what can be drawn at
// all.
struct Extent {
  Vec radius_x, radius_y, reach_x, reach_y;
};

inline Extent extent_of(const Projection &p, Vec log2_opacity) {
  const Vec sigmas = sqrt(max((log2_opacity - kLog2AlphaThreshold) * (2.0f / kLog2E), Vec{}));
  const Vec x = sqrt(p.xx_blur), y = sqrt(p.yy_blur), at_most = min(sigmas, broadcast(kExtentSigmas));
  // The reach is padded by more than float32 can lose, so that it never cuts what the exponent would let through.
  return {at_most * x, at_most * y, sigmas * x * 1.0005f + 1e-3f, sigmas * y * 1.0005f + 1e-3f};
}

// What a vector of Gaussians looks like in one image, lane by lane.
class Outlines {
 public:
  uint32_t drawn;  // lanes that are not too thin or too faint to be drawn

  Outlines(const Request &r, const Camera &camera, int batch, const Rows &rows) {
    const Shape shape = load_shape(r, batch, rows);
    Vec opacity = rows.column(r.opacities + batch * r.opacities_stride, 1, 0);
    Projection p;
    transform_point(camera, shape, p);
    project_covariance(camera, shape, r.eps2d, p);
    if (r.antialiased) opacity *= compensation(p, r.min_compensation);
    drawn = bits(both(gt(p.det, Vec{}), ge(opacity, broadcast(1.f / 255.f)))) & rows.valid();
    if (drawn == 0) return;
    const Vec log2_opacity = log2_positive(max(opacity, broadcast(1e-12f)));
    const Extent extent = extent_of(p, log2_opacity);
    const Vec x = camera.fx * p.point[0] * p.inverse_z + camera.cx;
    const Vec y = camera.fy * p.point[1] * p.inverse_z + camera.cy;
    const Vec a = 0.5f * kLog2E * p.conic_a(), b = kLog2E * p.conic_b(), c = 0.5f * kLog2E * p.conic_c();
    const Vec columns[kOutlineColumns] = {
        x, y, a, b, c, log2_opacity, extent.reach_x, extent.reach_y, extent.radius_x, extent.radius_y, p.point[2]};
    for (int i = 0; i < kOutlineColumns; i++) store(value_[i], columns[i]);
  }

  Footprint footprint(int lane) const {
    return {value_[0][lane], value_[1][lane], value_[2][lane], value_[3][lane],
            value_[4][lane], value_[5][lane], value_[6][lane], value_[7][lane]};
  }
  float radius_x(int lane) const { return value_[8][lane]; }
  float radius_y(int lane) const { return value_[9][lane]; }
  float depth(int lane) const { return value_[10][lane]; }

 private:
  static constexpr int kOutlineColumns = 11;
  float value_[kOutlineColumns][kLanes];
};

// Collects one task's Gaussians for one image: scan them all, then finish.
class Finder {
 public:
  Finder(const Request &r, Image &image, int index, int task)
      : request_(r),
        image_(image),
        batch_(index / r.cameras),
        output_(static_cast<int64_t>(index) * r.gaussians),
        next_(task * kGaussiansPerTask) {}

  // Takes neighbours in, with their means and largest scales; what cannot reach a live pixel goes no further.
  void scan(const Rows &rows, const Vec *mean, Vec largest) {
    store_missing(rows);
    for (uint32_t left = bits(may_reach(mean, largest)) & rows.valid(); left; left &= left - 1) {
      waiting_[waiting_count_++] = rows.id[__builtin_ctz(left)];
    }
    if (waiting_count_ < kLanes) return;
    project(Rows(waiting_, kLanes));
    waiting_count_ -= kLanes;
    std::copy_n(waiting_ + kLanes, waiting_count_, waiting_);
  }

  // Row behind the last one found.
  int finish() {
    if (waiting_count_ > 0) project(Rows(waiting_, waiting_count_));
    waiting_count_ = 0;
    return next_;
  }

 private:
  void store_missing(const Rows &rows) {
    const int first = rows.id[0];
    const int64_t at = output_ + first;
    std::fill_n(&image_.row_of[first], rows.count, -1);
    std::fill_n(request_.radii + 2 * at, 2 * rows.count, 0);
    std::fill_n(request_.means2d + 2 * at, 2 * rows.count, 0.f);
    std::fill_n(request_.depths + at, rows.count, 0.f);
  }

  // False where no covariance with half axes up to `largest` gets a Gaussian's radius into the live pixels.
  Mask may_reach(const Vec *mean, Vec largest) const {
    const Camera &c = image_.camera;
    Vec point[3];
    point_in_camera(c, mean, point);
    const Mask in_depth =
        both(ge(point[2], broadcast(request_.near_plane)), le(point[2], broadcast(request_.far_plane)));
    const Vec inverse_z = 1.0f / point[2], x = point[0] * inverse_z, y = point[1] * inverse_z;
    const Vec ux = max(min(x, broadcast(c.x_max)), broadcast(c.x_min));
    const Vec uy = max(min(y, broadcast(c.y_max)), broadcast(c.y_min));
    const Vec half_axis = c.stretch * largest;
    const Vec in_pixels_x = c.fx * inverse_z * half_axis, in_pixels_y = c.fy * inverse_z * half_axis;
    const Vec reach_x = reach_of(in_pixels_x * in_pixels_x * (1.f + ux * ux));
    const Vec reach_y = reach_of(in_pixels_y * in_pixels_y * (1.f + uy * uy));
    const Vec px = c.fx * x + c.cx, py = c.fy * y + c.cy;
    const PixelRect &live = image_.live_rect;
    const Mask across = both(ge(px + reach_x, broadcast(1.f * live.x0)), le(px - reach_x, broadcast(1.f + live.x1)));
    const Mask down = both(ge(py + reach_y, broadcast(1.f * live.y0)), le(py - reach_y, broadcast(1.f + live.y1)));
    return both(in_depth, both(across, down));
  }
  Vec reach_of(Vec variance) const {
    constexpr float kRounding = 1.001f, kCeil = 1.f;  // of float32, and of the radius to whole pixels
    return (kRounding * kExtentSigmas) * sqrt(variance + request_.eps2d) + kCeil;
  }

  void project(const Rows &rows) {
    const Outlines outlines(request_, image_.camera, batch_, rows);
    for (uint32_t found = outlines.drawn; found; found &= found - 1) {
      const int lane = __builtin_ctz(found);
      keep(rows.id[lane], outlines.footprint(lane), std::ceil(outlines.radius_x(lane)),
           std::ceil(outlines.radius_y(lane)), outlines.depth(lane));
    }
  }

  void keep(int gaussian, const Footprint &f, float radius_x, float radius_y, float depth) {
    const Request &r = request_;
    if (radius_x <= r.radius_clip && radius_y <= r.radius_clip) return;
    // written so that a NaN, which an overflow can leave, is culled
    if (!(f.x + radius_x > 0 && f.x - radius_x < r.width && f.y + radius_y > 0 && f.y - radius_y < r.height)) return;
    const int64_t at = output_ + gaussian;
    constexpr float kLargest = 1e9f;
    r.radii[2 * at] = static_cast<int32_t>(std::min(radius_x, kLargest));
    r.radii[2 * at + 1] = static_cast<int32_t>(std::min(radius_y, kLargest));
    r.means2d[2 * at] = f.x;
    r.means2d[2 * at + 1] = f.y;
    r.depths[at] = depth;
    const PixelRect p = pixel_rect(f, r.width, r.height);
    if (p.empty() || image_.live_tiles(p.x0 / kTile, p.x1 / kTile, p.y0 / kTile, p.y1 / kTile) == 0) return;
    image_.found[next_] = f;
    std::memcpy(&image_.found_key[next_], &depth, sizeof(depth));
    image_.found_id[next_] = gaussian;
    next_++;
  }

  const Request &request_;
  Image &image_;
  const int batch_;
  const int64_t output_;
  int next_;
  int32_t waiting_[2 * kLanes];
  int waiting_count_ = 0;
};

}  // namespace splat
