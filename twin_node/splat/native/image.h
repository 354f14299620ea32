// One image's share of a call: which Gaussians it sees, in depth order, and which tiles each of them touches.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include "interface.h"
#include "projection.h"
#include "workspace.h"

namespace splat {

constexpr int kTile = 16;                                  // pixels along the side of a tile
constexpr int kBlockWidth = 4, kBlockHeight = kLanes / 4;  // pixels of one vector
constexpr int kBlockColumns = kTile / kBlockWidth, kBlockRows = kTile / kBlockHeight;
constexpr int kBlocks = kBlockColumns * kBlockRows;  // per tile, at most 64
constexpr int kChannels = 8;                         // rendered in one pass
constexpr int kGaussiansPerTask = 512;               // fixed, so that sums do not depend on the thread count
constexpr float kExtentSigmas = 3.33f;               // at which gsplat culls
constexpr float kLog2E = 1.4426950408889634f;
constexpr float kLog2AlphaThreshold = -7.99435343685886f;  // log2(1 / 255): fainter than that is not drawn

typedef uint64_t BlockSet;  // bit row * kBlockColumns + column

// A Gaussian in the image: alpha = 2^(log2_opacity - (a dx^2 + b dx dy + c dy^2)), under the threshold beyond the
// reach.
struct Footprint {
  float x, y, a, b, c, log2_opacity, reach_x, reach_y;  // pixels
};

struct alignas(64) Splat {
  Footprint shape;
  float channel[kChannels];
};

struct PixelRect {
  int x0, x1, y0, y1;  // inclusive; empty where x1 < x0 or y1 < y0
  bool empty() const { return x1 < x0 || y1 < y0; }
  void include(int tile_x, int tile_y) {
    x0 = std::min(x0, tile_x);
    x1 = std::max(x1, tile_x + kTile - 1);
    y0 = std::min(y0, tile_y);
    y1 = std::max(y1, tile_y + kTile - 1);
  }
};

// Pixels whose centres lie within a footprint's reach, cut to the image.
inline PixelRect pixel_rect(const Footprint &f, int width, int height) {
  return {static_cast<int>(std::max(0.f, std::ceil(f.x - f.reach_x - 0.5f))),
          static_cast<int>(std::min(width - 1.f, std::floor(f.x + f.reach_x - 0.5f))),
          static_cast<int>(std::max(0.f, std::ceil(f.y - f.reach_y - 0.5f))),
          static_cast<int>(std::min(height - 1.f, std::floor(f.y + f.reach_y - 0.5f)))};
}

struct TileRect {
  int column0, column1, row0, row1;  // inclusive
};

struct Image {
  int width = 0, height = 0, tile_columns = 0, tile_rows = 0;
  Camera camera{};
  int visible = 0;             // splats
  int intersections = 0;       // (splat, tile) pairs
  PixelRect live_rect{};       // of the tiles with live blocks
  Buffer<BlockSet> live;       // [tiles] blocks that hold a pixel to render
  Buffer<int32_t> live_table;  // [(rows + 1) * (columns + 1)] live tiles above and left
  Buffer<Footprint> found;     // [N] packed at the front of each task's share, as are the next two
  Buffer<uint32_t> found_key;  // bits of the depth
  Buffer<int32_t> found_id;
  Buffer<int32_t> found_count;                          // [tasks]
  Buffer<uint32_t> key, place, key_spare, place_spare;  // radix sort; place: row of `found`
  Buffer<Splat> splats;                                 // [visible] in depth order
  Buffer<int32_t> id;                                   // [visible] Gaussian
  Buffer<float> depth;                                  // [visible]
  Buffer<TileRect> reached;                             // [visible] tiles that each comes into
  Buffer<int32_t> row_of;                               // [N] row in `splats`, -1 for none
  Buffer<int32_t> slot_begin;  // [visible + 1] first of a splat's intersections, counted splat by splat
  Buffer<int32_t> tile_begin;  // [tiles + 1] first of a tile's intersections, counted tile by tile
  Buffer<int32_t> tile_end;    // [tiles] behind the last one that a pixel of the tile still saw
  Buffer<int32_t> tile_fill;
  Buffer<int32_t> tile_splat;   // [intersections] row in `splats`, depth order within a tile
  Buffer<int32_t> tile_slot;    // [intersections] the same one's number, counted splat by splat
  Buffer<BlockSet> tile_hit;    // [intersections] blocks of the tile that it covers unfinished pixels of
  Buffer<BlockSet> tile_needed; // [intersections] those of them in which it bears on a gradient that is wanted
  Buffer<float> slot_gradient;  // [intersections, slot stride]
  Buffer<uint8_t> slot_used;    // [intersections] whether its gradient is other than zero
  Buffer<float> transmittance;  // [height, width] what is left behind the last splat

  int tiles() const { return tile_columns * tile_rows; }
  int tasks(int gaussians) const { return (gaussians + kGaussiansPerTask - 1) / kGaussiansPerTask; }

  int live_tiles(int column0, int column1, int row0, int row1) const {
    const int stride = tile_columns + 1;
    return live_table[(row1 + 1) * stride + column1 + 1] - live_table[row0 * stride + column1 + 1] -
           live_table[(row1 + 1) * stride + column0] + live_table[row0 * stride + column0];
  }
};

// Blocks of the tile at (x0, y0) that lie in the image and, with a mask, hold a selected pixel.
inline BlockSet live_blocks(const Image &image, const uint8_t *mask, int x0, int y0) {
  BlockSet live = 0;
  const int columns = std::min(kTile, image.width - x0), rows = std::min(kTile, image.height - y0);
  for (int y = 0; y < rows; y++) {
    const int first_bit = y / kBlockHeight * kBlockColumns;
    for (int x = 0; x < columns; x += kBlockWidth) {
      bool selected = mask == nullptr;
      for (int i = x; i < std::min(x + kBlockWidth, columns) && !selected; i++) {
        selected = mask[static_cast<int64_t>(y0 + y) * image.width + x0 + i] != 0;
      }
      if (selected) live |= BlockSet{1} << (first_bit + x / kBlockWidth);
    }
  }
  return live;
}

// Sets the image's size, its live blocks and the memory that projection writes to.
inline void prepare_image(Image &image, const Request &request, int index) {
  image.width = request.width;
  image.height = request.height;
  image.tile_columns = (request.width + kTile - 1) / kTile;
  image.tile_rows = (request.height + kTile - 1) / kTile;
  image.camera = make_camera(request.viewmats + 16 * index, request.Ks + 9 * index, request.width, request.height);
  const int64_t pixels = static_cast<int64_t>(request.width) * request.height;
  const uint8_t *mask = request.pixel_mask == nullptr ? nullptr : request.pixel_mask + pixels * index;
  const int stride = image.tile_columns + 1;
  image.live.reserve(image.tiles());
  image.live_table.reserve(static_cast<size_t>(stride) * (image.tile_rows + 1));
  std::fill_n(image.live_table.data(), stride, 0);
  image.live_rect = {request.width, -1, request.height, -1};
  for (int row = 0; row < image.tile_rows; row++) {
    image.live_table[(row + 1) * stride] = 0;
    for (int column = 0, in_row = 0; column < image.tile_columns; column++) {
      const BlockSet live = live_blocks(image, mask, column * kTile, row * kTile);
      image.live[row * image.tile_columns + column] = live;
      in_row += live != 0;
      if (live != 0) image.live_rect.include(column * kTile, row * kTile);
      image.live_table[(row + 1) * stride + column + 1] = image.live_table[row * stride + column + 1] + in_row;
    }
  }
  const size_t padded = static_cast<size_t>(image.tasks(request.gaussians)) * kGaussiansPerTask;
  image.found.reserve(padded);
  image.found_key.reserve(padded);
  image.found_id.reserve(padded);
  image.row_of.reserve(padded);
  image.found_count.reserve(image.tasks(request.gaussians));
  image.transmittance.reserve(pixels);
}

// Stable least-significant-digit radix sort of (key, place), 11 bits at a time: equal depths keep the Gaussians' order.
inline void sort_by_key(Image &image, int count) {
  constexpr int kBits = 11, kBuckets = 1 << kBits;
  image.key_spare.reserve(count);
  image.place_spare.reserve(count);
  uint32_t *key = image.key.data(), *place = image.place.data();
  uint32_t *to_key = image.key_spare.data(), *to_place = image.place_spare.data();
  int32_t histogram[3][kBuckets] = {};
  for (int i = 0; i < count; i++) {
    for (int pass = 0; pass < 3; pass++) histogram[pass][key[i] >> (pass * kBits) & (kBuckets - 1)]++;
  }
  for (int pass = 0; pass < 3; pass++) {
    int32_t *begin = histogram[pass];
    const int shift = pass * kBits;
    if (begin[key[0] >> shift & (kBuckets - 1)] == count) continue;
    for (int bucket = 0, total = 0; bucket < kBuckets; bucket++) {
      const int32_t size = begin[bucket];
      begin[bucket] = total;
      total += size;
    }
    for (int i = 0; i < count; i++) {
      const int32_t to = begin[key[i] >> shift & (kBuckets - 1)]++;
      to_key[to] = key[i];
      to_place[to] = place[i];
    }
    std::swap(key, to_key);
    std::swap(place, to_place);
  }
  if (place != image.place.data()) std::copy_n(place, count, image.place.data());
}

// Puts the visible Gaussians of all tasks into one list, nearest first.
inline void order_by_depth(Image &image, int gaussians) {
  const int tasks = image.tasks(gaussians);
  int count = 0;
  for (int task = 0; task < tasks; task++) count += image.found_count[task];
  image.visible = count;
  image.key.reserve(count);
  image.place.reserve(count);
  image.splats.reserve(count);
  image.id.reserve(count);
  image.depth.reserve(count);
  image.reached.reserve(count);
  image.slot_begin.reserve(static_cast<size_t>(count) + 1);
  for (int task = 0, to = 0; task < tasks; task++) {
    const uint32_t first = static_cast<uint32_t>(task) * kGaussiansPerTask;
    for (int i = 0; i < image.found_count[task]; i++, to++) {
      image.key[to] = image.found_key[first + i];
      image.place[to] = first + i;
    }
  }
  if (count > 0) sort_by_key(image, count);
}

// Copies what was found into the splats [begin, end), in depth order, and finds the tiles that they reach.
inline void gather_splats(Image &image, int begin, int end) {
  for (int row = begin; row < end; row++) {
    const uint32_t place = image.place[row];
    const int32_t id = image.found_id[place];
    image.splats[row].shape = image.found[place];
    image.id[row] = id;
    std::memcpy(&image.depth[row], &image.found_key[place], sizeof(float));
    image.row_of[id] = row;
    const PixelRect r = pixel_rect(image.splats[row].shape, image.width, image.height);
    image.reached[row] = {r.x0 / kTile, r.x1 / kTile, r.y0 / kTile, r.y1 / kTile};
  }
}

// Lists the splats of every live tile by counting sort; false where there are too many to count.
inline bool bin_into_tiles(Image &image) {
  const int tiles = image.tiles();
  int32_t *count = image.tile_begin.reserve(static_cast<size_t>(tiles) + 1) + 1;
  std::fill_n(image.tile_begin.data(), tiles + 1, 0);
  int64_t total = 0;
  for (int row = 0; row < image.visible; row++) {
    const TileRect &r = image.reached[row];
    if (total > std::numeric_limits<int32_t>::max() - tiles) return false;
    image.slot_begin[row] = static_cast<int32_t>(total);
    for (int y = r.row0; y <= r.row1; y++) {
      for (int x = r.column0; x <= r.column1; x++) {
        const int tile = y * image.tile_columns + x, here = image.live[tile] != 0;
        count[tile] += here;
        total += here;
      }
    }
  }
  image.slot_begin[image.visible] = image.intersections = static_cast<int32_t>(total);
  for (int tile = 0; tile < tiles; tile++) count[tile] += count[tile - 1];
  image.tile_fill.reserve(tiles);
  image.tile_end.reserve(tiles);
  std::copy_n(image.tile_begin.data(), tiles, image.tile_fill.data());
  image.tile_splat.reserve(total);
  image.tile_slot.reserve(total);
  image.tile_hit.reserve(total);
  image.tile_needed.reserve(total);
  for (int row = 0; row < image.visible; row++) {
    const TileRect &r = image.reached[row];
    int32_t slot = image.slot_begin[row];
    for (int y = r.row0; y <= r.row1; y++) {
      for (int x = r.column0; x <= r.column1; x++) {
        const int tile = y * image.tile_columns + x;
        if (image.live[tile] == 0) continue;
        const int32_t to = image.tile_fill[tile]++;
        image.tile_splat[to] = row;
        image.tile_slot[to] = slot++;
      }
    }
  }
  return true;
}

}  // namespace splat
