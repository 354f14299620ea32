// Alpha blending of one tile, front to back, and its vector-Jacobian product, one pixel per lane.
//
// Kerbl et al., "3D Gaussian Splatting", 2023, eq. 3; thresholds of gsplat 1.5.3 (RasterizeToPixels3DGS*.cu).
// A lane's transmittance turns negative once its pixel is finished; pixels outside the image or the mask start so.
#pragma once

#include "tile.h"

namespace splat {

constexpr float kTransmittanceCut = 1e-4f;  // a pixel is finished before the splat that would take it here
constexpr float kSmallestAlpha = 1e-10f;    // expected depth = depth / max(alpha, this)
constexpr int kGeometrySums = 6;            // of a slot: sums over pixels of v, v dx, v dy, v dx^2, v dx dy, v dy^2

// Arrays of one image.
struct PixelsOut {
  float *render, *alpha;
  const float *background;  // [channels] or null
  const float *backdrop;    // [H, W, channels] or null, as the next one
  float *seen;
  bool only_live;           // what no splat can reach is there from the last time
};
struct PixelsIn {
  const float *render, *alpha;
  const float *v_render, *v_alpha;  // v_alpha may be null
  const float *backdrop;            // [H, W, channels] or null: v_render is by what is seen before it
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

// What a splat of `alpha` takes of a block's pixels, and what it leaves to those behind.
struct Share {
  Vec behind, weight;
  Mask drawn;
  Share(const Coverage &c, Vec transmittance, Vec alpha, Vec cut) {
    const Vec taken = transmittance * alpha;
    behind = transmittance - taken;
    drawn = both(c.hit, gt(behind, cut));
    weight = select(drawn, taken, Vec{});
  }
};

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
  const Vec left = abs(transmittance), alpha = 1.f - left;
  Vec value[C];
  for (int q = 0; q < C; q++) value[q] = sums[q];
  if (out.background != nullptr) {
    for (int q = 0; q < C && q < pass.count; q++) value[q] += left * out.background[pass.first + q];
  }
  if (pass.has_depth && pass.expected_depth) value[pass.count - 1] /= max(alpha, broadcast(kSmallestAlpha));
  store_plane(image, tile, block, left, image.transmittance.data());
  store_plane(image, tile, block, alpha, out.alpha);
  store_pixels<C>(image, tile, pass, block, value, out.render);
  if (out.backdrop == nullptr) return;
  Vec behind[C];
  load_pixels<C>(image, tile, pass, block, out.backdrop, behind);
  for (int q = 0; q < C; q++) value[q] += (1.f - alpha) * behind[q];
  store_pixels<C>(image, tile, pass, block, value, out.seen);
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
      const Share share(c, transmittance[block], min(exp2_nonpositive(c.exponent), limit), cut);
      for (int q = 0; q < C; q++) sums[block][q] += share.weight * splat.channel[q];
      advance(transmittance[block], share.behind, c.hit, share.drawn, block, alive);
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
  const Mask drawn = gt(out.transmittance, Vec{});
  Vec value[C], suffix{}, v_alpha{};
  load_pixels<C>(image, tile, pass, block, in.v_render, out.v_render);
  load_pixels<C>(image, tile, pass, block, in.render, value);
  if (pass.first == 0 && in.v_alpha != nullptr) v_alpha = load_plane(image, tile, block, in.v_alpha);
  if (in.backdrop != nullptr) {
    Vec behind[C];
    load_pixels<C>(image, tile, pass, block, in.backdrop, behind);
    Vec hidden = out.v_render[0] * behind[0];
    for (int q = 1; q < C; q++) hidden += out.v_render[q] * behind[q];
    v_alpha -= hidden;
  }
  for (int q = 0; q < C; q++) suffix += out.v_render[q] * value[q];
  if (pass.has_depth && pass.expected_depth) {
    const int depth = pass.count - 1;
    const Vec alpha = load_plane(image, tile, block, in.alpha), v_depth = out.v_render[depth];
    const Mask shows = gt(alpha, broadcast(kSmallestAlpha));
    out.v_render[depth] = v_depth / max(alpha, broadcast(kSmallestAlpha));
    v_alpha -= select(shows, v_depth * value[depth] / alpha, Vec{});
  }
  suffix -= load_plane(image, tile, block, image.transmittance.data()) * v_alpha;
  out.suffix = select(drawn, suffix, Vec{});
  for (int q = 0; q < C; q++) out.v_render[q] = select(drawn, out.v_render[q], Vec{});
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

// Finds the blocks in which each splat of a tile matters: those that it or one behind it has hit whose gradient is
// wanted. Returns those of all.
inline BlockSet find_needed(Image &image, const Tile &tile, const Wanted &wanted) {
  const int begin = image.tile_begin[tile.index], end = image.tile_begin[tile.index + 1];
  BlockSet behind = 0;
  for (int at = end - 1; at >= begin; at--) {
    const BlockSet hit = at < image.tile_end[tile.index] ? image.tile_hit[at] : 0;
    if (hit != 0 && wanted(image.id[image.tile_splat[at]])) behind |= hit;
    image.tile_needed[at] = hit & behind;
  }
  return behind;
}

// Fills the slots of one tile's intersections. Front to back: the forward pass's transmittance is met again exactly.
template <int C>
inline void blend_tile_vjp(Image &image, const Tile &tile, const Pass &pass, float max_alpha, const PixelsIn &in,
                           const Wanted &wanted) {
  const int begin = image.tile_begin[tile.index], end = image.tile_begin[tile.index + 1];
  BlockGradient<C> blocks[kBlocks];
  BlockSet alive = find_needed(image, tile, wanted);  // blocks that leave it are hit by no other splat
  for (BlockSet left = alive; left; left &= left - 1) {
    const int block = __builtin_ctzll(left);
    read_block<C>(image, tile, pass, block, in, blocks[block]);
  }
  const Vec limit = broadcast(max_alpha), cut = broadcast(kTransmittanceCut);
  for (int at = begin; at < end; at++) {
    float *slot = &image.slot_gradient[static_cast<size_t>(image.tile_slot[at]) * pass.slot_stride];
    uint8_t &used = image.slot_used[image.tile_slot[at]];
    BlockSet left = image.tile_needed[at];
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
      const Share share(c, g.transmittance, alpha, cut);
      Vec v_weight = g.v_render[0] * splat.channel[0];
      for (int q = 1; q < C; q++) v_weight += g.v_render[q] * splat.channel[q];
      g.suffix -= share.weight * v_weight;
      if (learns) {
        for (int q = 0; q < C; q++) sums.value[kGeometrySums + q] += share.weight * g.v_render[q];
        const Vec v_alpha = g.transmittance * v_weight - g.suffix * reciprocal(1.0f - alpha);
        // alpha = raw where it is not clamped; d raw / d sigma = -raw
        const Vec v_sigma = select(both(share.drawn, le(raw, limit)), -(raw * v_alpha), Vec{});
        sums.add_geometry(v_sigma, c.dx, c.dy);
      }
      advance(g.transmittance, share.behind, c.hit, share.drawn, block, alive);
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
