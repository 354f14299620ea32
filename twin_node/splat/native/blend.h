// Alpha blending of one tile, front to back, and its vector-Jacobian product, one pixel per lane.
//
// Kerbl et al., "3D Gaussian Splatting", 2023, eq. 3; thresholds of gsplat 1.5.3 (RasterizeToPixels3DGS*.cu).
// A lane's transmittance turns negative once its pixel is finished; pixels outside the image or the mask start so.
#pragma once

#include "image.h"

namespace splat {

constexpr float kTransmittanceCut = 1e-4f;  // a pixel is finished before the splat that would take it here
constexpr float kSmallestAlpha = 1e-10f;    // expected depth = depth / max(alpha, this)
constexpr int kGeometrySums = 6;            // of a slot: sums over pixels of v, v dx, v dy, v dx^2, v dx dy, v dy^2

// Channels of the image that one pass over the tiles renders.
struct Pass {
  int first, count;  // of `total`
  int total;
  bool has_depth;  // the last one of the pass is the depth
  bool expected_depth;
  int slot_stride;  // floats per intersection in slot_gradient
};

// Arrays of one image.
struct PixelsOut {
  float *render, *alpha;
  const float *background;  // [channels] or null
  bool only_live;           // what no splat can reach is there from the last time
};
struct PixelsIn {
  const float *render, *alpha;
  const float *v_render, *v_alpha;  // v_alpha may be null
};

// Pixel centres of a tile's blocks, relative to the tile's corner.
struct PixelGrid {
  Vec x[kBlockColumns], y[kBlockRows];
  PixelGrid() {
    for (int lane = 0; lane < kLanes; lane++) {
      for (int i = 0; i < kBlockColumns; i++) x[i][lane] = i * kBlockWidth + lane % kBlockWidth + 0.5f;
      for (int i = 0; i < kBlockRows; i++) y[i][lane] = i * kBlockHeight + lane / kBlockWidth + 0.5f;
    }
  }
};

// A tile's 4x4 pixel cells, one per lane: the smallest patches that a footprint is tested against.
constexpr int kCell = 4, kCells = kTile / kCell * (kTile / kCell), kCellVectors = kCells / kLanes;
struct CellGrid {
  Vec left[kCellVectors], top[kCellVectors];  // first pixel centres, relative to the tile's corner
  CellGrid() {
    for (int cell = 0; cell < kCells; cell++) {
      left[cell / kLanes][cell % kLanes] = cell % (kTile / kCell) * kCell + 0.5f;
      top[cell / kLanes][cell % kLanes] = cell / (kTile / kCell) * kCell + 0.5f;
    }
  }
};
inline const PixelGrid kPixels;
inline const CellGrid kCellCorners;

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

// 1 where a lane's pixel is to be rendered, -1 elsewhere.
inline Vec initial_transmittance(const Image &image, const Tile &tile, int block) {
  if (tile.mask == nullptr && inside(image, tile, block)) return broadcast(1.f);
  Vec out;
  for (int lane = 0; lane < kLanes; lane++) {
    const int x = tile.block_x(block) + lane % kBlockWidth, y = tile.block_y(block) + lane / kBlockWidth;
    const bool selected = x < image.width && y < image.height &&
                          (tile.mask == nullptr || tile.mask[static_cast<int64_t>(y) * image.width + x] != 0);
    out[lane] = selected ? 1.f : -1.f;
  }
  return out;
}

// A footprint in the coordinates of one tile.
struct LocalFootprint {
  Vec x, y, a, b, c, peak;
  LocalFootprint(const Footprint &f, const Tile &tile)
      : x(broadcast(f.x - static_cast<float>(tile.x0))),
        y(broadcast(f.y - static_cast<float>(tile.y0))),
        a(broadcast(f.a)),
        b(broadcast(f.b)),
        c(broadcast(f.c)),
        peak(broadcast(f.log2_opacity)) {}
};

// Cells in which the footprint's alpha reaches the threshold anywhere, exactly but for a margin against rounding.
//
// The smallest a dx^2 + b dx dy + c dy^2 over a rectangle without the centre lies on an edge that faces the centre.
inline uint32_t cells_reached(const Footprint &f, const LocalFootprint &local) {
  const float limit = (f.log2_opacity - kLog2AlphaThreshold) * 1.002f + 0.01f;
  const Vec x_of_y = broadcast(-0.5f * f.b / f.a), y_of_x = broadcast(-0.5f * f.b / f.c), most = broadcast(limit);
  uint32_t reached = 0;
  for (int i = 0; i < kCellVectors; i++) {
    const Vec left = kCellCorners.left[i] - local.x, right = left + (kCell - 1.f);
    const Vec top = kCellCorners.top[i] - local.y, bottom = top + (kCell - 1.f);
    const Vec near_x = min(max(Vec{}, left), right), near_y = min(max(Vec{}, top), bottom);
    const Vec best_y = min(max(y_of_x * near_x, top), bottom), best_x = min(max(x_of_y * near_y, left), right);
    const Vec on_side = near_x * (local.a * near_x + local.b * best_y) + local.c * best_y * best_y;
    const Vec on_floor = best_x * (local.a * best_x + local.b * near_y) + local.c * near_y * near_y;
    reached |= bits(le(min(on_side, on_floor), most)) << (i * kLanes);
  }
  return reached;
}

// The blocks that make up cells: with fewer than 16 lanes a cell is several rows of blocks.
inline BlockSet blocks_of_cells(uint32_t cells) {
  if constexpr (kBlockHeight == kCell) return cells;
  constexpr int kRows = kCell / kBlockHeight, kAcross = kTile / kCell;
  BlockSet blocks = 0;
  for (int row = 0; row < kTile / kCell; row++) {
    const BlockSet across = cells >> (row * kAcross) & ((1u << kAcross) - 1);
    for (int i = 0; i < kRows; i++) blocks |= across << ((row * kRows + i) * kAcross);
  }
  return blocks;
}

// One footprint evaluated at one block of pixels.
struct Coverage {
  Vec dx, dy, exponent;  // exponent: log2 of the unclamped alpha
  Mask hit;              // above the threshold, in pixels that are not finished
};

inline Coverage cover(const LocalFootprint &f, int block, Vec transmittance) {
  Coverage out;
  out.dx = f.x - kPixels.x[block % kBlockColumns];
  out.dy = f.y - kPixels.y[block / kBlockColumns];
  out.exponent = f.peak - (out.dx * (f.a * out.dx + f.b * out.dy) + f.c * out.dy * out.dy);
  out.hit =
      both(both(ge(out.exponent, broadcast(kLog2AlphaThreshold)), le(out.exponent, f.peak)), gt(transmittance, Vec{}));
  return out;
}

// Moves a block's transmittance behind a splat; a block with no unfinished pixel leaves `alive`.
inline void advance(Vec &transmittance, Vec behind, Mask hit, Mask drawn, int block, BlockSet &alive) {
  const Mask finished = first_only(hit, drawn);
  Vec next = select(drawn, behind, transmittance);
  if (__builtin_expect(any(finished), 0)) {
    next = select(finished, -transmittance, next);
    if (!any(gt(next, Vec{}))) alive &= ~(BlockSet{1} << block);
  }
  transmittance = next;
}

template <int C>
inline void write_block(Image &image, const Tile &tile, const Pass &pass, int block, Vec transmittance, const Vec *sums,
                        const PixelsOut &out) {
  float sum[C][kLanes];
  for (int q = 0; q < C; q++) store(sum[q], sums[q]);
  for (int lane = 0; lane < kLanes; lane++) {
    const int x = tile.block_x(block) + lane % kBlockWidth, y = tile.block_y(block) + lane / kBlockWidth;
    if (x >= image.width || y >= image.height) continue;
    const int64_t pixel = static_cast<int64_t>(y) * image.width + x;
    const float left = std::fabs(transmittance[lane]), alpha = 1.f - left;
    image.transmittance[pixel] = left;
    out.alpha[pixel] = alpha;
    float *to = out.render + pixel * pass.total + pass.first;
    for (int q = 0; q < C && q < pass.count; q++) {
      to[q] = sum[q][lane] + (out.background != nullptr ? left * out.background[pass.first + q] : 0.f);
    }
    if (pass.has_depth && pass.expected_depth) to[pass.count - 1] /= std::max(alpha, kSmallestAlpha);
  }
}

// Renders channels [first, first + count) of one tile, count <= C.
template <int C>
inline void blend_tile(Image &image, const Tile &tile, const Pass &pass, float max_alpha, const PixelsOut &out) {
  Vec transmittance[kBlocks], sums[kBlocks][C];
  BlockSet alive = image.live[tile.index];
  const BlockSet rendered = alive;
  for (int block = 0; block < kBlocks; block++) {
    for (int q = 0; q < C; q++) sums[block][q] = Vec{};
    transmittance[block] = (rendered >> block & 1) ? initial_transmittance(image, tile, block) : broadcast(-1.f);
  }
  const Vec limit = broadcast(max_alpha), cut = broadcast(kTransmittanceCut);
  int at = image.tile_begin[tile.index];
  for (const int end = image.tile_begin[tile.index + 1]; at < end && alive; at++) {
    const Splat &splat = image.splats[image.tile_splat[at]];
    const LocalFootprint footprint(splat.shape, tile);
    BlockSet hit = 0;
    for (BlockSet left = blocks_of_cells(cells_reached(splat.shape, footprint)) & alive; left; left &= left - 1) {
      const int block = __builtin_ctzll(left);
      const Coverage c = cover(footprint, block, transmittance[block]);
      if (!any(c.hit)) continue;
      hit |= left & -left;
      const Vec alpha = min(exp2_nonpositive(c.exponent), limit);
      const Vec drawn_weight = transmittance[block] * alpha, behind = transmittance[block] - drawn_weight;
      const Mask drawn = both(c.hit, gt(behind, cut));
      const Vec weight = select(drawn, drawn_weight, Vec{});
      for (int q = 0; q < C; q++) sums[block][q] += weight * splat.channel[q];
      advance(transmittance[block], behind, c.hit, drawn, block, alive);
    }
    image.tile_hit[at] = hit;
  }
  image.tile_end[tile.index] = at;
  for (int block = 0; block < kBlocks; block++) {
    if (out.only_live && !(rendered >> block & 1)) continue;
    write_block<C>(image, tile, pass, block, transmittance[block], sums[block], out);
  }
}

// A block's pixels before the first splat, as the backward pass sees them.
template <int C>
struct BlockGradient {
  Vec transmittance;
  Vec suffix;  // what is yet to come, weighted by v: the sum over splats behind of weight * color . v, and alpha's part
  Vec v_render[C];
};

template <int C>
inline void read_block(const Image &image, const Tile &tile, const Pass &pass, int block, const PixelsIn &in,
                       BlockGradient<C> &out) {
  out.transmittance = initial_transmittance(image, tile, block);
  float suffix[kLanes] = {}, v_render[C][kLanes] = {};
  for (int lane = 0; lane < kLanes; lane++) {
    if (!(out.transmittance[lane] > 0.f)) continue;
    const int x = tile.block_x(block) + lane % kBlockWidth, y = tile.block_y(block) + lane / kBlockWidth;
    const int64_t pixel = static_cast<int64_t>(y) * image.width + x;
    const float *v = in.v_render + pixel * pass.total + pass.first,
                *value = in.render + pixel * pass.total + pass.first;
    float v_alpha = pass.first == 0 && in.v_alpha != nullptr ? in.v_alpha[pixel] : 0.f;
    for (int q = 0; q < C && q < pass.count; q++) {
      v_render[q][lane] = v[q];
      suffix[lane] += v[q] * value[q];
    }
    if (pass.has_depth && pass.expected_depth) {
      const int depth = pass.count - 1;
      const float alpha = in.alpha[pixel];
      v_render[depth][lane] = v[depth] / std::max(alpha, kSmallestAlpha);
      if (alpha > kSmallestAlpha) v_alpha -= v[depth] * value[depth] / alpha;
    }
    suffix[lane] -= image.transmittance[pixel] * v_alpha;
  }
  out.suffix = load(suffix);
  for (int q = 0; q < C; q++) out.v_render[q] = load(v_render[q]);
}

// Sums over the pixels of one tile and splat: the six of the geometry, then weight * v per channel.
template <int C>
struct SlotSums {
  static constexpr int kPadded = (kGeometrySums + C + 3) / 4 * 4;
  Vec value[kPadded];
  SlotSums() {
    for (auto &v : value) v = Vec{};
  }
  void add_geometry(Vec v, Vec dx, Vec dy) {
    const Vec vx = v * dx, vy = v * dy;
    value[0] += v;
    value[1] += vx;
    value[2] += vy;
    value[3] += vx * dx;
    value[4] += vx * dy;
    value[5] += vy * dy;
  }
  void write(const Pass &pass, float *slot) const {
    float sums[kPadded];
    for (int i = 0; i < kPadded; i += 4) sum4(value[i], value[i + 1], value[i + 2], value[i + 3], sums + i);
    for (int i = 0; i < kGeometrySums; i++) slot[i] = (pass.first > 0 ? slot[i] : 0.f) + sums[i];
    for (int q = 0; q < C && q < pass.count; q++) slot[kGeometrySums + pass.first + q] = sums[kGeometrySums + q];
  }
};

inline void clear_slot(const Pass &pass, float *slot, uint8_t &used) {
  if (pass.first == 0) {
    std::fill_n(slot, kGeometrySums, 0.f);
    used = 0;
  }
  std::fill_n(slot + kGeometrySums + pass.first, pass.count, 0.f);
}

// Which Gaussians a gradient is wanted of.
struct Wanted {
  int32_t first_row;
  const uint8_t *learns;  // [N] or null
  bool operator()(int32_t id) const { return id >= first_row && (learns == nullptr || learns[id] != 0); }
};

// Fills the slots of one tile's intersections. Front to back: the forward pass's transmittance is met again exactly.
template <int C>
inline void blend_tile_vjp(Image &image, const Tile &tile, const Pass &pass, float max_alpha, const PixelsIn &in,
                           const Wanted &wanted) {
  const int begin = image.tile_begin[tile.index], end = image.tile_begin[tile.index + 1];
  int seen = image.tile_end[tile.index];  // behind the last one that is seen and wanted: what hides it counts too
  while (seen > begin && !wanted(image.id[image.tile_splat[seen - 1]])) seen--;
  BlockGradient<C> blocks[kBlocks];
  BlockSet alive = seen > begin ? image.live[tile.index] : 0;  // blocks that leave it are hit by no other splat
  for (BlockSet left = alive; left; left &= left - 1) {
    const int block = __builtin_ctzll(left);
    read_block<C>(image, tile, pass, block, in, blocks[block]);
  }
  const Vec limit = broadcast(max_alpha), cut = broadcast(kTransmittanceCut);
  for (int at = begin; at < end; at++) {
    float *slot = &image.slot_gradient[static_cast<size_t>(image.tile_slot[at]) * pass.slot_stride];
    uint8_t &used = image.slot_used[image.tile_slot[at]];
    BlockSet left = at < seen ? image.tile_hit[at] : 0;
    if (left == 0) {
      clear_slot(pass, slot, used);
      continue;
    }
    const Splat &splat = image.splats[image.tile_splat[at]];
    const LocalFootprint footprint(splat.shape, tile);
    const bool learns = wanted(image.id[image.tile_splat[at]]);
    SlotSums<C> sums;
    for (; left; left &= left - 1) {
      const int block = __builtin_ctzll(left);
      BlockGradient<C> &g = blocks[block];
      const Coverage c = cover(footprint, block, g.transmittance);
      const Vec raw = exp2_nonpositive(c.exponent), alpha = min(raw, limit);
      const Vec drawn_weight = g.transmittance * alpha, behind = g.transmittance - drawn_weight;
      const Mask drawn = both(c.hit, gt(behind, cut));
      const Vec weight = select(drawn, drawn_weight, Vec{});
      Vec v_weight = g.v_render[0] * splat.channel[0];
      for (int q = 1; q < C; q++) v_weight += g.v_render[q] * splat.channel[q];
      g.suffix -= weight * v_weight;
      if (learns) {
        for (int q = 0; q < C; q++) sums.value[kGeometrySums + q] += weight * g.v_render[q];
        const Vec v_alpha = g.transmittance * v_weight - g.suffix * reciprocal(1.0f - alpha);
        // alpha = raw where it is not clamped; d raw / d sigma = -raw
        const Vec v_sigma = select(both(drawn, le(raw, limit)), -(raw * v_alpha), Vec{});
        sums.add_geometry(v_sigma, c.dx, c.dy);
      }
      advance(g.transmittance, behind, c.hit, drawn, block, alive);
    }
    if (learns) {
      sums.write(pass, slot);
      used = 1;
    } else {
      clear_slot(pass, slot, used);
    }
  }
}

}  // namespace splat
