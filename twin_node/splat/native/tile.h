// A tile's blocks of pixels, one pixel per lane, in and out of the arrays of an image.
#pragma once

#include "image.h"

namespace splat {

// Channels of the image that one pass over the tiles renders.
struct Pass {
  int first, count;  // of `total`
  int total;
  bool has_depth;  // the last one of the pass is the depth
  bool expected_depth;
  int slot_stride;  // floats per intersection in slot_gradient
};

struct Tile {
  int index, x0, y0;
  const uint8_t *mask;  // of the image, or null
  Tile(const Image &image, int index_, const uint8_t *mask_)
      : index(index_), x0(index_ % image.tile_columns * kTile), y0(index_ / image.tile_columns * kTile), mask(mask_) {}
  int block_x(int block) const { return x0 + block % kBlockColumns * kBlockWidth; }
  int block_y(int block) const { return y0 + block / kBlockColumns * kBlockHeight; }
};

inline bool inside(const Image &image, const Tile &tile, int block) {
  return tile.block_x(block) + kBlockWidth <= image.width && tile.block_y(block) + kBlockHeight <= image.height;
}

// Pixel of a block's first lane.
inline int64_t first_pixel(const Image &image, const Tile &tile, int block) {
  return static_cast<int64_t>(tile.block_y(block)) * image.width + tile.block_x(block);
}

// Calls work(lane, pixel) for the lanes of a block that lie inside the image.
template <class Work>
inline void over_lanes(const Image &image, const Tile &tile, int block, const Work &work) {
  for (int lane = 0; lane < kLanes; lane++) {
    const int x = tile.block_x(block) + lane % kBlockWidth, y = tile.block_y(block) + lane / kBlockWidth;
    if (x < image.width && y < image.height) work(lane, static_cast<int64_t>(y) * image.width + x);
  }
}

// 1 where a lane's pixel is to be rendered, -1 elsewhere.
inline Vec initial_transmittance(const Image &image, const Tile &tile, int block) {
  uint8_t selected[kLanes] = {};
  if (!inside(image, tile, block)) {
    over_lanes(image, tile, block,
               [&](int lane, int64_t pixel) { selected[lane] = tile.mask == nullptr || tile.mask[pixel] != 0; });
  } else if (tile.mask == nullptr) {
    return broadcast(1.f);
  } else {
    const uint8_t *from = tile.mask + first_pixel(image, tile, block);
    for (int row = 0; row < kBlockHeight; row++, from += image.width) {
      std::memcpy(selected + row * kBlockWidth, from, kBlockWidth);
    }
  }
  return __builtin_convertvector(2 * ones_where(selected) - 1, Vec);
}

// One float per pixel of a block; 0 beyond the image.
inline Vec load_plane(const Image &image, const Tile &tile, int block, const float *plane) {
  if (inside(image, tile, block)) return load_fours(plane + first_pixel(image, tile, block), image.width);
  Vec out{};
  over_lanes(image, tile, block, [&](int lane, int64_t pixel) { out[lane] = plane[pixel]; });
  return out;
}

inline void store_plane(const Image &image, const Tile &tile, int block, Vec value, float *plane) {
  if (inside(image, tile, block)) {
    return store_fours(plane + first_pixel(image, tile, block), image.width, value);
  }
  over_lanes(image, tile, block, [&](int lane, int64_t pixel) { plane[pixel] = value[lane]; });
}

// Whether the channels of a pass are all that a block's pixels have, four floats side by side.
template <int C>
inline bool are_quads(const Image &image, const Tile &tile, const Pass &pass, int block) {
  return C == 4 && pass.count == 4 && pass.total == 4 && inside(image, tile, block);
}

// A pass's channels of the pixels of a block, one vector each; 0 beyond the image.
template <int C>
inline void load_pixels(const Image &image, const Tile &tile, const Pass &pass, int block, const float *pixels,
                        Vec *channels) {
  if (are_quads<C>(image, tile, pass, block)) {
    return load_quads(pixels + 4 * first_pixel(image, tile, block), 4 * image.width, channels);
  }
  for (int q = 0; q < C; q++) channels[q] = Vec{};
  over_lanes(image, tile, block, [&](int lane, int64_t pixel) {
    for (int q = 0; q < C && q < pass.count; q++) channels[q][lane] = pixels[pixel * pass.total + pass.first + q];
  });
}

template <int C>
inline void store_pixels(const Image &image, const Tile &tile, const Pass &pass, int block, const Vec *channels,
                         float *pixels) {
  if (are_quads<C>(image, tile, pass, block)) {
    return store_quads(pixels + 4 * first_pixel(image, tile, block), 4 * image.width, channels);
  }
  over_lanes(image, tile, block, [&](int lane, int64_t pixel) {
    for (int q = 0; q < C && q < pass.count; q++) pixels[pixel * pass.total + pass.first + q] = channels[q][lane];
  });
}

}  // namespace splat
