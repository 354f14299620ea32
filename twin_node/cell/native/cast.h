// Solids drawn into an image: first which of them every pixel shows, then what it looks like there.
#pragma once

#include <algorithm>
#include <vector>

#include "entries.h"
#include "shade.h"

#include "../../native/rounded_twice.h"

namespace cell {

// Some rows of an image, so few that all about them stays in a near cache.
class Strip {
 public:
  static constexpr int32_t kRows = 16;

  explicit Strip(const CastRequest &request)
      : r_(request), shown_(static_cast<size_t>(request.width) * kRows), depth_(shown_.size()) {}

  void draw(int32_t top, int32_t bottom) {
    top_ = top, bottom_ = bottom;
    const float *before = r_.depth + begin_of(top);
    const int64_t pixels = begin_of(bottom) - begin_of(top);
    for (int64_t i = 0; i < pixels; i++) depth_[i] = before[i] > 0.f ? before[i] : kNever, shown_[i] = kBackground;
    for (int32_t index = 0; index < r_.solids; index++) find(Solid(r_, index));
    for (int32_t index = 0; index < r_.solids; index++) shade(Solid(r_, index));
  }

 private:
  static constexpr int32_t kBackground = -1;

  void find(const Solid &solid) {
    const float *lengths = solid.lengths;
    if (solid.form == kBox) return find(solid, BoxEntry(solid.origin, lengths));
    if (solid.form == kSphere) return find(solid, SphereEntry(solid.origin, lengths[0]));
    const CapsuleEntry entry(solid.origin, lengths[0], lengths[1]);
    if (!entry.is_about_camera()) find(solid, entry);
  }

  // Whose rays enter the solid before all that was found until now.
  template <class Entry>
  void find(const Solid &solid, const Entry entry) {
    const int64_t plane = static_cast<int64_t>(r_.width) * r_.height;
    const int32_t index = solid.index, columns = solid.right - solid.left;
    const Rotation rotation = solid.rotation;
    for (int32_t row = first_of(solid); row < end_of(solid); row++) {
      const int64_t begin = begin_of(row) + solid.left, own = begin - begin_of(top_);
      const float *__restrict x = r_.rays + begin, *__restrict y = x + plane, *__restrict z = y + plane;
      float *__restrict depth = depth_.data() + own;
      int32_t *__restrict shown = shown_.data() + own;
#pragma omp simd
      for (int32_t i = 0; i < columns; i++) {
        const float t = entry(rotation.turn_back({x[i], y[i], z[i]}));
        const bool is_nearer = t < depth[i];
        depth[i] = is_nearer ? t : depth[i];
        shown[i] = is_nearer ? index : shown[i];
      }
    }
  }

  void shade(const Solid &solid) {
    Shader shader(r_, solid);
    int64_t pixels[kBlock];
    float depths[kBlock];
    int32_t count = 0;
    for (int32_t row = first_of(solid); row < end_of(solid); row++) {
      const int64_t end = begin_of(row) + solid.right;
      for (int64_t pixel = begin_of(row) + solid.left; pixel < end; pixel++) {
        const int64_t own = pixel - begin_of(top_);
        if (shown_[own] != solid.index) continue;
        r_.depth[pixel] = depths[count] = depth_[own];
        r_.owners[pixel] = solid.owner;
        pixels[count++] = pixel;
        if (count == kBlock) shader.draw(pixels, depths, count), count = 0;
      }
    }
    shader.draw(pixels, depths, count);
  }

  int64_t begin_of(int32_t row) const { return static_cast<int64_t>(row) * r_.width; }
  int32_t first_of(const Solid &solid) const { return std::max(solid.top, top_); }
  int32_t end_of(const Solid &solid) const { return std::min(solid.bottom, bottom_); }

  const CastRequest &r_;
  std::vector<int32_t> shown_;  // [kRows, width] index of the solid
  std::vector<float> depth_;    // [kRows, width] of what is found, `kNever` where nothing is
  int32_t top_ = 0, bottom_ = 0;
};

inline void cast(const CastRequest &r) {
  Strip strip(r);
  for (int32_t top = 0; top < r.height; top += Strip::kRows) strip.draw(top, std::min(top + Strip::kRows, r.height));
}

}  // namespace cell

#include "../../native/rounded_as_usual.h"
