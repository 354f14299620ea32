// Images of one view: least and greatest values about each pixel, distances, and blobs.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace forecast {

// Pixels about one: row by row so many to either side.
struct Patch {
  int32_t reach;
  std::vector<int32_t> sides;  // [2 reach + 1]

  // Those whose middles lie within `radius` pixels.
  static Patch disk(double radius) {
    Patch patch{static_cast<int32_t>(radius), {}};
    for (int32_t row = -patch.reach; row <= patch.reach; row++) {
      int32_t side = patch.reach;
      while (std::hypot(static_cast<double>(row), static_cast<double>(side)) > radius) side--;
      patch.sides.push_back(side);
    }
    return patch;
  }

  static Patch square(int32_t reach) { return {reach, std::vector<int32_t>(2 * reach + 1, reach)}; }
};

struct Least {
  template <class Value>
  static Value of(Value one, Value other) {
    return other < one ? other : one;
  }
};

struct Greatest {
  template <class Value>
  static Value of(Value one, Value other) {
    return one < other ? other : one;
  }
};

// Every value of an image [height, width] becomes the least or greatest of a patch about it; outside there are none.
template <class Which, class Value>
inline void spread_over(std::vector<Value> &image, int32_t width, int32_t height, const Patch &patch, Value outside) {
  if (patch.reach == 0) return;
  const int32_t reach = patch.reach, stride = width + 2 * reach;
  std::vector<Value> padded(static_cast<size_t>(stride) * (height + 2 * reach), outside);
  for (int32_t y = 0; y < height; y++) {
    std::copy_n(&image[static_cast<size_t>(y) * width], width, &padded[static_cast<size_t>(y + reach) * stride + reach]);
  }
  for (int32_t y = 0; y < height; y++) {
    Value *to = &image[static_cast<size_t>(y) * width];
    for (int32_t row = -reach; row <= reach; row++) {
      const Value *line = &padded[static_cast<size_t>(y + reach + row) * stride + reach];
      const int32_t side = patch.sides[row + reach];
      for (int32_t column = -side; column <= side; column++) {
        const Value *from = line + column;
        for (int32_t x = 0; x < width; x++) to[x] = Which::of(to[x], from[x]);
      }
    }
  }
}

// A part of an image: columns and rows from the first to one before the last.
struct Window {
  int32_t left, right, top, bottom;

  int32_t width() const { return right - left; }
  int32_t height() const { return bottom - top; }

  // About the pixels of a mask and a rim of one pixel; empty where there are none.
  static Window about(const std::vector<uint8_t> &mask, int32_t width, int32_t height) {
    Window w{width, 0, height, 0};
    for (int32_t y = 0; y < height; y++) {
      const uint8_t *row = &mask[static_cast<size_t>(y) * width];
      if (std::none_of(row, row + width, [](uint8_t set) { return set != 0; })) continue;
      int32_t first = 0, last = width;
      while (!row[first]) first++;
      while (!row[last - 1]) last--;
      w = {std::min(w.left, first), std::max(w.right, last), std::min(w.top, y), y + 1};
    }
    if (w.right == 0) return {0, 0, 0, 0};
    return {std::max(w.left - 1, 0), std::min(w.right + 1, width), std::max(w.top - 1, 0), std::min(w.bottom + 1, height)};
  }
};

// Distances to the nearest pixel that is not set, along steps to the eight neighbours (Borgefors 1986): whole numbers of
// `kUnit` to a pixel, with steps as long as OpenCV's for masks of 3 x 3.
class Distances {
 public:
  static constexpr int32_t kUnit = 1 << 16;

  Distances(int32_t width, int32_t height)
      : width_(width), height_(height), stride_(width + 2), values_(static_cast<size_t>(stride_) * (height + 2)) {}

  template <class IsSet>
  void measure(const IsSet &is_set) {
    std::fill(values_.begin(), values_.end(), kFar);
    for (int32_t y = 0; y < height_; y++) {
      int32_t *own = line(y);
      const int32_t *above = own - stride_;
      for (int32_t x = 0; x < width_; x++) own[x] = is_set(x, y) ? nearest(above + x) : 0;
      for (int32_t x = 0; x < width_; x++) own[x] = std::min(own[x], own[x - 1] + kStraight);
    }
    for (int32_t y = height_ - 1; y >= 0; y--) {
      int32_t *own = line(y);
      const int32_t *below = own + stride_;
      for (int32_t x = 0; x < width_; x++) own[x] = std::min(own[x], nearest(below + x));
      for (int32_t x = width_ - 1; x >= 0; x--) own[x] = std::min(own[x], own[x + 1] + kStraight);
    }
  }

  const int32_t *row(int32_t y) const { return values_.data() + static_cast<size_t>(y + 1) * stride_ + 1; }

 private:
  static constexpr int32_t kStraight = 62587, kDiagonal = 89738;  // 0.955 and 1.3693
  static constexpr int32_t kFar = 1 << 29;

  int32_t *line(int32_t y) { return values_.data() + static_cast<size_t>(y + 1) * stride_ + 1; }

  // By way of the three neighbours in another row.
  static int32_t nearest(const int32_t *across) {
    return std::min(std::min(across[-1], across[1]) + kDiagonal, across[0] + kStraight);
  }

  const int32_t width_, height_, stride_;
  std::vector<int32_t> values_;
};

// Clears the blobs of a mask [height, width], pixels that touch at sides or corners, that have fewer than `fewest`.
inline void clear_specks(std::vector<uint8_t> &mask, int32_t width, int32_t height, size_t fewest) {
  std::vector<uint8_t> seen(mask.size(), 0);
  std::vector<int32_t> blob;
  const int32_t size = static_cast<int32_t>(mask.size());
  for (int32_t start = 0; start < size; start++) {
    if (!mask[start] || seen[start]) continue;
    blob.assign(1, start);
    seen[start] = 1;
    for (size_t next = 0; next < blob.size(); next++) {
      const int32_t y = blob[next] / width, x = blob[next] % width;
      for (int32_t v = std::max(y - 1, 0); v <= std::min(y + 1, height - 1); v++) {
        for (int32_t u = std::max(x - 1, 0); u <= std::min(x + 1, width - 1); u++) {
          const int32_t beside = v * width + u;
          if (mask[beside] && !seen[beside]) seen[beside] = 1, blob.push_back(beside);
        }
      }
    }
    if (blob.size() < fewest) {
      for (const int32_t pixel : blob) mask[pixel] = 0;
    }
  }
}

}  // namespace forecast
